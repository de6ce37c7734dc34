"""Backprojection's lines of pixels: expansions of range, echo and weights against the sum that takes every pixel alone.

``backproject_numpy`` (float64, no expansion) and lists of points (one pixel per lane) share none of the expansions.
"""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.focusers.backprojection import backproject, backproject_numpy
from sarmitsuba.signal.focusing.grid import default_grid
from sarmitsuba.signal.focusing.ideal import ideal_radar
from sarmitsuba.signal.focusing.pixel_tiles import LONGEST_LINE, nodes_needed, plan_line
from sarmitsuba.signal.focusing.profiles import plan_profiles
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.signal.raw_data import Layer, RawData


def noise_data(radar: Radar, seed: int) -> RawData:
    """Band-limited noise: every sample and every pulse counts."""
    rng = np.random.default_rng(seed)
    shape = (1, radar.track.n_pulses, radar.window.n_samples)
    spectrum = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    spectrum[..., np.abs(np.fft.fftfreq(shape[-1])) > 0.5 / 1.2] = 0.0
    return RawData(np.fft.ifft(spectrum).astype(np.complex64), (Layer("HH"),), "compressed", radar)


def odd_grid(rng: np.random.Generator, turned: float) -> ImageGrid:
    """A grid of odd size about the origin, turned from the flight direction (+y)."""
    n = rng.integers(37, 60, 2)
    along = np.array([np.sin(turned), np.cos(turned), 0.0])
    across = np.array([along[1], -along[0], 0.0])
    azimuth, ground = (0.4 * (np.arange(k) - k // 2) for k in n)
    return ImageGrid("ground", azimuth, ground, np.zeros(3), along, across)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("interpolation", "limit"), [("linear", -48.0), ("kernel", -95.0), ("kernel:8", -108.0)]
)
def test_any_track_heading_squint_and_range(seed: int, interpolation: str, limit: float) -> None:
    rng = np.random.default_rng(seed)
    radar = ideal_radar(
        slant_range=float(10.0 ** rng.uniform(2.7, 5.0)),
        resolution=3.0,
        squint_angle=float(rng.choice([0.0, 0.05, 0.6])),
    )
    position = radar.track.position.copy()
    position[:, 0] += 3.0 * np.sin(np.linspace(0.0, 7.0, len(position)))  # bends
    position[:, 2] += np.linspace(-2.0, 2.0, len(position)) ** 2
    radar = replace(radar, track=replace(radar.track, position=position))
    raw, grid = noise_data(radar, seed), odd_grid(rng, float(rng.uniform(-0.5, 0.5) * (seed % 2)))
    pick = rng.integers(0, grid.azimuth.size * grid.range.size, 150)
    exact = backproject_numpy(raw, grid.positions().reshape(-1, 3)[pick])
    image = backproject(raw, grid, interpolation=interpolation, oversampling=4 if limit < -100.0 else 0)
    # tol: the kernels' own errors on noise that fills the band, by test_backprojection.py
    assert image_error_db(image.reshape(1, -1)[:, pick], exact) < limit


@pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
@pytest.mark.parametrize("pattern", ["isotropic", "gaussian", "rectangular"])
def test_weights_along_a_line(mode: str, pattern: str) -> None:
    """Antenna and the pixel's own aperture vary along a line; single pixels take them without expansion."""
    radar = ideal_radar(slant_range=4e3, resolution=1.0, mode=mode, antenna=Antenna(pattern, 1.0, 0.02, 0.1))
    raw, grid = noise_data(radar, 5), odd_grid(np.random.default_rng(3), 0.0)
    pick = np.random.default_rng(4).integers(0, grid.azimuth.size * grid.range.size, 300)
    image = backproject(raw, grid, azimuth_window="hamming").reshape(1, -1)[:, pick]
    single = backproject(raw, grid.positions().reshape(-1, 3)[pick], azimuth_window="hamming")
    # tol: weights are parabolas to 3e-5; a band's last pulse counts in part, its sine rounded to float32
    assert image_error_db(image, single) < -75.0


def test_pixels_outside_the_receive_window_are_left_out() -> None:
    radar = ideal_radar(n_samples=64, resolution=3.0)
    raw = noise_data(radar, 1)
    grid = odd_grid(np.random.default_rng(1), 0.0)
    grid = replace(grid, range=8.0 * grid.range)  # past both ends of the window
    image = backproject(raw, grid).reshape(1, -1)
    single = backproject(raw, grid.positions().reshape(-1, 3))
    assert (single == 0.0).any() and (single != 0.0).any()
    np.testing.assert_array_equal(image == 0.0, single == 0.0)
    assert image_error_db(image, single) < -90.0  # tol: expansion and single-precision phase


def test_nodes_are_enough_by_brute_force() -> None:
    rng = np.random.default_rng(8)
    x = np.linspace(-1.0, 1.0, 501)
    for _ in range(200):
        kappa, bend, tolerance = rng.uniform(0.0, 2.0), rng.uniform(0.0, 1.0), 10.0 ** rng.uniform(-6.0, -2.0)
        k = nodes_needed(kappa, bend, tolerance)
        if k is None:
            continue
        nodes = np.cos(np.pi * (np.arange(k) + 0.5) / k)
        fit = np.polynomial.Chebyshev.fit(
            nodes, np.exp(1j * (kappa * nodes + bend * nodes**2)), k - 1, [-1.0, 1.0]
        )
        error = np.abs(fit(x) - np.exp(1j * (kappa * x + bend * x**2))).max()
        assert error <= tolerance, (kappa, bend, tolerance, k)


def test_lines_are_long_where_the_geometry_allows_it() -> None:
    request = {"grid": "ground", "center_x": 0.0, "center_y": 0.0, "height": 0.0, "extent_azimuth": 30.0}
    request |= {"extent_range": 30.0, "spacing_azimuth": 0.25, "spacing_range": 0.25}
    far, near = (ideal_radar(slant_range=r, resolution=1.0) for r in (20e3, 60.0))
    plans = [
        plan_line(radar, plan_profiles(radar, parse_window("rectangular")), default_grid(radar, request))
        for radar in (far, near)
    ]
    assert plans[0][0] == LONGEST_LINE and plans[0][1] < LONGEST_LINE / 2
    assert plans[1][0] < plans[0][0]
