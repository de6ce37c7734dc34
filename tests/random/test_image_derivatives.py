"""Images to first order against simulated ones, boxes on ground drawn by seed: their error is the one stated."""

import numpy as np
import pytest

from sarmitsuba.apps.fit.image_derivative import ImageDerivative, image_derivative
from tests.support.differences import drawn
from tests.support.draws import few_of


def errors(found: ImageDerivative, change: float) -> tuple[float, float]:
    """Error of the change to first order, as a share of the simulated change: measured and stated."""
    simulated = found.simulated_at(change).data.astype(np.complex128)
    true = simulated - found.image.data
    left = simulated - found.image_at(change).data
    return float(np.linalg.norm(left) / np.linalg.norm(true)), found.error(change)


@pytest.mark.parametrize("seed", few_of([1, 2, 3, 4]))
@pytest.mark.parametrize(
    ("kind", "parameter"),
    [
        ("alone", "shift:box:x"),
        ("rough", "shift:box:z"),
        ("rough", "height:box"),
        ("rough", "level:soil"),
    ],
)
def test_error_of_first_order_is_the_stated_one(kind: str, parameter: str, seed: int) -> None:
    found = image_derivative(drawn(seed, kind), parameter)
    for share in (0.5, 1.0):
        measured, stated = errors(found, share * found.largest_change)
        # tol: next order of exp(x), x^2 / 12, for a level; of a phase 1 %; directions over the box, edges of shadows
        assert measured == pytest.approx(
            stated, rel=0.08, abs=0.01 + stated**2 / 3.0 * (found.unit == "dB")
        ), share


@pytest.mark.parametrize("seed", few_of([1, 2, 3, 4]))
@pytest.mark.parametrize(
    "parameter",
    ["rms_height:wall", "rms_height:soil", "correlation_length:wall", "permittivity:soil", "loss:wall"],
)
def test_error_of_first_order_of_a_property_stays_below_the_stated_one(parameter: str, seed: int) -> None:
    found = image_derivative(drawn(seed, "rough"), parameter)
    for share in (-0.5, 0.5, 1.0):
        change = share * min(found.largest_change, 2.0 * found.value)
        measured, stated = errors(found, change)
        assert 0.0 < measured < stated < 0.5, (change, found.value)


def test_rate_of_a_shift_is_the_phase_of_the_path() -> None:
    """A box alone that moves along the line of sight, by the formula of the phase."""
    scene = drawn(5, "alone")
    sight = scene.radar.track.center_position - scene.radar.aim_point
    sight /= np.linalg.norm(sight)
    for axis, name in enumerate("xyz"):
        found = image_derivative(scene, f"shift:box:{name}")
        rate = 4.0 * np.pi / scene.radar.waveform.wavelength * abs(sight[axis])
        # tol: directions over the box and the aperture, which automatic blocks follow: half a degree over the least
        # component
        assert found.rate == pytest.approx(rate, rel=0.04), name
        assert found.displaces and found.unit == "m"
        # an eighth of a wavelength of path
        assert found.largest_change == pytest.approx(
            scene.radar.waveform.wavelength / 16.0 / abs(sight[axis]), rel=0.04
        )
