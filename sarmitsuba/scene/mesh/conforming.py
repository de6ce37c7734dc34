"""Triangles that meet corner to corner: sides are cut where corners of others lie on them."""

import numpy as np

from sarmitsuba.core.arrays import F64, I64

# passes in which sides are cut; each cuts one side of a triangle
_PASSES = 200
# corners within the tolerance of one, in the mean, beyond which they are first joined in cubes, and cubes across it
_NEIGHBOURS, _CUBES = 40, 4


def conforming(corners: F64, tolerance: float) -> tuple[F64, I64]:
    """Mesh of the same surface in which no corner lies within the side of another triangle.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    tolerance : m, distance within which corners are one, and lie on a side

    Returns
    -------
    vertices : (n_v, 3) float64, m
    faces : (m, 3) int64, without triangles narrower than the tolerance, and each once

    Notes
    -----
    Surfaces that cross each other, or touch within a face, are not joined.
    """
    vertices, faces = _join_corners(corners, tolerance)
    for _ in range(_PASSES):
        faces = _once(vertices, faces, tolerance)
        cut, place, at = _cuts(vertices, faces, tolerance)
        if not cut.size:
            break
        apex = faces[cut, place]
        a, b = faces[cut, (place + 1) % 3], faces[cut, (place + 2) % 3]
        faces = np.concatenate(
            [np.delete(faces, cut, axis=0), np.stack([apex, a, at], axis=1), np.stack([apex, at, b], axis=1)]
        )
    used, number = np.unique(faces, return_inverse=True)
    return vertices[used], np.asarray(number.reshape(-1, 3), dtype=np.int64)


def _join_corners(corners: F64, tolerance: float) -> tuple[F64, I64]:
    """Vertices and faces; corners nearer to another one than the tolerance are that one, not chains of them."""
    points, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    label = join_points(points, tolerance)[number.reshape(-1)]
    used, number = np.unique(label, return_inverse=True)
    return points[used], np.asarray(number.reshape(-1, 3), dtype=np.int64)


def join_points(points: F64, tolerance: float) -> I64:
    """Number (n,) of the point that stands for each: itself, or one within the tolerance that stands for itself."""
    from scipy.spatial import cKDTree

    rows, cell = np.arange(len(points)), np.arange(len(points))
    tree = cKDTree(points)
    if tree.count_neighbors(tree, tolerance) > _NEIGHBOURS * len(points):
        # many in a ball: one of each small cube first
        place = np.floor(points / (tolerance / _CUBES)).astype(np.int64)
        _, rows, cell = np.unique(place, axis=0, return_index=True, return_inverse=True)
        cell = cell.reshape(-1)
        tree = cKDTree(points[rows])
    pairs = tree.query_pairs(tolerance, output_type="ndarray")
    own = np.arange(rows.size)
    if len(pairs):
        low, high = pairs.min(axis=1), pairs.max(axis=1)
        order = np.lexsort((high, low))
        low, high = low[order], high[order]
        start = np.searchsorted(low, np.arange(rows.size + 1))
        taken = np.zeros(rows.size, dtype=bool)
        for i in np.unique(low):
            if not taken[i]:
                near = high[start[i] : start[i + 1]]
                near = near[~taken[near]]
                taken[near], own[near] = True, i
    return np.asarray(rows[own[cell]], dtype=np.int64)


def _once(vertices: F64, faces: I64, tolerance: float) -> I64:
    """Faces without those that have no height, and without copies."""
    t = vertices[faces]
    area = np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
    longest = np.linalg.norm(t - np.roll(t, 1, axis=1), axis=2).max(axis=1)
    own = np.sort(faces, axis=1)
    wide = (area > 0.5 * tolerance * longest) & (own[:, 0] < own[:, 1]) & (own[:, 1] < own[:, 2])
    faces, own = faces[wide], own[wide]
    _, first = np.unique(own, axis=0, return_index=True)
    return faces[np.sort(first)]


def _cuts(vertices: F64, faces: I64, tolerance: float) -> tuple[I64, I64, I64]:
    """Triangles to cut, number of the corner opposite to the cut side, and the corner that lies on it."""
    from scipy.spatial import cKDTree

    start, end = np.roll(faces, -1, axis=1).ravel(), np.roll(faces, -2, axis=1).ravel()
    key = np.minimum(start, end) * len(vertices) + np.maximum(start, end)
    _, of, count = np.unique(key, return_inverse=True, return_counts=True)
    open_side = np.flatnonzero(count[of.reshape(-1)] == 1)
    if not open_side.size:
        return (np.zeros(0, dtype=np.int64),) * 3
    rim = np.unique(np.concatenate([start[open_side], end[open_side]]))
    tree = cKDTree(vertices[rim])
    a, b = vertices[start[open_side]], vertices[end[open_side]]
    length = np.linalg.norm(b - a, axis=1)
    found = tree.query_ball_point(0.5 * (a + b), 0.5 * length + tolerance)
    each = np.fromiter((len(f) for f in found), dtype=np.int64, count=len(found))
    row = np.repeat(np.arange(open_side.size), each)
    vertex = rim[np.concatenate([*found, []]).astype(np.int64)]
    along = (b - a) / np.maximum(length, 1e-300)[:, None]
    off = vertices[vertex] - a[row]
    place = np.einsum("nc,nc->n", off, along[row])
    away = np.linalg.norm(off - place[:, None] * along[row], axis=1)
    inside = (away < tolerance) & (place > tolerance) & (place < length[row] - tolerance)
    row, vertex, place = row[inside], vertex[inside], place[inside]
    # nearest to the middle first; one side of a triangle at a time
    order = np.argsort(np.abs(place - 0.5 * length[row]), kind="stable")
    side, vertex = open_side[row[order]], vertex[order]
    _, first = np.unique(side // 3, return_index=True)
    side, vertex = side[first], vertex[first]
    return side // 3, side % 3, vertex
