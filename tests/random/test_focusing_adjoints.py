"""Focusing operators on drawn radars and data: the adjoint's defining equation, and the images of focus itself."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sarmitsuba.core.arrays import C64, LinearMap
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.progress import silent
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.receiver import moving_in_pulse
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.signal.chirp import n_fast_chirped
from sarmitsuba.signal.focusing import FOCUSERS, default_grid, focus
from sarmitsuba.signal.focusing.focuser import FocusTask, parse_focuser
from sarmitsuba.signal.focusing.focusers.backprojection import backproject_numpy
from sarmitsuba.signal.focusing.operator import FocusingOperator, focusing_operator
from sarmitsuba.signal.focusing.pixel_tiles import plan_line
from sarmitsuba.signal.focusing.profiles import plan_profiles
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.raw_data import Layer, RawData

# every focuser with every option that changes what it computes
NAMES = (
    "backprojection",
    "backprojection,interpolation=linear",
    "backprojection,interpolation=kernel:8,oversampling=3",
    "omega_k",
    "omega_k,stolt=phase",
    "omega_k,stolt=off",
    "range_doppler",
    "range_doppler,src=centroid",
    "range_doppler,rcmc=no,src=off",
    "chirp_scaling",
    "chirp_scaling,scaling=no",
    "polar_format",
    "factorised",
    "factorised,error=-25",
    "factorised,stages=2,error=-25",
    "factorised,stages=4",
    "auto",
)
# where a focuser's phase bound would refuse the drawn image, the bound is raised: the equation holds regardless
BOUNDS = ",bound=20"
CHANNELS = ("HH", "HV", "VV")
MODES = ("spotlight", "stripmap", "sliding_spotlight", "orbit")


def noise(rng: np.random.Generator, shape: tuple[int, ...]) -> C64:
    """Independent complex normal numbers."""
    return np.asarray(rng.standard_normal(shape) + 1j * rng.standard_normal(shape), dtype=np.complex64)


def drawn(mode: str, seed: int) -> tuple[Radar, ImageGrid]:
    """A radar of a mode with drawn squint, heading, side and pattern, and a grid of drawn kind, size and place."""
    rng = np.random.default_rng([32, seed, len(mode)])
    cell = float(rng.uniform(0.8, 1.5)) * (3.0 if mode == "orbit" else 1.0)
    flown: dict[str, Any] = {
        "mode": mode,
        "slant_range": float(rng.uniform(2e3, 6e3)),
        "look_angle_deg": float(rng.uniform(30.0, 50.0)),
        "heading_deg": float(rng.uniform(0.0, 360.0)),
        "squint_angle_deg": float(rng.uniform(-15.0, 15.0)) * (0.1 if "sliding" in mode else 1.0),
        "speed": 100.0,
    }
    if mode == "orbit":
        flown = {
            "mode": "spotlight",
            "orbit_altitude": 514e3,
            "orbit_pass": ("ascending", "descending")[rng.integers(2)],
            "incidence_angle_deg": float(rng.uniform(25.0, 45.0)),
            "latitude_deg": float(rng.uniform(-50.0, 50.0)),
        }
    beam: dict[str, Any] = {"pattern": "isotropic"}
    if mode in ("stripmap", "sliding_spotlight") or rng.random() < 0.5:
        beam = {"pattern": "rectangular", "antenna_length": 2.5 * cell, "antenna_height": 0.02}
    radar = RadarDescription(
        look_side=("left", "right")[rng.integers(2)],
        bandwidth=0.5 * SPEED_OF_LIGHT / cell,
        azimuth_resolution=cell,
        mode_parameters={"sliding_factor": float(rng.uniform(0.3, 1.0))} if "sliding" in mode else {},
        **flown,
        **beam,
    )
    size = float(rng.uniform(15.0, 30.0)) * cell
    film = FilmDescription(
        image_grid=("slant", "ground")[rng.integers(2)],
        image_extent_azimuth=size,
        image_extent_range=float(rng.uniform(0.5, 1.0)) * size,
    )
    scene = build_scene(points=[PointTarget("aim", np.zeros(3), 1.0)], radar=radar, film=film)
    return scene.radar, default_grid(scene.radar, scene.image)


def raw_noise(radar: Radar, rng: np.random.Generator, domain: str = "compressed") -> RawData:
    """Noise of all channels as raw data."""
    fast = n_fast_chirped(radar) if domain == "chirped" else radar.window.n_samples
    data = noise(rng, (len(CHANNELS), radar.track.n_pulses, fast))
    return RawData(data, tuple(Layer(channel) for channel in CHANNELS), domain, radar)  # type: ignore[arg-type]


def check_adjoint(operator: FocusingOperator, raw: RawData, rng: np.random.Generator) -> C64:
    r"""Check that <y, A x> = <A^H y, x> for the raw data x and images y that agree with A x, or do not; return A x.

    tol: single precision. The first, 1e-6 of the product itself, is of y = A x + noise, where it does not vanish; the
    second, 1e-7 of both norms, is of independent noise, where products are 1/sqrt(n) of them: 1e-2 to 1e-3.
    """
    x = raw.data.ravel()
    image = operator @ x
    level = float(np.sqrt(np.mean(np.abs(image) ** 2)))
    assert level > 0.0
    independent = noise(rng, image.shape) * np.float32(level)
    for y, tolerance, whole in ((image + independent, 1e-6, False), (independent, 1e-7, True)):
        ahead = np.vdot(y.astype(np.complex128), image)
        back = np.vdot((operator.H @ y).astype(np.complex128), x)
        scale = np.linalg.norm(y) * np.linalg.norm(image) if whole else abs(ahead)
        assert abs(ahead - back) <= tolerance * scale, (ahead, back)
    return np.asarray(image)


def operator_or_refusal(raw: RawData, grid: ImageGrid, name: str, **options: Any) -> FocusingOperator | str:
    """The operator, with a wide phase bound where the focuser has one; or why the focuser refuses these data."""
    bounded = name.split(",")[0] in ("range_doppler", "chirp_scaling") or "stolt" in name
    try:
        return focusing_operator(raw, grid, focuser=name + BOUNDS * bounded, **options)
    except DataError as error:
        if "states no adjoint" in str(error):  # of turning beams in the frequency domain
            return str(error)
        with pytest.raises(DataError):
            focus(raw, grid, focuser=name + BOUNDS * bounded, **options)
        return str(error)


@pytest.mark.filterwarnings("ignore:focus:sarmitsuba.core.errors.SarmitsubaWarning")
@pytest.mark.parametrize(
    "mode", [pytest.param(m, marks=pytest.mark.slow) if m == "orbit" else m for m in MODES]
)
def test_adjoint_of_every_focuser_and_mode(mode: str) -> None:
    served: set[str] = set()
    for seed in range(2 if mode == "orbit" else 3):
        radar, grid = drawn(mode, seed)
        rng = np.random.default_rng([33, seed])
        raw = raw_noise(radar, rng)
        windows = [("rectangular", "taylor", "hamming")[i] for i in rng.integers(3, size=2)]
        options = {"range_window": windows[0], "azimuth_window": windows[1]}
        for name in NAMES:
            operator = operator_or_refusal(raw, grid, name, **options)
            if isinstance(operator, str):
                continue
            served.add(name)
            image = check_adjoint(operator, raw, rng)
            try:
                expected = focus(raw, grid, focuser=operator.focuser, **options).data
            except DataError as error:  # a wide bound lets forms through that blur this image
                assert "bound" in name + BOUNDS and "it is of no use" in str(error)
                continue
            assert operator.image_shape == expected.shape
            assert np.array_equal(image, expected.ravel()), name
    # own apertures and a common one exclude some, the frequency domain takes no bent track
    assert {"backprojection", "auto"} <= served
    if mode in ("spotlight", "stripmap"):
        assert {name for name in NAMES if "_" in name and "polar" not in name} <= served, served
    if mode in ("spotlight", "orbit"):
        assert {"polar_format", *(name for name in NAMES if "factorised" in name)} <= served, served


def test_the_check_sees_an_adjoint_that_is_off_by_a_hundred_thousandth() -> None:
    radar, grid = drawn("spotlight", 5)
    rng = np.random.default_rng(5)
    raw = raw_noise(radar, rng)
    operator = focusing_operator(raw, grid)
    right = operator._rmatvec
    operator._rmatvec = lambda y: right(y) * np.float32(1.00001)  # type: ignore[method-assign]
    with pytest.raises(AssertionError):
        check_adjoint(operator, raw, rng)


def test_every_registered_focuser_is_among_them() -> None:
    own = {
        focuser.name
        for focuser in FOCUSERS
        if type(focuser).__module__.startswith("sarmitsuba.signal.focusing.")
    }
    assert own and {name.split(",")[0] for name in NAMES} >= own


@pytest.mark.parametrize("compression", ["flat", "matched"])
def test_chirped_data_are_compressed_by_the_operator(compression: str) -> None:
    radar, grid = drawn("spotlight", 7)
    rng = np.random.default_rng(7)
    raw = raw_noise(radar, rng, "chirped")
    operator = focusing_operator(raw, grid, compression=compression)  # type: ignore[arg-type]
    assert operator.data_shape == raw.data.shape
    image = check_adjoint(operator, raw, rng)
    assert np.array_equal(image, focus(raw, grid, compression=compression).data.ravel())  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["omega_k", "range_doppler,bound=20", "chirp_scaling,bound=20"])
def test_motion_compensation_is_part_of_the_operator(name: str) -> None:
    radar, grid = drawn("spotlight", 11)
    rng = np.random.default_rng(11)
    track = radar.track
    phase = 2.0 * np.pi * np.arange(track.n_pulses) / track.n_pulses
    sway = 0.05 * np.sin(phase)[:, None] * np.array([0.3, 0.2, 1.0])
    sway += 0.02 * np.diff(track.position[:2], axis=0) * np.sin(phase)[:, None]
    bent = replace(radar, track=replace(track, position=track.position + sway))
    raw = raw_noise(bent, rng)
    operator = focusing_operator(raw, grid, focuser=name)
    image = check_adjoint(operator, raw, rng)
    said = focus(raw, grid, focuser=name)
    assert "motion_compensation" in said.metadata["focus"]
    assert np.array_equal(image, said.data.ravel())


def check_map(imaging: LinearMap, raw: RawData, grid: ImageGrid, rng: np.random.Generator) -> None:
    """The adjoint of a focuser's map alone; tol: as for `check_adjoint`."""
    image = imaging.forward(raw.data)
    y = image + noise(rng, image.shape) * np.float32(np.sqrt(np.mean(np.abs(image) ** 2)))
    ahead = np.vdot(y.astype(np.complex128), image)
    assert image.shape == (len(raw.layers), *grid.shape) and abs(ahead) > 0.0
    assert abs(ahead - np.vdot(imaging.adjoint(y).astype(np.complex128), raw.data)) <= 1e-6 * abs(ahead)


@pytest.mark.parametrize("options", ["error=-25", "stages=2", "stages=3,error=-25"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_factorised_maps_of_own_apertures(options: str, seed: int) -> None:
    """It refuses these because plain backprojection is as fast; the map is the same."""
    radar, grid = drawn("stripmap", seed)
    rng = np.random.default_rng([34, seed])
    raw = raw_noise(radar, rng)
    windows = parse_window("taylor"), parse_window("hamming")
    focuser = parse_focuser(f"factorised,{options}")
    check_map(focuser.imaging(FocusTask(raw, grid, *windows, silent)), raw, grid, rng)


@pytest.mark.filterwarnings("ignore:focus:sarmitsuba.core.errors.SarmitsubaWarning")
@pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
def test_pixels_outside_of_the_receive_window(mode: str) -> None:
    radar, grid = drawn(mode, 4)
    grid = replace(grid, range=grid.range + 0.6 * radar.window.extent)
    rng = np.random.default_rng(4)
    raw = raw_noise(radar, rng)
    for name in ("backprojection", "omega_k", "range_doppler,bound=20"):
        image = check_adjoint(focusing_operator(raw, grid, focuser=name), raw, rng)
        assert (image == 0.0).any(), name


def test_long_lines_of_pixels_share_nodes() -> None:
    """A distant radar's pixels, of which many share a lane: the adjoint of the polynomials between nodes."""
    radar, grid = drawn("orbit", 1)
    raw = raw_noise(radar, np.random.default_rng(1))
    plan = plan_profiles(radar, parse_window("taylor"))
    per_line, nodes = plan_line(radar, plan, grid)
    assert 1 < nodes < per_line
    check_adjoint(focusing_operator(raw, grid, focuser="backprojection"), raw, np.random.default_rng(2))


def test_bistatic_data_and_more_layers_than_a_launch_takes() -> None:
    radar, grid = drawn("spotlight", 2)
    rng = np.random.default_rng(2)
    away = radar.track.position + np.array([700.0, -400.0, 150.0])
    apart = 0.5 * (
        np.linalg.norm(radar.track.position, axis=1) + np.linalg.norm(away, axis=1)
    ) - np.linalg.norm(radar.track.position, axis=1)
    window = replace(radar.window, start_range=radar.window.start_range + apart)
    isotropic = replace(radar.antenna, pattern="isotropic")
    receiver = replace(radar.track, position=away)
    radar = replace(radar, receiver=receiver, window=window, antenna=isotropic)
    data = noise(rng, (6, radar.track.n_pulses, radar.window.n_samples))
    raw = RawData(data, tuple(Layer("VV", order) for order in range(1, 7)), "compressed", radar)
    check_adjoint(focusing_operator(raw, grid), raw, rng)


@pytest.mark.parametrize("domain", ["compressed", "chirped"])
def test_motion_within_the_pulse_is_part_of_the_operator(domain: str) -> None:
    radar, grid = drawn("spotlight", 6)
    moving = moving_in_pulse(radar)
    rng = np.random.default_rng(6)
    raw = raw_noise(moving, rng, domain)
    operator = focusing_operator(raw, grid)
    image = check_adjoint(operator, raw, rng)
    assert np.array_equal(image, focus(raw, grid).data.ravel())
    still = focusing_operator(replace(raw, radar=radar), grid) @ raw.data.ravel()
    assert np.abs(image - still).max() > 1e-3 * np.abs(image).max()


def test_adjoint_is_the_conjugate_transpose_of_a_dense_reference() -> None:
    """Brute force: the matrix of `backproject_numpy`, which shares no code with the kernels, column by column."""
    radar, grid = drawn("spotlight", 3)
    radar = replace(radar, antenna=replace(radar.antenna, pattern="isotropic"))
    radar = radar.of_pulses(slice(0, 5))
    rows, columns = (slice(n // 2 - 2, n // 2 + 2) for n in grid.shape)
    small = replace(grid, azimuth=grid.azimuth[rows], range=grid.range[columns])
    shape = (1, radar.track.n_pulses, radar.window.n_samples)
    raw = RawData(np.zeros(shape, dtype=np.complex64), (Layer("VV"),), "compressed", radar)
    operator = focusing_operator(
        raw,
        small,
        focuser="backprojection,interpolation=kernel:8",
        range_window="rectangular",
        azimuth_window="rectangular",
    )
    dense = []
    for index in range(int(np.prod(shape))):
        unit = np.zeros(shape, dtype=np.complex64)
        unit.flat[index] = 1.0
        dense.append(backproject_numpy(replace(raw, data=unit), small.positions().reshape(-1, 3))[0])
    adjoint = np.array([operator.H @ row for row in np.eye(operator.shape[0], dtype=np.complex64)])
    expected = np.array(dense).conj().T
    # tol: interpolation by eight taps, 1e-6 (-124 dB over noise), and sums in single precision
    assert np.abs(adjoint - expected).max() < 1e-5 * np.abs(expected).max()


def test_autofocus_and_focusers_without_an_adjoint_are_refused() -> None:
    radar, grid = drawn("spotlight", 5)
    raw = raw_noise(radar, np.random.default_rng(5))
    with pytest.raises(DataError, match="autofocus phase_gradient is not linear in the data; leave it out"):
        focusing_operator(raw, grid, autofocus="phase_gradient")

    class Other(type(FOCUSERS["polar_format"]).__mro__[1]):  # type: ignore[misc]
        """A focuser of an extension that only focuses."""

        name = "other"
        title = "other"

        def focus(self, task: Any) -> Any:
            """Focus."""
            raise NotImplementedError

    with pytest.raises(DataError, match="focuser other: it states no adjoint"):
        focusing_operator(raw, grid, focuser=Other())


def test_values_that_are_not_finite_are_refused() -> None:
    radar, grid = drawn("spotlight", 5)
    raw = raw_noise(radar, np.random.default_rng(5))
    operator = focusing_operator(raw, grid)
    bad = raw.data.ravel().copy()
    bad[3] = np.nan
    with pytest.raises(DataError, match=r"1 of \d+ values of the raw data are NaN, infinite"):
        operator @ bad
    with pytest.raises(DataError, match="values of the image are NaN, infinite"):
        operator.H @ np.full(operator.shape[0], 1e39)


def test_operators_do_not_warn_of_their_own() -> None:
    radar, grid = drawn("stripmap", 1)
    raw = raw_noise(radar, np.random.default_rng(1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        operator = focusing_operator(raw, grid)
        operator.H @ (operator @ raw.data.ravel())
