"""Physical constants in SI units (CODATA values from SciPy), and conventions common to several stages."""

from scipy import constants as _codata

SPEED_OF_LIGHT: float = _codata.c  # m/s, exact
BOLTZMANN: float = _codata.k  # J/K, exact
VACUUM_PERMITTIVITY: float = _codata.epsilon_0  # F/m
VACUUM_IMPEDANCE: float = _codata.physical_constants["characteristic impedance of vacuum"][0]  # ohm

# WGS-84: NIMA TR8350.2, 3rd ed. (2000), tables 3.1 and 3.2, with the gravitational constant refined in 1994
EARTH_RADIUS = 6378137.0  # m, equatorial
EARTH_FLATTENING = 1.0 / 298.257223563
EARTH_GRAVITY = 3.986004418e14  # m^3/s^2, gravitational constant times mass, with the atmosphere
EARTH_ROTATION = 7.292115e-5  # rad/s

# share of the coherent rays, and weight in the image, of each ray subset of the error bars; 0: all rays together.
# Three to one: subsets of different density also show errors that depend on density, which equal subsets share
SUBSET_SHARES: dict[int, float] = {0: 1.0, 1: 0.75, 2: 0.25}
# error energy of ray sampling falls with this power of the number of rays: 2.5 dB per doubling
# (benchmarks/suite/error_bars.py)
RAY_ERROR_ORDER = 0.83
