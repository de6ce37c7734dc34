"""Recipe of a data set: what is drawn, by which distributions, and what is written."""

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from sarmitsuba.analysis.labels.classes import class_table
from sarmitsuba.apps.datasets.distributions import Choice, DrawnValue, Fixed, read_drawn
from sarmitsuba.apps.datasets.recipe_tables import DRAWS, FIXED_OF_OBJECTS, NOT_DRAWN, VALUES
from sarmitsuba.core.errors import DataError, SarmitsubaError
from sarmitsuba.core.parameters import ParamTable, Value, did_you_mean, float_value, one_line, string_value
from sarmitsuba.files.table_file import read_table
from sarmitsuba.loading.library import scenes_dir
from sarmitsuba.machine.regular_files import read_bytes

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
        """Names of the layers of labels."""
        return tuple(name.strip() for name in self.text("labels", "layers").split(",") if name.strip())

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
