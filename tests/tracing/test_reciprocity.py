"""HV = VH: one antenna sends and receives, whatever it looks at."""

import numpy as np
import pytest

from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.truth.validation.targets import geometry, parallelogram

FREQUENCY = 9.65e9
UP = np.array([0.0, 0.0, 1.0])


def wall_on_ground(off_deg: float) -> Geometry:
    """A wall on ground as wide as it is, its normal turned about the vertical."""
    off = np.radians(off_deg)
    normal, along = np.array([np.cos(off), np.sin(off), 0.0]), np.array([-np.sin(off), np.cos(off), 0.0])
    wall = parallelogram(-0.4 * along, 0.8 * along, 0.6 * UP)
    return geometry([wall, parallelogram(-0.4 * along, 2.0 * normal, 0.8 * along)])


@pytest.mark.parametrize("pec", [True, False])
@pytest.mark.parametrize("off_deg", [2.0, 20.0])
def test_a_turned_wall_on_ground_has_hv_equal_to_vh(pec: bool, off_deg: float) -> None:
    """Was: VH over HV like the tangent of the incidence angle, 2.1 in amplitude at 60 degrees."""
    material = Material("m", pec=pec, permittivity=1.0 if pec else 5.3 - 0.3j)
    theta = np.radians([35.0, 60.0])
    look = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1)
    shape = wall_on_ground(off_deg)
    whole = monostatic_rcs(
        shape, (material,), look, FREQUENCY, channels=("HH", "HV", "VH", "VV"), max_depth=3
    ).amplitude[:, 0]
    # tol: the 40 dB that are asked for
    limit = 10.0 ** (-40.0 / 20.0)
    assert (np.abs(whole[:, 1] - whole[:, 2]) < limit * np.abs(whole[:, 1])).all()
    assert (db_from_power(np.abs(whole[:, 1] / whole[:, 0]) ** 2) > -45.0).all()
    alone = monostatic_rcs(shape, (material,), look, FREQUENCY, channels=("VH",), max_depth=3).amplitude[:, 0]
    # tol: float32
    assert alone[:, 0] == pytest.approx(whole[:, 2], rel=1e-4)


def test_rough_ground_behind_a_wall_has_hv_equal_to_vh() -> None:
    """The same for the diffuse paths: both ways round, and back along the chain."""
    ground = Material(
        "g",
        permittivity=5.3 - 0.3j,
        rms_height=2e-3,
        correlation_length=0.02,
        diffuse_law="small_slope",
        cross_polar_ratio_db=-15.0,
    )
    look = np.array([[np.sin(0.9), 0.0, np.cos(0.9)]])
    channels = ("HH", "HV", "VH", "VV")
    flags = KernelFlags(channels=channels, antenna_pattern=False, taper=False)
    value = monostatic_rcs(
        wall_on_ground(25.0), (ground,), look, FREQUENCY, channels=channels, max_depth=3, flags=flags
    ).amplitude[0, 0]
    # tol: the 40 dB that are asked for
    assert abs(value[1] - value[2]) < 0.01 * abs(value[1])
