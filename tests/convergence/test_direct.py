"""The direct accumulator converges to the exact sum as its kernel widens."""

import numpy as np
import pytest

from sarmitsuba.signal.direct import box_distance, finish, plan_direct, spread_reference
from sarmitsuba.signal.gridding import gridding_kernel


def _run(s, exact, error_db, width, pulses=slice(250, 254), n_paths=200, extra=0.0):
    rng = np.random.default_rng(1)
    points = rng.uniform(s.box[0], s.box[1], (n_paths, 3))
    amplitude = rng.normal(size=(2, n_paths)) + 1j * rng.normal(size=(2, n_paths))
    half = np.linalg.norm(points[:, None] - s.radar.track.position[None, pulses], axis=-1)
    half += extra * rng.uniform(size=(n_paths, 1))
    plan = plan_direct(s.radar, pulses.start, pulses.stop, s.box, width, extra)
    profiles = finish(spread_reference(plan, s.radar, half, amplitude), plan, s.radar)
    assert profiles.dtype == np.complex64
    assert profiles.shape == (2, pulses.stop - pulses.start, s.radar.window.n_samples)
    return error_db(profiles, exact(s.radar, pulses, half, amplitude))


@pytest.mark.parametrize(
    ("width", "bound"), [(1, -11), (2, -25.5), (3, -47), (4, -64), (5, -84), (6, -102), (7, -121), (8, -130)]
)
def test_error_falls_with_the_width_as_predicted(setting, exact, error_db, width, bound):
    error = _run(setting(), exact, error_db, width)
    assert error < bound
    # tol: 1 dB, 200 random positions sample the kernel's mean error; complex64 ends at -138 dB
    assert abs(error - max(gridding_kernel(width).error_db, -138.0)) < (1.0 if width < 8 else 4.0)


@pytest.mark.parametrize("oversampling", [1.0, 1.2, 2.0])
@pytest.mark.parametrize("inset", [-15.0, 100.0])
def test_sampling_rate_and_window_do_not_matter(setting, exact, error_db, oversampling, inset):
    """Also with contributions far outside a window smaller than the box: only their true tails come in."""
    error = _run(setting(oversampling=oversampling, inset=inset), exact, error_db, 6)
    # tol: -95 dB, 7 dB over the width's mean error; a wrapped sinc tail would show at -45 dB
    assert error < -95.0


def test_single_pulse_and_longer_paths(setting, exact, error_db):
    error = _run(setting(), exact, error_db, 6, slice(511, 512), extra=80.0)
    assert error < -95.0  # tol: as above


def test_far_range_keeps_its_phase(setting, exact, error_db):
    s = setting(slant_range=700e3, frequency=9.65e9)
    # tol: -95 dB; 700 km in float64 are 2e-10 m, a phase of 5e-8
    assert _run(s, exact, error_db, 6) < -95.0


def test_box_distance_is_the_true_extreme():
    rng = np.random.default_rng(3)
    box = np.array([[-3.0, -2.0, 0.0], [4.0, 1.0, 2.0]])
    antenna = rng.uniform(-10, 10, (20, 3))
    near, far = box_distance(box, antenna)
    distance = np.linalg.norm(rng.uniform(box[0], box[1], (20000, 3))[:, None] - antenna, axis=-1)
    assert (near <= distance.min(axis=0)).all()
    assert (far >= distance.max(axis=0)).all()
    # tol: 0.3 m, the largest gap of 20000 random points to a corner of this box
    assert np.allclose(near, distance.min(axis=0), atol=0.3)
    assert np.allclose(far, distance.max(axis=0), atol=0.3)
