"""Radars over a box of scatterers, and the exact sum that the accumulators approximate."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.radar.antenna import Antenna, Pointing
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.waveform import Waveform
from sarmitsuba.signal.direct import box_distance


def _straight(slant_range: float, frequency: float, cell: float, n_pulses: int, squint: float) -> Track:
    """45 degree look at the origin over an aperture of azimuth cell ``cell``, flying along +y at 100 m/s."""
    look = np.radians(45.0)
    sight = np.array([np.sin(look) * np.cos(squint), np.sin(look) * np.sin(squint), -np.cos(look)])
    aperture = SPEED_OF_LIGHT / frequency * slant_range / (2.0 * cell)
    return Track.straight(-slant_range * sight, [0.0, 100.0, 0.0], 100.0 * n_pulses / aperture, n_pulses)


def _setting(
    *,
    slant_range: float = 10e3,
    frequency: float = 9.65e9,
    bandwidth: float = 300e6,
    extent: float = 400.0,
    height: float = 30.0,
    cell: float = 0.5,
    n_pulses: int = 512,
    squint: float = 0.0,
    oversampling: float = 1.2,
    track: Track | None = None,
    inset: float = -15.0,
) -> SimpleNamespace:
    """Radar and box: X band at 10 km over 400 m unless told otherwise; ``inset`` cuts the window into the box."""
    track = track or _straight(slant_range, frequency, cell, n_pulses, squint)
    box = np.array([[-0.5 * extent, -0.5 * extent, 0.0], [0.5 * extent, 0.5 * extent, height]])
    near, far = box_distance(box, track.position)
    spacing = SPEED_OF_LIGHT / (2.0 * bandwidth * oversampling)
    n_samples = int(np.ceil(((far - near).max() - 2.0 * inset) / spacing))
    zero = np.zeros_like(track.position)
    radar = Radar(
        "spotlight",
        track,
        Waveform(frequency, bandwidth, 2e-6),
        Antenna(),
        Pointing(zero, zero, zero),
        ReceiveWindow(near + inset, spacing, n_samples),
    )
    return SimpleNamespace(radar=radar, box=box, reference=np.zeros(3))


def _exact(radar: Radar, pulses: Any, slant_range: Any, amplitude: Any) -> Any:
    """Exact range-compressed profiles, (n_layers, n_pulses, n_samples) complex128; slant_range (n_paths, K)."""
    window = radar.window
    k = 4.0 * np.pi * radar.waveform.center_frequency / SPEED_OF_LIGHT
    out = np.zeros((len(amplitude), slant_range.shape[1], window.n_samples), dtype=np.complex128)
    for t, start in enumerate(window.start_range[pulses]):
        r = start + window.sample_spacing * np.arange(window.n_samples)
        response = np.sinc((r - slant_range[:, t, None]) / radar.waveform.range_cell)
        out[:, t] = (amplitude * np.exp(-1j * k * slant_range[:, t])) @ response
    return out


def _error_db(value: Any, truth: Any) -> float:
    return float(10.0 * np.log10(np.sum(np.abs(value - truth) ** 2) / np.sum(np.abs(truth) ** 2)))


@pytest.fixture(scope="session")
def setting() -> Callable[..., SimpleNamespace]:
    """Build a radar over a box."""
    return _setting


@pytest.fixture(scope="session")
def exact() -> Callable[..., Any]:
    """Sum paths exactly."""
    return _exact


@pytest.fixture(scope="session")
def error_db() -> Callable[..., float]:
    """Relative energy of a difference, dB."""
    return _error_db
