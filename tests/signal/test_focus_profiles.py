"""Range profiles: band weights, kernel correction, value between samples."""

import numpy as np
import pytest

from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.focusing.profiles import band_weights, parse_interpolation, plan_profiles
from sarmitsuba.signal.focusing.windows import parse_window


@pytest.mark.parametrize("factor", [1.0, 1.2, 2.0])
@pytest.mark.parametrize("window", ["rectangular", "taylor"])
def test_band_weights_are_confined_and_sum_to_the_bandwidth(factor: float, window: str) -> None:
    n = 400
    weights = band_weights(n, factor, 1.0, parse_window(window))
    assert weights.sum() == pytest.approx(n / factor, rel=1e-12)  # tol: rounding
    outside = np.abs(np.fft.fftfreq(n)) > 0.5 / factor + 1.0 / n
    assert not weights[outside].any()


@pytest.mark.parametrize(
    ("interpolation", "bound_db"),
    # tol: the kernels' own aliasing: linear at 8 x 1.2 samples per cell, the others at 2 x 1.2
    [("linear", -50.0), ("kernel:4", -60.0), ("kernel:6", -85.0), ("kernel:8", -105.0)],
)
def test_profile_between_samples_is_the_band_limited_function(interpolation: str, bound_db: float) -> None:
    radar = ideal_radar(n_samples=128)
    raw = ideal_echoes(radar, [2.0, -1.0, 0.0])
    plan = plan_profiles(radar, parse_window("hamming"), interpolation=interpolation)
    profile = plan.profiles(raw.data[0, :4])
    spectrum = np.fft.fft(raw.data[0, :4].astype(np.complex128), n=plan.n_fft)
    used = plan.gains > 0.0
    spectrum[:, ~used] = 0.0
    f = np.fft.fftfreq(plan.n_fft)
    spectrum[:, used] *= plan.gains[used] * plan.kernel.transform(f[used] / plan.oversampling)

    position = np.random.default_rng(1).uniform(20, 100, 400)
    exact = spectrum @ np.exp(2j * np.pi * np.outer(f, position)) / plan.n_fft
    fine = position * plan.oversampling
    base = np.floor(fine).astype(int)
    taps = plan.kernel.taps(fine - base)
    value = sum(profile[:, base + k] * taps[k] for k in range(plan.width))
    error = np.linalg.norm(value - exact) / np.linalg.norm(exact)
    assert 20 * np.log10(error) < bound_db


def test_point_amid_the_window_keeps_its_peak() -> None:
    radar = ideal_radar(n_samples=64)
    raw = ideal_echoes(radar, np.zeros(3))
    r = np.linalg.norm(radar.track.position[0])
    for window in ("rectangular", "taylor", "hann"):
        plan = plan_profiles(radar, parse_window(window), interpolation="kernel:8")
        x = (r - radar.window.start_range[0]) / plan.step
        base = int(x)
        taps = plan.kernel.taps(x - base)
        value = sum(plan.profiles(raw.data[0, :1])[0, base + k] * taps[k] for k in range(plan.width))
        peak = abs(value) * r**2 / radar.amplitude_constant
        # tol: rescaled for a point on the middle sample, this one lies up to a sample beside it
        assert 20 * np.log10(peak) == pytest.approx(0.0, abs=0.005)


def test_bad_options_are_refused() -> None:
    radar: Radar = ideal_radar(n_samples=64)
    with pytest.raises(DataError, match="interpolation 'nearest'"):
        parse_interpolation("nearest")
    with pytest.raises(DataError, match="oversampling = -1"):
        plan_profiles(radar, parse_window("hann"), oversampling=-1)
