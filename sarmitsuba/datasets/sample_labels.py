"""Labels of a sample: layers of its pixels, and boxes of its shapes."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.arrays import F64
from sarmitsuba.datasets.draw import PlacedShape
from sarmitsuba.datasets.recipe import RecipeError
from sarmitsuba.focusing.placement import ImagePlacement
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.labelling import labels
from sarmitsuba.parameters import did_you_mean
from sarmitsuba.scene.scene import Scene

# layer of codes of shapes, for masks of instances
SHAPES = "shape"


def label_layers(
    scene: Scene, grid: ImageGrid, names: Sequence[str], shapes: Sequence[PlacedShape]
) -> tuple[dict[str, NDArray[np.generic]], dict[int, str]]:
    """Layers of labels by name, and the shapes' names by their code in :data:`SHAPES`.

    Raises
    ------
    RecipeError
        There is no such layer.
    """
    if not names:
        return {}, {}
    found = labels(scene, grid, classes=_classes(scene, shapes))
    for name in names:
        if name not in found.layers:
            known = sorted(found.layers)
            guess = did_you_mean(name, known) or f"; there are {', '.join(known)}"
            raise RecipeError(f'[labels]: unknown layer "{name}"{guess}')
    codes: Mapping[int, str] = found.layers[SHAPES].codes if SHAPES in found.layers else {}
    return {name: found[name] for name in names}, dict(codes)


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
