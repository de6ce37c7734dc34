"""NumPy arrays as Dr.Jit arrays, always at aligned addresses."""

from __future__ import annotations

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.machine.backend import device_array, mi


def vector_rows(rows: F64) -> mi.Float64:
    """Array (n, 3) float64 as a flat Dr.Jit array to gather 3-vectors from."""
    return device_array(mi.Float64, np.asarray(rows, dtype=np.float64))


__all__ = ["device_array", "vector_rows"]
