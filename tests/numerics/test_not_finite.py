"""Results that are not numbers: none come of odd bodies, and what makes one stops the run and is named."""

import warnings
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from sarmitsuba.core.arrays import all_finite
from sarmitsuba.core.errors import DataError, RadarError, SceneError
from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.path_table import trace_paths
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.execution.turntable import Aspects, rcs_sweep
from sarmitsuba.truth.validation import targets
from tests.support.unweighted import focus, render

ROOT = Path(__file__).parents[2]
# wires and a wall, needles, shells inside out, a body on itself: cheap ones of the benchmark's
ODD = (2, 8, 10)


@pytest.fixture
def odd_bodies(benchmark_script: Callable[[str], ModuleType]) -> ModuleType:
    return benchmark_script("odd_bodies")


def outcome(module: ModuleType, seed: int, folder: Path) -> tuple[str, str]:
    drawn = module.draw(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        kind, line = module.outcome(drawn, module.write(drawn, folder))
    return str(kind), str(line)


@pytest.mark.parametrize("seed", ODD)
def test_odd_bodies_return_numbers(odd_bodies: ModuleType, seed: int, tmp_path: Path) -> None:
    kind, line = outcome(odd_bodies, seed, tmp_path)
    assert kind == "finite", line


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 130))
def test_more_odd_bodies_return_numbers_or_are_refused(
    odd_bodies: ModuleType, seed: int, tmp_path: Path
) -> None:
    kind, line = outcome(odd_bodies, seed, tmp_path)
    assert kind in ("finite", "refused"), line
    assert kind == "finite" or 0 < len(line) < 1000


@pytest.mark.slow
def test_a_crane_of_thin_cylinders(benchmark_script: Callable[[str], ModuleType], tmp_path: Path) -> None:
    """88 members of 4 and 8 cm: after five mirrors so curved a tube is wider than float32 can tell. Was all NaN."""
    scene = load_scene(benchmark_script("crane").crane(tmp_path), radar="airborne_x")
    raw = simulate(scene)
    assert all_finite(raw.data) and np.any(raw.data)


@pytest.fixture
def faulty() -> Scene:
    """A trihedral whose roughness is no number, as no file can have it."""
    scene = load_scene(
        "trihedral", parameters={"radar_material.rms_height": "0.0001", "radar_material.diffuse_law": "none"}
    )
    material = copy(scene.materials[0])
    object.__setattr__(material, "rms_height", np.nan)
    return replace(scene, materials=(material,))


NAMED = r"\d bounces? that ends on the shape \"trihedral\".*\"metal\".* is not a finite number; .*"


def test_echoes_that_are_no_numbers_stop_the_run(faulty: Scene) -> None:
    with pytest.raises(SceneError, match=r"trihedral: pulse \d+: an echo of " + NAMED):
        simulate(faulty)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["raw", "image"])
def test_so_does_every_method(faulty: Scene, method: str) -> None:
    with pytest.raises(SceneError, match=r"trihedral: (pulse|look) \d+: an echo of " + NAMED):
        render(faulty, method=method)  # type: ignore[arg-type]


@pytest.mark.slow
def test_so_do_paths_and_cross_sections(faulty: Scene) -> None:
    with pytest.raises(SceneError, match=r"trihedral: pulse \d+: a path of " + NAMED):
        trace_paths(faulty)
    with pytest.raises(SceneError, match=r"rcs: direction \(.*\): an echo of " + NAMED):
        rcs_sweep(faulty, Aspects(np.array([0.8]), np.array([0.5])), checked=0)


def test_echoes_from_elsewhere_that_are_no_numbers_are_refused() -> None:
    raw = simulate(load_scene("point"))
    raw.data[0, 3, 5] = np.nan
    raw.data[0, 4, 5] = np.inf
    with pytest.raises(
        DataError, match=r"focus: 2 of \d+ pulses hold NaN or infinite numbers, the first is pulse 3"
    ):
        focus(raw)


def test_large_numbers_are_numbers() -> None:
    assert all_finite(np.full(4, 3e38, np.float32))  # whose squares overflow
    assert not all_finite(np.array([0.0, 1.0j * np.inf], np.complex64))
    assert all_finite(np.zeros((0, 3), np.complex64))


@pytest.mark.parametrize("side", [100.0, 3000.0])
def test_large_plates_are_as_bright_as_they_are(side: float) -> None:
    """Seen from so far away that waves are plane, and not so far that phases are lost in rounding."""
    plate = targets.plate(side, side)
    result = monostatic_rcs(plate, targets.PEC, [[0.0, 0.0, 1.0]], 1e10, channels=("VV",), max_depth=1)
    wanted = 20.0 * np.log10(np.sqrt(4.0 * np.pi) * side**2 / 0.0299792458)
    # tol: 0.05 rad of phase over the larger one
    assert 20.0 * np.log10(abs(result.amplitude[0, 0])) == pytest.approx(wanted, abs=0.01)


def test_a_target_of_many_kilometres_is_refused() -> None:
    with pytest.raises(RadarError, match=r"a target of 4.24e\+05 m is too large for phases"):
        monostatic_rcs(targets.plate(3e5, 3e5), targets.PEC, [[0.0, 0.0, 1.0]], 1e10)
