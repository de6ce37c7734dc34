"""Unknown track errors of 0.1 m: the peak they cost, and what autofocus gives back."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from sarmitsuba.echo.raw import RawData
from sarmitsuba.errors import DataError, ExtensionError
from sarmitsuba.focusing import AUTOFOCUSERS, default_grid, focus
from sarmitsuba.focusing.autofocus import AutofocusTask, correct_ranges, parse_autofocus
from sarmitsuba.focusing.focuser import parse_focuser
from sarmitsuba.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.focusing.windows import parse_window
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.mode import MODES, AimGeometry
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.track import Track

ERROR = 0.1  # m


def strip_radar() -> Radar:
    """Stripmap whose beam passes over the pixels, each with its own aperture, of a third of the track."""
    antenna = Antenna("gaussian", 1.0, np.radians(1.0), np.radians(20.0))
    plain = ideal_radar(n_samples=280, mode="stripmap", antenna=antenna)
    track = Track.straight(plain.track.center_position, plain.track.velocity[0], 100.0, 360)
    aim = AimGeometry(
        np.zeros(3), track.center_position, np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    )
    spacing = plain.window.sample_spacing
    start = np.full(track.n_pulses, np.linalg.norm(track.position, axis=1).min() - 140 * spacing)
    return replace(
        plain,
        track=track,
        pointing=MODES["stripmap"].pointing(track, aim),
        window=ReceiveWindow(start, spacing, 280),
        half_aperture=0.0078,
    )


def low_frequency(n: int, rng: np.random.Generator) -> np.ndarray:
    """Up to three periods over the track, no part of it a mere shift of the image; largest value ``ERROR``."""
    u = np.linspace(-1.0, 1.0, n)
    wave = sum(rng.standard_normal() * np.cos(np.pi * k * u + rng.uniform(0.0, 6.28)) for k in (1, 2, 3))
    wave -= np.polyval(np.polyfit(u, wave, 1), u)
    return ERROR * wave / np.abs(wave).max()


@dataclass(frozen=True)
class Case:
    raw: RawData
    request: dict[str, Any]
    points: np.ndarray
    clean: np.ndarray  # level of every point without the error

    def levels(self, image: Any) -> np.ndarray:
        """Peak near every point over that of data without the error, dB."""
        return 20.0 * np.log10(peaks(image, self.points) / self.clean)


def peaks(image: Any, points: np.ndarray) -> np.ndarray:
    where = image.grid.positions()
    return np.array([np.abs(image.data[0][np.linalg.norm(where - p, axis=-1) < 4.0]).max() for p in points])


def case(mode: str, clutter: bool, seed: int) -> Case:
    """Points of unit RCS, on clutter 20 dB below them per cell if asked; the radar does not know of its wobble."""
    rng = np.random.default_rng(seed)
    radar = ideal_radar(n_samples=240, prf_factor=1.6) if mode == "spotlight" else strip_radar()
    n, length = radar.track.n_pulses, 60.0 if mode == "spotlight" else 160.0
    toward = -radar.track.center_position / np.linalg.norm(radar.track.center_position)
    flown = Track.from_samples(
        radar.track.time, radar.track.position + low_frequency(n, rng)[:, None] * toward
    )
    x = np.linspace(-24.0, 24.0, 5)  # apart in range and along the track
    y = np.linspace(-0.42, 0.42, 5)[rng.permutation(5)] * length
    points = np.stack([x + rng.uniform(-2.0, 2.0, 5), y, np.zeros(5)], axis=1)
    phase = rng.uniform(0.0, 6.28, 5)
    cloud = np.stack(
        [rng.uniform(-30.0, 30.0, 900), rng.uniform(-0.5, 0.5, 900) * length, np.zeros(900)], axis=1
    )
    level, turn = 0.01 * rng.standard_normal(900) ** 2, rng.uniform(0.0, 6.28, 900)

    def echoes(one: Radar) -> RawData:
        raw = ideal_echoes(one, points, 1.0, phase)
        if clutter:
            raw = replace(raw, data=raw.data + ideal_echoes(one, cloud, level, turn).data)
        return raw

    request = {
        "grid": "slant",
        "center_x": 0.0,
        "center_y": 0.0,
        "height": 0.0,
        "extent_azimuth": length,
        "extent_range": 64.0,
        "spacing_azimuth": 0.0,
        "spacing_range": 0.0,
    }
    clean = focus(echoes(radar), request=request)
    blurred = replace(echoes(replace(radar, track=flown)), radar=radar)
    return Case(blurred, request, points, peaks(clean, points))


@pytest.mark.parametrize("clutter", [False, True])
@pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
@pytest.mark.parametrize("method", ["phase_gradient", "minimum_entropy", "maximum_contrast"])
def test_the_peak_that_is_lost_comes_back(method: str, mode: str, clutter: bool) -> None:
    one = case(mode, clutter, seed=len(method) + len(mode) + clutter)
    lost = one.levels(focus(one.raw, request=one.request, focuser="omega_k"))
    assert lost.mean() < -6.0
    image = focus(one.raw, request=one.request, focuser="omega_k", autofocus=method)
    # tol: 1 dB, asked for, of the points' mean; single points with clutter of -20 dB in their cell 1.5 dB
    assert one.levels(image).mean() == pytest.approx(0.0, abs=1.0)
    assert np.abs(one.levels(image)).max() < (1.5 if clutter else 1.0)
    facts = image.metadata["focus"]["autofocus"]
    assert facts["method"] == method and 0.2 * ERROR < facts["range_error_rms"] < ERROR


@pytest.mark.parametrize("focuser", ["backprojection", "polar_format"])
def test_it_serves_other_focusers(focuser: str) -> None:
    one = case("spotlight", True, seed=77)
    image = focus(one.raw, request=one.request, focuser=focuser, autofocus="phase_gradient")
    assert np.abs(one.levels(image)).max() < 1.5  # tol: clutter of -20 dB in a point's cell


@pytest.mark.parametrize("seed", range(3))
def test_correcting_a_known_range_error_gives_the_true_echoes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    radar = ideal_radar(n_samples=160)
    error = rng.uniform(-0.4, 0.4, radar.track.n_pulses)
    distance = np.linalg.norm(radar.track.position, axis=1)
    flown = replace(
        radar,
        track=Track.from_samples(radar.track.time, radar.track.position * (1.0 + error / distance)[:, None]),
    )
    got = correct_ranges(replace(ideal_echoes(flown, np.zeros(3)), radar=radar), error).data
    true = ideal_echoes(radar, np.zeros(3)).data
    # tol: the sinc's tails beyond the window's end
    assert np.linalg.norm(got - true) / np.linalg.norm(true) < 0.02


def test_names_and_data_that_are_refused() -> None:
    assert set(AUTOFOCUSERS.names) == {"phase_gradient", "minimum_entropy", "maximum_contrast"}
    assert parse_autofocus("none") is None
    assert parse_autofocus("phase_gradient,rounds=3").options["rounds"] == 3  # type: ignore[union-attr]
    with pytest.raises(ExtensionError, match="autofocus 'sharp' is unknown; choose one of"):
        parse_autofocus("sharp")
    with pytest.raises(DataError, match="autofocus phase_gradient: option 'turns' is unknown"):
        parse_autofocus("phase_gradient,turns=3")
    radar = ideal_radar()
    raw = ideal_echoes(radar, np.zeros(3))
    with pytest.raises(DataError, match="autofocus: the data hold nothing but zeros"):
        focus(replace(raw, data=0.0 * raw.data), autofocus="phase_gradient")


def test_good_data_are_left_as_they_are() -> None:
    radar = ideal_radar(n_samples=160)
    raw = ideal_echoes(radar, [[0.0, 0.0, 0.0], [9.0, 7.0, 0.0]])
    grid = default_grid(radar, {"extent_azimuth": 40.0, "extent_range": 40.0})
    window = parse_window("rectangular")
    task = AutofocusTask(raw, grid, parse_focuser("omega_k"), window, window)
    wavelength = radar.waveform.wavelength
    for method in AUTOFOCUSERS:
        assert 4.0 * np.pi / wavelength * np.abs(method.estimate(task)).max() < 0.2  # tol: rad, of side lobes
