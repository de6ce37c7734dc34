"""Labels of a sample: layers of its pixels with codes that all samples share, and boxes of its shapes."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sarmitsuba.analysis.labels import labels
from sarmitsuba.analysis.labels.classes import classes_of_shapes, shape_names
from sarmitsuba.analysis.labels.echo_labels import NO_CLASS
from sarmitsuba.analysis.labels.makers import checked_layers
from sarmitsuba.apps.datasets.draw import Drawer, PlacedShape
from sarmitsuba.apps.datasets.recipe import RecipeError
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing.placement import ImagePlacement
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.pixel_labels import LabelLayer, LabelledInstance

# layers of codes of shapes, for masks of instances; the first that there is
SHAPES = ("shape", "instance")
# layers whose codes are shapes: names belong to the sample, not to the data set
OF_SHAPES = (*SHAPES, "shadow_of", "second_instance")
# number that the loader adds to the second material of a name
_NUMBERED = re.compile(r"_\d+$")


@dataclass(frozen=True, eq=False)
class SampleLabels:
    """Labels of a sample.

    Parameters
    ----------
    layers : by name; codes of classes and materials are those of the data set
    shapes : code, name and class ("" without one) of the shapes in the layers :data:`OF_SHAPES`
    instances : by name
    """

    layers: Mapping[str, LabelLayer] = field(default_factory=dict)
    shapes: tuple[tuple[int, str, str], ...] = ()
    instances: Mapping[str, LabelledInstance] = field(default_factory=dict)


def sample_labels(
    drawer: Drawer, scene: Scene, grid: ImageGrid, shapes: Sequence[PlacedShape]
) -> SampleLabels:
    """Labels of a drawn scene, as its recipe asks for.

    Raises
    ------
    RecipeError
        There is no such layer.
    """
    names = drawer.recipe.layers
    if not names:
        return SampleLabels()
    try:
        checked_layers(names)
    except DataError as error:
        raise RecipeError(f"[labels]: {error}") from None
    present = shape_names(scene)
    classes = classes_of_shapes(present, drawer.recipe.class_table)
    classes |= {shape.name: shape.semantic_class for shape in shapes if shape.name in present}
    found = labels(scene, grid, classes=classes, layers=names)
    shared = {"class": (*drawer.classes, NO_CLASS), "material": drawer.materials}
    layers = {
        name: _recode_layer(found.layers[name], shared[name]) if name in shared else found.layers[name]
        for name in names
    }
    codes: dict[int, str] = {}
    for name in OF_SHAPES:
        if name in layers:
            codes |= {code: shape for code, shape in layers[name].codes.items() if code}
            layers[name] = replace(layers[name], values=layers[name].values.astype(np.int32))
    return SampleLabels(
        layers,
        tuple((code, name, classes.get(name, "")) for code, name in sorted(codes.items())),
        {one.name: one for one in found.instances},
    )


def _recode_layer(layer: LabelLayer, names: Sequence[str]) -> LabelLayer:
    """A layer of codes with those of names of the data set, from 1; 0 stays.

    Raises
    ------
    DataError
        The layer has another name.
    """
    number = {name: i for i, name in enumerate(names, 1)}
    kind = np.uint8 if len(names) < 255 else np.int32
    table = np.zeros(max(layer.codes, default=0) + 1, dtype=kind)
    for code, name in layer.codes.items():
        own = name if name in number else _NUMBERED.sub("", name)
        if code and own not in number:
            if np.any(layer.values == code):
                raise DataError(f'labels: "{name}" is not one of {", ".join(names)}')
            continue
        if code:
            table[code] = number[own]
    codes = {0: layer.codes.get(0, "none"), **{i: name for name, i in number.items()}}
    return replace(layer, values=table[layer.values], codes=codes)


def corner_boxes(scene: Scene, grid: ImageGrid, shapes: Sequence[PlacedShape]) -> F64:
    """Bounds (n, 4) of every shape's vertices in the image: first row and column, last row and column, in pixels.

    Fractions of pixels from the centre of the first; they may lie outside the image. Hidden vertices count, echoes of
    several bounces do not; NaN where the image has no place for a vertex.
    """
    own = grid.in_frame(scene.offset)
    placement = ImagePlacement(own, scene.radar)
    out = np.full((len(shapes), 4), np.nan)
    for row, shape in zip(out, shapes, strict=True):
        azimuth, across = placement.locate(shape.vertices - scene.offset)
        if np.isfinite(azimuth).all():
            rows = (azimuth - own.azimuth[0]) / own.azimuth_spacing
            columns = (across - own.range[0]) / own.range_spacing
            row[:] = rows.min(), columns.min(), rows.max(), columns.max()
    return out
