"""Labels of a sample: layers of its pixels, and boxes of its shapes."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.arrays import F64
from sarmitsuba.datasets.draw import PlacedShape
from sarmitsuba.datasets.recipe import RecipeError
from sarmitsuba.errors import DataError
from sarmitsuba.focusing.placement import ImagePlacement
from sarmitsuba.image.labels import LabelledInstance
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.labelling import labels
from sarmitsuba.labelling.makers import checked_layers
from sarmitsuba.scene.scene import Scene

# layers of codes of shapes, for masks of instances; the first that there is
SHAPES = ("shape", "instance")


def label_layers(
    scene: Scene, grid: ImageGrid, names: Sequence[str], shapes: Sequence[PlacedShape]
) -> tuple[dict[str, NDArray[np.generic]], dict[int, str], dict[str, LabelledInstance]]:
    """Layers of labels by name, the shapes' names by their code in :data:`SHAPES`, and instances by name.

    Raises
    ------
    RecipeError
        There is no such layer.
    """
    if not names:
        return {}, {}, {}
    try:
        checked_layers(names)
    except DataError as error:
        raise RecipeError(f"[labels]: {error}") from None
    found = labels(scene, grid, classes=_classes(scene, shapes), layers=names)
    codes: Mapping[int, str] = next((found.layers[n].codes for n in SHAPES if n in names), {})
    return {name: found[name] for name in names}, dict(codes), {one.name: one for one in found.instances}


def _classes(scene: Scene, shapes: Sequence[PlacedShape]) -> dict[str, str]:
    present = {*scene.geometry.mesh_names, *(volume.name for volume in scene.volumes)}
    return {shape.name: shape.semantic_class for shape in shapes if shape.name in present}


def corner_boxes(scene: Scene, grid: ImageGrid, shapes: Sequence[PlacedShape]) -> F64:
    """Bounds (n, 4) of every shape's vertices in the image: first row and column, last row and column, in pixels.

    Fractions of pixels from the centre of the first; they may lie outside the image. Hidden vertices count, echoes of
    several bounces do not; NaN where the image has no place for a vertex.
    """
    own = grid.in_frame(scene.offset)
    placement = ImagePlacement(own, scene.radar)
    out = np.full((len(shapes), 4), np.nan)
    for row, shape in zip(out, shapes, strict=True):
        azimuth, across = placement.imaged(shape.vertices - scene.offset)
        if np.isfinite(azimuth).all():
            rows = (azimuth - own.azimuth[0]) / own.azimuth_spacing
            columns = (across - own.range[0]) / own.range_spacing
            row[:] = rows.min(), columns.min(), rows.max(), columns.max()
    return out
