"""Boxes of shapes in an image, the share of each that the antenna sees, and the pixels in its shadow alone."""

from collections.abc import Callable

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.analysis.labels.geometric_layers import SurfacePoints
from sarmitsuba.analysis.labels.ground_shapes import surface_samples
from sarmitsuba.analysis.labels.owners import SceneShapes
from sarmitsuba.analysis.labels.sight import SightLines
from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing.placement import ImagePlacement
from sarmitsuba.signal.image import ImageGrid

# places on a shape whose sight decides its visible share
PLACES = 1024
# facets on a line of sight, at most, that are looked at for a second shape
_PASSED = 32


def boxes(where: NDArray[np.bool_]) -> tuple[tuple[int, int, int, int], F64, int]:
    """Box of pixels (n_azimuth, n_range), corners (4, 2) of the smallest rectangle about them, and their number.

    The box is the first and last row and column, -1 without pixels; the rectangle encloses the pixels' areas.
    """
    row, column = np.nonzero(where)
    if not row.size:
        return (-1, -1, -1, -1), np.full((4, 2), np.nan), 0
    box = (int(row.min()), int(column.min()), int(row.max()), int(column.max()))
    # ends of the rows of pixels are enough
    lines, first = np.unique(row, return_index=True)
    last = np.append(first[1:], row.size) - 1
    ends = [
        (line + a, column[end] + b)
        for a in (-0.5, 0.5)
        for end, b in ((first, -0.5), (last, 0.5))
        for line in (lines,)
    ]
    points = np.concatenate([np.stack(pair, axis=1) for pair in ends])
    return box, _smallest_rectangle(points), int(row.size)


def _smallest_rectangle(points: F64) -> F64:
    """Corners (4, 2) in turn of the rectangle of least area about points (n, 2), which lie not all on one line.

    One of its sides lies on a side of the convex hull (Freeman and Shapira, 1975).
    """
    hull = points[scipy.spatial.ConvexHull(points).vertices]
    side = np.roll(hull, -1, axis=0) - hull
    along = side / np.linalg.norm(side, axis=1, keepdims=True)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    u, v = hull @ along.T, hull @ across.T
    best = int(np.argmin(np.ptp(u, axis=0) * np.ptp(v, axis=0)))
    a, b = u[:, best], v[:, best]
    corners = np.array([[a.min(), b.min()], [a.max(), b.min()], [a.max(), b.max()], [a.min(), b.max()]])
    return np.asarray(corners @ np.stack([along[best], across[best]]))


def _solid(scene: Scene) -> I64:
    """Faces that waves meet."""
    invisible = np.array([m.invisible for m in scene.materials], dtype=bool)
    if not scene.geometry.n_faces:
        return np.zeros(0, dtype=np.int64)
    return np.flatnonzero(~invisible[scene.geometry.face_material])


def visible_shares(scene: Scene, grid: ImageGrid, shapes: SceneShapes) -> F64:
    """Share of the area of each mesh that the antenna sees from the middle of its aperture, (n_shapes,) 0 ... 1.

    Of ``PLACES`` places on each, evenly spread. NaN for other shapes, which have no surface.
    """
    geometry, solid = scene.geometry, _solid(scene)
    out = np.full(shapes.n, np.nan)
    placement = ImagePlacement(grid, scene.radar)
    row_of = np.full(max(1, geometry.n_faces), -1, dtype=np.int64)
    row_of[solid] = np.arange(solid.size)
    places, rows, of = [np.zeros((0, 3))], [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for mesh in range(len(geometry.mesh_names)):
        place, face = surface_samples(geometry, mesh, PLACES)
        kept = row_of[face] >= 0
        places.append(place[kept])
        rows.append(row_of[face[kept]])
        of.append(np.full(int(kept.sum()), mesh))
    place, row, mesh_of = np.concatenate(places), np.concatenate(rows), np.concatenate(of)
    if not solid.size:
        seen = np.zeros(0, dtype=bool)
    else:
        sight = SightLines(geometry.vertices[geometry.faces[solid]])
        seen = sight.hidden_by(place, row, placement.antenna(place)) < 0
    count = np.bincount(mesh_of, minlength=shapes.n)
    total = np.bincount(mesh_of, seen, shapes.n)
    out[count > 0] = total[count > 0] / count[count > 0]
    return out


def shadows(scene: Scene, grid: ImageGrid, shapes: SceneShapes, points: Callable[[], SurfacePoints]) -> I64:
    """Number of pixels whose ground each shape alone hides from the antenna, (n_shapes,)."""
    out = np.zeros(shapes.n, dtype=np.int64)
    geometry, solid = scene.geometry, _solid(scene)
    if scene.radar.all_round or not solid.size or not shapes.ground.any():
        return out
    found, mesh = points(), geometry.face_mesh
    hidden = np.flatnonzero(~found.seen & shapes.ground[mesh[found.found.face]])
    if not hidden.size:
        return out
    row_of = np.full(geometry.n_faces, -1, dtype=np.int64)
    row_of[solid] = np.arange(solid.size)
    place, face = found.found.point[hidden].copy(), row_of[found.found.face[hidden]]
    antenna = ImagePlacement(grid, scene.radar).antenna(place)
    by = _hidden_by_one(geometry, solid, place, face, antenna)
    pixel, alone = found.found.pixel[hidden][by >= 0], by[by >= 0]
    pairs = np.unique(np.stack([pixel, alone], axis=1), axis=0)
    np.add.at(out, pairs[:, 1], 1)
    out[shapes.ground] = 0
    return out


def _hidden_by_one(geometry: Geometry, solid: I64, place: F64, face: I64, antenna: F64) -> I64:
    """Mesh (n,) that alone hides places (n, 3), m, on faces (n,) of ``solid`` from antennas (n, 3); -1: several."""
    corners = geometry.vertices[geometry.faces[solid]]
    sight, mesh = SightLines(corners), geometry.face_mesh[solid]
    out = np.full(len(place), -2, dtype=np.int64)
    going = np.arange(len(place))
    for _ in range(_PASSED):
        met = sight.hidden_by(place[going], face[going], antenna[going])
        going, met = going[met >= 0], met[met >= 0]
        if not going.size:
            break
        new = mesh[met]
        out[going] = np.where((out[going] == -2) | (out[going] == new), new, -1)
        line = antenna[going] - place[going]
        normal = sight.normal[met]
        along = np.einsum("ni,ni->n", line, normal)
        share = np.einsum("ni,ni->n", corners[met, 0] - place[going], normal)
        share = share / np.where(along == 0.0, 1e-300, along)
        place[going] += np.clip(share, 0.0, 1.0)[:, None] * line
        face[going] = met
        going = going[out[going] >= 0]
    return np.maximum(out, -1)
