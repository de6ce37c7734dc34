"""Physical constants in SI units, and conventions common to several stages.

Conversions between linear values and decibels.
"""

from typing import overload

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64

# CODATA 2022 (Mohr et al., Rev. Mod. Phys. 97, 025002, 2025); the same with every version of SciPy
SPEED_OF_LIGHT = 299792458.0  # m/s, exact
BOLTZMANN = 1.380649e-23  # J/K, exact
VACUUM_PERMITTIVITY = 8.8541878188e-12  # F/m
VACUUM_IMPEDANCE = 376.730313412  # ohm

# WGS-84: NIMA TR8350.2, 3rd ed. (2000), tables 3.1 and 3.2, with the gravitational constant refined in 1994
EARTH_RADIUS = 6378137.0  # m, equatorial
EARTH_FLATTENING = 1.0 / 298.257223563
EARTH_GRAVITY = 3.986004418e14  # m^3/s^2, gravitational constant times mass, with the atmosphere
EARTH_ROTATION = 7.292115e-5  # rad/s

# share of the coherent rays, and weight in the image, of each ray subset of the error bars; 0: all rays together.
# Equal: their error is lowest, and their difference has a fixed ratio to it at the edges of shadows (error_bars.py)
SUBSET_SHARES: dict[int, float] = {0: 1.0, 1: 0.5, 2: 0.5}
# error energy of ray sampling falls with this power of the number of rays: 2.5 dB per doubling
# (benchmarks/suite/error_bars.py)
RAY_ERROR_ORDER = 0.83

# window of images in Python and on the command line: without one the side lobes of a city's corners cross its picture
DEFAULT_WINDOW = "taylor"


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
