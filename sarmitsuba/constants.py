"""Physical constants in SI units, CODATA values from SciPy."""

from scipy import constants as _codata

SPEED_OF_LIGHT: float = _codata.c  # m/s, exact
BOLTZMANN: float = _codata.k  # J/K, exact
VACUUM_PERMITTIVITY: float = _codata.epsilon_0  # F/m
VACUUM_IMPEDANCE: float = _codata.physical_constants["characteristic impedance of vacuum"][0]  # ohm

__all__ = ["BOLTZMANN", "SPEED_OF_LIGHT", "VACUUM_IMPEDANCE", "VACUUM_PERMITTIVITY"]
