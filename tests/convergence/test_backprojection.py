"""The compiled backprojection against the exact sum in float64, and how its error falls."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import direction_gain, look_directions
from sarmitsuba.signal.focusing.focusers.backprojection import backproject, backproject_numpy
from sarmitsuba.signal.focusing.grid import default_grid
from sarmitsuba.signal.focusing.ideal import ideal_radar
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.signal.raw_data import Layer, RawData


def noise_data(radar: Radar, n_layers: int = 1, seed: int = 0) -> RawData:
    """Band-limited noise everywhere: every sample and every pulse counts alike, unlike with points."""
    rng = np.random.default_rng(seed)
    shape = (n_layers, radar.track.n_pulses, radar.window.n_samples)
    white = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    spectrum = np.fft.fft(white)
    spectrum[..., np.abs(np.fft.fftfreq(shape[-1])) > 0.5 / 1.2] = 0.0
    data = np.fft.ifft(spectrum).astype(np.complex64)
    return RawData(data, tuple(Layer("HH", n) for n in range(n_layers)), "compressed", radar)


def pixels(n: int, extent: float, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (n, 3)) * [extent, extent, 0.1 * extent]


@pytest.mark.parametrize(
    ("slant_range", "resolution"), [pytest.param(10e3, 1.0, marks=pytest.mark.slow), (700e3, 12.0)]
)
def test_best_setting_is_the_exact_sum(slant_range: float, resolution: float) -> None:
    radar = ideal_radar(slant_range=slant_range, resolution=resolution, n_samples=200)
    raw = noise_data(radar, n_layers=2)
    points = pixels(301, 60.0)
    exact = backproject_numpy(raw, points)
    best = image_error_db(backproject(raw, points, interpolation="kernel:8", oversampling=4), exact)
    default = image_error_db(backproject(raw, points), exact)
    # tol: the required -75 dB; single-precision samples, sincos and sums leave about -115 dB
    assert best < -105.0
    # tol: the six-tap kernel's aliasing
    assert default < -85.0


def test_wider_kernels_err_less() -> None:
    raw = noise_data(ideal_radar(n_samples=200, resolution=2.0))
    points = pixels(200, 50.0)
    exact = backproject_numpy(raw, points)
    errors = [
        image_error_db(backproject(raw, points, interpolation=f"kernel:{width}"), exact)
        for width in (4, 6, 8)
    ]
    assert errors[1] < errors[0] - 20.0 and errors[2] < errors[1] - 10.0, errors
    assert errors[0] < -55.0


def test_linear_interpolation_is_second_order() -> None:
    raw = noise_data(ideal_radar(n_samples=200, resolution=2.0))
    points = pixels(400, 50.0)
    exact = backproject_numpy(raw, points)
    errors = [
        image_error_db(backproject(raw, points, interpolation="linear", oversampling=factor), exact)
        for factor in (2, 4, 8, 16)
    ]
    slopes = -np.diff(errors)  # dB per doubling; second order is 12 dB
    # tol: the coarsest step is not yet in the asymptote; Monte Carlo of 400 pixels
    assert (slopes > 11.0).all() and slopes[-1] == pytest.approx(12.0, abs=0.7), errors
    assert errors[2] < -45.0


def test_antenna_weights_and_windows_in_the_kernel() -> None:
    radar = ideal_radar(n_samples=200, resolution=2.0, antenna=Antenna("rectangular", 1.0, 0.012, 0.05))
    raw = noise_data(radar)
    points = pixels(50, 40.0)
    gain = direction_gain(radar, slice(None), look_directions(radar, points))
    # the exact sum with the weights put into the data, pixel by pixel
    weighted = np.array(
        [
            backproject_numpy(replace(raw, data=(raw.data * g[None, :, None]).astype(np.complex64)), p[None])[
                0, 0
            ]
            * g.size
            / np.sum(g**2)
            for g, p in zip(gain, points, strict=True)
        ]
    )
    assert (
        image_error_db(backproject(raw, points)[0], weighted) < -80.0
    )  # tol: six-tap kernel, single precision


def test_grid_and_list_of_points_give_the_same_pixels() -> None:
    radar = ideal_radar(n_samples=200, resolution=2.0)
    for n_layers in (1, 3, 5):  # different numbers of pixels a lane
        raw = noise_data(radar, n_layers)
        grid = default_grid(radar, {**REQUEST, "extent_azimuth": 13.0})
        image = backproject(raw, grid)
        listed = backproject(raw, grid.positions().reshape(-1, 3))
        assert image.shape == (n_layers, *grid.shape)
        np.testing.assert_allclose(image.reshape(n_layers, -1), listed, atol=1e-5 * np.abs(image).max())


def test_batches_of_pulses_do_not_show() -> None:
    raw = noise_data(ideal_radar(n_samples=200, resolution=2.0))
    points = pixels(100, 50.0)
    whole = backproject(raw, points)
    pieces = backproject(raw, points, batch_bytes=1, tile_pixels=64)
    assert image_error_db(pieces, whole) < -110.0  # tol: order of single-precision sums


REQUEST = {
    "grid": "ground",
    "center_x": 0.0,
    "center_y": 0.0,
    "height": 0.0,
    "extent_azimuth": 20.0,
    "extent_range": 20.0,
    "spacing_azimuth": 0.0,
    "spacing_range": 0.0,
}
