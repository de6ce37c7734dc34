"""Triangles of one shape that lie within those of another one, in the same plane."""

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64, unit_rows
from sarmitsuba.scene.mesh.joined_sides import ROUNDING

# share of a triangle's area that may be uncovered, for rounding
UNCOVERED = 1e-6
# triangles whose neighbours are searched at a time; bounds the memory
SLAB = 20_000


def double_faces(corners: F64, shape: I64, distance: float = 0.0) -> NDArray[np.bool_]:
    """Whether each triangle is covered by triangles of one shape with a lower number, of either orientation.

    Surfaces are two-sided and without thickness: a face that is given twice, in the same triangles or in others, is one
    face. Without the covered triangles it stands once.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    shape : (n,) number of the shape of each triangle
    distance : m between two planes that are taken for one, in addition to the rounding of float32 files

    Notes
    -----
    Ignores faces that overlap in part, or are covered by several shapes together: they stay.
    """
    out = np.zeros(len(corners), dtype=bool)
    if not len(corners) or (shape == shape[0]).all():
        return out
    reach = distance + ROUNDING * float(np.abs(corners).max())
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    normal /= twice[:, None]
    trees = TriangleBalls(middle, radius)

    # triangles whose middle lies on one of a lower shape, then all that overlap these
    found = []
    for some in np.array_split(np.arange(len(corners)), 1 + len(corners) // SLAB):
        a, b = trees.near(middle[some], np.full(some.size, reach))
        a = some[a]
        lower = shape[b] < shape[a]
        a, b = a[lower], b[lower]
        off = np.abs(np.einsum("pi,pi->p", middle[a] - corners[b, 0], normal[b]))
        a, b = a[off <= reach], b[off <= reach]
        found.append(a[_holds(corners[b], normal[b], middle[a], reach)])
    chosen = np.unique(np.concatenate(found))
    if not chosen.size:
        return out
    a, b = trees.near(middle[chosen], radius[chosen] + reach)
    a = chosen[a]
    lower = shape[b] < shape[a]
    a, b = a[lower], b[lower]
    off = np.abs(np.einsum("pki,pi->pk", corners[a] - corners[b, :1], normal[b])).max(axis=1)
    flat = np.abs(np.einsum("pi,pi->p", normal[a], normal[b])) > 0.5
    a, b = a[flat & (off <= reach)], b[flat & (off <= reach)]
    area = _common_area(corners[a], corners[b], normal[b])
    key, group = np.unique(a * (int(shape.max()) + 1) + shape[b], return_inverse=True)
    covered = np.bincount(group.reshape(-1), area, len(key))
    face = key // (int(shape.max()) + 1)
    around = np.linalg.norm(np.roll(corners[face], -1, axis=1) - corners[face], axis=2).sum(axis=1)
    missing = 0.5 * twice[face] - covered
    out[face[(covered > 0.0) & (missing <= UNCOVERED * 0.5 * twice[face] + reach * around)]] = True
    return out


class TriangleBalls:
    """Balls around triangles, in a tree for each power of two of their radius."""

    def __init__(self, middle: F64, radius: F64) -> None:
        size = np.frexp(radius)[1]
        self._of_size = [
            (rows, float(radius[rows].max()), scipy.spatial.cKDTree(middle[rows]))
            for rows in (np.flatnonzero(size == each) for each in np.unique(size))
        ]

    def near(self, point: F64, reach: F64) -> tuple[I64, I64]:
        """Numbers of balls of radius ``reach`` (n,) around points (n, 3), and triangles whose balls they may meet."""
        first, second = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
        for rows, radius, tree in self._of_size:
            found = tree.query_ball_point(point, reach + radius)
            count = np.fromiter((len(each) for each in found), dtype=np.int64, count=len(found))
            first.append(np.repeat(np.arange(len(point)), count))
            second.append(rows[np.concatenate([*found, []]).astype(np.int64)])
        return np.concatenate(first), np.concatenate(second)


def _holds(corners: F64, normal: F64, point: F64, reach: float) -> NDArray[np.bool_]:
    """Whether points (n, 3) in the planes of triangles lie within them, to within ``reach`` m."""
    step = np.roll(corners, -1, axis=1) - corners
    inward = np.cross(normal[:, None], step)
    height = np.einsum("pki,pki->pk", inward, point[:, None] - corners)
    return np.asarray((height >= -reach * np.linalg.norm(inward, axis=2)).all(axis=1))


def _common_area(first: F64, second: F64, normal: F64) -> F64:
    """Common areas (n,) of pairs of triangles (n, 3, 3), seen along the normals (n, 3) of the second."""
    step = np.roll(second, -1, axis=1) - second
    inward = np.cross(normal[:, None], step)
    inward = unit_rows(inward)
    points = first - second[:, :1]
    for k in range(3):
        # corners beyond the side move onto its line, after the place where the outline crosses it
        m = inward[:, None, k]
        height = ((points - (second[:, None, k] - second[:, :1])) * m).sum(axis=2)
        before, last = np.roll(height, 1, axis=1), np.roll(points, 1, axis=1)
        cut = points - np.minimum(height, 0.0)[..., None] * m
        crosses = before * height < 0.0
        share = before / np.where(crosses, before - height, 1.0)
        crossing = np.where(crosses[..., None], last + share[..., None] * (points - last), cut)
        points = np.stack([crossing, cut], axis=2).reshape(len(points), 2 * points.shape[1], 3)
    twice = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)
    return np.asarray(0.5 * np.abs(np.einsum("pi,pi->p", twice, normal)))
