"""Conversions between linear values and decibels."""

from typing import overload

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64


@overload
def db_from_power(power: float) -> float: ...
@overload
def db_from_power(power: ArrayLike) -> F64: ...
def db_from_power(power: ArrayLike) -> float | F64:
    """Return ``10 log10(power)``, float64; zero gives ``-inf`` without a warning."""
    with np.errstate(divide="ignore"):
        found = 10.0 * np.log10(np.asarray(power, dtype=np.float64))
    return float(found) if np.ndim(power) == 0 else np.asarray(found)


@overload
def db_from_amplitude(amplitude: float) -> float: ...
@overload
def db_from_amplitude(amplitude: ArrayLike) -> F64: ...
def db_from_amplitude(amplitude: ArrayLike) -> float | F64:
    """Return ``20 log10(amplitude)``, float64; zero gives ``-inf`` without a warning."""
    with np.errstate(divide="ignore"):
        found = 20.0 * np.log10(np.asarray(amplitude, dtype=np.float64))
    return float(found) if np.ndim(amplitude) == 0 else np.asarray(found)


@overload
def power_from_db(value_db: float) -> float: ...
@overload
def power_from_db(value_db: ArrayLike) -> F64: ...
def power_from_db(value_db: ArrayLike) -> float | F64:
    """Return ``10**(value_db / 10)``, float64."""
    found = 10.0 ** (np.asarray(value_db, dtype=np.float64) / 10.0)
    return float(found) if np.ndim(value_db) == 0 else np.asarray(found)


@overload
def amplitude_from_db(value_db: float) -> float: ...
@overload
def amplitude_from_db(value_db: ArrayLike) -> F64: ...
def amplitude_from_db(value_db: ArrayLike) -> float | F64:
    """Return ``10**(value_db / 20)``, float64."""
    found = 10.0 ** (np.asarray(value_db, dtype=np.float64) / 20.0)
    return float(found) if np.ndim(value_db) == 0 else np.asarray(found)
