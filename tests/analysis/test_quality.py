"""Quality of an image: points against what is known of them, speckle and looks against theory, noise against radar."""

import dataclasses
import json
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from sarmitsuba import cli
from sarmitsuba.analysis.image_quality import (
    Area,
    contrast,
    describe_weak_echoes,
    entropy,
    image_quality,
    spectral_looks,
)
from sarmitsuba.analysis.point_quality import KnownPoint, window_irw
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.aperture_weights import incidence_angle
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.metrics import point_target
from sarmitsuba.signal.noise import add_noise
from sarmitsuba.signal.raw_data import Layer, RawData
from tests.support.unweighted import focus

SEEDS = [0, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2))]


def random_radar(rng: np.random.Generator, **more: object) -> Radar:
    distance = float(rng.choice([8e3, 12e3, 700e3]))
    return ideal_radar(
        slant_range=distance,
        # coarser from space, where an aperture of the same cell has more pulses than a test needs
        resolution=float(rng.uniform(0.6, 1.5)) * (4.0 if distance > 1e5 else 1.0),
        bandwidth=float(rng.uniform(100e6, 250e6)),
        look_angle=float(rng.uniform(0.5, 1.0)),
        squint_angle=float(rng.uniform(-0.2, 0.2)),
        n_samples=384,
        **more,  # type: ignore[arg-type]
    )


def windowed(window: str, n: int = 512, fine: int = 128) -> float:
    """Half-power width of a window's transform, summed directly, in cells."""
    from sarmitsuba.signal.focusing.windows import parse_window

    u = (np.arange(n) + 0.5) / n - 0.5
    x = np.arange(0, 3 * fine) / fine
    w = parse_window(window)(u)
    h = np.abs(np.cos(2.0 * np.pi * np.outer(x, u)) @ w) ** 2
    i = int(np.flatnonzero(h < 0.5 * h[0])[0])
    return 2.0 * float(np.interp(-0.5 * h[0], -h[i - 1 : i + 1], x[i - 1 : i + 1]))


@pytest.mark.parametrize("window", ["rectangular", "hamming", "taylor:4:-35"])
def test_width_of_windows(window: str) -> None:
    # tol: steps of 1/64 and 1/128 cell, interpolated
    assert window_irw(window) == pytest.approx(windowed(window), rel=1e-3)


def test_width_without_window_is_that_of_sinc() -> None:
    # tol: linear interpolation between steps of 1/64 cell
    assert window_irw("rectangular") == pytest.approx(0.885893, rel=1e-4)


@pytest.mark.parametrize("kind", ["slant", "ground"])
@pytest.mark.parametrize("seed", SEEDS)
def test_known_points_are_measured_as_they_are(seed: int, kind: str) -> None:
    """Random radars and squints, points of any height: place, level, phase and width."""
    rng = np.random.default_rng(seed)
    radar = random_radar(rng)
    places = np.array([[0.0, 0.0, 0.0], [45.0, -50.0, 4.0], [-55.0, 40.0, -3.0]])
    places[:, :2] += rng.uniform(-3.0, 3.0, (3, 2))
    rcs, phase = rng.uniform(0.5, 5.0, 3), rng.uniform(-3.0, 3.0, 3)
    raw = ideal_echoes(radar, places, rcs, phase)
    request = ImageRequest(grid=kind, extent_azimuth=180.0, extent_range=180.0)  # type: ignore[arg-type]
    image = focus(raw, request=request)
    known = [
        KnownPoint(tuple(p.tolist()), f"p{i}", float(r), float(f))
        for i, (p, r, f) in enumerate(zip(places, rcs, phase, strict=True))
    ]
    report = image_quality(image, known, [])
    assert len(report.points) == 3 and not report.left_out
    cells = radar.waveform.range_cell, float(image.azimuth_resolution_cell)
    for point in report.points:
        # tol: 0.1 of a cell; the other points' side lobes and the profiles' interpolation move it by 0.01
        assert abs(point.range_error) < 0.1 * cells[0] * (1.0 if kind == "slant" else 2.5)
        assert abs(point.azimuth_error) < 0.1 * cells[1]
        # tol: the other points' side lobes, -40 dB and less in amplitude
        assert abs(point.rcs_error_db) < 0.2
        assert abs(math.degrees(point.phase_error)) < 3.0
        for cut, irw in zip((point.azimuth_cut, point.range_cut), point.predicted_irw, strict=True):
            assert cut.irw == pytest.approx(irw, rel=0.02)  # tol: the same side lobes
            assert cut.pslr_db == pytest.approx(-13.26, abs=0.5)


def test_points_are_found_and_clutter_is_not() -> None:
    radar = ideal_radar(resolution=0.9, bandwidth=180e6, squint_angle=-0.08, n_samples=384)
    places = np.array([[-40.0, -35.0, 0.0], [35.0, 45.0, 0.0]])
    raw = ideal_echoes(radar, places, [4.0, 1.0])
    request = ImageRequest(grid="ground", extent_azimuth=160.0, extent_range=160.0)
    image = focus(raw, request=request, range_window="taylor", azimuth_window="taylor")
    speckle = noise_image(request, radar=radar)
    level = np.sqrt(1e-3 / np.mean(np.abs(speckle.data) ** 2))
    image = dataclasses.replace(image, data=image.data + np.complex64(level) * speckle.data)
    report = image_quality(image)
    assert len(report.points) == 2
    for point, place in zip(report.points, places, strict=True):
        # tol: 0.1 of a cell of about 1 m; noise 30 dB down moves it by 0.01
        np.testing.assert_allclose(point.position, place, atol=0.15)
    even, dark = report.areas
    assert (even.name, dark.name) == ("even", "dark") and dark.sigma0_db <= even.sigma0_db
    for area in report.areas:  # of neither target
        for point in report.points:
            assert not (
                area.azimuth[0] <= point.azimuth <= area.azimuth[1]
                and area.range[0] <= point.range <= area.range[1]
            )
    assert image_quality(speckle).points == ()
    # speckle of one look
    for area in image_quality(speckle).areas:
        assert abs(area.enl - 1.0) < 4.0 * area.enl_sigma


def test_corners_of_a_body_are_not_isolated_points() -> None:
    """Corners two cells apart are brighter than all around and as narrow as points, but side lobes of each other."""
    radar = ideal_radar(resolution=0.9, bandwidth=180e6, n_samples=384)
    places = np.array([[-30.0, -30.0, 0.0], [-30.0, -28.0, 0.0], [30.0, 30.0, 0.0]])
    request = ImageRequest(grid="ground", extent_azimuth=160.0, extent_range=160.0)
    raw = ideal_echoes(radar, places, [4.0, 3.0, 1.0])
    report = image_quality(focus(raw, request=request, range_window="taylor", azimuth_window="taylor"))
    (point,) = report.points
    np.testing.assert_allclose(point.position, places[2], atol=0.15)  # tol: 0.1 of a cell


@cache
def noise_image(request: ImageRequest, window: str = "rectangular", radar: Radar | None = None) -> SarImage:
    """Focused receiver noise: speckle of one look whose spectrum is exactly the processed band."""
    radar = radar or ideal_radar(resolution=1.0, bandwidth=150e6, n_samples=512)
    radar = dataclasses.replace(radar, noise_temperature=500.0)
    shape = (1, radar.track.n_pulses, radar.window.n_samples)
    raw = add_noise(RawData(np.zeros(shape, np.complex64), (Layer("VV"),), "compressed", radar), seed=7)
    return focus(raw, request=request, range_window=window, azimuth_window=window)


WIDE = ImageRequest(extent_azimuth=100.0, extent_range=160.0)


@pytest.mark.parametrize("window", ["rectangular", "taylor"])
def test_noise_is_that_of_the_radar_and_speckle_of_one_look(window: str) -> None:
    image = noise_image(WIDE, window)
    grid = image.grid
    area = Area((-40.0, 40.0), (float(grid.range[20]), float(grid.range[-20])))
    (found,) = image_quality(image, areas=[area]).areas
    report = image_quality(image, areas=[area])
    # tol: 4 standard deviations of the mean of n cells, 10 log10(1 + 4 / sqrt(n))
    assert abs(found.sigma0_db - report.nesz_db) < 10.0 * math.log10(1.0 + 4.0 / math.sqrt(found.cells))
    assert abs(found.enl - 1.0) < 4.0 * found.enl_sigma
    assert found.enl_sigma < 0.06
    # one look of even ground: ln N - entropy is 1 less Euler's constant
    # tol: the mean of I ln I varies by 1.3 / sqrt(n)
    assert abs(found.entropy_deficit - 0.42278) < 4.0 * 1.3 / math.sqrt(found.cells)


@pytest.mark.parametrize("looks", [(4, 1), (1, 3), (3, 2)])
@pytest.mark.parametrize("window", ["rectangular", "taylor"])
def test_looks_reach_the_predicted_number(looks: tuple[int, int], window: str) -> None:
    image = noise_image(WIDE, window)
    done = spectral_looks(image, *looks)
    # tol: bins cut by the looks' edges overlap by less than one in a look
    assert done.predicted_enl == pytest.approx(looks[0] * looks[1], rel=0.03)
    grid = image.grid
    area = Area((-45.0, 45.0), (float(grid.range[15]), float(grid.range[-15])))
    (found,) = image_quality(image, areas=[area], looks=looks).areas
    assert abs(found.enl - done.predicted_enl) < 4.0 * found.enl_sigma
    (one,) = image_quality(image, areas=[area]).areas
    assert (
        abs(found.sigma0_db - one.sigma0_db) < 0.25
    )  # tol: pixels at the edges that the looks' widths carry over
    # blocks of as many pixels average less, since neighbours are not independent
    blocks = image.multilook(*looks).power[3:-3, 3:-3]
    assert blocks.mean() ** 2 / blocks.var() < 0.8 * found.enl


def test_overlapping_looks_count_by_their_correlation() -> None:
    image = noise_image(WIDE)
    done = spectral_looks(image, 5, overlap=0.5)
    # rectangular bands that share a half: rho = 1/2 for neighbours, and the image's own ENL is one
    exact = 25.0 / (5.0 + 8.0 * 0.25)
    assert done.predicted_enl == pytest.approx(exact, rel=0.05)  # tol: whole bins
    inside = done.sigma0[20:-20, 20:-20]
    cells = inside.size * image.grid.azimuth_spacing * image.grid.range_spacing / (150.0 / 150.0) / 3.0
    sigma = exact * math.sqrt(2.0 * (1.0 + 1.0 / exact) / cells)
    assert abs(inside.mean() ** 2 / inside.var() - done.predicted_enl) < 4.0 * sigma


@pytest.mark.parametrize("looks", [(3, 1), (1, 2)])
def test_looks_widen_a_point_by_their_number(looks: tuple[int, int]) -> None:
    raw = ideal_echoes(ideal_radar(resolution=1.0, bandwidth=150e6, n_samples=512), [0.4, 0.3, 0.0])
    image = focus(raw, request=ImageRequest(extent_azimuth=110.0, extent_range=160.0))
    one, more = image.sigma0(), spectral_looks(image, *looks).sigma0
    i, j = np.unravel_index(int(one.argmax()), one.shape)
    grid = image.grid

    def width(power: np.ndarray, axis: int) -> float:
        line = power[:, j] if axis == 0 else power[i]
        fine = np.linspace(0, line.size - 1, 64 * line.size)
        dense = np.interp(fine, np.arange(line.size), line)
        return float(np.ptp(fine[dense > 0.5 * dense.max()]))

    for axis, n in enumerate(looks):
        # tol: half-power points from straight lines between pixels of half a cell
        assert width(more, axis) / width(one, axis) == pytest.approx(n, rel=0.12)
    assert spectral_looks(image, *looks).azimuth_cell == pytest.approx(
        image.azimuth_resolution_cell * looks[0], rel=0.01
    )
    assert grid.shape == more.shape


def test_contrast_and_entropy() -> None:
    rng = np.random.default_rng(5)
    values = rng.uniform(0.1, 2.0, (30, 40))
    p = [v / values.sum() for v in values.ravel()]
    assert entropy(values) == pytest.approx(-sum(v * math.log(v) for v in p), rel=1e-12)
    assert entropy(np.ones((7, 9))) == pytest.approx(math.log(63.0), rel=1e-12)
    mean = sum(values.ravel()) / values.size
    spread = math.sqrt(sum((v - mean) ** 2 for v in values.ravel()) / values.size)
    assert contrast(values) == pytest.approx(spread / mean, rel=1e-12)


BAD: dict[str, tuple[Callable[[SarImage], object], str]] = {
    "no points": (lambda image: image_quality(image, []), "list of points is empty"),
    "area outside": (
        lambda image: image_quality(image, areas=[Area((1e4, 2e4), (0.0, 1.0))]),
        "fewer than 2 x 2 pixels",
    ),
    "no look": (lambda image: spectral_looks(image, 0, 1), "give at least 1 x 1"),
    "too many looks": (lambda image: spectral_looks(image, 5000, 1), "looks in azimuth exceed the"),
    "overlap": (lambda image: spectral_looks(image, 2, 1, overlap=0.95), "0 to 0.9"),
    "no channel": (lambda image: image_quality(image, channel="HV"), "no channel 'HV'"),
}


@pytest.mark.parametrize("name", sorted(BAD))
def test_what_cannot_be_measured_is_one_line(name: str) -> None:
    image = small_image()
    call, message = BAD[name]
    with pytest.raises(DataError, match=message) as found:
        call(image)
    assert "\n" not in str(found.value)


def small_image() -> SarImage:
    raw = ideal_echoes(ideal_radar(resolution=1.0, bandwidth=150e6), [0.2, -0.3, 0.0], 2.0)
    return focus(raw, request=ImageRequest(extent_azimuth=60.0, extent_range=60.0))


def test_points_outside_the_image_are_left_out_and_said() -> None:
    report = image_quality(small_image(), [(0.2, -0.3, 0.0), (900.0, 0.0, 0.0)])
    assert len(report.points) == 1 and len(report.left_out) == 1
    assert "point 2" in report.left_out[0] and "is outside the image" in report.left_out[0]
    assert report.left_out[0] in report.as_table()


def test_command_writes_table_json_and_plot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = small_image()
    image.save(tmp_path / "image.h5")
    assert cli.main(["quality", str(tmp_path), "--point", "0.2", "-0.3", "--looks", "2", "1"]) == 0
    shown = capsys.readouterr().out
    assert "IRW m az" in shown and "ENL predicted" in shown
    record = json.loads((tmp_path / "quality.json").read_text())
    (point,) = record["points"]
    direct = point_target(image.total(), image.grid.azimuth_spacing, image.grid.range_spacing)
    # tol: the same point, interpolated with and without its carrier
    assert point["azimuth_irw_m"] == pytest.approx(direct.azimuth.irw, rel=2e-3)
    assert point["rcs_m2"] == pytest.approx(2.0, rel=0.01)
    assert record["looks"] == [2, 1]
    assert (tmp_path / "quality.png").stat().st_size > 1000
    assert cli.main(["quality", str(tmp_path), "--point", "1", "2", "3", "4"]) == 2
    assert "--point" in capsys.readouterr().err
    assert cli.main(["picture", str(tmp_path), "--spectral-looks", "2", "1"]) == 0


def test_default_grid_is_along_incidence() -> None:
    """The predicted range width on the ground is that of the slant cell over the sine of the incidence."""
    radar = ideal_radar(resolution=1.0, bandwidth=150e6)
    image = focus(
        ideal_echoes(radar, [0.0, 0.0, 0.0]), request=ImageRequest(grid="ground", extent_range=60.0)
    )
    (point,) = image_quality(image, [(0.0, 0.0, 0.0)], []).points
    sine = math.sin(float(incidence_angle(radar, np.zeros(3))))
    assert point.predicted_irw[1] == pytest.approx(0.8859 * radar.waveform.range_cell / sine, rel=1e-3)
    assert default_grid(radar, ImageRequest(grid="ground", extent_range=60.0)).kind == "ground"


@pytest.mark.parametrize("seed", SEEDS)
def test_pixels_with_apertures_of_their_own(seed: int) -> None:
    """Stripmap, squinted: every pixel's carrier and lobes are those of its own aperture."""
    rng = np.random.default_rng(seed)
    squint = float(rng.uniform(-0.15, 0.15))
    radar = ideal_radar(resolution=0.4, bandwidth=150e6, squint_angle=squint, n_samples=384, mode="stripmap")
    wave = radar.waveform.wavelength
    # apertures of a third of the track
    radar = dataclasses.replace(radar, half_aperture=wave / (4.0 * 1.2))
    places = np.array([[0.0, 0.0, 0.0], [20.0, 80.0, 0.0], [-25.0, -90.0, 0.0]])
    places[:, :2] += rng.uniform(-2.0, 2.0, (3, 2))
    phase = rng.uniform(-3.0, 3.0, 3)
    image = focus(
        ideal_echoes(radar, places, 1.0, phase),
        request=ImageRequest(extent_azimuth=260.0, extent_range=140.0),
    )
    known = [
        KnownPoint(tuple(p.tolist()), f"p{i}", 1.0, float(f))
        for i, (p, f) in enumerate(zip(places, phase, strict=True))
    ]
    report = image_quality(image, known, [])
    assert len(report.points) == 3
    for point in report.points:
        # tol: the aperture's ends fall between pulses, and side lobes of the other points
        assert abs(point.azimuth_error) < 0.05 and abs(point.range_error) < 0.05
        assert abs(math.degrees(point.phase_error)) < 3.0
        assert point.azimuth_cut.irw == pytest.approx(point.predicted_irw[0], rel=0.03)
        assert point.range_cut.irw == pytest.approx(point.predicted_irw[1], rel=0.02)


def test_scene_points_are_known_to_the_image() -> None:
    """Metadata name the scene's point scatterers, and quality measures those."""
    image = small_image()
    entry = {"name": "corner", "position": [0.2, -0.3, 0.0], "rcs": 2.0, "phase": 0.0}
    image = dataclasses.replace(image, metadata={**image.metadata, "points": [entry]})
    (point,) = image_quality(image).points
    assert point.name == "corner" and abs(point.rcs_error_db) < 0.05  # tol: profiles cut by the window's ends


@pytest.mark.parametrize(("channel", "factor"), [("RH", 1.0), ("RV", 1j), ("LV", -1j)])
def test_a_point_of_the_scene_has_its_part_of_a_compact_channel(channel: str, factor: complex) -> None:
    """HH = VV: half the power in RH and in RV, which leads by 90 degrees; was 3 dB and 90 degrees of error."""
    image = small_image()
    entry = {"name": "corner", "position": [0.2, -0.3, 0.0], "rcs": 2.0, "phase": 0.0}
    linear = dataclasses.replace(image, metadata={**image.metadata, "points": [entry]})
    (expected,) = image_quality(linear).points
    data = np.asarray(linear.data * (factor * math.sqrt(0.5)), dtype=np.complex64)
    (found,) = image_quality(dataclasses.replace(linear, data=data, layers=(Layer(channel),))).points
    assert found.rcs_error_db == pytest.approx(expected.rcs_error_db, abs=1e-4)
    assert found.phase_error == pytest.approx(expected.phase_error, abs=1e-5)
    cross = dataclasses.replace(linear, layers=(Layer("HV"),))
    assert math.isnan(image_quality(cross).points[0].rcs_error_db)  # nothing to compare with


@pytest.mark.parametrize(("ground_db", "said"), [(6.0, False), (-6.0, True)])
def test_ground_below_the_noise_is_said(ground_db: float, said: bool) -> None:
    rng = np.random.default_rng(4)
    request = ImageRequest(extent_azimuth=60.0, extent_range=60.0)
    image = noise_image(request)
    noise = image.metadata["focus"]["nesz"]
    ground = rng.normal(size=image.data.shape) + 1j * rng.normal(size=image.data.shape)
    level = np.sqrt(0.5 * noise * 10.0 ** (0.1 * ground_db) * image.cell_area)
    known = {**image.metadata, "effects": {"effects": {"diffuse": {"on": True}}}}
    shown = dataclasses.replace(
        image, data=(image.data + level * ground).astype(np.complex64), metadata=known
    )
    notes = describe_weak_echoes(shown)
    assert bool(notes) is said
    if said:
        assert "below the noise, NESZ" in notes[0]
    patch = image.data * np.float32(5.0)  # 14 dB over the noise, on a seventh of the image
    patch[:, :, image.grid.shape[1] // 7 :] = image.data[:, :, image.grid.shape[1] // 7 :]
    assert not describe_weak_echoes(dataclasses.replace(shown, data=patch))
    bare = {**known, "effects": {"effects": {"diffuse": {"on": False}}}}  # targets without ground
    assert not describe_weak_echoes(dataclasses.replace(shown, metadata=bare))


@pytest.mark.parametrize("noisy", [False, True])
def test_an_empty_channel_is_said(noisy: bool) -> None:
    image = noise_image(ImageRequest(extent_azimuth=60.0, extent_range=60.0))
    data = np.stack([100.0 * image.data[0], image.data[0] * (1.0 if noisy else 1e-6)])
    facts = (
        image.metadata["focus"]
        if noisy
        else {k: v for k, v in image.metadata["focus"].items() if k != "nesz"}
    )
    both = dataclasses.replace(
        image, data=data, layers=(Layer("VV"), Layer("HV")), metadata={**image.metadata, "focus": facts}
    )
    (note,) = describe_weak_echoes(both)
    assert note.startswith(f"HV: no echo, {'noise' if noisy else 'rounding'} alone")
    even = dataclasses.replace(both, data=np.stack([100.0 * image.data[0]] * 2))
    assert not describe_weak_echoes(even)
