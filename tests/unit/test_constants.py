"""Physical constants against those of SciPy."""

import pytest
import scipy.constants

from sarmitsuba.core import constants


def test_physical_constants_are_those_of_codata() -> None:
    assert (constants.SPEED_OF_LIGHT, constants.BOLTZMANN) == (scipy.constants.c, scipy.constants.k)
    # tol: 2e-9, more than the adjustment of 2022 changed that of 2018, which older versions of SciPy have
    assert constants.VACUUM_PERMITTIVITY == pytest.approx(scipy.constants.epsilon_0, rel=2e-9)
    impedance = 1.0 / (constants.VACUUM_PERMITTIVITY * constants.SPEED_OF_LIGHT)
    # tol: 1e-11, the digits given
    assert pytest.approx(impedance, rel=1e-11) == constants.VACUUM_IMPEDANCE
