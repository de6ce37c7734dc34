"""Welding: labels of vertices at equal positions."""

import numpy as np

from sarmitsuba.core.arrays import F64, I64


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
