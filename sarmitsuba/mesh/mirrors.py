"""Mirror planes of surfaces, and the part of a surface that they complete."""

import numpy as np

from sarmitsuba.arrays import F64, I64
from sarmitsuba.mesh.double_faces import TriangleBalls
from sarmitsuba.mesh.remesh import distance_to_triangles


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
    if not len(faces):
        return np.zeros(3), np.zeros((0, 3))
    t = vertices[faces]
    area = 0.5 * np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
    middle = t.mean(axis=1)
    centroid = np.average(middle, axis=0, weights=area)
    spread = np.einsum("n,ni,nj->ij", area, middle - centroid, middle - centroid)
    box = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    points = np.concatenate([vertices, _samples(t, step)])
    balls = TriangleBalls(middle, np.linalg.norm(t - middle[:, None], axis=2).max(axis=1))
    best = (box, np.zeros((0, 3)))
    for center, axes in ((box, np.eye(3)), (centroid, np.linalg.eigh(spread)[1].T)):
        found = [axis for axis in axes if _mirrored(points, t, balls, center, axis, tolerance)]
        if len(found) > len(best[1]):
            best = (center, np.array(found))
    return best


def _samples(t: F64, step: float) -> F64:
    """Points (n, 3) of triangles (m, 3, 3), at most ``step`` apart, the middles of equal parts of each."""
    longest = np.linalg.norm(t - np.roll(t, 1, axis=1), axis=2).max(axis=1)
    parts = np.maximum(1, np.ceil(longest / step)).astype(np.int64)
    out = []
    for n in np.unique(parts):
        i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
        up, down = (i + j < n), (i + j < n - 1)
        a = np.concatenate([(i[up] + 1.0 / 3.0), (i[down] + 2.0 / 3.0)]) / n
        b = np.concatenate([(j[up] + 1.0 / 3.0), (j[down] + 2.0 / 3.0)]) / n
        share = np.stack([1.0 - a - b, a, b], axis=1)
        out.append(np.einsum("qk,mkc->mqc", share, t[parts == n]).reshape(-1, 3))
    return np.concatenate(out)


def _mirrored(points: F64, t: F64, balls: TriangleBalls, center: F64, axis: F64, tolerance: float) -> bool:
    """Whether the mirrored points lie on the surface, and no triangle lies in the plane."""
    normal = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    across = np.abs(normal @ axis) > 0.9 * np.linalg.norm(normal, axis=1)
    if (across & (np.abs((t - center) @ axis).max(axis=1) < tolerance)).any():
        return False
    few = points[:: max(1, len(points) // 64)]
    for some in (few, points):
        there = some - 2.0 * ((some - center) @ axis)[:, None] * axis
        row, triangle = balls.near(there, np.full(len(there), tolerance))
        off = distance_to_triangles(there[row], t[triangle])
        nearest = np.full(len(there), np.inf)
        np.minimum.at(nearest, row, off)
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
        _, first, number = np.unique(
            np.round((whole - center) / (0.01 * tolerance)).astype(np.int64),
            axis=0,
            return_index=True,
            return_inverse=True,
        )
        vertices, faces = whole[first], number.reshape(-1)[faces]
        bad = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
        faces = faces[~bad]
        used, number = np.unique(faces, return_inverse=True)
        vertices, faces = vertices[used], np.asarray(number.reshape(-1, 3), dtype=np.int64)
    return vertices, faces
