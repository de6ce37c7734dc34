"""Spectrum of a pixel's own pulses against the integral that it stands for."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.signal.focusing.frequency_domain.aperture_filter import aperture_filter
from sarmitsuba.signal.focusing.frequency_domain.track_geometry import track_geometry
from sarmitsuba.signal.focusing.grid import default_grid
from sarmitsuba.signal.focusing.ideal import ideal_radar
from sarmitsuba.signal.focusing.windows import parse_window


@pytest.mark.parametrize("window", ["rectangular", "taylor", "hann"])
@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_fourier_transform_of_the_weights(window: str, seed: int) -> None:
    rng = np.random.default_rng([seed, len(window)])
    half, width = float(rng.uniform(0.006, 0.012)), float(rng.uniform(0.012, 0.03))
    antenna = Antenna("gaussian", 1.0, width, 0.4)
    radar = replace(
        ideal_radar(slant_range=float(rng.uniform(3e3, 30e3)), mode="stripmap", antenna=antenna),
        half_aperture=half,
    )
    request = {"grid": "slant", "center_x": 0.0, "center_y": 0.0, "height": 0.0}
    grid = default_grid(radar, request | {"extent_azimuth": 20.0, "extent_range": 20.0})
    geometry = track_geometry(radar, grid)
    taper = parse_window(window)
    filtered = aperture_filter(radar, grid, geometry, taper, np.array([-0.1, 0.1]))
    assert filtered is not None
    rho, k = geometry.rho_center, 4.0 * np.pi / radar.waveform.wavelength * float(rng.uniform(0.98, 1.02))
    sine = np.linspace(-2.0, 2.0, 161) * half
    got = filtered(k * sine[:, None], np.array([k]), k * np.sqrt(1.0 - sine[:, None] ** 2))[:, 0]

    # the weights' own chirp and its transform by the midpoint rule, over its value by stationary phase; the weight
    # falls to zero within one pulse
    edge = rho * half / np.sqrt(1.0 - half**2) + geometry.spacing
    n = 1 << 15
    u = edge * (2.0 * (np.arange(n) + 0.5) / n - 1.0)
    angle = u / np.hypot(u, rho)
    gain = 0.5 ** (
        (angle / np.sin(0.5 * width)) ** 2
    )  # both ways of a Gaussian beam of that half-power width
    step = geometry.spacing * (1.0 - angle**2) / np.hypot(u, rho)
    share = np.clip((half - np.abs(angle)) / step + 0.5, 0.0, 1.0)
    weight = taper(np.clip(angle / (2.0 * half), -0.5, 0.5)) * gain * share
    exact = np.array(
        [np.sum(weight * np.exp(1j * k * (np.hypot(u, rho) - s * u))) * 2.0 * edge / n for s in sine]
    )
    cosine = np.sqrt(1.0 - sine**2)
    exact /= np.sqrt(2.0 * np.pi * rho / (k * cosine**3)) * np.exp(1j * (k * rho * cosine + 0.25 * np.pi))
    error = np.sum(np.abs(got - exact) ** 2) / np.sum(np.abs(exact) ** 2)
    product = 8.0 * half**2 * rho / radar.waveform.wavelength
    # tol: next orders of stationary phase, which fall with the power of 2.5 of the time-bandwidth product
    assert 10.0 * np.log10(error) < 10.0 * np.log10(2.0 * product**-2.5), product
