"""Limits of the trace kernel in the far field; its levels on canonical targets are the validation cases'."""

import numpy as np

from sarmitsuba.scene.materials.material import Material
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.truth.validation.targets import PEC, dihedral, trihedral

FREQUENCY = 9.65e9


DIHEDRAL = dihedral(1.0, 1.0, 1.0)
TRIHEDRAL = trihedral(1.0, "triangular")
LOOK = [[1.0, 1.0, 0.0]]


def test_orders_add_up_and_the_third_dominates() -> None:
    """Bounce orders of a trihedral on its axis sum to the whole."""
    look = [[1.0, 1.0, 1.0]]
    whole = monostatic_rcs(TRIHEDRAL, PEC, look, FREQUENCY)
    orders = monostatic_rcs(TRIHEDRAL, PEC, look, FREQUENCY, keep_orders=True)
    np.testing.assert_allclose(orders.amplitude.sum(axis=1), whole.amplitude[:, 0], rtol=1e-3)
    assert np.abs(orders.amplitude[0, 2, 0]) > 30 * np.abs(orders.amplitude[0, :2, 0]).max()


def test_permittivity_one_returns_nothing_and_metal_is_the_perfect_limit() -> None:
    """Vacuum reflects exactly nothing; 1e7 S/m is a perfect conductor to 0.01 dB."""
    air = (Material("air", permittivity=1.0 + 0j),)
    assert not np.any(monostatic_rcs(DIHEDRAL, air, LOOK, FREQUENCY, ray_spacing=0.05).amplitude)
    metal = (Material("metal", permittivity=1.0 - 1.8e7j),)
    a = monostatic_rcs(DIHEDRAL, metal, LOOK, FREQUENCY, ray_spacing=0.05).rcs_dbsm("HH")
    b = monostatic_rcs(DIHEDRAL, PEC, LOOK, FREQUENCY, ray_spacing=0.05).rcs_dbsm("HH")
    np.testing.assert_allclose(a, b, atol=0.01)  # tol: loss 4 Rs / eta of a real metal, twice
