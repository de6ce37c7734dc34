"""Weights and cells of pixels with apertures of their own are those of a sum over all pulses."""

import dataclasses

import numpy as np
import pytest

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.focusing.aperture_weights import ground_cell_area, matched_weights
from sarmitsuba.signal.focusing.ideal import ideal_radar


def drawn_strip(rng: np.random.Generator) -> Radar:
    """A long track with bends and uneven pulses, a beam wide enough for one gain per cell, a squinted band."""
    radar = ideal_radar(
        slant_range=float(rng.uniform(2e3, 5e3)),
        resolution=0.5,
        mode="stripmap",
        squint_angle=float(rng.uniform(-0.2, 0.2)),
        antenna=Antenna("gaussian", 1e3, float(rng.uniform(0.1, 0.2)), 0.5),
    )
    n = int(rng.integers(900, 1400))
    step = radar.track.velocity[0] * float(np.diff(radar.track.time).mean())
    u = np.arange(n) - 0.5 * n + rng.uniform(-0.2, 0.2, n)
    position = radar.track.center_position + u[:, None] * step
    position += np.outer(np.sin(3.0 * u / n), rng.uniform(-2.0, 2.0, 3))
    track = Track.from_samples(np.arange(n) * float(np.diff(radar.track.time).mean()), position)
    middle = radar.track.n_pulses // 2
    pointing = dataclasses.replace(
        radar.pointing,
        **{
            name: np.repeat(getattr(radar.pointing, name)[middle][None], n, axis=0)
            for name in ("boresight", "azimuth_axis", "elevation_axis")
        },
    )
    window = dataclasses.replace(radar.window, start_range=np.full(n, 1e3))
    return dataclasses.replace(
        radar, track=track, pointing=pointing, window=window, half_aperture=float(rng.uniform(0.01, 0.03))
    )


def weights_of_all(radar: Radar, point: np.ndarray) -> np.ndarray:
    """W g^2 of every pulse, by its definition, without a window."""
    track, pointing = radar.track, radar.pointing
    speed = np.linalg.norm(track.velocity, axis=1)
    forward = track.velocity / speed[:, None]
    line = point - track.position
    distance = np.linalg.norm(line, axis=1)
    look = line / distance[:, None]
    center = np.sum(forward * pointing.boresight, axis=1)
    sine = np.sum(look * forward, axis=1)
    step = np.abs(speed * np.gradient(track.time) * (1.0 - sine**2) / distance + np.gradient(center))
    share = np.clip((radar.half_aperture - np.abs(sine - center)) / step + 0.5, 0.0, 1.0)
    sines = [np.sum(look * axis, axis=1) for axis in (pointing.azimuth_axis, pointing.elevation_axis)]
    return np.asarray(share * radar.antenna.two_way_amplitude(*sines) ** 2)


def area_of_all(radar: Radar, point: np.ndarray, weights: np.ndarray) -> float:
    """Noise-equivalent area on the ground by Parseval's sum over all pulses, for a narrow band."""
    line = point - radar.track.position
    u = (line / np.linalg.norm(line, axis=1)[:, None])[:, :2]
    change = np.gradient(u, axis=0)
    turn = np.abs(u[:, 0] * change[:, 1] - u[:, 1] * change[:, 0])
    wave = radar.waveform
    v = (np.arange(4096) + 0.5) / 4096 - 0.5
    band = np.mean(1.0 / (wave.center_frequency + wave.bandwidth * v)) / wave.bandwidth
    aperture = np.sum(np.where(weights > 0.0, weights**2 / turn, 0.0)) / weights.sum() ** 2
    return float(aperture * band * (0.5 * SPEED_OF_LIGHT) ** 2)


@pytest.mark.parametrize("seed", range(4))
def test_pulses_outside_the_band_change_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    radar = drawn_strip(rng)
    track = radar.track
    aim = radar.pointing.boresight[0] * (track.center_position[2] / -radar.pointing.boresight[0, 2])
    # in the middle, at the ends and beyond: whole apertures, parts of one, and none
    for place in (0.5, float(rng.uniform(0.2, 0.8)), 0.0, 1.0, 3.0):
        along = track.position[0] + place * (track.position[-1] - track.position[0])
        point = along + aim + rng.uniform(-5.0, 5.0, 3) * [1.0, 1.0, 0.0]
        found, exact = matched_weights(radar, point), weights_of_all(radar, point)
        # tol: rounding of sines, over steps of 1e-4 between pulses
        np.testing.assert_allclose(found, exact, rtol=0.0, atol=1e-9)
        both = matched_weights(radar, np.array([point, point + np.array([3.0, 40.0, 0.0])]))
        np.testing.assert_allclose(both[0], exact, rtol=0.0, atol=1e-9)  # tol: the same
        assert (exact > 0.0).any() == (place != 3.0)
        if place != 3.0:
            area = ground_cell_area(radar, point, exact, "rectangular")
            # tol: the band's integral, by the midpoint rule in both
            assert area == pytest.approx(area_of_all(radar, point, exact), rel=1e-6)
