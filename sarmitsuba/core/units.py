"""Conversions between linear values and decibels."""

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64


def db_from_power(power: ArrayLike) -> F64:
    """Return ``10 log10(power)`` as float64; zero gives ``-inf`` without a warning."""
    with np.errstate(divide="ignore"):
        return np.asarray(10.0 * np.log10(np.asarray(power, dtype=np.float64)))


def power_from_db(value_db: ArrayLike) -> F64:
    """Return ``10**(value_db / 10)`` as float64."""
    return np.asarray(10.0 ** (np.asarray(value_db, dtype=np.float64) / 10.0))
