"""Motion compensation: frequency-domain focusing of recorded tracks that are not straight."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from sarmitsuba.errors import DataError
from sarmitsuba.focusing import default_grid, focus
from sarmitsuba.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.image.metrics import image_error_db
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track


def asked(extent: float = 60.0, grid: Literal["slant", "ground"] = "slant") -> ImageRequest:
    return ImageRequest(grid=grid, extent_azimuth=extent, extent_range=extent)


def wobbling(radar: Radar, size: float, rng: np.random.Generator) -> Radar:
    """Low-frequency departures of up to ``size`` across and upwards, and a third of it along."""
    u = np.linspace(-1.0, 1.0, radar.track.n_pulses)
    error = np.zeros((u.size, 3))
    for axis, part in enumerate((size, size / 3.0, size)):
        wave = sum(
            rng.standard_normal() * np.cos(np.pi * k * u + rng.uniform(0.0, 2.0 * np.pi)) for k in (1, 2)
        )
        error[:, axis] = part * wave / np.abs(wave).max()
    track = Track.from_samples(radar.track.time, radar.track.position + error)
    return replace(radar, track=track)


@pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
@pytest.mark.parametrize("seed", range(4))
def test_omega_k_of_a_wobbling_track_is_backprojection(mode: str, seed: int) -> None:
    rng = np.random.default_rng(10 * seed + len(mode))
    radar = ideal_radar(
        mode=mode, n_samples=320, squint_angle=np.radians(rng.uniform(-6.0, 6.0)), prf_factor=2.0
    )
    radar = wobbling(radar, 0.1, rng)
    points = np.array([[3.3, -4.2, 0.0], [-24.0, 24.0, 0.0], [24.0, -22.0, 0.0]])
    raw = ideal_echoes(radar, points, [1.0, 2.0, 0.5], [0.3, 1.0, 2.0])
    request = asked(grid=("slant", "ground")[seed % 2])
    exact = focus(raw, request=request)
    image = focus(raw, request=request, focuser="omega_k")
    facts = image.metadata["focus"]["motion_compensation"]
    # tol: the phase that compensation says it leaves, and the unevenly spaced pulses' weights (-30 dB)
    bound = 20.0 * np.log10(facts["residual_phase"] + 10.0 ** (-30.0 / 20.0))
    assert image_error_db(image.data[0], exact.data[0]) < bound

    # told that the track was straight, the same data lose their peak
    line = focus(raw, request=request).grid
    straight = Track.straight(
        line.origin if request.grid == "slant" else radar.track.position.mean(axis=0),
        float(np.linalg.norm(radar.track.velocity, axis=1).mean()) * line.along,
        (radar.track.n_pulses - 1) / np.ptp(radar.track.time),
        radar.track.n_pulses,
    )
    lost = focus(replace(raw, radar=replace(radar, track=straight)), exact.grid, focuser="omega_k")
    peak = float(np.abs(exact.data).max())
    assert 20.0 * np.log10(np.abs(lost.data).max() / peak) < -6.0
    # tol: 1 dB, asked for
    assert 20.0 * np.log10(np.abs(image.data).max() / peak) == pytest.approx(0.0, abs=1.0)


def test_off_refuses_and_far_tracks_are_refused() -> None:
    rng = np.random.default_rng(5)
    radar = wobbling(ideal_radar(n_samples=320), 0.1, rng)
    raw = ideal_echoes(radar, np.zeros(3))
    with pytest.raises(DataError, match=r"omega_k: the track is curved.*take focuser backprojection"):
        focus(raw, request=asked(), focuser="omega_k", motion_compensation="off")
    with pytest.raises(DataError, match="motion compensation 'on': unknown; choose one of auto, off"):
        focus(raw, request=asked(), focuser="omega_k", motion_compensation="on")
    t = radar.track.time
    arc = radar.track.position + np.stack([30.0 * (t / t.max()) ** 2, 0.0 * t, 0.0 * t], axis=1)
    turning = replace(radar, track=Track.from_samples(t, arc))
    grid = default_grid(turning, asked(200.0))
    raw = ideal_echoes(turning, np.zeros(3))
    with pytest.raises(
        DataError, match=r"would leave .* rad at the image's edges .*take focuser backprojection"
    ):
        focus(raw, grid, focuser="omega_k")
    back = replace(turning, track=Track.from_samples(t, radar.track.position[::-1]))
    with pytest.raises(DataError, match="does not go steadily forward along the grid"):
        focus(replace(raw, radar=back), default_grid(radar, asked(60.0)), focuser="omega_k")
