"""Physical constants in SI units, and conventions common to several stages."""

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

# energy of a channel relative to the strongest's below which its echoes are rounding and residues of symmetry, dB
EMPTY_DB = -60.0

# window of images in Python and on the command line: without one the side lobes of a city's corners cross its picture
DEFAULT_WINDOW = "taylor"

# letters of radar bands with a usual frequency of each, Hz, within IEEE Std 521: ALOS-2, NISAR's S band, Sentinel-1,
# TerraSAR-X, airborne Ku and Ka radars
BANDS: dict[str, float] = {
    "L": 1.2575e9,
    "S": 3.2e9,
    "C": 5.405e9,
    "X": 9.65e9,
    "Ku": 16.7e9,
    "Ka": 35.0e9,
}
