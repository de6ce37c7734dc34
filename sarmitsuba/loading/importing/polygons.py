"""Triangulation of polygons with holes, in the plane and in space."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import one_line

if TYPE_CHECKING:
    import shapely


# most corners of a footprint: longer ones are coast lines or hostile, and take minutes to triangulate
MOST_CORNERS = 20_000


def require_shapely(where: str) -> None:
    """Raise a SceneError where the package shapely is missing."""
    try:
        from shapely import constrained_delaunay_triangles  # noqa: F401
    except ImportError as error:
        raise SceneError(
            f"{where}: footprints need the package shapely 2.1 or later ({error}); pip install 'sarmitsuba[importing]'"
        ) from error


def why_unusable(polygon: "shapely.Polygon") -> str:
    """Reason why a polygon is unusable as a footprint; empty where it is usable."""
    import shapely

    corners = shapely.get_num_coordinates(polygon)
    if corners > MOST_CORNERS:
        return f"outlines of more than {MOST_CORNERS} corners"
    if polygon.is_empty or not np.isfinite(polygon.bounds).all():
        return "outlines without numbers"
    if not polygon.is_valid:
        return "outlines that intersect themselves"
    return "" if polygon.area > 0.0 else "outlines without area"


def triangulate(polygon: "shapely.Polygon") -> tuple[F64, I32]:
    """Triangulation of a valid polygon, counter-clockwise, without additional corners.

    Returns
    -------
    corners (n, 2) float64: exterior, then holes, without the repeated last; faces (m, 3) int32

    Raises
    ------
    SceneError : GEOS finds no triangles
    """
    import shapely

    rings = [np.asarray(ring.coords)[:-1, :2] for ring in (polygon.exterior, *polygon.interiors)]
    corners = np.concatenate(rings)
    try:
        # GEOS fails on repeated consecutive corners
        pieces = shapely.constrained_delaunay_triangles(shapely.remove_repeated_points(polygon))
    except shapely.errors.GEOSException as error:
        x, y = polygon.bounds[:2]
        raise SceneError(
            f"an outline of {len(corners)} corners at ({x:g}, {y:g}) cannot be triangulated "
            f"({one_line(error, 80)}); leave it out or simplify it"
        ) from error
    rows = shapely.get_coordinates(pieces).reshape(-1, 4, 2)[:, :3]
    place = {corner.tobytes(): i for i, corner in enumerate(corners + 0.0)}
    faces = np.array([[place[c.tobytes()] for c in row] for row in rows + 0.0], dtype=np.int32).reshape(-1, 3)
    a, b, c = (corners[faces[:, i]] for i in range(3))
    clockwise = _cross(b - a, c - a) < 0.0
    faces[clockwise] = faces[clockwise][:, ::-1]
    return corners, faces


def triangulate_in_space(rings: Sequence[F64]) -> tuple[F64, I32] | None:
    """Triangulation of a plane polygon in space; None where it has no area or intersects itself.

    Parameters
    ----------
    rings : exterior, then holes, each (n, 3) float64, m, last corner not repeated; the exterior is counter-clockwise
        about the outward normal

    Returns
    -------
    corners (n, 3) float64; faces (m, 3) int32, of the exterior's orientation
    """
    import shapely

    exterior = rings[0]
    normal = np.cross(exterior, np.roll(exterior, -1, axis=0)).sum(axis=0)  # Newell; twice the area
    size = float(np.linalg.norm(normal))
    if not size > 1e-9:
        return None
    normal /= size
    side = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(normal, side)], axis=1)
    middle = exterior.mean(axis=0)
    flat = [(ring - middle) @ frame for ring in rings]
    polygon = shapely.Polygon(flat[0], flat[1:])
    if why_unusable(polygon):
        return None
    _, faces = triangulate(polygon)
    return np.concatenate(list(rings)), faces


def _cross(a: F64, b: F64) -> F64:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
