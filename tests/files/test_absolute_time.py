"""Absolute time: a point on given state vectors is seen when and where the numbers say, and files keep the UTC."""

import datetime
import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.files import read_image, read_raw, write_image, write_raw
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.collection import Collection
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.orbit import StateVectors
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.utc import DEFAULT_EPOCH, utc_of, utc_text
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.simulation.execution.render import simulate
from tests.support.draws import few_of
from tests.support.unweighted import focus

LIGHT = 299792458.0
MU, TURN = 3.986004418e14, 7.292115e-5
A, F = 6378137.0, 1.0 / 298.257223563
WAVELENGTH = LIGHT / 9.65e9


# ---- the numbers, written down anew


def ellipsoid(latitude: float, longitude: float, height: float) -> np.ndarray:
    """ECEF position of WGS-84 coordinates, rad and m."""
    square = F * (2.0 - F)
    normal = A / np.sqrt(1.0 - square * np.sin(latitude) ** 2)
    level = (normal + height) * np.cos(latitude)
    up = (normal * (1.0 - square) + height) * np.sin(latitude)
    return np.array([level * np.cos(longitude), level * np.sin(longitude), up])


def vectors(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """(n, 6) state vectors in ECEF of a Keplerian ellipse about the turning Earth; time zero is over mid latitudes."""
    axis, shape = 6.9e6 + 3e4 * rng.uniform(), 1e-3
    rate = np.sqrt(MU / axis**3)
    inclination, node, start = np.radians(97.5), rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.5, 0.9)
    mean = start + rate * time
    anomaly = mean.copy()
    for _ in range(50):
        anomaly = mean + shape * np.sin(anomaly)
    slope = rate / (1.0 - shape * np.cos(anomaly))
    minor = np.sqrt(1.0 - shape**2)
    flat = axis * np.stack([np.cos(anomaly) - shape, minor * np.sin(anomaly), 0.0 * time])
    fast = axis * slope * np.stack([-np.sin(anomaly), minor * np.cos(anomaly), 0.0 * time])

    def about_x(v: np.ndarray, angle: float) -> np.ndarray:
        c, s = np.cos(angle), np.sin(angle)
        return np.stack([v[0], c * v[1] - s * v[2], s * v[1] + c * v[2]])

    def about_z(v: np.ndarray, angle: np.ndarray | float) -> np.ndarray:
        c, s = np.cos(angle), np.sin(angle)
        return np.stack([c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]])

    position, velocity = (about_z(about_x(v, inclination), node - TURN * time) for v in (flat, fast))
    velocity = velocity - TURN * np.stack([-position[1], position[0], 0.0 * time])
    return np.concatenate([position, velocity]).T


def lagrange(time: np.ndarray, values: np.ndarray, at: float) -> tuple[np.ndarray, np.ndarray]:
    """Value and derivative of the polynomial of degree 8 through the nine nearest positions."""
    first = int(np.clip(np.searchsorted(time, at) - 5, 0, time.size - 9))
    t, x = time[first : first + 9], values[first : first + 9]
    value, slope = np.zeros(3), np.zeros(3)
    for i in range(9):
        others = np.delete(t, i)
        scale = np.prod(t[i] - others)
        value += x[i] * np.prod(at - others) / scale
        slope += x[i] * sum(np.prod(np.delete(at - others, k)) for k in range(8)) / scale
    return value, slope


def zero_doppler(time: np.ndarray, rows: np.ndarray, place: np.ndarray) -> tuple[float, float]:
    """Time, s, and range, m, at which the line to a place is square to the Earth-fixed velocity, by Newton's steps."""
    at, step = 0.0, 1e-3
    for _ in range(30):
        miss = [
            float((place - x) @ v)
            for x, v in (lagrange(time, rows[:, :3], at + d) for d in (-step, 0.0, step))
        ]
        at -= miss[1] / ((miss[2] - miss[0]) / (2.0 * step))
    return at, float(np.linalg.norm(place - lagrange(time, rows[:, :3], at)[0]))


# ---- against the program


@pytest.mark.parametrize("moving", ["off", "on"])
@pytest.mark.parametrize("seed", few_of(range(4), 1))
def test_a_point_is_seen_at_its_zero_doppler_time_and_range(tmp_path: Path, seed: int, moving: str) -> None:
    """Orbit, place, zero-Doppler time and range: within 65 ns and 1 mm, in the echoes' own phase and in every file."""
    rng = np.random.default_rng(seed)
    zero = utc_of("2024-05-01T06:00:00.123456789Z")
    time = np.arange(-8.0, 9.0) * 10.0
    rows = vectors(rng, time)
    below = rows[8, :3] / np.linalg.norm(rows[8, :3])
    # the place: some hundred km to a side of the ground track
    aside = np.cross(below, rows[8, 3:] / np.linalg.norm(rows[8, 3:])) * rng.choice([-1.0, 1.0])
    toward = below + rng.uniform(0.045, 0.06) * aside
    latitude, longitude = np.arctan2(toward[2], np.hypot(*toward[:2])), np.arctan2(toward[1], toward[0])
    height = float(rng.uniform(0.0, 800.0))
    offset = rng.uniform(-30.0, 30.0, 2)
    anchor = ellipsoid(latitude, longitude, height)
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    up = np.array(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)]
    )
    place = anchor + offset[0] * east + offset[1] * np.cross(up, east)
    when, nearest = zero_doppler(time, rows, place)

    stamps = [utc_text(zero + np.timedelta64(round(t * 1e9), "ns")) for t in time]
    lines = [
        f"{stamp}, " + ", ".join(f"{v:.9f}" for v in row) for stamp, row in zip(stamps, rows, strict=True)
    ]
    (tmp_path / "vectors.csv").write_text("\n".join(lines))
    point = PointTarget("p", (float(offset[0]), float(offset[1]), 0.0), 1.0)
    sensor = RadarDescription(
        state_vectors_file=str(tmp_path / "vectors.csv"),
        latitude_deg=float(np.degrees(latitude)),
        longitude_deg=float(np.degrees(longitude)),
        height=height,
        center_frequency=9.65e9,
        bandwidth=100e6,
        n_pulses=1200,
        prf=3000.0,
    )
    film = FilmDescription(image_grid="ground", image_extent_azimuth=150.0, image_extent_range=150.0)
    settings = TraceSettings(effects={"motion_in_pulse": moving}, method="raw")
    raw = simulate(build_scene(points=[point], radar=sensor, film=film, settings=settings))
    track, window = raw.radar.track, raw.radar.window
    # range history from the echoes: the phase along the track, its whole number of waves by the profiles' place
    data = raw.total().astype(np.complex128)
    ranges = window.start_range[:, None] + window.sample_spacing * np.arange(window.n_samples)
    peak = int(np.abs(data[track.center_index]).argmax())
    guess = raw.radar.slant_range(raw.radar.anchor.from_ecef(place))
    echo = np.array(
        [
            np.sum(
                row
                * np.exp(4j * np.pi / WAVELENGTH * there)
                * np.sinc((line - there) / window.sample_spacing)
            )
            for row, line, there in zip(data, ranges, guess, strict=True)
        ]
    )
    assert abs(ranges[track.center_index, peak] - nearest) < 100.0
    history = guess - np.unwrap(np.angle(echo)) * WAVELENGTH / (4.0 * np.pi)
    seconds = (track.utc - zero) / np.timedelta64(1, "ns") * 1e-9
    middle = float(seconds.mean())
    fit = np.polynomial.Polynomial.fit(seconds - middle, history, 5)
    found = float(min(fit.deriv().roots(), key=abs).real)
    delay = (
        nearest / LIGHT if moving == "on" else 0.0
    )  # the antenna is abeam halfway between sending and receiving
    off_time, off_range = found + middle + delay - when, float(fit(found)) - nearest
    print(f"orbit {seed}, motion_in_pulse {moving}: {1e9 * off_time:.2f} ns, {1e3 * off_range:.4f} mm")
    assert abs(off_time) < 65e-9
    assert abs(off_range) < 1e-3
    # and the antenna of the image, halfway, is abeam at its own UTC
    halfway = raw.radar.start_stop().track
    line = raw.radar.anchor.from_ecef(place) - halfway.position
    miss = np.einsum("ij,ij->i", line, halfway.velocity)
    seconds = (halfway.utc - zero) / np.timedelta64(1, "ns") * 1e-9 - middle
    root = min(np.polynomial.Polynomial.fit(seconds, miss, 5).roots(), key=abs).real
    assert abs(float(root) + middle - when) < 65e-9


def position_at(flight: Collection, time: np.datetime64) -> np.ndarray:
    """Position of an image's antenna at a UTC, m."""
    return flight.state(float((time - flight.start) / np.timedelta64(1, "ns")) * 1e-9)[0]


def dated(epoch: str = "2024-02-29T23:59:59.999999871Z") -> object:
    radar = ideal_radar(n_samples=160)
    radar = replace(radar, track=replace(radar.track, epoch=epoch))
    return ideal_echoes(radar, [[0.0, 0.0, 0.0]])


@pytest.mark.parametrize("suffix", [".h5", ".cphd"])
def test_raw_data_keep_the_time_of_every_pulse(tmp_path: Path, suffix: str) -> None:
    raw = dated()
    write_raw(raw, tmp_path / f"raw{suffix}")
    again = read_raw(tmp_path / f"raw{suffix}")
    # tol: a nanosecond, to which UTC is kept
    assert np.abs((again.radar.track.utc - raw.radar.track.utc).astype(int)).max() <= 1
    if suffix == ".h5":
        assert again.radar.track.epoch == raw.radar.track.epoch == utc_of("2024-02-29T23:59:59.999999871Z")
        with h5py.File(tmp_path / "raw.h5", "a") as file:
            del file["track"].attrs["epoch"]
        assert read_raw(tmp_path / "raw.h5").radar.track.epoch == DEFAULT_EPOCH
        with h5py.File(tmp_path / "raw.h5", "a") as file:
            file["track"].attrs["epoch"] = "yesterday"
        with pytest.raises(DataError, match="is not a UTC date and time") as caught:
            read_raw(tmp_path / "raw.h5")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [".h5", ".nitf"])
def test_images_keep_the_time_of_the_flight(tmp_path: Path, suffix: str) -> None:
    raw = dated()
    image = focus(raw, request={"grid": "ground", "extent_azimuth": 20.0, "extent_range": 20.0})
    write_image(image, tmp_path / f"image{suffix}")
    again = read_image(tmp_path / f"image{suffix}")
    first = raw.radar.track.utc[0]
    places = []
    for one in (image, again):
        flight = Collection.read(one.metadata["focus"], "image")
        assert abs(int((flight.start - first).astype(int))) <= 1
        places.append(one.anchor.to_ecef(position_at(flight, raw.radar.track.utc[7])))
    np.testing.assert_allclose(places[0], places[1], atol=1e-6)  # tol: rounding of ECEF and polynomials
    exact = raw.radar.anchor.to_ecef(raw.radar.track.position[7])
    np.testing.assert_allclose(places[0], exact, atol=1e-5)  # tol: a nanosecond of flight, polynomial
    text = json.dumps(image.metadata["focus"]["flight"])
    assert "2024-02-29T23:59:59.999999871Z" in text


def test_the_default_is_stated_and_steady(tmp_path: Path) -> None:
    track = Track.straight([0.0, 0.0, 1e3], [0.0, 100.0, 0.0], 10.0, 3)
    assert utc_text(track.epoch) == "2000-01-01T00:00:00Z"
    assert [utc_text(one) for one in track.utc] == [
        "1999-12-31T23:59:59.9Z",
        "2000-01-01T00:00:00Z",
        "2000-01-01T00:00:00.1Z",
    ]
    for given in (
        "2024-05-01T08:00:00.25Z",
        "2024-05-01T08:00:00.25+00:00",
        np.datetime64("2024-05-01T08:00:00.25"),
        datetime.datetime(2024, 5, 1, 10, 0, 0, 250000, datetime.timezone(datetime.timedelta(hours=2))),
    ):
        assert utc_text(replace(track, epoch=given).epoch) == "2024-05-01T08:00:00.25Z"
    moved = replace(track, epoch="2024-05-01T08:00:00Z").moved([1.0, 0.0, 0.0]).of_pulses([0, 1])
    assert utc_text(moved.epoch) == "2024-05-01T08:00:00Z"


@pytest.mark.parametrize(
    "given",
    [
        "yesterday",
        "2024-13-01T00:00:00Z",
        "2024-05-01T08:00:60Z",
        "2024-05-01T08:00:00+02:00",
        "9999-01-01T00:00:00Z",
        "2024-05-01T08:00:00Z\n\x1b[2J",
        np.datetime64("NaT"),
        np.datetime64("9999-01-01"),
        datetime.datetime(2024, 5, 1),
        3.0,
        None,
    ],
)
def test_what_is_no_utc_is_one_line(given: object) -> None:
    track = Track.straight([0.0, 0.0, 1e3], [0.0, 100.0, 0.0], 10.0, 3)
    with pytest.raises(RadarError, match=r"^track: epoch: ") as caught:
        replace(track, epoch=given)
    assert "\n" not in str(caught.value)


def scene_with(**changes: object) -> Track:
    sensor = RadarDescription(slant_range=5e3, n_pulses=64, prf=200.0, **changes)  # type: ignore[arg-type]
    return build_scene(points=[PointTarget("p", (0.0, 0.0, 0.0), 1.0)], radar=sensor).radar.track


def test_the_description_has_an_epoch() -> None:
    assert utc_text(scene_with(epoch="2024-05-01T08:00:00.5Z").epoch) == "2024-05-01T08:00:00.5Z"
    assert scene_with().epoch == DEFAULT_EPOCH
    with pytest.raises(RadarError, match='epoch = "soon" is not a UTC date and time such as'):
        scene_with(epoch="soon")


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")  # a few pulses only
def test_files_of_tracks_have_dates(tmp_path: Path) -> None:
    lines = [f"2024-05-01T06:00:00.{i:03}Z, 5000, {0.1 * i - 0.5}, 4000" for i in range(12)]
    path = tmp_path / "track.csv"
    path.write_text("\n".join(["time, x, y, z", *lines]))
    track = Track.from_csv(path)
    assert utc_text(track.utc[11]) == "2024-05-01T06:00:00.011Z" and track.time[0] == 0.0
    sensor = RadarDescription(track_file=str(path))
    built = build_scene(points=[PointTarget("p", (0.0, 0.0, 0.0), 1.0)], radar=sensor)
    assert utc_text(built.radar.track.utc[11]) == "2024-05-01T06:00:00.011Z"
    with pytest.raises(RadarError, match="epoch has no effect beside dates"):
        build_scene(
            points=[PointTarget("p", (0.0, 0.0, 0.0), 1.0)],
            radar=replace(sensor, epoch="2024-05-01T06:00:00Z"),
        )
    path.write_text("\n".join([lines[0], "2024-05-01T06:00:99Z, 5000, 0, 4000"]))
    with pytest.raises(RadarError, match="is not a date and time of the cale"):
        Track.from_csv(path)


def test_an_orbit_file_of_sentinel_1_has_dates(tmp_path: Path) -> None:
    time = np.arange(0.0, 9.0) * 10.0
    stamps = [
        f"UTC=2024-05-01T06:00:{t:09.6f}" if t < 60.0 else f"UTC=2024-05-01T06:01:{t - 60.0:09.6f}"
        for t in time
    ]
    names = ("X", "Y", "Z", "VX", "VY", "VZ")
    items = "".join(
        f"<OSV><UTC>{stamp}</UTC>"
        + "".join(f"<{n}>{v:.9f}</{n}>" for n, v in zip(names, row, strict=True))
        + "</OSV>"
        for stamp, row in zip(stamps, vectors(np.random.default_rng(0), time - 40.0), strict=True)
    )
    (tmp_path / "orbit.EOF").write_text(f"<E><Ref_Frame>EARTH_FIXED</Ref_Frame>{items}</E>")
    found = StateVectors.read(tmp_path / "orbit.EOF")
    assert found.dated and utc_text(found.epoch) == "2024-05-01T06:00:00Z" and found.time[-1] == 80.0


def test_files_that_mix_dates_and_seconds_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "track.csv"
    for first, then in (("2024-05-01T06:00:00Z", "1.0"), ("0.0", "2024-05-01T06:00:00Z")):
        path.write_text(f"{first}, 0, 0, 1\n{then}, 1, 0, 1\n")
        with pytest.raises(RadarError, match="is not a UTC date and time"):
            Track.from_csv(path)


def test_state_vectors_by_seconds_take_the_epoch_of_their_zero(tmp_path: Path) -> None:
    time = np.arange(0.0, 9.0) * 10.0 + 1000.0
    rows = vectors(np.random.default_rng(0), time - 1040.0)
    lines = [f"{t}, " + ", ".join(f"{v:.9f}" for v in row) for t, row in zip(time, rows, strict=True)]
    (tmp_path / "vectors.csv").write_text("\n".join(lines))
    found = StateVectors.read(tmp_path / "vectors.csv")
    assert not found.dated and found.time[0] == 0.0
    assert found.epoch - DEFAULT_EPOCH == np.timedelta64(1000, "s")
