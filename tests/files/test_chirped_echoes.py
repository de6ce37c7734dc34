"""Chirped echoes by a header: exact echoes of points in RADARSAT-1-like geometry focus in place, or are refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from sarmitsuba import cli
from sarmitsuba.analysis.image_quality import image_quality
from sarmitsuba.analysis.point_quality import KnownPoint
from sarmitsuba.core.errors import DataError
from sarmitsuba.files import read_raw, write_raw
from sarmitsuba.signal.doppler_estimate import estimate_doppler
from tests.support.draws import few_of
from tests.support.unweighted import focus

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

    The antenna is at V t at all times t and sends the carrier with its chirp over the pulse about t_n; a wave received
    at t left at the time t' with |x(t') - p| + |x(t) - p| = c (t - t'). The beam lights a point while its Doppler
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
    near, far = first * cosine.max() + 40.0 * step, last * cosine.min() - 40.0 * step
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


@pytest.mark.parametrize("seed", few_of(range(8), 1))
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
    for focuser in ("omega_k", "chirp_scaling"):
        other = focus(raw, focuser=focuser)
        # tol: the error that the image measured of itself, at 64 of 700 000 pixels of which 1 000 bear it: 6 dB
        stated = other.metadata["focus"]["stated_error_db"]
        off = 20.0 * np.log10(np.linalg.norm(other.data - image.data) / np.linalg.norm(image.data))
        print(f"{focuser}: {off:.1f} dB off backprojection, {stated:.1f} dB stated")
        assert off < stated + 6.0 and stated < -22.0
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
            f"{point.azimuth_error / cells[0]:.4f} and {point.range_error / cells[1]:.4f} cells off, "
            f"{point.azimuth_cut.irw / cells[0]:.3f} and {point.range_cut.irw / cells[1]:.3f} cells wide, side lobes "
            f"{point.azimuth_cut.pslr_db:.2f} and {point.range_cut.pslr_db:.2f} dB, ISLR "
            f"{point.azimuth_cut.islr_null_db:.2f} and {point.range_cut.islr_null_db:.2f} dB"
        )
        # tol: found 0.004 of a cell in azimuth, the delay's change over the swath; 0.0003 in range
        assert abs(point.azimuth_error) < 0.01 * cells[0]
        assert abs(point.range_error) < 0.005 * cells[1]
        # tol: uniform bands: 0.886 cells, -13.26 dB, ISLR over 16 cells -10 dB; pixels of half a cell, chirp's edges
        assert point.azimuth_cut.irw == pytest.approx(0.886 * cells[0], rel=0.005)
        assert point.range_cut.irw == pytest.approx(0.886 * cells[1], rel=0.01)
        for cut in (point.azimuth_cut, point.range_cut):
            assert cut.pslr_db == pytest.approx(-13.26, abs=0.05)
            assert cut.islr_null_db == pytest.approx(-10.0, abs=0.1)


def clutter(
    rng: np.random.Generator, shape: tuple[int, int], header: Header, centroid: float, beam: float
) -> np.ndarray:
    """Echoes of uniform clutter by their spectrum: at each frequency f a beam's band about centroid (1 + f / f0)."""
    prf, f0 = header["prf_hz"], header["carrier_hz"]
    f = np.fft.fftfreq(shape[1], 1.0 / header["sampling_rate_hz"])
    off = np.fft.fftfreq(shape[0], 1.0 / prf)[:, None] - centroid * (1.0 + f / f0)
    folded = np.mod(off + 0.5 * prf, prf) - 0.5 * prf
    power = sum(np.sinc(0.886 * (folded + k * prf) / beam) ** 4 for k in (-1, 0, 1))
    noise = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    band = abs(header["chirp_rate_hz_per_s"] * header["pulse_length_s"])
    return np.fft.ifft2(noise * np.sqrt(power) * (np.abs(f) <= 0.5 * band))


def test_the_centroid_of_clutter_is_found_or_refused() -> None:
    """Drawn centroids of L band (carrier over bandwidth 43), where the range walk tells the multiple, and of C band."""
    found = refused = 0
    for seed in range(24):
        rng = np.random.default_rng(seed)
        header = drawn(rng, 0) | {"carrier_hz": [1.27e9, 5.3e9][seed % 2]}
        prf, centroid = header["prf_hz"], float(rng.uniform(-6000.0, 6000.0))
        data = clutter(rng, (512, 700), header, centroid, 0.75 * prf).astype(np.complex64)
        band = abs(header["chirp_rate_hz_per_s"] * header["pulse_length_s"])
        try:
            got = estimate_doppler(data, prf, header["carrier_hz"], header["sampling_rate_hz"], band)
        except DataError as error:
            refused += 1
            assert "does not tell the multiple" in str(error) and seed % 2 == 1
            continue
        found += 1
        assert (
            abs(got.frequency - centroid) < 5.0 * got.deviation < 0.01 * prf
        )  # tol: five standard deviations
        assert abs(got.walk - centroid) < 5.0 * got.walk_deviation  # tol: the same
    assert found >= 12 and refused >= 4


@pytest.mark.slow
def test_the_centroid_of_radarsat_1_is_near_the_limit() -> None:
    """Clutter of 1536 pulses of 2048 samples with RADARSAT-1's numbers: the walk's deviation, and no wrong multiple."""
    header = {"carrier_hz": 5.3e9, "sampling_rate_hz": 32.317e6, "prf_hz": 1256.98}
    header |= {"chirp_rate_hz_per_s": -0.72135e12, "pulse_length_s": 41.75e-6}
    found = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        centroid = float(rng.uniform(-7000.0, 7000.0))
        data = clutter(rng, (1536, 2048), header, centroid, 950.0).astype(np.complex64)
        try:
            got = estimate_doppler(data, 1256.98, 5.3e9, 32.317e6, 0.72135e12 * 41.75e-6)
        except DataError as error:
            print(error)
            continue
        print(f"{centroid:.1f} Hz: {got}")
        found += 1
        assert abs(got.frequency - centroid) < 5.0 * got.deviation < 3.0  # tol: 5 sigma
        assert 50.0 < got.walk_deviation < 250.0
    assert found >= 4


def test_auto_estimates_the_centroid(tmp_path: Path) -> None:
    """Uniform clutter of L band, two pulse rates off, as the reader sees it."""
    rng = np.random.default_rng(5)
    header = drawn(rng, -2) | {"carrier_hz": 1.27e9, "effective_velocity_m_per_s": 7000.0}
    data = clutter(rng, (600, 1000), header, header["doppler_centroid_hz"], 0.75 * header["prf_hz"])
    told = read_raw(save(tmp_path, header, data))
    raw = read_raw(save(tmp_path, header | {"doppler_centroid_hz": "auto"}, data))
    facts = raw.metadata["doppler_centroid"]
    assert facts["multiple_of_prf"] == round(header["doppler_centroid_hz"] / header["prf_hz"]) == -2
    assert (
        abs(facts["frequency_hz"] - header["doppler_centroid_hz"]) < 5.0 * facts["deviation_hz"]
    )  # tol: 5 sigma
    np.testing.assert_array_equal(raw.data, told.data)
    write_raw(raw, tmp_path / "raw.h5")
    again = read_raw(tmp_path / "raw.h5").radar
    assert again.waveform == raw.radar.waveform
    np.testing.assert_array_equal(again.window.start_range, raw.radar.window.start_range)


GOOD: Header = drawn(np.random.default_rng(1), 1) | {"data": "echoes.npy"}
LATE = GOOD["first_sample_time_s"]
WRONG: dict[str, tuple[Header, str]] = {
    "missing rate": ({"chirp_rate_hz_per_s": None}, "chirp_rate_hz_per_s is missing"),
    "no data": ({"data": None}, "data is missing"),
    "NaN": ({"prf_hz": float("nan")}, "prf_hz = nan is out of bounds"),
    "infinite": ({"carrier_hz": float("inf")}, "carrier_hz = inf is out of bounds"),
    "negative": ({"pulse_length_s": -1e-6}, "pulse_length_s = -1e-06 is out of bounds"),
    "text": ({"prf_hz": "fast"}, "prf_hz = fast is not a number"),
    "truth": ({"prf_hz": True}, "prf_hz = True is not a number"),
    "list": ({"prf_hz": [1200.0]}, "is not a number"),
    "no sweep": ({"chirp_rate_hz_per_s": 0.0}, "sweeps 0 Hz"),
    "undersampled": ({"sampling_rate_hz": 1e7}, "is below the pulse's bandwidth"),
    "long pulse": ({"pulse_length_s": 1e-3, "chirp_rate_hz_per_s": 1e10}, "is not shorter than 1 / prf_hz"),
    "two starts": ({"first_range_m": 3e5}, "give one of"),
    "no start": ({"first_sample_time_s": None}, "give one of"),
    "at once": ({"first_sample_time_s": 0.0}, "the first sample is of the range 0 m"),
    "slow": ({"effective_velocity_m_per_s": 1.0}, "is a squint sine of"),
    "wide": ({"doppler_bandwidth_hz": 5000.0}, "is above prf_hz"),
    "far ahead": ({"doppler_centroid_hz": 5e5}, "is a squint sine of"),
    "centroid": ({"doppler_centroid_hz": "find"}, "doppler_centroid_hz = find is not a number"),
    "typo": ({"prf": 1200.0}, '"prf" is unknown'),
    "elsewhere": ({"data": "../echoes.npy"}, "is not a .npy or .mat file in the folder of the header"),
    "other kind": ({"data": "echoes.csv"}, "is not a .npy or .mat file"),
    "gone": ({"data": "other.npy"}, "other.npy: no such file"),
    "variable": ({"variable": "data"}, "has no effect with a .npy file"),
    "side": ({"look_side": "down"}, "is none of left, right"),
    "channel": ({"channel": "XX"}, "is none of"),
    "migration": (
        {"doppler_centroid_hz": 5e4, "effective_velocity_m_per_s": 5e3},
        "no range is recorded throughout",
    ),
    "above": ({"incidence_angle_deg": 1.0, "first_sample_time_s": 5e-6}, "is above the ground"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_headers_are_one_line(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    changes, text = WRONG[name]
    header = {key: value for key, value in (GOOD | changes).items() if value is not None}
    np.save(tmp_path / "echoes.npy", np.ones((400, 340), np.complex64))
    (tmp_path / "scene.json").write_text(json.dumps(header))
    assert cli.main(["focus", str(tmp_path / "scene.json"), "-o", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert (
        text in message and message.count("\n") == 1 and "scene.json" in message
    ) or "other.npy" in message


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (np.ones((400, 340)), "holds float64 of shape (400, 340)"),
        (np.ones((2, 400, 340), np.complex64), "of shape (2, 400, 340)"),
        (np.full((400, 340), np.nan, np.complex64), "NaN or infinite"),
        (np.full((400, 340), 1e300, np.complex128), "NaN or infinite"),
        (np.ones((400, 300), np.complex64), "longer than the 324 samples of the chirp"),
        (np.ones((4, 340), np.complex64), "holds 4 pulses"),
        (np.array([{"a": 1}], dtype=object), "cannot be read as a NumPy array"),
        (
            b"\x93NUMPY\x01\x00v\x00{'descr': '<c8', 'fortran_order': False, 'shape': (1000000, 1000000), }",
            "cannot be read",
        ),
        (b"nothing", "cannot be read as a NumPy array"),
        (b"", "cannot be read as a NumPy array"),
    ],
)
def test_wrong_data_are_one_line(tmp_path: Path, content: Any, text: str) -> None:
    if isinstance(content, bytes):
        (tmp_path / "echoes.npy").write_bytes(content)
    else:
        np.save(tmp_path / "echoes.npy", content, allow_pickle=True)
    (tmp_path / "scene.json").write_text(json.dumps(GOOD))
    with pytest.raises(DataError) as caught:
        read_raw(tmp_path / "scene.json")
    assert text in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("content", ["", "[]", "{", "3", "[" * 100000, "prf_hz = ", "\x00", "a = 1\na = 2"])
@pytest.mark.parametrize("kind", ["json", "toml"])
def test_wrong_texts_are_one_line(tmp_path: Path, content: str, kind: str) -> None:
    path = tmp_path / f"scene.{kind}"
    path.write_text(content)
    with pytest.raises(DataError) as caught:
        read_raw(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_matlab_files_with_several_matrices_name_one(tmp_path: Path) -> None:
    data = np.ones((400, 340), np.complex64)
    scipy.io.savemat(tmp_path / "echoes.mat", {"data": data, "other": data, "n": 3.0})
    header = GOOD | {"data": "echoes.mat"}
    (tmp_path / "scene.json").write_text(json.dumps(header))
    with pytest.raises(DataError, match="2 complex matrices: data, other; name one by variable"):
        read_raw(tmp_path / "scene.json")
    (tmp_path / "scene.json").write_text(json.dumps(header | {"variable": "n"}))
    with pytest.raises(DataError, match='has no complex matrix "n"'):
        read_raw(tmp_path / "scene.json")
    (tmp_path / "scene.json").write_text(json.dumps(header | {"variable": "other"}))
    assert read_raw(tmp_path / "scene.json").data.shape == (1, 400, 340)
    (tmp_path / "echoes.mat").write_bytes((tmp_path / "echoes.mat").read_bytes()[:700])
    with pytest.raises(DataError, match=r"MATLAB file|no complex matrix"):
        read_raw(tmp_path / "scene.json")


def test_a_centroid_that_the_echoes_do_not_tell_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(2)
    data = rng.normal(size=(200, 600)) + 1j * rng.normal(size=(200, 600))
    for samples, text in ((data, "give doppler_centroid_hz"), (0.0 * data, "the echoes are zero")):
        path = save(tmp_path, GOOD | {"doppler_centroid_hz": "auto"}, samples)
        assert cli.main(["focus", str(path), "-o", str(tmp_path / "out")]) == 2
        message = capsys.readouterr().err
        assert "scene.json: Doppler centroid: " in message and text in message and message.count("\n") == 1
