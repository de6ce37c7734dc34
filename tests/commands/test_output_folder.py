"""What a run finds out before its simulation, what it uses again, and whose files it touches."""

import json
import os
import shutil
from collections import namedtuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sarmitsuba.simulation.execution.render
from sarmitsuba import cli
from sarmitsuba.core.errors import DataError, OutputError
from sarmitsuba.files import FORMATS, FileFormat, read_image, read_raw
from sarmitsuba.machine.journal import Journal
from sarmitsuba.machine.output import MANIFEST
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.raw_data import RawData


def render(out: Path, *options: str) -> int:
    return cli.main(["render", "box", "-o", str(out), *options])


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--window", "hammin"), "window 'hammin': unknown"),
        (("--focuser", "polar"), "focuser 'polar' is unknown"),
        (("--focuser", "backprojection,width=3"), "option 'width' is unknown"),
        (
            ("--format", "hdf5,tiff"),
            "file format 'tiff' is unknown; did you mean \"geotiff\"?; choose one of ",
        ),
        (("--format", "openexr,openexr"), "two of them would write image.exr"),
        (("--method", "image", "--no-focus"), "makes an image without raw data"),
        (("--method", "raster", "--target-error", "-30"), "makes one pass only"),
        (("--target-error", "30"), "--target-error = 30 dB is above the bound 0 dB"),
        (("--target-error", "nan"), "--target-error = nan is not a finite number"),
        (("--time-limit", "-5"), "--time-limit = -5 s is below the bound 0 s"),
        (("--seed", "-1"), "--seed = -1 is below the bound 0"),
        (("--seed", str(2**31)), "is above the bound"),
    ],
)
def test_what_can_be_checked_is_checked_before_the_simulation(
    simulations: list[Scene], tmp_path: Path, capsys: Any, options: tuple[str, ...], reason: str
) -> None:
    assert render(tmp_path / "out", *options) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ") and reason in line
    assert simulations == [] and not (tmp_path / "out").exists()


def test_a_focuser_that_cannot_do_the_grid_is_refused_before_the_simulation(
    simulations: list[Scene], tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "sarmitsuba.signal.focusing.focusers.omega_k.OmegaK.refusal",
        lambda self, radar, grid: "not this grid",
    )
    assert render(tmp_path / "out", "--focuser", "omega_k") == 2
    assert "focuser omega_k: not this grid; take focuser backprojection" in capsys.readouterr().err
    assert simulations == []


def test_a_disk_without_room_is_found_before_the_simulation(
    simulations: list[Scene], tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10, 10, 1000))
    assert render(tmp_path / "out") == 2
    assert "GB are free" in capsys.readouterr().err
    assert simulations == []


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["cost", "box", "--target-error", "-300"], "--target-error = -300 dB is below the bound -200 dB"),
        (["cost", "box", "--budget", "nan"], "--budget = nan s must be above 0"),
        (["focus", "{raw}", "-o", "{out}", "--extent", "-5", "5"], "--extent = -5 m is below the bound 0 m"),
        (
            ["focus", "{raw}", "-o", "{out}", "--spacing", "0", "nan"],
            "--spacing = nan is not a finite number",
        ),
        (["focus", "{raw}", "-o", "{out}", "--height", "inf"], "--height = inf is not a finite number"),
        (["focus", "{raw}", "-o", "{out}", "--center", "1e12", "0"], "--center = 1e+12 m is above the bound"),
    ],
)
def test_bounds_hold_for_the_other_commands_too(
    fake_stages: dict[str, Any], tmp_path: Path, capsys: Any, options: list[str], line: str
) -> None:
    assert render(tmp_path / "a", "--quiet") == 0
    paths = {"raw": tmp_path / "a" / "raw.h5", "out": tmp_path / "b"}
    assert cli.main([option.format(**paths) for option in options]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert line in said and not (tmp_path / "b").exists()


def test_a_corrected_command_uses_the_raw_data_that_are_there(
    simulations: list[Scene], tmp_path: Path, capsys: Any
) -> None:
    out = tmp_path / "out"
    assert render(out) == 0
    before = (out / "raw.h5").read_bytes()
    capsys.readouterr()
    assert render(out, "--window", "hamming") == 0
    assert len(simulations) == 1
    assert (
        f"{out / 'raw.h5'}: raw data of this scene and these settings, used again" in capsys.readouterr().out
    )
    assert (out / "raw.h5").read_bytes() == before
    assert json.loads((out / "parameters.json").read_text())["focus"]["window"] == "hamming"
    # other settings are not the same data
    assert render(out, "--seed", "8") == 2
    assert (
        "holds results of another scene, of other settings or of another version" in capsys.readouterr().err
    )
    assert (out / "raw.h5").read_bytes() == before
    assert render(out, "--seed", "8", "--force") == 0
    assert [scene.settings.seed for scene in simulations] == [3, 8]
    # --force begins anew whatever is there
    assert render(out, "--seed", "8", "--force") == 0
    assert len(simulations) == 3


def test_a_run_that_failed_while_focusing_goes_on_from_its_raw_data(
    simulations: list[Scene], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sarmitsuba.signal.focusing

    def fail(*_: Any, **__: Any) -> None:
        raise DataError("no")

    good = sarmitsuba.signal.focusing.focus
    monkeypatch.setattr(sarmitsuba.signal.focusing, "focus", fail)
    assert render(tmp_path / "out", "--quiet") == 2
    assert names(tmp_path / "out") == {"raw.h5", MANIFEST}
    monkeypatch.setattr(sarmitsuba.signal.focusing, "focus", good)
    assert render(tmp_path / "out", "--quiet") == 0
    assert len(simulations) == 1 and "image.h5" in names(tmp_path / "out")


def test_an_interrupted_run_of_many_passes_goes_on(
    fake_stages: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[bool] = []

    def refine(scene: Scene, *, state: Path, **_: Any) -> None:
        seen.append(state.exists())
        state.write_text("a pass")
        raise KeyboardInterrupt

    once = sarmitsuba.simulation.execution.render.execute

    def execute(scene: Scene, options: Any, **how: Any) -> Any:
        if scene.settings.adds_passes:
            refine(scene, **how)
        return once(scene, options, **how)

    monkeypatch.setattr("sarmitsuba.simulation.execution.render.execute", execute)
    out = tmp_path / "out"
    goal = ("--target-error", "-40", "--quiet")
    for options in ((), (), ("--target-error", "-30"), ("--force",), ()):
        assert render(out, *goal, *options) == 130
        assert names(out) == {"passes.npz", MANIFEST}
    assert seen == [False, True, True, False, True]
    # over the results of something else
    assert render(out, "--seed", "7", "--force", "--quiet") == 0
    assert "passes.npz" not in names(out)
    assert render(out, *goal) == 2
    assert render(out, *goal, "--force") == 130
    assert render(out, *goal) == 130
    assert seen[5:] == [False, True]


def test_chirped_data_are_made_from_what_is_there_and_not_the_other_way_round(
    simulations: list[Scene], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    for options, domain, runs in (
        ((), "compressed", 1),
        (("--raw", "chirped"), "chirped", 1),
        (("--raw", "chirped"), "chirped", 1),
        ((), "compressed", 2),
    ):
        assert render(out, "--quiet", "--no-focus", *options) == 0
        assert read_raw(out / "raw.h5").domain == domain
        assert len(simulations) == runs


@pytest.mark.parametrize("damage", ["cut", "other mark"])
def test_raw_data_that_prove_nothing_are_not_used(
    simulations: list[Scene], tmp_path: Path, capsys: Any, damage: str
) -> None:
    import h5py

    out = tmp_path / "out"
    assert render(out, "--no-focus") == 0
    size = (out / "raw.h5").stat().st_size
    if damage == "cut":
        (out / "raw.h5").write_bytes(bytes(size))  # as large as the list says
    else:
        with h5py.File(out / "raw.h5", "a") as file:
            text = file["metadata"].asstr()[()]
            mark = json.loads(text)["fingerprint"]
            file["metadata"][()] = text.replace(mark, "0" * len(mark))
        record = json.loads((out / MANIFEST).read_text())
        record["files"]["raw.h5"] = (out / "raw.h5").stat().st_size
        (out / MANIFEST).write_text(json.dumps(record))
    assert render(out) == 0
    assert len(simulations) == 2
    assert ("simulating anew" in capsys.readouterr().err) == (damage == "cut")


def test_only_what_the_program_wrote_is_removed(
    simulations: list[Scene], tmp_path: Path, capsys: Any
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    (out / "quicklook_mine.png").write_text("mine")
    assert render(out) == 0  # nothing is in the way
    assert render(out, "--seed", "4", "--force", "--no-focus") == 0
    assert names(out) == {"mine.txt", "quicklook_mine.png", "raw.h5", "parameters.json", MANIFEST}
    assert (out / "quicklook_mine.png").read_text() == "mine"


@pytest.mark.parametrize(
    "name", ["raw.h5", "image.exr", "quicklook.png", "quicklook_order.png", "parameters.json"]
)
def test_a_file_of_the_users_own_is_never_overwritten(
    simulations: list[Scene], tmp_path: Path, capsys: Any, name: str
) -> None:
    out = tmp_path / "out"
    assert render(out) == 0
    (out / name).write_text("mine")  # the user has put something else there
    for options in ((), ("--force",), ("--seed", "5", "--force")):
        capsys.readouterr()
        assert render(out, *options) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert f"{name}: this file was not written by the program here" in line
    assert (out / name).read_text() == "mine"
    assert len(simulations) == 1


def test_a_list_that_cannot_be_read_is_one_line(
    simulations: list[Scene], tmp_path: Path, capsys: Any
) -> None:
    out = tmp_path / "out"
    assert render(out) == 0
    for text in ("", "[]", '{"files": 3, "mark": ""}', '{"files": {"raw.h5": "x"}, "mark": ""}'):
        (out / MANIFEST).write_text(text)
        capsys.readouterr()
        assert render(out) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "the list of written files cannot be read" in line


def test_focus_replaces_results_of_the_same_data_only(
    fake_stages: dict[str, Any], tmp_path: Path, capsys: Any
) -> None:
    for name, seed in (("a", "1"), ("b", "2")):
        assert render(tmp_path / name, "--seed", seed, "--no-focus") == 0
    out, one, two = (str(tmp_path / name) for name in ("out", "a/raw.h5", "b/raw.h5"))
    assert cli.main(["focus", one, "-o", out]) == 0
    assert cli.main(["focus", one, "-o", out, "--window", "hamming"]) == 0
    assert cli.main(["focus", two, "-o", out]) == 2
    assert "holds results of another scene" in capsys.readouterr().err
    assert cli.main(["focus", two, "-o", out, "--force"]) == 0
    # into the folder of the data themselves
    assert cli.main(["focus", one, "-o", str(tmp_path / "a")]) == 0
    assert {"raw.h5", "image.h5"} <= names(tmp_path / "a")


def test_formats_of_extensions_are_written(simulations: list[Scene], tmp_path: Path, capsys: Any) -> None:
    def pixels(path: Path, image: SarImage) -> None:
        with path.open("wb") as file:
            np.savez(file, **{channel: image.total(channel) for channel in image.channels})

    def echoes(path: Path, raw: RawData) -> None:
        path.write_bytes(raw.total("VV").tobytes())

    FORMATS.register(FileFormat("test_pixels", "pixels only", (".testnpz",), write_image=pixels))
    FORMATS.register(FileFormat("test_echoes", "echoes only", (".echo",), write_raw=echoes))
    FORMATS.register(FileFormat("test_read_only", "nothing", (".ro",), read_image=read_image))
    out, pictures = (
        tmp_path / "a",
        {"accuracy.png", "quicklook.png", "quicklook_order.png", "parameters.json", MANIFEST},
    )
    assert render(out, "--format", "test_pixels", "--quiet") == 0
    assert names(out) == {"raw.h5", "image.testnpz", *pictures}
    written = (out / "raw.h5").stat().st_mtime_ns
    assert render(out, "--format", "hdf5,test_pixels, test_echoes", "--quiet") == 0
    assert names(out) == {"raw.h5", "raw.echo", "image.h5", "image.testnpz", *pictures}
    assert len(simulations) == 1 and (out / "raw.h5").stat().st_mtime_ns == written
    image = read_image(out / "image.h5")
    np.testing.assert_array_equal(np.load(out / "image.testnpz")["VV"], image.total("VV"))
    whole = np.frombuffer((out / "raw.echo").read_bytes(), np.complex64)
    np.testing.assert_array_equal(whole, read_raw(out / "raw.h5").total("VV").ravel())
    options = ("-o", str(tmp_path / "b"), "--format", "test_pixels", "--quiet")
    assert cli.main(["focus", str(out / "raw.h5"), *options]) == 0
    assert names(tmp_path / "b") == {"image.testnpz", *pictures}
    capsys.readouterr()
    assert render(tmp_path / "c", "--format", "test_read_only") == 2
    assert "test_read_only can be read but not written" in capsys.readouterr().err


def hostile(record: dict[str, Any], folder: Path, out: Path, rng: np.random.Generator) -> dict[str, Any]:
    """The list with a name that leads elsewhere, in the folder but not a result's, or to what is no regular file."""
    mine = folder / "mine.h5"
    size = int(rng.choice([-1, mine.stat().st_size]))
    kind = int(rng.integers(10))
    if kind == 5:
        (out / "raw_2.h5").symlink_to(mine)
    if kind == 6:
        (out / "sub").mkdir()
        (out / "sub" / "raw.h5").write_text("mine")
    if kind == 7:
        (out / "quicklook_HH.png").symlink_to(folder / "nowhere")
    name = [
        "../mine.h5",
        str(mine),
        "./../mine.h5",
        "thesis.txt",
        "..",
        "raw_2.h5",
        "sub/raw.h5",
        "quicklook_HH.png",
        "raw.h5\x00",
        "raw.h5/../../mine.h5",
    ][kind]
    record["files"][name] = size
    return record


@pytest.mark.parametrize("seed", range(12))
def test_a_list_from_elsewhere_takes_no_file_of_others(
    seed: int, simulations: list[Scene], tmp_path: Path, capsys: Any
) -> None:
    rng = np.random.default_rng([seed, 26])
    out = tmp_path / "out"
    assert render(out) == 0
    (tmp_path / "mine.h5").write_text("mine")
    (out / "thesis.txt").write_text("mine")
    record = hostile(json.loads((out / MANIFEST).read_text()), tmp_path, out, rng)
    (out / MANIFEST).write_text(json.dumps(record))
    before = {p: p.lstat().st_ino for p in tmp_path.rglob("*") if p.is_symlink() or "mine" in p.name}
    before |= {p: p.lstat().st_ino for p in out.rglob("*") if p.name == "thesis.txt" or p.parent != out}
    capsys.readouterr()
    assert render(out, "--seed", "9", "--force") == 0
    assert {p: p.lstat().st_ino for p in before} == before
    assert (tmp_path / "mine.h5").read_text() == (out / "thesis.txt").read_text() == "mine"
    strange = [name for name in record["files"] if name not in ("raw_2.h5", "quicklook_HH.png")]
    odd = [name for name in strange if "/" in name or name in ("..", "thesis.txt") or "\x00" in name]
    said = [line for line in capsys.readouterr().err.splitlines() if "which no command writes" in line]
    assert len(said) == bool(odd)
    assert not any("\x00" in line for line in said)


@pytest.mark.parametrize("name", ["raw.h5", "image.h5", "quicklook.png", "parameters.json", "raw.blocks"])
@pytest.mark.parametrize("target", ["mine", "nowhere"])
def test_nothing_is_written_through_a_link(
    simulations: list[Scene], tmp_path: Path, capsys: Any, name: str, target: str
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (tmp_path / "mine").write_text("")
    (out / name).symlink_to(tmp_path / target)
    (out / MANIFEST).write_text(json.dumps({"mark": "", "files": {name: -1}}))
    status = render(out, "--force")
    assert (tmp_path / "mine").read_text() == "" and not (tmp_path / "nowhere").exists()
    # a link is no list of finished blocks, and stays
    assert status == 2 or name == "raw.blocks" or not (out / name).is_symlink()


def test_a_list_that_is_a_pipe_or_too_long_is_one_line(
    simulations: list[Scene], tmp_path: Path, capsys: Any
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    os.mkfifo(out / MANIFEST)
    assert render(out) == 2
    (out / MANIFEST).unlink()
    (out / MANIFEST).write_text(" " * 10_000_000)
    assert render(out) == 2
    for line in capsys.readouterr().err.splitlines():
        assert "the list of written files cannot be read" in line


def test_a_journal_follows_no_link(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("")
    for target in ("mine", "nowhere"):
        (tmp_path / "raw.blocks").symlink_to(tmp_path / target)
        with pytest.raises(OutputError, match="cannot write"):
            Journal(tmp_path / "raw.blocks", lambda label, payload: True)
        (tmp_path / "raw.blocks").unlink()
    assert (tmp_path / "mine").read_text() == "" and not (tmp_path / "nowhere").exists()
    os.mkfifo(tmp_path / "raw.blocks")
    with pytest.raises(OutputError, match="is not a regular file"):
        Journal(tmp_path / "raw.blocks", lambda label, payload: True)
