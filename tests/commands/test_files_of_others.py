"""Every command that writes: what the program did not write stays, and names that the system refuses are one line."""

import json
from pathlib import Path
from typing import Any

import pytest

from sarmitsuba import cli
from sarmitsuba.core.errors import DataError
from sarmitsuba.machine.journal import MAGIC
from sarmitsuba.machine.output import MANIFEST
from sarmitsuba.scene.scene import Scene

LONG = "c" * 300
LONGER = "/" + "a" * 5000


def one_line(capsys: Any) -> str:
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ") and len(line) < 1000
    return str(line)


def render(out: Path, *options: str) -> int:
    return cli.main(["render", "box", "-o", str(out), "--quiet", *options])


@pytest.mark.parametrize(("text", "stays"), [(b"mine", True), (MAGIC + b"cut", False)])
def test_a_list_of_blocks_that_is_none_stays(
    text: bytes, stays: bool, simulations: list[Scene], tmp_path: Path
) -> None:
    assert render(tmp_path) == 0
    (tmp_path / "raw.blocks").write_bytes(text)
    assert render(tmp_path, "--window", "hamming") == 0
    assert (tmp_path / "raw.blocks").exists() == stays and len(simulations) == 1


def test_passes_of_others_are_refused_before_the_simulation(
    simulations: list[Scene], tmp_path: Path, capsys: Any
) -> None:
    (tmp_path / "passes.npz").write_text("mine")
    for options in ((), ("--force",)):
        assert render(tmp_path, "--target-error", "-30", *options) == 2
        assert "passes.npz: this file was not written by the program here" in one_line(capsys)
    assert (tmp_path / "passes.npz").read_text() == "mine" and not simulations


@pytest.mark.parametrize(
    ("command", "name", "work"),
    [
        ("cost plate -o {out}", "cost.md", "sarmitsuba.apps.cost.study_cost"),
        ("cost plate -o {out}", "cost.json", "sarmitsuba.apps.cost.study_cost"),
        ("cost plate -o {out}", "cost.png", "sarmitsuba.apps.cost.study_cost"),
        (
            "validate --case plate -o {out}",
            "images/validation/plate.png",
            "sarmitsuba.truth.validation.run_cases.run_case",
        ),
        ("validate -o {out}", "validation.md", "sarmitsuba.truth.validation.run_cases.run_case"),
        ("view {out}", "page.html", "sarmitsuba.view.page.run_folder.read_run"),
        ("view {out} -o {out}/mine.html", "mine.html", "sarmitsuba.view.page.run_folder.read_run"),
        ("view {out} -o {out}/page.html", "page.html", "sarmitsuba.view.page.run_folder.read_run"),
        ("picture {out}/image.h5 -o {out}/mine.png", "mine.png", "sarmitsuba.files.read_image"),
        ("quality {out}/image.h5", "quality.png", "sarmitsuba.files.read_image"),
        ("polarimetry {out}/image.h5", "polarimetry.json", "sarmitsuba.files.read_image"),
        ("interferogram {out}/a.h5 {out}/b.h5", "interferogram.json", "sarmitsuba.files.read_image"),
        ("import {out}/a.ply -o {out}/b.xml", "b.xml", "sarmitsuba.loading.importing.convert.find_source"),
        ("scenes --copy plate {out}", "plate.xml", "shutil.copyfile"),
    ],
)  # fmt: skip
def test_files_of_others_are_refused_before_any_work(
    command: str, name: str, work: str, tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(work, None)
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / name).write_text("mine")
    assert cli.main(command.format(out=tmp_path).split()) == 2
    assert name in one_line(capsys) and (tmp_path / name).read_text() == "mine"


def test_a_picture_that_the_user_names_is_replaced_by_force_and_a_result_stays_one(
    fake_stages: dict[str, Any], tmp_path: Path, capsys: Any
) -> None:
    out, mine = tmp_path / "out", tmp_path / "mine.png"
    assert render(out) == 0
    draw = ["picture", str(out), "--quiet", "-o"]
    assert cli.main([*draw, str(mine)]) == 0
    before = mine.read_bytes()
    assert cli.main([*draw, str(mine), "--title", "another"]) == 2
    assert "already exists; choose another -o, or --force replaces it" in one_line(capsys)
    assert mine.read_bytes() == before and {p.name for p in tmp_path.iterdir()} == {"out", "mine.png"}
    assert cli.main([*draw, str(mine), "--title", "another", "--force"]) == 0
    assert mine.read_bytes() != before
    # in a folder of results: the list goes on knowing it, and the next run replaces it
    assert cli.main([*draw, str(out / "quicklook.png"), "--title", "another"]) == 0
    size = (out / "quicklook.png").stat().st_size
    assert json.loads((out / MANIFEST).read_text())["files"]["quicklook.png"] == size
    assert render(out, "--window", "hamming") == 0


@pytest.mark.parametrize(
    "command",
    [
        f"render {LONG}.xml -o o",
        f"render plate -o {LONG}",
        f"render plate -o o --radar {LONGER}",
        f"focus {LONGER}.h5 -o o",
        f"view {LONGER}",
        f"view {LONG}",
        f"picture {LONGER}",
        f"quality {LONG}",
        f"polarimetry {LONG}.h5",
        f"interferogram {LONGER} {LONG}",
        f"rcs {LONG}.ply",
        f"cost plate -o {LONG}",
        f"scenes --copy plate {LONG}",
        f"scenes --copy {LONGER} o",
        f"import {LONGER}.ply -o a.xml",
        f"import a.ply -o {LONG}.xml",
        f"validate --case slab_kernel -o {LONG}",
        f"--extension {LONGER} doctor",
    ],
)
def test_names_that_are_too_long_are_one_line(
    command: str, tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(command.split()) == 2
    assert LONG[:40] in (line := one_line(capsys)) or LONGER[:40] in line or "a.ply" in line
    assert list(tmp_path.iterdir()) == []


def test_a_record_with_names_that_are_too_long_is_one_line(tmp_path: Path) -> None:
    from sarmitsuba.view.page.run_folder import _scene

    with pytest.raises(DataError, match="does not exist any more"):
        _scene({"scene": LONGER, "definitions": {}}, tmp_path, False)


def test_whatever_else_the_system_refuses_is_one_line(
    capsys: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def refuse(*_: Any) -> None:
        (tmp_path / LONG).stat()

    monkeypatch.setattr("sarmitsuba.commands.scenes.copy_scene", refuse)
    assert cli.main(["scenes", "--copy", "plate", str(tmp_path)]) == 2
    assert "the name is longer than the system allows" in one_line(capsys)
