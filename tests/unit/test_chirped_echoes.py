"""Chirped echoes by a header: exact echoes of points in RADARSAT-1-like geometry focus in place, or are refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from sarmitsuba import cli
from sarmitsuba.analysis.quality import KnownPoint, image_quality
from sarmitsuba.echo.doppler_estimate import estimate_doppler
from sarmitsuba.errors import DataError
from sarmitsuba.focusing import focus
from sarmitsuba.io import read_raw, write_raw
from tests.support.draws import few_of

LIGHT = 299792458.0
Header = dict[str, Any]


def drawn(rng: np.random.Generator, multiple: int | None = None) -> Header:
    """A header like RADARSAT-1's, scaled down: C band, 5.3 GHz, a centroid several pulse rates away."""
    prf = float(rng.uniform(1200.0, 1400.0))
    turns = rng.integers(-6, 7) if multiple is None else multiple
    return {
        "carrier_hz": 5.3e9,
        "sampling_rate_hz": 32.317e6,
        "chirp_rate_hz_per_s": float(rng.choice([-1.0, 1.0]) * rng.uniform(2.6e12, 3e12)),
        "pulse_length_s": 10e-6,
        "prf_hz": prf,
        "first_sample_time_s": float(rng.uniform(1.5e-3, 2e-3)),
        "effective_velocity_m_per_s": float(rng.uniform(4000.0, 5000.0)),
        "doppler_centroid_hz": float((turns + rng.uniform(-0.5, 0.5)) * prf),
        "look_side": str(rng.choice(["left", "right"])),
        "channel": "HH",
    }


def echoes(header: Header, shape: tuple[int, int], points: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Echoes of points (time s, range m) of closest approach, by the delay equation at every received sample.

    The antenna is at V t at all times t and sends the carrier with its chirp over the pulse about t_n; a wave received at
    t left at the time t' with |x(t') - p| + |x(t) - p| = c (t - t'). The beam lights a point while its Doppler
    frequency is within half the pulse rate of the centroid.
    """
    f0, rate, length = (header[n] for n in ("carrier_hz", "chirp_rate_hz_per_s", "pulse_length_s"))
    v, prf = header["effective_velocity_m_per_s"], header["prf_hz"]
    pulse = (np.arange(shape[0]) - 0.5 * (shape[0] - 1)) / prf
    fast = header["first_sample_time_s"] + np.arange(shape[1]) / header["sampling_rate_hz"]
    out = np.zeros(shape, complex)
    for (when, nearest), value in zip(points, values, strict=True):
        there = np.hypot(nearest, v * (pulse - when))
        doppler = -2.0 * f0 / LIGHT * v**2 * (pulse - when) / there
        for n in np.flatnonzero(np.abs(doppler - header["doppler_centroid_hz"]) <= 0.5 * prf):
            delay = 2.0 * there[n] / LIGHT
            some = np.flatnonzero(np.abs(fast - delay - 0.5 * length) < 0.6 * length)
            received = pulse[n] - 0.5 * length + fast[some]
            back = np.hypot(nearest, v * (received - when))
            sent = received - delay
            for _ in range(6):  # a contraction by v / c
                sent = received - (np.hypot(nearest, v * (sent - when)) + back) / LIGHT
            inside = np.abs(sent - pulse[n]) <= 0.5 * length
            phase = -2.0 * np.pi * f0 * (received - sent) + np.pi * rate * (sent - pulse[n]) ** 2
            out[n, some] += value * inside * np.exp(1j * phase)
    return out


def seen(rng: np.random.Generator, header: Header, shape: tuple[int, int], n: int) -> np.ndarray:
    """Times and ranges of closest approach of points, apart, whose whole apertures are recorded."""
    f0, v, prf = (header[name] for name in ("carrier_hz", "effective_velocity_m_per_s", "prf_hz"))
    sine = 0.5 * LIGHT / f0 / v * (header["doppler_centroid_hz"] + np.array([-0.5, 0.0, 0.5]) * prf)
    tangent, cosine = sine / np.sqrt(1.0 - sine**2), np.sqrt(1.0 - sine**2)
    step = 0.5 * LIGHT / header["sampling_rate_hz"]
    first = 0.5 * LIGHT * header["first_sample_time_s"]
    last = first + step * (shape[1] - header["pulse_length_s"] * header["sampling_rate_hz"])
    near, far = first * cosine.max() + 20.0 * step, last * cosine.min() - 20.0 * step
    assert near < far
    ranges = np.linspace(near, far, n) + rng.uniform(-1.0, 1.0, n) * step
    span = shape[0] / prf
    early, late = -0.5 * span + far * tangent.max() / v, 0.5 * span + near * tangent.min() / v
    assert early < late
    times = early + (late - early) * (rng.permutation(n) + rng.uniform(0.3, 0.7, n)) / n
    return np.column_stack([times, ranges])


def save(folder: Path, header: Header, data: np.ndarray, kind: str = "npy", rows: bool = True) -> Path:
    """Write data and header; the path of the header."""
    data = (data if rows else data.T).astype(np.complex64)
    header = header | {"data": f"echoes.{kind}", "pulses_along": "rows" if rows else "columns"}
    if kind == "npy":
        np.save(folder / "echoes.npy", data)
    else:
        scipy.io.savemat(folder / "echoes.mat", {"data": data, "AGC": np.ones(3)})
    if rows:
        path = folder / "scene.json"
        path.write_text(json.dumps(header))
    else:
        path = folder / "scene.toml"
        path.write_text("".join(f"{name} = {json.dumps(value)}\n" for name, value in header.items()))
    return path


@pytest.mark.parametrize("seed", few_of(range(8), 2))
def test_points_land_in_place_with_the_resolution_of_the_bands(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    header, shape = drawn(rng), (900, 900)
    points = seen(rng, header, shape, 3)
    values = np.exp(1j * rng.uniform(-3.0, 3.0, 3))
    data = echoes(header, shape, points, values)
    path = save(tmp_path, header, data, str(rng.choice(["npy", "mat"])), bool(rng.integers(2)))
    raw = read_raw(path)
    assert raw.domain == "chirped" and raw.channels == ("HH",) and raw.radar.look_side == header["look_side"]
    image = focus(raw)
    assert not image.calibrated
    grid, v = image.grid, header["effective_velocity_m_per_s"]
    across = np.sqrt(points[:, 1] ** 2 - (grid.origin[2] - grid.height) ** 2)
    # the frame's origin is below the antenna at time zero
    places = (v * points[:, 0])[:, None] * grid.along + across[:, None] * grid.across
    known = [KnownPoint(tuple(place.tolist()), f"p{i}") for i, place in enumerate(places)]
    report = image_quality(image, known, [])
    assert len(report.points) == 3 and "uncalibrated" in report.as_table()
    band = 0.8 * header["prf_hz"]
    cells = (v / band, 0.5 * LIGHT / abs(header["chirp_rate_hz_per_s"] * header["pulse_length_s"]))
    for point in report.points:
        print(
            f"{point.azimuth_error / cells[0]:.3f} {point.range_error / cells[1]:.3f} "
            f"{point.azimuth_cut.irw / cells[0]:.3f} {point.range_cut.irw / cells[1]:.3f} "
            f"{point.azimuth_cut.pslr_db:.2f} {point.range_cut.pslr_db:.2f} "
            f"{point.azimuth_cut.islr_null_db:.2f} {point.range_cut.islr_null_db:.2f}"
        )
        assert abs(point.azimuth_error) < 0.05 * cells[0]
        assert abs(point.range_error) < 0.05 * cells[1]
