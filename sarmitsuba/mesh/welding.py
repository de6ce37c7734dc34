"""Welding: labels of vertices at equal positions."""

import numpy as np

from sarmitsuba.arrays import F64, I64


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
