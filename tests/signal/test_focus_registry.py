"""Focusers and windows: options, refusals, a user's own, and no Mitsuba in any of it."""

import inspect
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.core.errors import BackendError, DataError, ExtensionError
from sarmitsuba.machine.backend import arrays, dr
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing import (
    FOCUSERS,
    WINDOWS,
    Focused,
    Focuser,
    FocusTask,
    WindowFamily,
    WindowParameter,
    default_grid,
)
from sarmitsuba.signal.focusing.aperture_weights import matched_weights
from sarmitsuba.signal.focusing.autofocus import parse_autofocus
from sarmitsuba.signal.focusing.focuser import option, parse_focuser
from sarmitsuba.signal.focusing.focusers.backprojection import Backprojection, backproject
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import ImageGrid
from tests.support.unweighted import focus

REQUEST = ImageRequest(extent_azimuth=12.0, extent_range=12.0)


def test_built_in_focusers_are_found_and_described() -> None:
    assert set(FOCUSERS.names) >= {"backprojection", "omega_k"}
    for focuser in FOCUSERS:
        assert focuser.title and focuser.title in focuser.help
        for name in focuser.options:
            assert f"{name}=" in focuser.help


def test_options_are_read_with_their_types() -> None:
    text = "backprojection,interpolation=kernel:8,oversampling=4"
    assert parse_focuser(text) == Backprojection("kernel:8", 4)
    assert parse_focuser("backprojection") == Backprojection()
    for text in ("off", "false", "no", "0"):
        assert parse_focuser(f"range_doppler,rcmc={text}").options["rcmc"] is False
    with pytest.raises(DataError, match="option 'width' is unknown; it takes interpolation, oversampling"):
        parse_focuser("backprojection,width=3")
    with pytest.raises(DataError, match=r"oversampling = '2\.5' is not of type int"):
        parse_focuser("backprojection,oversampling=2.5")
    with pytest.raises(ExtensionError, match="choose one of"):
        parse_focuser("cubist_format")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        *((f"factorised,error={value}", "must be from -300 to 0") for value in ("nan", "inf", "-inf", "50")),
        ("auto,error=nan", "error = nan must be from -300 to 0"),
        ("omega_k,bound=nan", "bound = nan must be"),
        ("range_doppler,bound=-1", "bound = -1 must be"),
        ("chirp_scaling,bound=inf", "bound = inf must be"),
        ("backprojection,oversampling=1", "oversampling = 1 must be from 2 to 64, or 0"),
        ("backprojection,interpolation=cubic", "must be linear, kernel, kernel:4, kernel:6 or kernel:8"),
    ],
)
def test_values_of_options_are_checked(text: str, said: str) -> None:
    with pytest.raises(DataError, match=said):
        parse_focuser(text)


@pytest.mark.parametrize(
    "text", ["phase_gradient,rounds=0", "minimum_entropy,orders=1", "maximum_contrast,pixels=-3"]
)
def test_values_of_autofocusers_options_are_checked(text: str) -> None:
    with pytest.raises(DataError, match="must be from"):
        parse_autofocus(text)


def test_options_change_the_image_and_are_written_down() -> None:
    raw = ideal_echoes(ideal_radar(n_samples=128, resolution=4.0), np.zeros(3))
    plain = focus(raw, request=REQUEST)
    best = focus(raw, request=REQUEST, focuser="backprojection,interpolation=kernel:8,oversampling=4")
    assert plain.metadata["focus"]["interpolation"] == "kernel"
    same = {"azimuth_cell_polynomial": None, "stated_error_db": None, "chosen": None, "witness": None}
    assert best.metadata["focus"]["stated_error_db"] < plain.metadata["focus"]["stated_error_db"]
    assert best.metadata["focus"] | same == plain.metadata["focus"] | {
        **same,
        "interpolation": "kernel:8",
        "oversampling": 4,
    }
    assert (plain.data != best.data).any()


def test_a_refusal_names_what_can_do_it() -> None:
    radar = ideal_radar(n_samples=128, resolution=4.0)
    raw = ideal_echoes(radar, np.zeros(3))
    wavy = radar.track.position + np.sin(np.arange(radar.track.n_pulses))[:, None] * [0.0, 0.0, 0.1]
    raw = replace(raw, radar=replace(radar, track=replace(radar.track, position=wavy)))
    with pytest.raises(DataError, match=r"omega_k: the track is curved.*take focuser .*backprojection"):
        focus(raw, request=REQUEST, focuser="omega_k", motion_compensation="off")


@dataclass(frozen=True)
class EveryNth(Focuser):
    """Backprojection of every n-th pulse."""

    name: ClassVar[str] = "test_every_nth"
    title: ClassVar[str] = "every n-th pulse"
    step: int = option(2, "n")

    def refusal(self, radar: Radar, grid: ImageGrid) -> str:
        return "too few pulses" if radar.track.n_pulses < 4 * self.step else ""

    def focus(self, task: FocusTask) -> Focused:
        weights = np.zeros(task.raw.radar.track.n_pulses)
        weights[:: self.step] = 1.0
        raw = replace(task.raw, data=(task.raw.data * weights[None, :, None]).astype(np.complex64))
        scale = np.float32(weights.size / weights.sum())
        return Focused(
            backproject(raw, task.grid) * scale, lambda point: matched_weights(raw.radar, point) * weights
        )


def test_a_focuser_of_ones_own_gives_calibrated_images() -> None:
    FOCUSERS.register(EveryNth())
    radar = ideal_radar(n_samples=128, resolution=4.0, prf_factor=5.0)
    raw = ideal_echoes(radar, np.zeros(3), rcs=2.5)
    image = focus(raw, request=REQUEST, focuser="test_every_nth,step=3")
    assert 10 * np.log10(image.rcs().max() / 2.5) == pytest.approx(0.0, abs=0.05)  # tol: interpolated peak
    # the cell is that of the whole aperture: a third of the pulses spans the same angles
    whole = focus(raw, request=REQUEST)
    assert image.metadata["focus"]["method"] == "test_every_nth" and image.metadata["focus"]["step"] == 3
    assert image.range_resolution_cell == whole.range_resolution_cell
    assert np.isfinite(image.sigma0()).all()
    with pytest.raises(
        DataError, match=r"test_every_nth: too few pulses; take focuser backprojection or .*omega_k"
    ):
        focus(raw, request=REQUEST, focuser="test_every_nth,step=100000")


def test_a_window_of_ones_own() -> None:
    def power(u: np.ndarray, exponent: float) -> np.ndarray:
        return np.asarray(np.cos(np.pi * u) ** exponent)

    WINDOWS.register(
        WindowFamily(
            "test_cosine", "power of cosine", power, (WindowParameter("exponent", 1.0, 0.0, 9.0, ""),)
        )
    )
    u = np.linspace(-0.5, 0.5, 101)
    np.testing.assert_allclose(parse_window("test_cosine:2")(u), parse_window("hann")(u), atol=1e-12)
    assert str(parse_window("test_cosine")) == "test_cosine:1"
    with pytest.raises(DataError, match=r"exponent must be a number within 0 .. 9"):
        parse_window("test_cosine:10")
    with pytest.raises(DataError, match=r"taylor\[:N_BAR\[:LEVEL_DB\]\]"):
        parse_window("boxcar")


def test_the_public_function_has_a_plain_signature() -> None:
    names = list(inspect.signature(sarmitsuba.focus).parameters)
    assert names[:3] == ["raw", "grid", "request"] and "focuser" in names


def test_focusing_needs_no_mitsuba() -> None:
    code = """
import sys
import numpy as np
from sarmitsuba.signal.focusing import FOCUSERS, default_grid, focus
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.radar.image_request import ImageRequest
assert not {"mitsuba", "drjit"} & set(sys.modules)
raw = ideal_echoes(ideal_radar(n_samples=128, resolution=4.0), np.zeros(3))
for focuser in FOCUSERS:
    image = focus(raw, request=ImageRequest(extent_azimuth=12.0, extent_range=12.0), focuser=focuser)
    assert abs(image.rcs().max() - 1.0) < 0.01, image.rcs().max()
print("mitsuba" in sys.modules, any(name.startswith("sarmitsuba.tracing.kernel") for name in sys.modules))
"""
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=Path(sarmitsuba.__file__).parents[1]
    )
    assert run.stdout.strip() == "False False", run.stderr


def test_array_types_follow_a_running_mitsuba(monkeypatch: pytest.MonkeyPatch) -> None:
    cuda = dr.JitBackend.CUDA  # starts Dr.Jit before anything is faked
    monkeypatch.setitem(sys.modules, "mitsuba", SimpleNamespace(variant=lambda: "cuda_ad_rgb"))
    monkeypatch.setattr("drjit.has_backend", lambda backend: backend != cuda)
    with pytest.raises(BackendError, match="needs an NVIDIA GPU"):
        arrays()
    monkeypatch.setattr("drjit.has_backend", lambda backend: True)
    assert arrays().__name__ == "drjit.cuda"
    # what runs counts more than what the environment asks for
    monkeypatch.setitem(sys.modules, "mitsuba", SimpleNamespace(variant=lambda: "llvm_ad_rgb"))
    monkeypatch.setenv("SARMITSUBA_VARIANT", "cuda_ad_rgb")
    assert arrays().__name__ == "drjit.llvm"
    monkeypatch.setitem(sys.modules, "mitsuba", SimpleNamespace(variant=lambda: None))
    assert arrays().__name__ == "drjit.cuda"


def test_an_image_request_may_be_a_mapping_but_not_any() -> None:
    radar = ideal_radar(n_samples=128, resolution=4.0)
    np.testing.assert_array_equal(
        default_grid(radar, vars(REQUEST)).positions(), default_grid(radar, REQUEST).positions()
    )
    with pytest.raises(DataError, match="extent unknown"):
        default_grid(radar, {"extent": 3.0})
