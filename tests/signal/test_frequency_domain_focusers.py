"""Omega-K, range-Doppler and chirp scaling against exact backprojection: points, theory's residual phase, noise."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.aperture_weights import aperture_weights, direction_gain, look_directions
from sarmitsuba.signal.focusing.focuser import check_focuser, parse_focuser
from sarmitsuba.signal.focusing.focusers.backprojection import backproject, series_at
from sarmitsuba.signal.focusing.focusers.chirp_scaling import ChirpScaling
from sarmitsuba.signal.focusing.frequency_domain.track_geometry import range_walk, track_geometry
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.focusing.profiles import plan_spectrum
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.metrics import PointTargetMetrics, image_error_db, point_target
from sarmitsuba.signal.raw_data import RawData
from tests.support.draws import few_of
from tests.support.geometries import random_geometry
from tests.support.unweighted import focus

ALGORITHMS = ("omega_k", "omega_k,stolt=phase", "range_doppler", "chirp_scaling")
REQUEST = {
    "center_x": 0.0,
    "center_y": 0.0,
    "height": 0.0,
    "extent_azimuth": 60.0,
    "extent_range": 60.0,
    "spacing_azimuth": 0.0,
    "spacing_range": 0.0,
}
# seeds of the geometries: heading, squint, look angle and side are random
GEOMETRIES = [
    (mode, slant_range, cell, seed)
    for seed, (slant_range, cell) in enumerate([(10e3, 1.0), (700e3, 5.0)])
    for mode in ("spotlight", "stripmap")
]


geometry = cache(random_geometry)


def points_of(grid: ImageGrid) -> np.ndarray:
    """Centre, edges and corners, off the pixels: (9, 3)."""
    rng = np.random.default_rng(5)
    margin = 26  # half a chip and two pixels
    rows = np.array([margin, grid.shape[0] // 2, grid.shape[0] - 1 - margin])
    columns = np.array([margin, grid.shape[1] // 2, grid.shape[1] - 1 - margin])
    coarse = replace(grid, azimuth=grid.azimuth[rows], range=grid.range[columns])
    off = rng.uniform(-0.5, 0.5, 2)
    step = [grid.azimuth_spacing * off[0], grid.range_spacing * off[1]]
    return (
        replace(coarse, azimuth=coarse.azimuth + step[0], range=coarse.range + step[1])
        .positions()
        .reshape(-1, 3)
    )


def exact(raw: RawData, points: np.ndarray) -> np.ndarray:
    """Backprojection in float64 by exact trigonometric interpolation, with antenna and the pixels' own apertures."""
    radar = raw.radar
    gain = direction_gain(radar, slice(None), look_directions(radar, points))
    weight = aperture_weights(radar, points, "rectangular") * gain
    plan = plan_spectrum(radar, parse_window("rectangular"))
    image = np.zeros(len(points), dtype=np.complex128)
    for t in np.flatnonzero(weight.any(axis=0)):
        r = np.linalg.norm(points - radar.track.position[t], axis=1)
        spectrum = np.fft.fft(raw.data[0, t].astype(np.complex128), n=plan.n_fft) * plan.gains / plan.n_fft
        position = (r - radar.window.start_range[t]) / plan.sample_spacing
        profile = series_at(spectrum, position)
        image += weight[:, t] * profile * r**2 * np.exp(4j * np.pi / radar.waveform.wavelength * r)
    return image / (radar.amplitude_constant * (weight * gain).sum(axis=1))


def measured(pixels: np.ndarray, grid: ImageGrid, point: np.ndarray) -> PointTargetMetrics:
    line = point - grid.origin
    row = (line @ grid.along - grid.azimuth[0]) / grid.azimuth_spacing
    rho = np.hypot(line @ grid.across, line[2])
    column = (rho - grid.range[0]) / grid.range_spacing
    return point_target(pixels, grid.azimuth_spacing, grid.range_spacing, near=(row, column), chip=48)


def pixel_at(grid: ImageGrid, point: np.ndarray) -> tuple[int, int]:
    distance = np.linalg.norm(grid.positions() - point, axis=-1)
    row, column = np.unravel_index(int(distance.argmin()), distance.shape)
    return int(row), int(column)


@pytest.mark.parametrize(
    ("mode", "slant_range", "cell", "seed"),
    # the far stripmap is the hardest
    [pytest.param(*g, marks=() if g[:2] == ("stripmap", 700e3) else pytest.mark.slow) for g in GEOMETRIES],
)
def test_points_are_those_of_exact_backprojection(
    mode: str, slant_range: float, cell: float, seed: int
) -> None:
    radar, grid = geometry(mode, slant_range, cell, seed)
    assert np.isfinite(radar.half_aperture) == (mode == "stripmap")
    points = points_of(grid)
    # all in one scene: what the points' side lobes do to each other is the same in the reference
    raw = ideal_echoes(radar, points, rcs=2.5, phase=0.6)
    reference = backproject(raw, grid, interpolation="kernel:8", oversampling=4)[0]
    places = [pixel_at(grid, point) for point in points]
    values = exact(raw, np.array([grid.positions()[place] for place in places]))
    for place, value in zip(places, values, strict=True):
        assert abs(reference[place] / value - 1.0) < 1e-3  # tol: float32 sums of the compiled kernel
    for name in ALGORITHMS:
        focuser = parse_focuser(name)
        check_focuser(focuser, radar, grid)
        pixels = focus(raw, grid, focuser=focuser).data[0]
        for point, place, value in zip(points, places, values, strict=True):
            where, ratio = (name, point), pixels[place] / value
            # tol: the 5 degrees, 2 % and 0.5 dB
            assert abs(np.degrees(np.angle(ratio))) < 5.0, where
            assert abs(20.0 * np.log10(abs(ratio))) < 0.1, where
            got, wanted = measured(pixels, grid, point), measured(reference, grid, point)
            for axis in ("azimuth", "range"):
                mine, theirs = getattr(got, axis), getattr(wanted, axis)
                assert mine.irw == pytest.approx(theirs.irw, rel=0.02), where
                assert mine.pslr_db == pytest.approx(theirs.pslr_db, abs=0.5), where


@pytest.mark.parametrize("grid_kind", ["slant", "ground"])
@pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
@pytest.mark.parametrize("name", ALGORITHMS)
def test_images_can_be_subtracted(name: str, mode: str, grid_kind: str) -> None:
    radar, _ = geometry(mode, 10e3, 1.0, 0)
    grid = default_grid(radar, {**REQUEST, "grid": grid_kind})
    raw = ideal_echoes(radar, [[3.4, -4.2, 0.0], [-14.0, 9.0, 0.0]], rcs=[1.0, 3.0])
    one, other = focus(raw, grid, focuser=name).data, backproject(raw, grid)
    # tol: residual phase of the approximate form, stationary phase of the aperture's 200 pulses
    assert image_error_db(one, other) < (-45.0 if "phase" in name else -58.0)


@pytest.mark.parametrize("name", ["omega_k", "chirp_scaling"])
def test_images_do_not_depend_on_the_length_of_the_transforms(name: str) -> None:
    """A receive window that stands still: range walks through it, and transforms are longer than backprojection's."""
    radar = ideal_radar(squint_angle=0.25, n_samples=400, resolution=0.7)
    fixed = np.full(radar.track.n_pulses, radar.window.start_range.mean())
    radar = replace(radar, window=replace(radar.window, start_range=fixed))
    whole = default_grid(radar, {**REQUEST, "grid": "slant"})
    assert range_walk(radar, whole, track_geometry(radar, whole)) > 55
    raw = ideal_echoes(radar, [3.4, -4.2, 0.0])
    grid = default_grid(radar, {**REQUEST, "grid": "slant", "extent_range": 40.0})
    # tol: side lobes over range that the window's ends cut off
    assert image_error_db(focus(raw, grid, focuser=name).data, backproject(raw, grid)) < -56.0


def echoes_at(squint: float, away: float, **changes: Any) -> tuple[RawData, ImageGrid, np.ndarray]:
    """One point at ``away`` from the reference range, alone in its image of 160 m."""
    radar = ideal_radar(squint_angle=squint, n_samples=400, resolution=0.5, bandwidth=300e6, **changes)
    grid = default_grid(radar, {**REQUEST, "grid": "slant", "extent_range": 160.0, "extent_azimuth": 50.0})
    across = np.hypot(*(np.array([0.0, 0.0, 0.0]) - radar.track.center_position)[[0, 2]]) + away
    drop = radar.track.center_position[2]
    ground = np.sqrt(across**2 - drop**2) + radar.track.center_position[0]
    return ideal_echoes(radar, [ground, 0.0, 0.0]), grid, np.array([ground, 0.0, 0.0])


def chip_error_db(name: str, raw: RawData, grid: ImageGrid, point: np.ndarray) -> float:
    """Error against backprojection over the pixels about a point, dB."""
    row, column = pixel_at(grid, point)
    rows, columns = slice(row - 32, row + 33), slice(column - 32, column + 33)
    part = replace(grid, azimuth=grid.azimuth[rows], range=grid.range[columns])
    reference = backproject(raw, part, interpolation="kernel:8", oversampling=4)[0]
    pixels = focus(raw, grid, focuser=replace(parse_focuser(name), bound=1e9)).data[0]
    return image_error_db(pixels[rows, columns], reference)


def rms_phase_db(phase: np.ndarray) -> float:
    """Error of a point's image with these phases over its spectrum, dB: |e^{j phi} - 1| is phi."""
    return float(10.0 * np.log10(np.mean(phase**2)))


@pytest.mark.parametrize(
    ("squint", "away"), [(0.12, 50.0), pytest.param(-0.2, -45.0, marks=pytest.mark.slow)]
)
def test_the_residual_phases_are_those_of_theory(squint: float, away: float) -> None:
    raw, grid, point = echoes_at(squint, away)
    radar = raw.radar
    line = point - radar.track.position
    theta = np.arcsin(line @ grid.along / np.linalg.norm(line, axis=1))
    middle = np.arcsin(
        -radar.track.center_position @ grid.along / np.linalg.norm(radar.track.center_position)
    )
    offset = 4.0 * np.pi / SPEED_OF_LIGHT * radar.waveform.bandwidth * (np.arange(64) - 31.5) / 64
    kc = 4.0 * np.pi / radar.waveform.wavelength
    # the leading terms, with the residual bulk phase of the mapping by its series in the offset
    migration = away * np.outer(1.0 / np.cos(theta) - 1.0 / np.cos(middle), offset)
    coupling = -away * np.outer(np.tan(theta) ** 2 / np.cos(theta), offset**2) / (2.0 * kc)
    approximate = chip_error_db("omega_k,stolt=phase", raw, grid, point)
    accurate = chip_error_db("range_doppler", raw, grid, point)
    scaled = chip_error_db("chirp_scaling", raw, grid, point)
    # tol: 1.5 dB, the chip holds nearly all of the point's energy and of the error's
    assert approximate == pytest.approx(rms_phase_db(migration + coupling), abs=1.5)
    assert accurate == pytest.approx(rms_phase_db(coupling), abs=1.5)
    assert scaled == pytest.approx(accurate, abs=0.5)  # tol: both leave the same phase
    assert accurate < approximate
    assert chip_error_db("omega_k", raw, grid, point) < -65.0  # tol: stationary phase


def test_approximate_omega_k_is_chirp_scaling_without_scaling() -> None:
    raw, grid, _ = echoes_at(0.12, 50.0)
    one = focus(raw, grid, focuser="omega_k,stolt=phase,bound=9").data
    other = focus(raw, grid, focuser="chirp_scaling,scaling=no,bound=9").data
    scaled = focus(raw, grid, focuser="chirp_scaling").data
    # tol: echoes of the chirps' periodic transforms; one route has two chirps and two FFTs more than the other
    assert image_error_db(other, one) < -80.0
    assert image_error_db(scaled, one) > -30.0


@pytest.mark.filterwarnings("ignore:focus. the image of:sarmitsuba.core.errors.SarmitsubaWarning")
def test_the_reference_function_alone_focuses_at_the_reference_range_only() -> None:
    at, off = (chip_error_db("omega_k,stolt=off", *echoes_at(0.05, away)) for away in (0.0, 40.0))
    assert at < -20.0  # tol: the range side lobes are off the reference range
    assert off > -10.0


@pytest.mark.filterwarnings("ignore:focus. the image of:sarmitsuba.core.errors.SarmitsubaWarning")
def test_each_switch_of_range_doppler_costs_what_it_leaves() -> None:
    raw, grid, point = echoes_at(0.12, 0.0)
    full = chip_error_db("range_doppler", raw, grid, point)
    centroid = chip_error_db("range_doppler,src=centroid", raw, grid, point)
    off = chip_error_db("range_doppler,src=off", raw, grid, point)
    unmoved = chip_error_db("range_doppler,rcmc=no", raw, grid, point)
    assert full < -60.0  # tol: exact at the reference range
    assert full + 20.0 < centroid < off
    assert unmoved > -10.0


def test_the_scaling_factor_is_that_of_the_angles() -> None:
    radar = ideal_radar(squint_angle=0.2, n_samples=400, resolution=0.5)
    grid = default_grid(radar, {**REQUEST, "extent_range": 4.0, "extent_azimuth": 4.0})
    line = radar.aim_point - radar.track.position
    cosine = np.sqrt(1.0 - (line @ grid.along / np.linalg.norm(line, axis=1)) ** 2)
    expected = np.abs(np.cos(0.2) / cosine - 1.0).max()
    # tol: the corners see the track 2 m off, 65 of the pulses are looked at
    assert ChirpScaling().largest_factor(radar, grid) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(
    "name", ["range_doppler", "chirp_scaling", "omega_k,stolt=phase", "omega_k,stolt=off"]
)
def test_past_its_limit_each_refuses_and_names_what_can_do_it(name: str) -> None:
    radar = ideal_radar(squint_angle=0.6, n_samples=6000, resolution=0.5, bandwidth=300e6)
    grid = default_grid(
        radar, {**REQUEST, "extent_range": 1800.0, "spacing_range": 20.0, "spacing_azimuth": 5.0}
    )
    with pytest.raises(
        DataError, match=r"leaves a phase of up to .* rad .*(take focuser .*omega_k|stolt=on)"
    ) as caught:
        check_focuser(parse_focuser(name), radar, grid)
    assert "\n" not in str(caught.value)
    bold = replace(parse_focuser(name), bound=1e9)
    assert not bold.refusal(radar, grid)
    check_focuser(parse_focuser("omega_k"), radar, grid)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("omega_k,stolt=maybe", "stolt = 'maybe' must be on"),
        ("range_doppler,src=1", "src = '1' must be doppler"),
    ],
)
def test_unknown_options_are_one_line(name: str, text: str) -> None:
    radar, grid = geometry("spotlight", 10e3, 1.0, 0)
    with pytest.raises(DataError, match=text):
        check_focuser(parse_focuser(name), radar, grid)


@pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
def test_noise_comes_through_as_through_a_matched_filter(mode: str) -> None:
    """Pixel noise of white receiver noise of unit power per sample, against the sum of the squared weights."""
    radar, grid = geometry(mode, 10e3, 1.0, 0)
    rng = np.random.default_rng(3)
    shape = (1, radar.track.n_pulses, radar.window.n_samples)
    noise = (rng.standard_normal((*shape, 2)) * np.sqrt(0.5)).astype(np.float32).view(np.complex64)[..., 0]
    raw = RawData(noise, ideal_echoes(radar, np.zeros(3)).layers, "compressed", radar)
    rows, columns = (np.linspace(10, n - 11, 5).astype(int) for n in grid.shape)
    points = replace(grid, azimuth=grid.azimuth[rows], range=grid.range[columns]).positions().reshape(-1, 3)
    gain = direction_gain(radar, slice(None), look_directions(radar, points))
    weight = aperture_weights(radar, points, "rectangular")
    r = np.linalg.norm(points[:, None] - radar.track.position, axis=-1)
    scale = radar.amplitude_constant * (weight * gain**2).sum(axis=1)
    share = radar.waveform.bandwidth / radar.window.sampling_rate
    predicted = share * np.mean(((weight * gain * r**2) ** 2).sum(axis=1) / scale**2)
    for name in ("backprojection", *ALGORITHMS):
        image: SarImage = focus(raw, grid, focuser=name)
        power = float(np.mean(np.abs(image.data) ** 2))
        # tol: the 0.3 dB; the mean over some 5000 cells has a sigma of 0.06 dB
        assert abs(10.0 * np.log10(power / predicted)) < 0.3, name


def edge_of_swath(squint: float, swath: float) -> tuple[Radar, ImageGrid, np.ndarray]:
    """A radar, a narrow image of this swath, m, and a point at its far edge."""
    cell = 0.5 * SPEED_OF_LIGHT / 300e6
    radar = ideal_radar(
        squint_angle=squint, resolution=cell, bandwidth=300e6, n_samples=int(1.2 * swath / cell) + 120
    )
    origin = radar.track.center_position
    middle, step = float(np.hypot(origin[0], origin[2])), 0.5 * cell * float(np.cos(squint))
    narrow = {**REQUEST, "grid": "slant", "extent_azimuth": 60.0 * step, "extent_range": 8.0 * step}
    grid = default_grid(radar, {**narrow, "spacing_azimuth": step, "spacing_range": step})
    n = round((0.5 * swath + 30.0 * step) / step)
    grid = replace(grid, range=middle + step * np.arange(-n, n + 1))
    rho = middle + 0.5 * swath
    return radar, grid, np.array([np.sqrt(rho**2 - origin[2] ** 2) + origin[0], 0.0, 0.0])


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "name",
    few_of(
        [
            "omega_k,stolt=phase",
            "range_doppler",
            "chirp_scaling",
            "range_doppler,src=centroid",
            "range_doppler,src=off",
            "chirp_scaling,scaling=no",
        ],
        3,
    ),
)
def test_just_within_its_limit_each_is_as_good_as_promised(name: str, seed: int) -> None:
    """The widest swath not refused at a random squint; where the swath hardly matters, the largest squint of one."""
    rng = np.random.default_rng([seed, len(name)])
    squint, width = np.radians(rng.uniform(1.0, 9.0)), rng.uniform(50.0, 200.0)

    def setting(value: float) -> tuple[Radar, ImageGrid, np.ndarray]:
        if "src" in name:
            return edge_of_swath(np.radians(10.0 * value), width)
        return edge_of_swath(squint, 4000.0 * value)

    focuser = parse_focuser(name)
    low, high = 0.0, 1.0
    for _ in range(10):
        middle = 0.5 * (low + high)
        refused = bool(focuser.refusal(*setting(middle)[:2]))
        low, high = (low, middle) if refused else (middle, high)
    assert 0.0 < low < high < 1.0
    radar, grid, point = setting(low)
    raw = ideal_echoes(radar, point)
    row, column = pixel_at(grid, point)
    columns = slice(max(column - 48, 0), column + 49)
    part = replace(grid, range=grid.range[columns])
    reference = backproject(raw, part, interpolation="kernel:8", oversampling=4)[0]
    pixels = focus(raw, grid, focuser=focuser).data[0][:, columns]
    inside = (row, column - columns.start)
    value = exact(raw, part.positions()[inside][None])[0]
    # tol: the 5 degrees, 2 % and 0.5 dB
    assert abs(np.degrees(np.angle(pixels[inside] / value))) < 5.0, low
    got, wanted = (measured(data, part, point) for data in (pixels, reference))
    for axis in ("azimuth", "range"):
        mine, theirs = getattr(got, axis), getattr(wanted, axis)
        assert mine.irw == pytest.approx(theirs.irw, rel=0.02), low
        assert mine.pslr_db == pytest.approx(theirs.pslr_db, abs=0.5), low
