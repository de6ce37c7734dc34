"""Parameters of every section of a recipe, with bounds and meaning."""

from sarmitsuba.core.constants import DEFAULT_WINDOW
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import Param, ParamTable
from sarmitsuba.loading.tables import INTEGRATOR
from sarmitsuba.radar.description import SENSOR
from sarmitsuba.radar.film import FILM

_MOST = 10_000_000


def _whole(name: str, default: int, doc: str, low: int, high: int) -> Param:
    return Param(name, "integer", default, doc, "", low, high, python=True)


def _number(
    name: str, default: float, doc: str, unit: str, low: float, high: float, *, positive: bool = False
) -> Param:
    return Param(name, "float", default, doc, unit, low, high, positive, python=True)


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
