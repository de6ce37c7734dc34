"""Unknown low-frequency track error: the peak it costs, and what autofocus and motion compensation give back.

Usage: python -m benchmarks.suite.track_error [--quick] [-o FOLDER]
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.support import harness
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.mode import MODES, AimGeometry
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.focusing import AUTOFOCUSERS
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.raw_data import RawData
from tests.support.unweighted import focus

ERROR = 0.1  # m
SEEDS, SEEDS_QUICK = 4, 1


def strip_radar() -> Radar:
    """Stripmap whose beam passes over the pixels, each with its own aperture, of two fifths of the track."""
    antenna = Antenna("gaussian", 1.0, np.radians(0.6), np.radians(20.0))
    plain = ideal_radar(n_samples=280, mode="stripmap", antenna=antenna)
    track = Track.straight(plain.track.center_position, plain.track.velocity[0], 130.0, 312)
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
        half_aperture=0.005,
    )


def low_frequency(n: int, rng: np.random.Generator) -> np.ndarray:
    """Up to three periods over the track, no part of it a mere shift of the image; largest value ``ERROR``."""
    u = np.linspace(-1.0, 1.0, n)
    wave = sum(rng.standard_normal() * np.cos(np.pi * k * u + rng.uniform(0.0, 6.28)) for k in (1, 2, 3))
    wave -= np.polyval(np.polyfit(u, wave, 1), u)
    return np.asarray(ERROR * wave / np.abs(wave).max())


@dataclass(frozen=True)
class Case:
    """Data of a track that wobbles, of which their radar does not know; ``known`` has the radar that does."""

    raw: RawData
    known: RawData
    request: dict[str, Any]
    points: np.ndarray
    clean: np.ndarray  # level of every point without the error

    def levels(self, image: Any) -> np.ndarray:
        """Peak near every point over that of data without the error, dB."""
        return np.asarray(20.0 * np.log10(peaks(image, self.points) / self.clean))


def peaks(image: Any, points: np.ndarray) -> np.ndarray:
    """Largest level within 4 m of every point."""
    where = image.grid.positions()
    return np.array([np.abs(image.data[0][np.linalg.norm(where - p, axis=-1) < 4.0]).max() for p in points])


def case(mode: str, clutter: bool, seed: int) -> Case:
    """Points of unit RCS, on clutter of 900 scatterers of 1 % of that if asked."""
    rng = np.random.default_rng(seed)
    radar = ideal_radar(n_samples=240, prf_factor=1.6) if mode == "spotlight" else strip_radar()
    n, length = radar.track.n_pulses, 60.0 if mode == "spotlight" else 160.0
    toward = -radar.track.center_position / np.linalg.norm(radar.track.center_position)
    wobble = low_frequency(n, rng)[:, None] * toward
    flown = replace(radar, track=Track.from_samples(radar.track.time, radar.track.position + wobble))
    x = np.linspace(-24.0, 24.0, 5)  # apart in range and along the track
    y = np.linspace(-0.42, 0.42, 5)[rng.permutation(5)] * length
    points = np.stack([x + rng.uniform(-2.0, 2.0, 5), y, np.zeros(5)], axis=1)
    phase = rng.uniform(0.0, 6.28, 5)
    cloud = rng.uniform(-0.5, 0.5, (900, 3)) * np.array([60.0, length, 0.0])
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
    clean = focus(echoes(radar), request=request, focuser="omega_k")
    known = echoes(flown)
    return Case(replace(known, radar=radar), known, request, points, peaks(clean, points))


@harness.benchmark
def run(quick: bool) -> harness.Report:
    """Mean level of the points by mode, clutter and correction."""
    report = harness.Report(
        "track_error",
        "Unknown track error",
        f"{ERROR} m of low-frequency error along the line of sight, X band: mean peak of five points over that of data "
        "without it, dB, by omega-K; worst of the seeds.",
    )
    rows = []
    for mode in ("spotlight", "stripmap"):
        for clutter in (False, True):
            cases = [case(mode, clutter, seed) for seed in range(SEEDS_QUICK if quick else SEEDS)]
            kept = {name: [] for name in ("none", *AUTOFOCUSERS.names, "compensated")}  # type: dict[str, list[float]]
            for one in cases:
                for name in ("none", *AUTOFOCUSERS.names):
                    image = focus(one.raw, request=one.request, focuser="omega_k", autofocus=name)
                    kept[name].append(float(one.levels(image).mean()))
                image = focus(one.known, request=one.request, focuser="omega_k")
                kept["compensated"].append(float(one.levels(image).mean()))
            worst = [f"{max(values, key=abs):.2f}" for values in kept.values()]
            rows.append([mode, "clutter" if clutter else "points", *worst])
    report.table(
        "Mean peak, dB",
        ["mode", "scene", "unknown error", *AUTOFOCUSERS.names, "motion compensation, track known"],
        rows,
    )
    return report


if __name__ == "__main__":
    harness.main(run)
