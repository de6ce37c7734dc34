"""Edges that two triangles of a mesh share."""

import numpy as np

from sarmitsuba.core.arrays import I64


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
