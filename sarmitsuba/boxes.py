"""Boxes along the axes."""

from itertools import product

import numpy as np

from sarmitsuba.arrays import F64


def box_corners(box: F64) -> F64:
    """Corners (8, 3) of a box (2, 3): least and greatest coordinates, z fastest."""
    return np.array(list(product(*np.asarray(box).T)))
