"""Roofs over footprints: flat, gabled over four corners, pyramids over convex outlines."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.loading.importing.polygons import triangulate

if TYPE_CHECKING:
    import shapely


# default pitch of 35 degrees, and largest height of a roof relative to the house
_RISE, _SHARE = 0.35, 0.5
# deviation from a straight wall up to which a corner is redundant, m
_STRAIGHT = 1e-3
GABLED = ("gabled",)
PYRAMIDS = ("pyramidal", "hipped", "tented")


@dataclass(frozen=True, eq=False)
class Roof:
    """Surface of a roof.

    Parameters
    ----------
    corners : (n, 2) float64, m
    lift : (n,) float64, 0 at the eaves, 1 at the ridge
    faces : (m, 3) int32, seen from above counter-clockwise
    gables : (k, 3) int32, vertical triangles under a ridge, of the walls' material
    """

    corners: F64
    lift: F64
    faces: I32
    gables: I32

    @property
    def is_flat(self) -> bool:
        """Whether the roof has no ridge."""
        return not self.lift.any()


def rise(polygon: "shapely.Polygon", height: float) -> float:
    """Default height of a pitched roof over a footprint, m, for a house of a given height, m."""
    x, y = np.asarray(polygon.minimum_rotated_rectangle.exterior.coords.xy)
    sides = np.hypot(np.diff(x), np.diff(y))
    return float(min(_RISE * sides.min(), _SHARE * height))


def make_roof(polygon: "shapely.Polygon", shape: str, across: bool) -> Roof:
    """Roof of a shape of OpenStreetMap's ``roof:shape`` for simple footprints, else flat.

    Parameters
    ----------
    polygon : footprint, m, valid, exterior counter-clockwise
    shape : ``gabled`` needs four corners; ``pyramidal``, ``hipped`` and ``tented`` become a pyramid over convex
        outlines
    across : the ridge runs along the shorter side
    """
    corners = np.asarray(polygon.simplify(_STRAIGHT).exterior.coords)[:-1]
    if not polygon.interiors and shape in GABLED and len(corners) == 4 and _convex(corners):
        return _make_gable(corners, across)
    if not polygon.interiors and shape in PYRAMIDS and _convex(corners):
        n = len(corners)
        apex = np.asarray(polygon.centroid.coords)
        faces = [[i, (i + 1) % n, n] for i in range(n)]
        return _roof(np.concatenate([corners, apex]), [0.0] * n + [1.0], faces, [])
    flat, triangles = triangulate(polygon)
    return Roof(flat, np.zeros(len(flat)), triangles, np.zeros((0, 3), dtype=np.int32))


def _make_gable(corners: F64, across: bool) -> Roof:
    """Gabled roof with its ridge between the midpoints of two opposite sides, along the longer ones unless across."""
    side = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    long_first = side[0] + side[2] >= side[1] + side[3]
    a, b, c, d = corners if long_first != across else np.roll(corners, -1, axis=0)
    points = np.array([a, b, c, d, 0.5 * (b + c), 0.5 * (d + a)])
    slopes = [[0, 1, 4], [0, 4, 5], [2, 3, 5], [2, 5, 4]]
    return _roof(points, [0.0] * 4 + [1.0] * 2, slopes, [[1, 2, 4], [3, 0, 5]])


def _roof(corners: F64, lift: list[float], faces: list[list[int]], gables: list[list[int]]) -> Roof:
    whole = [np.array(rows, dtype=np.int32).reshape(-1, 3) for rows in (faces, gables)]
    return Roof(corners, np.array(lift), whole[0], whole[1])


def _convex(corners: F64) -> bool:
    """Whether a counter-clockwise outline is convex."""
    step = np.roll(corners, -1, axis=0) - corners
    after = np.roll(step, -1, axis=0)
    return bool((step[:, 0] * after[:, 1] > step[:, 1] * after[:, 0]).all())
