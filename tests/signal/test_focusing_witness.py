"""What an image measures of its own error: pixels recomputed by an exact sum; and dense pulses, where laws failed."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import ModuleType
from typing import ClassVar

import numpy as np
import pytest

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError, SarmitsubaWarning
from sarmitsuba.core.witness import Witness
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.focuser import Focused, Focuser, FocusTask, parse_focuser
from sarmitsuba.signal.focusing.focusers.backprojection import Backprojection, backproject
from sarmitsuba.signal.focusing.grid import default_grid
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.focusing.witness import sum_exactly
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.signal.raw_data import Layer, RawData
from tests.support.draws import few_of
from tests.support.geometries import random_geometry
from tests.support.unweighted import focus

RECTANGULAR = parse_window("rectangular")


@pytest.fixture
def drawn_focusing(benchmark_script: Callable[[str], ModuleType]) -> ModuleType:
    return benchmark_script("drawn_focusing")


def small(squint: float = 0.0) -> tuple[RawData, ImageGrid]:
    radar = ideal_radar(resolution=1.0, n_samples=96, squint_angle=squint)
    grid = default_grid(radar, ImageRequest(extent_azimuth=32.0, extent_range=32.0))
    points = np.array([[0.0, 0.0, 0.0], [6.0, -9.0, 0.0], [-7.0, 11.0, 0.0]])
    return ideal_echoes(radar, points, [1.0, 3.0, 0.5], [0.0, 1.0, 2.0]), grid


# ---------------------------------------------------------------- the exact sum


@pytest.mark.parametrize(
    "seed", few_of((10, 9, 1, 3, 5), 2)
)  # the first with a beam and apertures of the pixels' own
def test_the_exact_sum_is_that_of_an_independent_program(drawn_focusing: ModuleType, seed: int) -> None:
    """Beams, own apertures, moving receive windows: a sum by Fourier series that shares no code."""
    drawn = drawn_focusing.draw_echoes(seed)
    pixel = np.random.default_rng(seed).integers(0, np.prod(drawn.grid.shape), 6)
    points = drawn.grid.positions().reshape(-1, 3)[pixel]
    found = sum_exactly(drawn.raw, points, RECTANGULAR, RECTANGULAR)
    # tol: profiles are transformed in single precision and interpolated by eight taps
    assert image_error_db(found, drawn_focusing.direct_sum(drawn.raw, points)) < -125.0


@pytest.mark.parametrize("bistatic", [False, True])
def test_the_exact_sum_takes_windows_channels_and_a_separate_receiver(bistatic: bool) -> None:
    raw, grid = small()
    other = np.roll(raw.data, 3, axis=2)  # range cells on
    data = np.concatenate([0.25 * raw.data, 0.75 * raw.data, other])
    layers = (Layer("VV", 1), Layer("VV", 2), Layer("HH"))
    radar = raw.radar
    if bistatic:
        radar = replace(radar, receiver=radar.track.moved([0.0, 40.0, 60.0]))
    raw = replace(raw, data=data, layers=layers, radar=radar)
    windows = parse_window("taylor"), parse_window("hamming")
    points = grid.positions()[::9, ::9].reshape(-1, 3)
    image = backproject(
        raw,
        points,
        range_window=windows[0],
        azimuth_window=windows[1],
        interpolation="kernel:8",
        oversampling=4,
    )
    found = sum_exactly(raw, points, *windows)
    # tol: the compiled sum's single precision
    assert image_error_db(np.array([image[0] + image[1], image[2]]), found) < -100.0


# ---------------------------------------------------------------- the witness of an image


@dataclass(frozen=True)
class _Wrong(Focuser):
    """Backprojection, some pixels of which are wrong: stands for any focuser whose law is."""

    name: ClassVar[str] = "wrong"
    title: ClassVar[str] = "of a test"
    factor: complex = 1.0
    rows: int = -1  # first ones; -1: all
    channel: int = 0

    def error_db(self, radar: Radar, grid: ImageGrid) -> float:
        return -60.0

    def focus(self, task: FocusTask) -> Focused:
        made = Backprojection().focus(task)
        made.pixels[self.channel, : self.rows if self.rows > 0 else None] *= np.complex64(self.factor)
        return made


def witness_of(raw: RawData, grid: ImageGrid, focuser: str | Focuser) -> Witness:
    found = Witness.read(focus(raw, grid, focuser=focuser).metadata["focus"]["witness"])
    assert found is not None
    return found


@pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
@pytest.mark.parametrize("name", ["omega_k", "range_doppler", "backprojection,interpolation=linear"])
def test_the_witness_is_the_true_error(mode: str, name: str) -> None:
    radar, grid = random_geometry(mode, 10e3, 1.0, 0)
    points = grid.positions()[20::30, 20::20].reshape(-1, 3)
    raw = ideal_echoes(radar, points)
    image = focus(raw, grid, focuser=name)
    found = Witness.read(image.metadata["focus"]["witness"])
    assert found is not None and found.reference == "backprojection in float64"
    exact = backproject(raw, grid, interpolation="kernel:8", oversampling=4)
    true = image_error_db(image.data, exact)
    # tol: sum of 64 pixels: 2.5 dB rms; the upper level holds for 19 of 20 draws, nearly for the others
    assert found.error_db == pytest.approx(true, abs=6.0)
    assert found.upper_db > true - 3.0


def test_a_law_that_is_wrong_is_contradicted_in_one_line() -> None:
    raw, grid = small()
    with pytest.warns(
        SarmitsubaWarning,
        match=r"focuser wrong has an error of -3\d\.\d dB, .*expected -60.*take focuser back",
    ):
        image = focus(raw, grid, focuser=_Wrong(factor=1.02))
    assert image.metadata["focus"]["witness"]["law_db"] == -60.0


@pytest.mark.parametrize("factor", [-1.0, 30.0])
def test_a_useless_image_is_refused_and_what_works_is_named(factor: float) -> None:
    raw, grid = small()
    with pytest.raises(DataError, match=r"an error of .* dB.*no use; take focuser backprojection$"):
        focus(raw, grid, focuser=_Wrong(factor=factor))


def test_an_image_that_is_not_a_number_is_refused() -> None:
    raw, grid = small()

    class _Broken(_Wrong):
        def focus(self, task: FocusTask) -> Focused:
            made = super().focus(task)
            made.pixels[0, 3, 3] = np.nan
            return made

    with pytest.raises(DataError, match="no use; take focuser backprojection"):
        focus(raw, grid, focuser=_Broken())


def test_errors_of_the_edge_and_of_one_channel_are_seen() -> None:
    raw, grid = small()
    two = replace(raw, data=np.concatenate([raw.data] * 2), layers=(Layer("VV"), Layer("HH")))
    for focuser in (_Wrong(factor=0.5, rows=2), _Wrong(factor=1.01, channel=1)):
        with pytest.warns(SarmitsubaWarning, match="expected -60"):
            focus(two, grid, focuser=focuser)


def test_the_witness_is_of_the_recorded_track_and_not_of_a_straightened_one() -> None:
    radar = ideal_radar(resolution=1.0, n_samples=128)
    phase = np.linspace(0.0, 6.0, radar.track.n_pulses)
    sway = np.stack([0.02 * np.sin(phase), 0.0 * phase, 0.02 * np.cos(phase)], axis=1)
    radar = replace(radar, track=replace(radar.track, position=radar.track.position + sway))
    grid = default_grid(radar, ImageRequest(extent_azimuth=32.0, extent_range=32.0))
    raw = ideal_echoes(radar, np.array([[0.0, 0.0, 0.0], [9.0, 11.0, 0.0]]))
    image = focus(raw, grid, focuser="omega_k")
    facts = image.metadata["focus"]
    found = Witness.read(facts["witness"])
    assert "motion_compensation" in facts and found is not None
    assert found.reference == "backprojection in float64" and not found.contradicts
    true = image_error_db(image.data, backproject(raw, grid, interpolation="kernel:8", oversampling=4))
    # tol: the law of what compensation leaves, which is of the worst pixel, is added
    assert true - 3.0 < found.upper_db < facts["stated_error_db"] < true + 15.0


def test_an_image_without_echoes_has_no_witness() -> None:
    raw, grid = small()
    assert "witness" not in focus(replace(raw, data=0.0 * raw.data), grid).metadata["focus"]


@pytest.mark.parametrize("squint", [0.0, 0.2])
def test_conjugated_echoes_are_named(squint: float) -> None:
    raw, grid = small(squint)
    focus(raw, grid)  # a warning would be an error
    with pytest.warns(SarmitsubaWarning, match="the echoes focus when they are conjugated"):
        focus(replace(raw, data=raw.data.conj()), grid)


def test_nothing_is_said_of_conjugated_clutter_or_noise() -> None:
    raw, grid = small()
    rng = np.random.default_rng(4)
    noise = (rng.standard_normal(raw.data.shape) + 1j * rng.standard_normal(raw.data.shape)).astype(
        np.complex64
    )
    focus(replace(raw, data=noise), grid)


# ---------------------------------------------------------------- dense pulses


@pytest.mark.parametrize("name", ["omega_k", "range_doppler", "chirp_scaling"])
@pytest.mark.parametrize(
    ("frequency", "slant_range", "resolution", "density"),
    [
        (435e6, 1000.0, 0.5, 4.1),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in ((1.3e9, 2e3, 1.0, 4.0), (16e9, 500.0, 0.3, 9.0))
        ),
    ],
)
def test_dense_pulses_change_nothing(
    name: str, frequency: float, slant_range: float, resolution: float, density: float
) -> None:
    """Pulses closer than a quarter of a wavelength sample directions past grazing, where nothing is."""
    wavelength = SPEED_OF_LIGHT / frequency
    radar = ideal_radar(
        slant_range=slant_range,
        resolution=resolution,
        center_frequency=frequency,
        bandwidth=50e6,
        n_samples=80,
        prf_factor=density * resolution / wavelength,
    )
    sides = {"extent_azimuth": 30.0 * resolution, "extent_range": 30.0}
    grid = default_grid(radar, ImageRequest(**sides))
    raw = ideal_echoes(radar, np.array([[0.0, 0.0, 0.0], [4.0, 5.0 * resolution, 0.0]]))
    focuser = replace(parse_focuser(name), **({} if name == "omega_k" else {"bound": 1.0}))
    image = focus(raw, grid, focuser=focuser)
    exact = backproject(raw, grid, interpolation="kernel:8", oversampling=4)
    true = image_error_db(image.data, exact)
    assert true < image.metadata["focus"]["stated_error_db"] + 3.0
    # tol: stationary phase over apertures of some tens of Fresnel widths, and range-Doppler's residual phase
    assert true < (-50.0 if name == "omega_k" else -25.0)
