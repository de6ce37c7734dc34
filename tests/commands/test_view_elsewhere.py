"""Results name their scene so that it is found from every working folder, and so that a changed one is said."""

import json
import shutil
from pathlib import Path

import pytest

from sarmitsuba import cli
from sarmitsuba.loading.kept_paths import found_path, kept_path
from sarmitsuba.loading.library import resolve, resolve_radar

BOX = (
    '<scene version="3.0.0"><sensor type="sar_antenna"><integer name="n_pulses" value="16"/>'
    '<float name="prf" value="30"/><film type="range_film"/></sensor>'
    '<shape type="cube" id="{name}"><bsdf type="radar_material"><string name="material" value="{material}"/>'
    "</bsdf></shape></scene>"
)


def write(folder: Path, name: str, material: str = "concrete") -> None:
    folder.mkdir(exist_ok=True)
    (folder / "mine.xml").write_text(BOX.format(name=name, material=material))


def shapes_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def test_a_page_made_in_another_folder_shows_the_runs_own_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "a", "chapel")
    write(tmp_path / "b", "tavern")  # of the same file name
    monkeypatch.chdir(tmp_path / "a")
    assert (
        cli.main(["render", "mine.xml", "-o", "run", "--radar", "airborne_x", "--quiet", "--no-chart"]) == 0
    )
    record = json.loads(Path("run/parameters.json").read_text())
    assert (record["scene"], record["radar_file"]) == ("../mine.xml", "airborne_x")
    assert cli.main(["focus", "run/raw.h5", "-o", "again", "--quiet", "--no-chart"]) == 0
    monkeypatch.chdir(tmp_path / "b")
    for folder in ("../a/run", "../a/again"):
        assert cli.main(["view", folder]) == 0
        page = shapes_of(Path(folder) / "page.html")
        assert "chapel" in page and "tavern" not in page
    assert "other shapes or materials" not in capsys.readouterr().err

    # together they may move
    shutil.copytree(tmp_path / "a", tmp_path / "c")
    shutil.rmtree(tmp_path / "a")
    assert cli.main(["view", "../c/run"]) == 0
    write(tmp_path / "c", "chapel", "wood")
    assert cli.main(["view", "../c/run"]) == 0
    assert (
        "mine.xml holds other shapes or materials than when these results were made"
        in capsys.readouterr().err
    )
    (tmp_path / "c" / "mine.xml").unlink()
    assert cli.main(["view", "../c/run"]) == 2
    assert "the scene of these results does not exist any more" in capsys.readouterr().err


def test_files_are_found_again_from_the_records_folder(tmp_path: Path) -> None:
    for place in ("run/mine.xml", "mine", "run/mine", "deep/er/mine.xml"):
        file = tmp_path / place
        assert found_path(kept_path(file, tmp_path / "run"), tmp_path / "run") == file
    assert found_path(kept_path(resolve("tower"), tmp_path), tmp_path) == resolve("tower")
    radar = resolve_radar("airborne_x")
    assert found_path(kept_path(radar, tmp_path), tmp_path, radar=True) == radar
