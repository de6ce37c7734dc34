"""Recipe of a data set: parameters of its sections, their distributions, and the files that are written.

A distribution is uniform, normal, a choice, a grid, or one value.
"""

import hashlib
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np

from sarmitsuba.analysis.label_classes import class_table
from sarmitsuba.core.constants import DEFAULT_WINDOW
from sarmitsuba.core.errors import DataError, SarmitsubaError
from sarmitsuba.core.parameters import (
    Param,
    ParamTable,
    Value,
    did_you_mean,
    float_value,
    is_finite,
    one_line,
    string_value,
)
from sarmitsuba.core.registry import Registry
from sarmitsuba.files.table_file import read_table
from sarmitsuba.loading.library import scenes_dir
from sarmitsuba.loading.tables import INTEGRATOR
from sarmitsuba.machine.regular_files import read_bytes
from sarmitsuba.radar.description import SENSOR
from sarmitsuba.radar.film import FILM

_MOST = 10_000_000


def _whole(name: str, default: int, doc: str, low: int, high: int) -> Param:
    return Param(name, "integer", default, doc, "", low, high, python=True)


def _number(
    name: str, default: float, doc: str, unit: str, low: float, high: float, *, positive: bool = False
) -> Param:
    return Param(name, "float", default, doc, unit, low, high, positive, python=True)


# layers that boxes of echoes are made of
ECHO_BOXES = ("instance", "instance_here")


def _words(text: str) -> tuple[str, ...]:
    """Words between commas."""
    return tuple(word.strip() for word in text.split(",") if word.strip())


def _word(name: str, default: str, doc: str, choices: tuple[str, ...] = ()) -> Param:
    return Param(name, "string", default, doc, choices=choices, python=True)


def _flag(name: str, doc: str) -> Param:
    return Param(name, "boolean", False, doc, python=True)


def _table(section: str, doc: str, *params: Param) -> ParamTable:
    return ParamTable(section, "section", doc, params, DataError)


# [dataset], [parts], [images], [labels] and [output] hold values, the other sections distributions
DATASET = _table(
    "dataset",
    "Number of samples, scenes and random numbers.",
    _word("title", "", "one line for the data card"),
    _word("licence", "", "licence of the data set, for the data card"),
    _whole("samples", 100, "number of simulated images", 1, _MOST),
    _whole("views", 1, "images of each scene, each by another draw of the radar", 1, _MOST),
    _whole("seed", 0, "seed of all draws", 0, 2**31 - 1),
    _whole("attempts", 20, "draws of a sample that may fail before the run ends", 1, 1000),
    _whole("error_every", 0, "sampling error is measured on every so many samples; 0 = on none", 0, _MOST),
)
PARTS = _table(
    "parts",
    "Shares of training, validation and test.",
    _word("by", "scene", "whether parts share no mesh, or no scene", ("instance", "scene")),
    _number("train", 0.7, "share of the training part", "", 0.0, 1.0),
    _number("validation", 0.15, "share of the validation part", "", 0.0, 1.0),
    _number("test", 0.15, "share of the test part", "", 0.0, 1.0),
)
IMAGES = _table(
    "images",
    "Pixels, tiles and focusing.",
    _whole("pixels_azimuth", 128, "rows of a simulated image", 8, 65536),
    _whole("pixels_range", 128, "columns of a simulated image", 8, 65536),
    _whole("tile_azimuth", 0, "rows of a tile; 0 = the whole image", 0, 65536),
    _whole("tile_range", 0, "columns of a tile; 0 = the whole image", 0, 65536),
    _whole("overlap", 0, "least number of rows and columns that neighbouring tiles share", 0, 65535),
)
LABELLING = _table(
    "labels",
    "Labels of every pixel, in docs/labels.md.",
    _word("layers", "", "names of layers, separated by commas"),
    _word(
        "boxes",
        "shapes",
        "what COCO's boxes and masks bound: surfaces, or their echoes",
        ("shapes", "echoes"),
    ),
    _word("mechanisms", "", "of these echoes, separated by commas; none named = all"),
)
RESULTS = _table(
    "output",
    "What is written beside images, labels and drawn values.",
    _flag("raw", "also the range-compressed echoes of every sample, in a file each"),
    _flag("pictures", "also a picture of every image, PNG, as COCO's detectors read"),
    _number("picture_range_db", 45.0, "range of a picture below its brightest thousandth", "dB", 1.0, 200.0),
)
FOCUSING = _table(
    "focusing",
    "Focusing of raw and hybrid samples, windows of all.",
    _word("window", DEFAULT_WINDOW, "in range and azimuth"),
    _word("focuser", "auto", "of raw data"),
    _word("autofocus", "none", "of raw data"),
)
SCENE = _table(
    "scene",
    "A scene file in place of drawn shapes.",
    _word("file", "", "scene file, or the name of a shipped scene"),
)
GROUND = _table(
    "ground",
    "Ground of a drawn scene.",
    _word("material", "soil", "named material, or none for no ground"),
    _number("rms_height", 0.0, "roughness; 0 = typical of the material", "m", 0.0, 10.0),
    _number("relief", 0.0, "standard deviation of the ground's height; 0 = level ground", "m", 0.0, 100.0),
    _number("relief_length", 10.0, "correlation length of the height", "m", 0.1, 1e4),
    _number("extent", 60.0, "side of ground with relief; level ground goes on", "m", 1.0, 1e4),
)


def _declare_places(section: str, doc: str, count: int, spread: float, *params: Param) -> ParamTable:
    return _table(
        section,
        doc,
        _whole("count", count, "number of shapes", 0, 10_000),
        _number(
            "spread", spread, "side of the square about the image's centre where they stand", "m", 0.0, 1e5
        ),
        _number("heading_deg", 0.0, "direction of their x axis, from east to north", "deg", -720.0, 720.0),
        _number("gap", 0.3, "least distance from other shapes in plan", "m", 0.0, 1e4),
        *params,
    )


OBJECTS = _declare_places(
    "objects",
    "Shapes from a folder of meshes, each an instance.",
    1,
    0.0,
    _word("meshes", "targets", "folder of meshes, or the name of a shipped one"),
    _word("classes", "folder", "class of a mesh: its folder's name, or its own", ("folder", "mesh")),
    _word("material", "pec", "named material"),
    _number("rms_height", 0.0, "roughness; 0 = typical of the material", "m", 0.0, 10.0),
    _number("scale", 1.0, "factor of all lengths", "", 1e-3, 1e3),
)
WALLS = _declare_places(
    "walls",
    "Straight walls.",
    0,
    30.0,
    _number("length", 6.0, "length", "m", 0.01, 1e4),
    _number("height", 2.0, "height", "m", 0.01, 1e3),
    _number("thickness", 0.25, "thickness", "m", 0.001, 100.0),
    _word("material", "brick", "named material"),
)
CLUTTER = _declare_places(
    "clutter",
    "Boxes, such as crates and stones.",
    0,
    30.0,
    _number("size", 0.8, "mean side", "m", 0.01, 100.0),
    _number("irregularity", 0.3, "standard deviation of the sides over their mean", "", 0.0, 0.5),
    _word("material", "wood", "named material"),
)
TREES = _declare_places(
    "trees",
    "Trees: crowns that waves go through.",
    0,
    30.0,
    _number("radius", 2.0, "radius of the crown", "m", 0.05, 50.0),
    _number("height", 6.0, "height", "m", 0.1, 100.0),
    _word("preset", "deciduous_summer", "medium of the crown"),
)
# sections of values, and of distributions
VALUES = {t.plugin: t for t in (DATASET, PARTS, IMAGES, LABELLING, RESULTS)}
DRAWS = {
    "radar": SENSOR,
    "film": FILM,
    "tracing": INTEGRATOR,
    **{t.plugin: t for t in (FOCUSING, SCENE, GROUND, OBJECTS, WALLS, CLUTTER, TREES)},
}
# parameters of objects that are not drawn: they say which meshes there are
FIXED_OF_OBJECTS = ("meshes", "classes")
# given by [images], by the draw, and by the recipe's own way of measuring errors
NOT_DRAWN = {
    "film": {
        "pixels_azimuth": "give it in [images]",
        "pixels_range": "give it in [images]",
        "image_extent_azimuth": "give pixels_azimuth in [images], and pixel_spacing_azimuth",
        "image_extent_range": "give pixels_range in [images], and pixel_spacing_range",
    },
    "tracing": {
        "keep_subsets": "give error_every in [dataset]",
        "keep_orders": "bounce orders are layers of labels",
        "target_error_db": "samples are made in one pass; give ray_spacing",
        "time_limit": "samples with a time limit would not be repeatable",
        "seed": "give seed in [dataset]",
    },
}


# trials of a normal draw within the parameter's bounds; more are needed only where these hold less than 1 %
_TRIALS = 1000
# most levels of a grid, and values of a choice
_MOST_LEVELS = 1_000_000


class DrawnValue(ABC):
    """Distribution of one parameter, checked against its bounds."""

    @property
    def levels(self) -> int:
        """Number of values of a grid, gone through in turn; 1: drawn at random."""
        return 1

    @property
    def texts(self) -> tuple[str, ...]:
        """All texts that may be drawn."""
        return ()

    @abstractmethod
    def draw(self, generator: np.random.Generator, level: int) -> Value | None:
        """One value; ``level`` is the place in a grid, 0 to ``levels - 1``."""

    @abstractmethod
    def __str__(self) -> str:
        """The distribution, for the data card."""


@dataclass(frozen=True)
class Fixed(DrawnValue):
    """One value for all draws."""

    value: Value | None

    def draw(self, generator: np.random.Generator, level: int) -> Value | None:
        """See the base class."""
        return self.value

    @property
    def texts(self) -> tuple[str, ...]:
        """See the base class."""
        return (self.value,) if isinstance(self.value, str) else ()

    def __str__(self) -> str:
        return "automatic" if self.value is None else _format_value(self.value)


@dataclass(frozen=True)
class Uniform(DrawnValue):
    """Equal density from ``low`` to ``high``; integers with both ends."""

    low: float
    high: float
    whole: bool

    def draw(self, generator: np.random.Generator, level: int) -> Value:
        """See the base class."""
        if self.whole:
            return int(generator.integers(int(self.low), int(self.high), endpoint=True))
        return float(generator.uniform(self.low, self.high))

    def __str__(self) -> str:
        return f"uniform from {self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class Normal(DrawnValue):
    """Normal distribution cut off at the parameter's bounds; integers are rounded."""

    mean: float
    sigma: float
    low: float
    high: float
    whole: bool

    def draw(self, generator: np.random.Generator, level: int) -> Value:
        """See the base class.

        Raises
        ------
        DataError
            A thousand values lie out of bounds.
        """
        for _ in range(_TRIALS):
            value = float(generator.normal(self.mean, self.sigma))
            value = float(round(value)) if self.whole else value
            if self.low <= value <= self.high:
                return int(value) if self.whole else value
        raise DataError(f"{self}: {_TRIALS} draws lie outside {self.low:g} to {self.high:g}")

    def __str__(self) -> str:
        return f"normal of mean {self.mean:g} and standard deviation {self.sigma:g}"


@dataclass(frozen=True)
class Choice(DrawnValue):
    """Equally probable values."""

    values: tuple[Value | None, ...]

    def draw(self, generator: np.random.Generator, level: int) -> Value | None:
        """See the base class."""
        return self.values[int(generator.integers(len(self.values)))]

    @property
    def texts(self) -> tuple[str, ...]:
        """See the base class."""
        return tuple(value for value in self.values if isinstance(value, str))

    def __str__(self) -> str:
        return f"one of {', '.join(_format_value(v) for v in self.values)}"


@dataclass(frozen=True)
class Grid(DrawnValue):
    """Equally spaced values with both ends, each in turn."""

    low: float
    high: float
    count: int
    whole: bool

    @property
    def levels(self) -> int:
        """See the base class."""
        return self.count

    def draw(self, generator: np.random.Generator, level: int) -> Value:
        """See the base class."""
        share = level / (self.count - 1) if self.count > 1 else 0.0
        value = self.low + share * (self.high - self.low)
        return round(value) if self.whole else value

    def __str__(self) -> str:
        return f"grid of {self.count} values from {self.low:g} to {self.high:g}"


class Distribution(ABC):
    """Kind of distribution, by its name in a recipe: ``{ uniform = [0, 360] }``.

    Attributes
    ----------
    name : in a recipe
    form : of its list
    """

    name: ClassVar[str]
    form: ClassVar[str]

    @abstractmethod
    def read(self, values: Sequence[object], param: Param, where: str) -> DrawnValue:
        """The distribution of a parameter from the list in a recipe.

        Raises
        ------
        DataError
            A value is out of the parameter's bounds or of the wrong type, or the list has another form.
        """

    def _numbers(self, values: Sequence[object], param: Param, where: str, checked: int) -> list[float]:
        """Numbers of a list; the first ``checked`` are values of the parameter."""
        shown = one_line(list(values))
        if param.kind not in ("float", "integer", "integer or auto"):
            raise DataError(f"{where}: {param.name} is of type {param.kind}; draw it by choice = [...]")
        if len(values) != self.form.count(",") + 1:
            raise DataError(f"{where}: {param.name}: {self.name} = {shown} is not of the form {self.form}")
        out: list[float] = []
        for i, value in enumerate(values):
            if isinstance(value, bool) or not isinstance(value, int | float) or not is_finite(value):
                raise DataError(f"{where}: {param.name}: {self.name} = {shown} does not hold numbers alone")
            out.append(float(value))
            if i < checked:
                param.convert(value, where, DataError)
        return out


DISTRIBUTIONS: Registry[Distribution] = Registry("distribution", Distribution)


class _UniformKind(Distribution):
    name, form = "uniform", "[low, high]"

    def read(self, values: Sequence[object], param: Param, where: str) -> DrawnValue:
        """See the base class."""
        low, high = self._numbers(values, param, where, 2)
        if low > high:
            raise DataError(
                f"{where}: {param.name}: uniform = [{low:g}, {high:g}] falls; give the lower end first"
            )
        return Uniform(low, high, param.kind != "float")


class _NormalKind(Distribution):
    name, form = "normal", "[mean, standard deviation]"

    def read(self, values: Sequence[object], param: Param, where: str) -> DrawnValue:
        """See the base class."""
        mean, sigma = self._numbers(values, param, where, 1)
        if sigma < 0.0:
            raise DataError(
                f"{where}: {param.name}: normal has the standard deviation {sigma:g}; give at least 0"
            )
        # where the minimum itself is no value, the next number above it is
        low = math.nextafter(param.minimum, math.inf) if param.positive else param.minimum
        return Normal(mean, sigma, low, param.maximum, param.kind != "float")


class _ChoiceKind(Distribution):
    name, form = "choice", "[value, value ...]"

    def read(self, values: Sequence[object], param: Param, where: str) -> DrawnValue:
        """See the base class."""
        if not 1 <= len(values) <= _MOST_LEVELS:
            raise DataError(f"{where}: {param.name}: choice of {len(values)} values; give at least one")
        return Choice(tuple(param.convert(value, where, DataError) for value in values))


class _GridKind(Distribution):
    name, form = "grid", "[first, last, number of values]"

    def read(self, values: Sequence[object], param: Param, where: str) -> DrawnValue:
        """See the base class."""
        low, high, count = self._numbers(values, param, where, 2)
        if count != round(count) or not 1 <= count <= _MOST_LEVELS:
            raise DataError(
                f"{where}: {param.name}: a grid of {count:g} values; give an integer from 1 to {_MOST_LEVELS}"
            )
        return Grid(low, high, int(count), param.kind != "float")


for _kind in (_UniformKind(), _NormalKind(), _ChoiceKind(), _GridKind()):
    DISTRIBUTIONS.register(_kind)


def read_drawn(value: object, param: Param, where: str) -> DrawnValue:
    """Distribution of a parameter as a recipe gives it: a value, or a table of one distribution.

    Raises
    ------
    DataError
        One line: an unknown distribution, a wrong type, or a value out of bounds.
    """
    param = replace(param, python=True)
    if not isinstance(value, Mapping):
        return Fixed(param.convert(value, where, DataError))
    known = DISTRIBUTIONS.names
    if len(value) != 1:
        raise DataError(f"{where}: {param.name} = {one_line(dict(value))}: give one of {', '.join(known)}")
    ((name, values),) = value.items()
    if name not in DISTRIBUTIONS:
        guess = did_you_mean(name, known) or f"; choose one of {', '.join(known)}"
        raise DataError(f'{where}: {param.name}: unknown distribution "{one_line(name)}"{guess}')
    kind = DISTRIBUTIONS[name]
    if not isinstance(values, list | tuple):
        raise DataError(
            f"{where}: {param.name}: {name} = {one_line(values)} is no list; give {name} = {kind.form}"
        )
    return kind.read(values, param, where)


def _format_value(value: Value | None) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:g}" if isinstance(value, float) else str(value)


_MOST_BYTES = 1 << 20
PART_NAMES = ("train", "validation", "test")
# most files of one kind in a folder, whose list names them all
_MOST_FILES = 50_000
# section of names of shapes and their classes
CLASSES = "classes"


class RecipeError(DataError):
    """A recipe that no draw can satisfy."""


@dataclass(frozen=True, eq=False)
class RecipeSection:
    """Distributions of one section.

    Parameters
    ----------
    name : of the section
    drawn : by parameter
    given : names of the parameters in the recipe
    """

    name: str
    drawn: Mapping[str, DrawnValue]
    given: frozenset[str]

    def draw(self, generator: np.random.Generator, levels: Mapping[str, int]) -> dict[str, Value | None]:
        """One value of every parameter; ``levels`` are places in grids by ``section.parameter``."""
        return {
            name: kind.draw(generator, levels.get(f"{self.name}.{name}", 0))
            for name, kind in self.drawn.items()
        }

    def text(self, name: str) -> str:
        """Text that is not drawn."""
        kind = self.drawn[name]
        assert isinstance(kind, Fixed)
        return str(kind.value)


@dataclass(frozen=True, eq=False)
class Recipe:
    """Recipe as read.

    Parameters
    ----------
    path : of its file
    values : of the sections without distributions, by section and name
    sections : with distributions, by name; absent ones have defaults
    class_table : class by name of a shape or pattern of names, of [classes]
    given : names of the sections in the file
    digest : SHA-256 of its content
    """

    path: Path
    values: Mapping[str, Mapping[str, Value | None]]
    sections: Mapping[str, RecipeSection]
    class_table: Mapping[str, str]
    given: frozenset[str]
    digest: str

    def whole(self, section: str, name: str) -> int:
        """Integer value."""
        return int(float_value(self.values[section], name))

    def real(self, section: str, name: str) -> float:
        """Real value."""
        return float_value(self.values[section], name)

    def text(self, section: str, name: str) -> str:
        """Text."""
        return string_value(self.values[section], name)

    def flag(self, section: str, name: str) -> bool:
        """Switch."""
        return bool(self.values[section][name])

    @property
    def samples(self) -> int:
        """Number of simulated images."""
        return self.whole("dataset", "samples")

    @property
    def views(self) -> int:
        """Images of a scene."""
        return self.whole("dataset", "views")

    @property
    def seed(self) -> int:
        """Seed of all draws."""
        return self.whole("dataset", "seed")

    @cached_property
    def layers(self) -> tuple[str, ...]:
        """Names of the layers of labels, those that boxes of echoes need included."""
        needed = ECHO_BOXES if self.boxes_of_echoes else ()
        return tuple(dict.fromkeys((*_words(self.text("labels", "layers")), *needed)))

    @property
    def boxes_of_echoes(self) -> bool:
        """Whether boxes and masks are those of echoes, not of surfaces."""
        return self.text("labels", "boxes") == "echoes"

    @property
    def mechanisms(self) -> tuple[str, ...]:
        """Mechanisms of the echoes of boxes; empty: all."""
        return _words(self.text("labels", "mechanisms"))

    @property
    def from_file(self) -> bool:
        """Whether scenes are files, not drawn shapes."""
        return "scene" in self.given

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a simulated image."""
        return self.whole("images", "pixels_azimuth"), self.whole("images", "pixels_range")

    @property
    def tile(self) -> tuple[int, int]:
        """Rows and columns of a stored image."""
        rows, columns = self.shape
        return self.whole("images", "tile_azimuth") or rows, self.whole("images", "tile_range") or columns

    @cached_property
    def corners(self) -> tuple[tuple[int, int], ...]:
        """First row and column of every tile; the last ones end with the image."""
        overlap = self.whole("images", "overlap")
        starts = [_starts(size, tile, overlap) for size, tile in zip(self.shape, self.tile, strict=True)]
        return tuple((row, column) for row in starts[0] for column in starts[1])

    @property
    def rows(self) -> int:
        """Number of stored images."""
        return self.samples * len(self.corners)

    def drawn(self, section: str, name: str) -> DrawnValue:
        """Distribution of a parameter."""
        return self.sections[section].drawn[name]

    @cached_property
    def grids(self) -> tuple[tuple[str, int], ...]:
        """Parameters on grids with their numbers of values; the last goes through its values first."""
        return tuple(
            (f"{section.name}.{name}", kind.levels)
            for section in self.sections.values()
            for name, kind in section.drawn.items()
            if kind.levels > 1
        )

    def levels(self, number: int) -> dict[str, int]:
        """Places in the grids of a sample: all combinations in turn."""
        out, rest = {}, number
        for name, count in reversed(self.grids):
            rest, out[name] = divmod(rest, count)
        return out

    def file_beside(self, name: str) -> Path:
        """A path in the recipe, relative to its folder."""
        return self.path.parent / name


def _starts(size: int, tile: int, overlap: int) -> list[int]:
    """First pixels of tiles along one axis."""
    count = 1 + -(-(size - tile) // (tile - overlap))
    return [round(i * (size - tile) / (count - 1)) if count > 1 else 0 for i in range(count)]


def resolve_recipe(name_or_path: str | Path) -> Path:
    """File of a recipe: a path, or the name of a shipped one.

    Raises
    ------
    DataError
        There is no such file.
    """
    path = Path(name_or_path)
    if os.path.isfile(path):
        return path
    folder = scenes_dir() / "recipes"
    shipped = folder / f"{path.stem}.toml"
    if str(name_or_path) in (path.stem, f"{path.stem}.toml") and os.path.isfile(shipped):
        return shipped
    names = sorted(p.stem for p in folder.glob("*.toml"))
    raise DataError(
        f"{one_line(name_or_path)}: no such recipe{did_you_mean(path.stem, names)}; shipped: {', '.join(names)}"
    )


def read_recipe(name_or_path: str | Path) -> Recipe:
    """Recipe from a TOML or JSON file, or a shipped one by name.

    Raises
    ------
    DataError
        One line: an unknown section or parameter, a wrong type, a value out of bounds, or a contradiction.
    """
    path = resolve_recipe(name_or_path)
    content = read_table(path, "a recipe", _MOST_BYTES)
    where = path.name
    known = (*VALUES, *DRAWS, CLASSES)
    for name, section in content.items():
        if name not in known:
            guess = did_you_mean(name, known) or f"; there are {', '.join(known)}"
            raise DataError(f'{where}: unknown section "{one_line(name)}"{guess}')
        if not isinstance(section, Mapping):
            raise DataError(f"{where}: {name} = {one_line(section)} is no section; write [{name}]")
    values = {
        name: table.read(_section(content, name), f"{where}: [{name}]", python=True)
        for name, table in VALUES.items()
    }
    sections = {
        name: _read_section(name, table, _section(content, name), where) for name, table in DRAWS.items()
    }
    table = class_table(_section(content, CLASSES), f"{where}: [{CLASSES}]")
    recipe = Recipe(path, values, sections, table, frozenset(content), _digest(path))
    _check(recipe, where)
    return recipe


def _digest(path: Path) -> str:
    return hashlib.sha256(read_bytes(path, _MOST_BYTES)).hexdigest()


def _section(content: Mapping[str, object], name: str) -> Mapping[str, object]:
    section = content.get(name, {})
    assert isinstance(section, Mapping)
    return section


def _read_section(name: str, table: ParamTable, given: Mapping[str, object], where: str) -> RecipeSection:
    place = f"{where}: [{name}]"
    refused = NOT_DRAWN.get(name, {})
    drawn: dict[str, DrawnValue] = {}
    for key, value in given.items():
        try:
            table.check_name(key, place)
        except SarmitsubaError as error:
            raise DataError(str(error)) from None
        if key in refused:
            raise DataError(f"{place}: {key} is not drawn; {refused[key]}")
        drawn[key] = read_drawn(value, table[key], place)
        if name == "objects" and key in FIXED_OF_OBJECTS and not isinstance(drawn[key], Fixed):
            raise DataError(f"{place}: {key} is not drawn; give one text")
    if name not in ("radar", "film", "tracing"):
        drawn = {p.name: drawn.get(p.name, Fixed(p.default)) for p in table.rows}
    return RecipeSection(name, drawn, frozenset(given))


def _check(recipe: Recipe, where: str) -> None:
    """Raise a DataError where sections contradict each other."""
    shares = [recipe.real("parts", name) for name in PART_NAMES]
    if abs(sum(shares) - 1.0) > 1e-6:
        raise DataError(f"{where}: [parts]: train, validation and test add up to {sum(shares):g}, not 1")
    _check_tiles(recipe, where)
    drawn_shapes = recipe.given & {"ground", "objects", "walls", "trees", "clutter"}
    if recipe.from_file and drawn_shapes:
        raise DataError(
            f"{where}: [scene] names a scene file, and [{min(drawn_shapes)}] draws shapes; leave one of them out"
        )
    if recipe.from_file and not str(recipe.sections["scene"].drawn["file"]):
        raise DataError(f"{where}: [scene]: file is empty; name a scene file or a shipped scene")
    if recipe.text("parts", "by") == "instance" and recipe.from_file:
        raise DataError(f'{where}: [parts]: by = "instance" needs [objects]; give by = "scene"')
    if recipe.samples % recipe.views:
        raise DataError(
            f"{where}: [dataset]: samples = {recipe.samples} is no multiple of views = {recipe.views}; change one"
        )
    kind = recipe.sections["radar"].drawn.get("polarisation")
    if isinstance(kind, Choice) and len({str(value).count(",") for value in kind.values}) > 1:
        raise DataError(
            f"{where}: [radar]: polarisation: one of {kind} has other numbers of channels; give each the same number"
        )
    for name, _ in recipe.grids:
        section = name.partition(".")[0]
        if section not in ("radar", "film", "tracing", "focusing") and recipe.views > 1:
            raise DataError(
                f"{where}: [{section}]: a grid over samples cannot change a scene that has {recipe.views} views; "
                "draw it at random"
            )


def _check_tiles(recipe: Recipe, where: str) -> None:
    """Raise a DataError where tiles do not fit the image, or there are too many files."""
    overlap = recipe.whole("images", "overlap")
    for axis, size, tile in zip(("azimuth", "range"), recipe.shape, recipe.tile, strict=True):
        if tile > size:
            raise DataError(
                f"{where}: [images]: tile_{axis} = {tile} is larger than pixels_{axis} = {size}; make it smaller"
            )
        if overlap >= tile:
            raise DataError(
                f"{where}: [images]: overlap = {overlap} is not below tile_{axis} = {tile}; make it smaller"
            )
    for name, files in (("pictures", recipe.rows), ("raw", recipe.samples)):
        if recipe.flag("output", name) and files > _MOST_FILES:
            raise DataError(
                f"{where}: [output]: {name} takes {files} files, and a folder holds {_MOST_FILES} at most; leave "
                "it out or make fewer samples"
            )
