"""A run that stops in the middle of a block goes on from the finished ones and has the bits of one without a stop."""

import dataclasses
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sarmitsuba import cli
from sarmitsuba.core.errors import OutputError
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.files import read_image, read_raw
from sarmitsuba.loading.load import load_scene
from sarmitsuba.machine.output import MANIFEST, OutputFolder, output_folder
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.execution import tracing, witnesses
from sarmitsuba.simulation.execution import tracing as batches
from sarmitsuba.simulation.execution.blocks import Blocks
from sarmitsuba.simulation.execution.render import simulate
from tests.support.unweighted import refine

BOX = """<scene version="3.0.0">
    <integrator type="sar_path">
        <float name="ray_spacing" value="0.2"/>
    </integrator>
    <sensor type="sar_antenna">
        <float name="slant_range" value="3000"/>
        <float name="azimuth_resolution" value="1"/>
        <film type="range_film">
            <float name="image_extent_azimuth" value="12"/>
            <float name="image_extent_range" value="12"/>
        </film>
    </sensor>
    <bsdf type="radar_material" id="soil">
        <string name="material" value="medium_dry_ground"/>
        <float name="rms_height" value="0.008"/>
        <string name="diffuse_law" value="constant_gamma"/>
        <float name="diffuse_level_db" value="-14"/>
    </bsdf>
    <shape type="rectangle">
        <transform name="to_world"><scale x="12" y="12"/></transform><ref id="soil"/>
    </shape>
    <shape type="cube">
        <transform name="to_world"><scale x="2" y="2" z="2"/></transform><ref id="soil"/>
    </shape>
</scene>"""
# a process that is killed (SIGKILL) at a report of its progress
COMMAND = """
import os, signal, sys
from sarmitsuba import cli
from sarmitsuba.commands.console import Console

left = int(sys.argv[1])

def progress(self, *figures):
    global left
    left -= 1
    if left < 0:
        os.kill(os.getpid(), signal.SIGKILL)

Console.progress = progress
cli.main(sys.argv[2:])
"""


class Killed(BaseException):
    """Nothing in the program catches it."""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("box") / "box.xml"
    path.write_text(BOX)
    return path


@pytest.fixture(scope="module")
def box(file: Path) -> Scene:
    scene = load_scene(file)
    return replace(scene, radar=replace(scene.radar, noise_temperature=300.0))


def killing(monkeypatch: pytest.MonkeyPatch, after: int) -> Callable[[], int]:
    """Stop at a launch: the first after so many; returns how many there were."""
    count, inner = 0, tracing.Tracer.launch

    def launch(self: Any, *args: Any, **options: Any) -> Any:
        nonlocal count
        count += 1
        if count > after:
            raise Killed
        return inner(self, *args, **options)

    monkeypatch.setattr(tracing.Tracer, "launch", launch)
    return lambda: count


def same(a: RawData, b: RawData) -> None:
    np.testing.assert_array_equal(a.data, b.data)
    assert a.layers == b.layers
    statistics = [dict(raw.metadata["statistics"]) for raw in (a, b)]
    for one in statistics:  # powers are sums that threads form in any order
        one["power"], one["power_outside"] = np.float32(one["power"]), np.float32(one["power_outside"])
    # tol: float32 rounding of the sums over lanes
    assert statistics[0] == pytest.approx(statistics[1], rel=1e-5)
    assert a.metadata["sampling"] == b.metadata["sampling"]


@pytest.mark.parametrize(
    ("seed", "settings"),
    [
        (1, {"key_pulse_interval": 16}),
        (2, {"keep_orders": True, "keep_subsets": True, "effects": {"noise": "on"}}),
        pytest.param(3, {"method": "raw", "keep_subsets": True}, marks=pytest.mark.slow),
    ],
)
def test_a_stop_at_a_drawn_launch_loses_the_block_in_work_and_no_bit(
    box: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int, settings: dict[str, Any]
) -> None:
    monkeypatch.setattr(batches, "MAX_LANES", 300_000)  # several batches where every pulse is traced
    # launches of the witnesses come after all blocks, and are made again
    monkeypatch.setattr(witnesses, "MOST", 0)
    monkeypatch.setattr(witnesses, "FEWEST", 0)
    monkeypatch.setattr(Blocks, "witness", lambda self, allowed: None)
    scene = replace(box, settings=replace(box.settings, seed=seed, **settings))
    state = tmp_path / "raw.blocks"
    with monkeypatch.context() as patch:
        launches = killing(patch, 1000)
        whole = simulate(scene)
        n = launches()
    assert n >= 5
    stops = [int(stop) for stop in np.random.default_rng(seed).integers(2, n // 2 + 1, 2)]
    for stop in stops:
        with monkeypatch.context() as patch:
            killing(patch, stop)
            with pytest.raises(Killed):
                simulate(scene, state=state)
    with monkeypatch.context() as patch:
        launches = killing(patch, 1000)
        same(simulate(scene, state=state), whole)
        # every stop loses the block in work at most: one launch, or two of coherent and diffuse rays apart
        assert launches() <= n - sum(stops) + 2
    assert state.stat().st_size < 1.2 * whole.data.nbytes + 20_000
    with monkeypatch.context() as patch:
        killing(patch, 0)
        same(simulate(scene, state=state), whole)


@pytest.mark.slow
def test_shorter_blocks_are_not_decided_twice(
    box: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wanted are blocks with less error than the first: stopped in the shorter ones, the run keeps to them."""
    settings = replace(box.settings, target_error_db=-35.0)
    scene, state = replace(box, settings=settings), tmp_path / "raw.blocks"
    with monkeypatch.context() as patch:
        launches = killing(patch, 1000)
        whole = simulate(scene)
        n = launches()
    assert whole.metadata["sampling"]["key_pulse_interval"] < 25
    for stop in (1, n // 2):
        state.unlink(missing_ok=True)
        with monkeypatch.context() as patch:
            killing(patch, stop)
            with pytest.raises(Killed):
                simulate(scene, state=state)
        same(simulate(scene, state=state), whole)


def test_blocks_of_something_else_are_noticed(box: Scene, tmp_path: Path) -> None:
    state = tmp_path / "raw.blocks"
    said: list[str] = []

    def ready(run: Any) -> None:
        said.append(str(run.finished))

    first = simulate(box, state=state, ready=ready)
    other = replace(box, settings=replace(box.settings, seed=99))
    for scene, plan, line in (
        (box, None, "finished blocks of an interrupted run of this scene, used again"),
        (other, None, "of another scene, of other settings"),
        (other, EffectsPlan(replace(KernelFlags(), diffuse=True), 2), "of another scene, of other settings"),
        (box, None, "of another scene, of other settings"),
    ):
        raw = simulate(scene, plan=plan, state=state, ready=ready)
        assert line in said[-1] and str(state) in said[-1] and "\n" not in said[-1]
    np.testing.assert_array_equal(raw.data, first.data)


def test_nothing_is_kept_without_a_file(box: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    simulate(box)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(OutputError, match="cannot write"):
        simulate(box, state=tmp_path / "none" / "raw.blocks")


@pytest.mark.slow
def test_passes_go_on_within_a_pass(box: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = replace(box, settings=replace(box.settings, key_pulse_interval=16))
    options: dict[str, Any] = {"target_error_db": -199.0, "max_passes": 2}
    state = tmp_path / "passes.npz"
    with monkeypatch.context() as patch:
        launches = killing(patch, 1000)
        whole = refine(scene, **options)
        n = launches()
    for stop in (n // 4, n // 2):  # in the first pass, and in the second
        with monkeypatch.context() as patch:
            killing(patch, stop)
            with pytest.raises(Killed):
                refine(scene, state=state, **options)
        assert (tmp_path / "passes.blocks").exists()
    again = refine(scene, state=state, **options)
    np.testing.assert_array_equal(again.raw.data, whole.raw.data)
    np.testing.assert_array_equal(again.image.data, whole.image.data)
    assert again.passes == whole.passes == 2
    assert {path.name for path in tmp_path.iterdir()} == {"passes.npz"}
    assert dataclasses.astuple(again)[3] == whole.error_db


# ------------------------------------------------------------ from the command line

OPTIONS = ("-D", "sar_path.key_pulse_interval=8", "--format", "hdf5")
RESULTS = {"accuracy.png", "raw.h5", "image.h5", "quicklook.png", "parameters.json", MANIFEST}


def render(scene: Path, out: Path, *options: str) -> int:
    return cli.main(["render", str(scene), "-o", str(out), *OPTIONS, *options])


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.fixture(scope="module")
def whole(file: Path) -> Path:
    out = file.parent / "whole"
    assert render(file, out, "--quiet") == 0
    assert names(out) == RESULTS
    return out


def same_raw(out: Path, whole: Path) -> None:
    assert names(out) == {"raw.h5", "parameters.json", MANIFEST}
    np.testing.assert_array_equal(read_raw(out / "raw.h5").data, read_raw(whole / "raw.h5").data)


def same_files(out: Path, whole: Path) -> None:
    assert names(out) == RESULTS
    np.testing.assert_array_equal(read_raw(out / "raw.h5").data, read_raw(whole / "raw.h5").data)
    np.testing.assert_array_equal(read_image(out / "image.h5").data, read_image(whole / "image.h5").data)


def test_a_killed_process_loses_nothing(file: Path, whole: Path, tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "out"
    arguments = ["render", str(file), "-o", str(out), *OPTIONS]
    killed = subprocess.run([sys.executable, "-c", COMMAND, "5", *arguments], capture_output=True, text=True)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert names(out) == {"raw.blocks"}
    assert render(file, out) == 0
    said = capsys.readouterr().out
    assert f"{out / 'raw.blocks'}: " in said and "finished blocks of an interrupted run" in said
    same_files(out, whole)


@pytest.mark.parametrize(
    "name",
    [
        "raw.h5",
        "image.h5",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("quicklook.png", "parameters.json")),
    ],
)
def test_a_kill_between_a_file_and_the_list_of_files(
    file: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """The file stands whole and the list does not say so yet, or half a file stands under its temporary name."""
    out, inner = tmp_path / "out", os.replace

    def replaced(source: Any, target: Any) -> None:
        if Path(target).name != name:
            return inner(source, target)
        Path(source).with_name(f".sarmitsuba-part-{2**22 + 1}-0.h5").write_bytes(b"half")
        inner(source, target)
        monkeypatch.setattr(OutputFolder, "enter", lambda self, *names: None)
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", replaced)
        with pytest.raises(Killed):
            render(file, out, "--quiet")
    monkeypatch.undo()
    assert render(file, out, "--quiet") == 0
    same_files(out, whole)


def test_another_scene_begins_anew_and_says_so(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        killing(patch, 3)
        with pytest.raises(Killed):
            render(file, out, "--no-focus")
    capsys.readouterr()
    assert render(file, out, "--seed", "5", "--no-focus") == 0
    (line,) = (row for row in capsys.readouterr().out.splitlines() if "raw.blocks" in row)
    assert "finished blocks of another scene, of other settings" in line and "begun anew" in line
    assert names(out) == {"raw.h5", "parameters.json", MANIFEST}


@pytest.mark.parametrize("limit", [3_000, 40_000, 120_000])
def test_a_full_disk_is_one_line_and_the_command_goes_on_afterwards(
    file: Path, whole: Path, tmp_path: Path, capsys: Any, limit: int
) -> None:
    """A bound on the size of files, as a disk that fills up: in the blocks, later in them, and in the results."""
    resource = pytest.importorskip("resource")
    out = tmp_path / "out"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        status = render(file, out, "--quiet", "--no-focus")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    (line,) = capsys.readouterr().err.splitlines()
    assert (
        status == 2
        and "cannot write: " in line
        and "exceeds the size limit of the system or the user" in line
    )
    assert names(out) <= {"raw.blocks", "raw.h5", MANIFEST}
    assert render(file, out, "--quiet", "--no-focus") == 0
    same_raw(out, whole)


def test_two_runs_in_one_folder(file: Path, whole: Path, tmp_path: Path, capsys: Any) -> None:
    pytest.importorskip("fcntl")
    out = tmp_path / "out"
    with output_folder(str(out)):
        assert render(file, out, "--no-focus") == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"error: {out}: another run is writing into this folder; ")
        assert names(out) == set()
    assert render(file, out, "--quiet", "--no-focus") == 0
    same_raw(out, whole)


def test_a_file_of_the_users_own_in_the_place_of_the_blocks(file: Path, tmp_path: Path, capsys: Any) -> None:
    (tmp_path / "raw.blocks").write_text("mine")
    assert render(file, tmp_path, "--quiet") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "raw.blocks: this file was not written by the program here" in line
    assert (tmp_path / "raw.blocks").read_text() == "mine"


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs a folder that nobody can write to")
def test_a_folder_that_cannot_be_written_to(file: Path, capsys: Any) -> None:
    for folder in ("/proc/self", "/proc/sarmitsuba"):
        assert render(file, Path(folder), "--quiet") == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"error: {folder}: cannot ")
