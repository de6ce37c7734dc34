"""Physical constants in SI units, CODATA values from SciPy, and conventions that several stages share."""

from scipy import constants as _codata

SPEED_OF_LIGHT: float = _codata.c  # m/s, exact
BOLTZMANN: float = _codata.k  # J/K, exact
VACUUM_PERMITTIVITY: float = _codata.epsilon_0  # F/m
VACUUM_IMPEDANCE: float = _codata.physical_constants["characteristic impedance of vacuum"][0]  # ohm

# share of the coherent rays, and weight in the image, of each set that error bars keep apart; 0: all rays together.
# Three to one: sets of different density differ by what their density blurs, too, which equal ones would share
SUBSET_SHARES: dict[int, float] = {0: 1.0, 1: 0.75, 2: 0.25}

__all__ = ["BOLTZMANN", "SPEED_OF_LIGHT", "SUBSET_SHARES", "VACUUM_IMPEDANCE", "VACUUM_PERMITTIVITY"]
