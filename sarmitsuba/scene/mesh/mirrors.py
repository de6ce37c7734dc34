"""Mirror planes of surfaces, and the part of a surface that they complete."""

from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.scene.mesh.double_faces import TriangleBalls
from sarmitsuba.scene.mesh.remesh import distance_to_triangles, join_points

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

# points tried at first and at a time, and distance below which one of several is mirrored, over the step between them
FEW, THINNED = 64, 0.5
# triangles with the nearest middles that are tried before all near ones
NEAREST = 6
# shortest side, over the longest allowed, of slivers that are cut into strips; others' most pieces a square of it
NARROW, MOST_CUT = 0.25, 16.0
# points whose neighbours are searched at a time; bounds the memory
_AT_ONCE, _REST = 2000, 8


def mirror_planes(vertices: F64, faces: I64, tolerance: float, step: float) -> tuple[F64, F64]:
    """Perpendicular mirror planes of a surface through one point.

    Parameters
    ----------
    vertices : (n, 3) float64, m
    faces : (m, 3) int64
    tolerance : m by which the mirrored surface may leave the surface
    step : m between the points that are mirrored: smaller holes and details are not seen

    Returns
    -------
    center : (3,) float64, m, on all planes
    normals : (k, 3) float64, unit vectors, k from 0 to 3

    Notes
    -----
    Planes across the axes of the frame and across the principal axes of the surface are tried, those that hold no
    triangle; planes at 45 degrees to both are not found.
    """
    from scipy.spatial import cKDTree

    if not len(faces):
        return np.zeros(3), np.zeros((0, 3))
    t = vertices[faces]
    area = 0.5 * np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
    middle = t.mean(axis=1)
    centroid = np.average(middle, axis=0, weights=area)
    spread = np.einsum("n,ni,nj->ij", area, middle - centroid, middle - centroid)
    box = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    t = _pieces(t, step)
    middle = t.mean(axis=1)
    points = _thin_points(np.concatenate([vertices, middle]), THINNED * step)
    tree, balls = (
        cKDTree(middle),
        TriangleBalls(middle, np.linalg.norm(t - middle[:, None], axis=2).max(axis=1)),
    )
    best = (box, np.zeros((0, 3)))
    for center, axes in ((box, np.eye(3)), (centroid, np.linalg.eigh(spread)[1].T)):
        found = [axis for axis in axes if _is_mirrored(points, t, tree, balls, center, axis, tolerance)]
        if len(found) > len(best[1]):
            best = (center, np.array(found))
    return best


def _pieces(t: F64, longest: float) -> F64:
    """Triangles (n, 3, 3) cut until no side is longer: slivers into strips, others across their longest sides."""
    done = []
    while len(t):
        size = np.linalg.norm(np.roll(t, -1, axis=1) - np.roll(t, 1, axis=1), axis=2)  # of the side opposite
        long = size.max(axis=1) > longest
        done.append(t[~long])
        t, size = t[long], size[long]
        sliver = size.min(axis=1) <= NARROW * longest
        done.append(_cut_strips(t[sliver], size[sliver], (1.0 - NARROW) * longest))
        t, place = t[~sliver], size[~sliver].argmax(axis=1)
        row = np.arange(len(t))
        apex, a, b = t[row, place], t[row, (place + 1) % 3], t[row, (place + 2) % 3]
        middle = 0.5 * (a + b)
        t = np.concatenate([np.stack([apex, a, middle], axis=1), np.stack([apex, middle, b], axis=1)])
    return np.concatenate(done)


def _cut_strips(t: F64, size: F64, longest: float) -> F64:
    """Triangles between points at equal distances, no longer than given, on the two long sides of slivers."""
    place, row = size.argmin(axis=1), np.arange(len(t))
    apex, a, b = t[row, place], t[row, (place + 1) % 3], t[row, (place + 2) % 3]
    count = np.ceil(size.max(axis=1) / longest).astype(np.int64)
    row = np.repeat(row, count)
    last = np.arange(row.size) - np.repeat(np.cumsum(count) - count, count)
    near, far = ((last + i)[:, None] / count[row][:, None] for i in (0.0, 1.0))
    sides = a - apex, b - apex
    first, second = (apex[row] + near * side[row] for side in sides)
    third, fourth = (apex[row] + far * side[row] for side in sides)
    wide = last > 0  # the first strip is a triangle
    return np.concatenate(
        [np.stack([first, third, fourth], axis=1), np.stack([first, fourth, second], axis=1)[wide]]
    )


def count_pieces(t: F64, longest: float) -> float:
    """Most triangles into which those of a surface (n, 3, 3) are cut for their mirrors, about."""
    size = np.linalg.norm(np.roll(t, -1, axis=1) - np.roll(t, 1, axis=1), axis=2)
    area = 0.5 * np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
    strips = 2.0 * size.max(axis=1) / ((1.0 - NARROW) * longest)
    return float(np.sum(1.0 + strips + MOST_CUT * area / longest**2))


def _thin_points(points: F64, size: float) -> F64:
    """One of the points (n, 3) of each cube of a size, those of different cubes mixed."""
    _, first = np.unique(np.floor(points / size).astype(np.int64), axis=0, return_index=True)
    return np.asarray(points[np.random.default_rng(0).permutation(first)])


def _is_mirrored(
    points: F64, t: F64, tree: "cKDTree", balls: TriangleBalls, center: F64, axis: F64, tolerance: float
) -> bool:
    """Whether the mirrored points lie on the surface, and no triangle lies in the plane."""
    normal = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    across = np.abs(normal @ axis) > 0.9 * np.linalg.norm(normal, axis=1)
    if (across & (np.abs((t - center) @ axis).max(axis=1) < tolerance)).any():
        return False
    few = points[:: max(1, len(points) // FEW)]
    for some in (few, *np.array_split(points, 1 + len(points) // _AT_ONCE)):
        there = some - 2.0 * ((some - center) @ axis)[:, None] * axis
        # most lie on one of the triangles with the nearest middles
        _, near = tree.query(there, k=np.arange(1, min(NEAREST, len(t)) + 1))
        off = np.full(len(there), np.inf)
        for triangle in near.T:
            off = np.minimum(off, distance_to_triangles(there, t[triangle]))
        rest = there[off > tolerance]
        for few_there in np.array_split(rest, 1 + len(rest) // _REST):
            row, triangle = balls.near(few_there, np.full(len(few_there), tolerance))
            nearest = np.full(len(few_there), np.inf)
            np.minimum.at(nearest, row, distance_to_triangles(few_there[row], t[triangle]))
            if (nearest > tolerance).any():
                return False
    return True


def part_of(vertices: F64, faces: I64, center: F64, normals: F64, tolerance: float) -> tuple[F64, I64]:
    """Part of a surface on the positive side of planes, its triangles cut at them.

    Parameters
    ----------
    vertices, faces : of the surface
    center : (3,) float64, m, on all planes
    normals : (k, 3) float64, unit vectors
    tolerance : m; corners nearer to a plane are moved onto it
    """
    from trimesh.intersections import slice_faces_plane

    for normal in normals:
        height = (vertices - center) @ normal
        vertices = vertices - np.where(np.abs(height) < tolerance, height, 0.0)[:, None] * normal
        height = (vertices - center) @ normal
        inside = (height[faces] > -1e-12 * np.abs(height).max()).all(axis=1)
        crossing = ~inside & (height[faces].max(axis=1) > tolerance * 0.5)
        cut_v, cut_f = slice_faces_plane(vertices, faces[crossing], normal, center)[:2]
        height = (cut_v - center) @ normal
        cut_v = cut_v - np.where(np.abs(height) < tolerance, height, 0.0)[:, None] * normal
        whole = np.concatenate([vertices, cut_v])
        faces = np.concatenate([faces[inside], np.asarray(cut_f, dtype=np.int64) + len(vertices)])
        vertices, faces = whole, join_points(whole, 0.01 * tolerance)[faces]
        bad = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
        # slivers that were moved into the plane whole
        bad |= (np.abs((vertices - center) @ normal)[faces] < 1e-9 * tolerance).all(axis=1)
        faces = faces[~bad]
        used, number = np.unique(faces, return_inverse=True)
        vertices, faces = vertices[used], np.asarray(number.reshape(-1, 3), dtype=np.int64)
    return vertices, faces
