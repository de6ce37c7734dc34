"""Checks for NaN and infinity, which are never returned silently."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64
from sarmitsuba.core.errors import DataError


def all_finite(data: NDArray[np.complexfloating] | NDArray[np.floating]) -> bool:
    """Whether every number is finite, tested by a sum of squares in one pass without a temporary array."""
    flat = np.ascontiguousarray(data).reshape(-1)
    real = flat.view(flat.real.dtype)
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(np.dot(real, real)):
            return True
    return bool(np.isfinite(real).all())  # the squares of large numbers overflow


def check_pulses(data: C64, where: str = "") -> None:
    """Raise an error for echoes with NaN or infinite numbers.

    Parameters
    ----------
    data : (n_layers, n_pulses, n_fast)
    where : start of the message, such as a file's name and a colon

    Raises
    ------
    DataError
        A pulse holds NaN or infinite numbers.
    """
    if all(all_finite(plane) for plane in data):
        return
    bad = [i for i in range(data.shape[1]) if not np.isfinite(data[:, i]).all()]
    raise DataError(
        f"{where}{len(bad)} of {data.shape[1]} pulses hold NaN or infinite numbers, the first is pulse {bad[0]}; set "
        "them to zero"
    )
