"""Passes: state on disk, resuming, and what stops them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sarmitsuba.core.errors import DataError
from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.raw_data import Layer
from sarmitsuba.simulation.execution.fingerprint import fingerprint
from sarmitsuba.simulation.execution.passes import Passes, PassLayout
from sarmitsuba.simulation.execution.raw import echoes
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.planning.sampling.piece import crop
from tests.support.unweighted import refine


class Ticks:
    """A clock that goes on by a second whenever it is read."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        self.now += 1.0
        return self.now


@pytest.fixture(scope="module")
def scene() -> Scene:
    whole = crop(load_scene("tower"), 0.2, 0.03)
    return replace(whole, settings=replace(whole.settings, ray_spacing=0.3, max_depth=2))


def test_needs_a_target_or_a_limit(scene: Scene) -> None:
    with pytest.raises(DataError, match="target_error_db"):
        refine(scene)


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
def test_interrupted_run_goes_on_and_ends_alike(scene: Scene, tmp_path: Path) -> None:
    state = tmp_path / "passes.npz"
    bounds: Any = {"target_error_db": -90.0, "time_limit": 600.0, "max_passes": 3}
    seen = []

    def progress(stage: str, done: float, total: float, info: object, /) -> None:
        seen.append((stage, done, total, info))
        if len(seen) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        refine(
            scene,
            target_error_db=-90.0,
            time_limit=600.0,
            state=state,
            max_passes=3,
            progress=progress,
            clock=Ticks(),
        )
    assert state.exists() and "dB error" in seen[0][3] and "dB wanted" in seen[0][3]
    resumed = refine(scene, target_error_db=-90.0, time_limit=600.0, state=state, max_passes=3, clock=Ticks())
    assert resumed.passes == 3 and len(resumed.history) == 3 and not resumed.met
    straight = refine(scene, clock=Ticks(), **bounds)
    # tol: float32 sums in whatever order threads finish
    error = np.linalg.norm(resumed.raw.data - straight.raw.data) / np.linalg.norm(straight.raw.data)
    assert error < 1e-5
    # the target counts what two sets of one spacing cannot see, too
    assert resumed.image.metadata["sampling_error"]["VV"]["error_db"] <= resumed.error_db + 0.1


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
def test_more_passes_are_better_and_a_met_target_ends_them(scene: Scene) -> None:
    one = refine(scene, time_limit=1e-3, clock=Ticks())
    assert one.passes == 1
    more = refine(scene, target_error_db=one.error_db - 2.5, time_limit=600.0, clock=Ticks())
    assert more.met and 1 < more.passes <= 8  # doubling the rays lowers it by 2.5 dB
    assert more.error_db <= one.error_db - 2.5


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
def test_a_run_at_other_spacings_is_the_run_made_so(scene: Scene) -> None:
    run = Run(scene)
    assert run.sampling is not None
    denser = run.at(0.7)
    made = Run(
        replace(scene, settings=replace(scene.settings, **run.sampling.spacings.at(0.7))), plan=run.plan
    )
    ours, theirs = (echoes(one, pass_index=3) for one in (denser, made))
    # tol: float32 sums in whatever order threads finish
    assert np.linalg.norm(ours.data - theirs.data) < 1e-5 * np.linalg.norm(theirs.data)
    assert denser.report is not None and made.report is not None and run.report is None
    assert denser.report.rays_per_key_pulse == made.report.rays_per_key_pulse
    assert denser.trace_scene is run.trace_scene


def test_state_of_another_scene_is_refused(scene: Scene, tmp_path: Path) -> None:
    state = tmp_path / "passes.npz"
    np.savez(state, data=np.zeros(1), record=np.frombuffer(b'{"fingerprint": "x"}', dtype=np.uint8))
    with pytest.raises(DataError, match="passes"):
        refine(scene, time_limit=1.0, state=state)


def test_damaged_states_are_one_line(tmp_path: Path) -> None:
    state = tmp_path / "passes.npz"
    data, layers = np.ones((1, 20, 20), np.complex64), (Layer("VV"),)
    Passes("x", 1, 1.0, data, layers, [(1.0, -20.0)], {}, [0], 1.0, 5).save(state)
    whole, rng, layout = state.read_bytes(), np.random.default_rng(3), PassLayout(layers, 20, 20, 10.0)
    np.testing.assert_array_equal(Passes.load(state, "x", layout).data, data)
    for k in range(200):
        damaged = bytearray(whole[: rng.integers(len(whole))] if k % 2 else whole)
        for _ in range(10):
            damaged[-int(rng.integers(1, min(len(damaged), 600) + 1))] = int(rng.integers(256))
        state.write_bytes(bytes(damaged))
        with pytest.raises(DataError, match=r"remove (it|the file)") as caught:
            Passes.load(state, "x", layout)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize(
    ("record", "arrays"),
    [
        ({}, {"data": np.ones((2, 5, 7), np.complex64)}),
        ({}, {"data": np.full((2, 5, 6), np.nan, np.complex64)}),
        ({}, {"data": np.full((2, 5, 6), 1e30, np.complex64)}),
        ({}, {"data": np.ones((2, 5, 6), np.int64)}),
        ({}, {"data": np.full((2, 5, 6), "a")}),
        ({}, {"change": np.ones((1, 5, 3), np.complex64)}),
        ({}, {"change": np.full((1, 5, 6), np.inf, np.complex64)}),
        ({}, {"more": np.ones(3)}),
        *(({"count": value}, {}) for value in (-1, 0, 3, 10**30, 1.5, True, "1", None, float("inf"))),
        *(({"layers": value}, {}) for value in ([["VV", 0, 1]], [["VV", 0, 2], ["VV", 0, 1]], 1, [1])),
        *(({"levels": value}, {}) for value in ([], [0, 5], [-1], [1000], "ab", [None, None])),
        *(({"weight": value}, {}) for value in (0.0, 7.0, float("nan"), 1e308)),
        *(({"history": value}, {}) for value in ([], [[1.0]], [[float("inf"), 0.0]] * 2, [["a", "b"]] * 2)),
        ({"share": 0.25}, {}),
        ({"rays": -1}, {}),
        ({"seconds": float("nan")}, {}),
        ({"source": "hope"}, {}),
        ({"metadata": []}, {}),
        ({"fingerprint": "y"}, {}),
    ],
)
def test_states_that_no_run_writes_are_refused(
    tmp_path: Path, count: int, record: dict[str, object], arrays: dict[str, np.ndarray]
) -> None:
    """Arrays and records of the right fingerprint, but of another shape, type, size or count than the run's."""
    state, layers = tmp_path / "passes.npz", (Layer("VV", 0, 1), Layer("VV", 0, 2))
    layout, data = PassLayout(layers, 5, 6, 10.0), np.ones((2, 5, 6), np.complex64)
    change = data[:1] if count == 2 else None
    history, levels = [(1.0, -20.0), (2.0, -25.0)][:count], [0, 1][:count]
    weight = sum(2.0**level for level in levels)
    own = {"change": change, "share": 2.0 ** levels[-1] / weight}
    Passes("x", count, 2.0, data, layers, history, {}, levels, weight, 5, **own).save(state)
    assert Passes.load(state, "x", layout).count == count
    with np.load(state) as file:
        found = dict(file)
    changed = json.loads(found["record"].tobytes()) | record
    found |= {"record": np.frombuffer(json.dumps(changed).encode(), np.uint8)} | arrays
    np.savez(state, **found)
    with pytest.raises(DataError, match=r"cannot read the passes of an earlier run: .*; remove the file"):
        Passes.load(state, "x", layout)


def test_states_that_unpack_are_refused(tmp_path: Path) -> None:
    state, layers = tmp_path / "passes.npz", (Layer("VV"),)
    data = np.zeros((1, 500, 600), np.complex64)
    Passes("x", 1, 1.0, data, layers, [(1.0, -20.0)], {}, [0], 1.0, 5).save(state)
    with np.load(state) as file:
        np.savez_compressed(state, **dict(file))
    with pytest.raises(DataError, match="uncompressed"):
        Passes.load(state, "x", PassLayout(layers, 500, 600, 10.0))


def test_fingerprint_sees_what_matters(scene: Scene) -> None:
    other = replace(scene, settings=replace(scene.settings, ray_spacing=0.31))
    wanted = replace(scene, settings=replace(scene.settings, target_error_db=-30.0, time_limit=9.0))
    assert fingerprint(scene) != fingerprint(other)
    assert fingerprint(scene) == fingerprint(wanted)
