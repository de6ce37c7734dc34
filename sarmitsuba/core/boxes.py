"""Boxes along the axes."""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64


def box_of_each(points: F64) -> tuple[F64, F64]:
    """Least and greatest coordinates (n, k) of a few points each (n, few, k); much faster than a reduction."""
    low = high = points[:, 0]
    for column in np.moveaxis(points[:, 1:], 1, 0):
        low, high = np.minimum(low, column), np.maximum(high, column)
    return low, high


def boxes_meet(points: F64, box: F64) -> NDArray[np.bool_]:
    """Whether the boxes of a few points each (n, few, 3) meet a box (2, 3), (n,)."""
    low, high = box_of_each(points)
    meets = np.ones(len(points), dtype=bool)
    for axis in range(points.shape[2]):
        meets &= (low[:, axis] <= box[1, axis]) & (high[:, axis] >= box[0, axis])
    return meets


def box_corners(box: F64) -> F64:
    """Corners (8, 3) of a box (2, 3): least and greatest coordinates, z fastest."""
    return np.array(list(product(*np.asarray(box).T)))
