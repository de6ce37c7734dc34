"""NumPy arrays as Dr.Jit arrays, always at aligned addresses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.backend import mi

if TYPE_CHECKING:
    Array = TypeVar("Array")

_ALIGNMENT = 64  # bytes; the widest vector of a processor


def device_array(array_type: type[Array], values: NDArray[Any]) -> Array:
    """Copy a NumPy array, flattened, into a Dr.Jit array of ``array_type``; the items' types must agree.

    Dr.Jit takes a NumPy array's memory as it is, and whether its address is aligned enters the kernel: the same
    code would now and then be compiled again.
    """
    flat = np.ascontiguousarray(values).reshape(-1)
    memory = np.empty(flat.nbytes + _ALIGNMENT, dtype=np.uint8)
    start = -memory.ctypes.data % _ALIGNMENT
    aligned = memory[start : start + flat.nbytes].view(flat.dtype)
    aligned[...] = flat
    return array_type(aligned)  # type: ignore[call-arg]


def vector_rows(rows: NDArray[np.float64]) -> mi.Float64:
    """(n, 3) float64 array as a flat Dr.Jit array to gather 3-vectors from."""
    return device_array(mi.Float64, np.asarray(rows, dtype=np.float64))


__all__ = ["device_array", "vector_rows"]
