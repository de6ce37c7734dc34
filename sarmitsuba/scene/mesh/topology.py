"""Topology of meshes: vertices at equal positions, edges that two triangles share, connected parts."""

import numpy as np

from sarmitsuba.core.arrays import F64, I32, I64


def weld(v: F64) -> I64:
    """(n_v,) int64 label of every position, equal for vertices with equal coordinates.

    Labels depend on the positions alone, not on the order of the vertices: the rank of a 64-bit hash of the bits of
    the three coordinates, or of the coordinates themselves if two hashes collide.
    """
    bits = np.ascontiguousarray(v + 0.0).view(np.uint64)  # + 0.0 turns -0 into 0
    with np.errstate(over="ignore"):
        h = np.zeros(v.shape[0], dtype=np.uint64)
        for k in range(3):  # splitmix64 rounds
            h = (h ^ bits[:, k]) * np.uint64(0x9E3779B97F4A7C15)
            h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            h = h ^ (h >> np.uint64(31))
    _, first, label = np.unique(h, return_index=True, return_inverse=True)
    if not np.array_equal(bits, bits[first[label]]):
        _, label = np.unique(v + 0.0, axis=0, return_inverse=True)
    return np.asarray(label.reshape(-1), dtype=np.int64)


def copies_apart(vertex: I64) -> I64:
    """Labels (3 n_faces,) of corners, of which the copies of a face with the same corners share none.

    The first of every set of copies keeps its neighbours, the second ones have each other, and so on.
    """
    ids = np.sort(vertex.reshape(-1, 3), axis=1)
    with np.errstate(over="ignore"):
        key = (
            ids.astype(np.uint64) * np.array([1, 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9], dtype=np.uint64)
        ).sum(axis=1, dtype=np.uint64)
    order = np.argsort(key, kind="stable")
    same = np.append(False, (ids[order[1:]] == ids[order[:-1]]).all(axis=1))
    if not same.any():
        return vertex
    place = np.arange(len(order))
    rank = np.zeros(len(order), dtype=np.int64)
    rank[order] = place - np.maximum.accumulate(np.where(same, 0, place))
    label = vertex * (int(rank.max()) + 1) + np.repeat(rank, 3)
    return np.asarray(np.unique(label, return_inverse=True)[1].reshape(-1), dtype=np.int64)


def edge_pairs(vertex: I64) -> tuple[I64, I64]:
    """Both sides of every edge that exactly two triangles share.

    Parameters
    ----------
    vertex : (3 n,) label of each corner's vertex, not negative; equal where corners coincide

    Returns
    -------
    first, second : (n_edges,) number of the edge in either triangle, three times the triangle's plus that of the
        corner at which the edge starts; the smaller number first
    """
    start = vertex.reshape(-1, 3)
    end = np.roll(start, -1, axis=1)
    key = np.minimum(start, end) * (int(vertex.max(initial=0)) + 1) + np.maximum(start, end)
    return twins(key.ravel())


def twins(key: I64) -> tuple[I64, I64]:
    """First and second index of every value that occurs exactly twice; values are not negative."""
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    pair = first[np.diff(first, append=len(key)) == 2]
    return order[pair], order[pair + 1]


def label_connected(count: int, first: I64 | I32, second: I64 | I32) -> I64:
    """Number of the connected part of each of ``count`` nodes, (count,) int64; parts are numbered by their first nodes.

    Two rounds at least halve the number of parts that have to be joined. Importing SciPy's search takes longer (0.07 s)
    than most scenes' meshes.

    Parameters
    ----------
    first, second : (n,) nodes at both ends of each link
    """
    # the least known node of each part; the parts at both ends of a link are joined at the lesser one
    root = np.arange(count)
    a, b = root[first], root[second]
    while (apart := a != b).any():
        first, second = first[apart], second[apart]
        np.minimum.at(root, np.maximum(a, b)[apart], np.minimum(a, b)[apart])
        while ((above := root[root]) != root).any():
            root = above
        a, b = root[first], root[second]
    return np.unique(root, return_inverse=True)[1].reshape(-1).astype(np.int64)
