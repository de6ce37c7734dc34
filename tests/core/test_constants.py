"""Physical constants against those of SciPy, and conversions common to all rooms."""

import numpy as np
import pytest
import scipy.constants

from sarmitsuba.core import constants
from sarmitsuba.core.arrays import sum_energies, sum_energy, unit_rows
from sarmitsuba.core.units import amplitude_from_db, db_from_amplitude, db_from_power, power_from_db


def test_physical_constants_are_those_of_codata() -> None:
    assert (constants.SPEED_OF_LIGHT, constants.BOLTZMANN) == (scipy.constants.c, scipy.constants.k)
    # tol: 2e-9, more than the adjustment of 2022 changed that of 2018, which older versions of SciPy have
    assert constants.VACUUM_PERMITTIVITY == pytest.approx(scipy.constants.epsilon_0, rel=2e-9)
    impedance = 1.0 / (constants.VACUUM_PERMITTIVITY * constants.SPEED_OF_LIGHT)
    # tol: 1e-11, the digits given
    assert pytest.approx(impedance, rel=1e-11) == constants.VACUUM_IMPEDANCE


def test_decibels_and_back_keep_the_form_of_their_argument() -> None:
    powers = np.array([0.0, 0.5, 1e-30, 2e12])
    assert db_from_power(powers)[0] == db_from_amplitude(0.0) == -np.inf
    # tol: rounding of float64 at 123 dB
    np.testing.assert_allclose(power_from_db(db_from_power(powers)), powers, rtol=1e-13)
    np.testing.assert_allclose(amplitude_from_db(db_from_amplitude(powers)), powers, rtol=1e-13)
    for convert in (db_from_power, db_from_amplitude, power_from_db, amplitude_from_db):
        assert type(convert(2.0)) is float and convert(powers[:3]).shape == (3,)
    assert db_from_amplitude(10.0) == 2.0 * db_from_power(10.0) == 20.0


def test_energies_and_unit_rows_are_those_of_the_field() -> None:
    planes = np.array([[[3.0 + 4.0j, 0.0]], [[1.0, 1.0j]]], dtype=np.complex64)
    assert sum_energies(planes).tolist() == [25.0, 2.0] and sum_energy(planes) == 27.0
    rows = unit_rows(np.array([[3.0, 0.0, 4.0], [0.0, 0.0, 0.0]]))
    assert rows.tolist() == [[0.6, 0.0, 0.8], [0.0, 0.0, 0.0]]
