"""``render --labels`` and ``focus --labels``: the same labels, in every file."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import sarmitsuba
from sarmitsuba import cli

SMALL = ("--pixels", "24x31", "--no-error-bars", "--no-chart", "--format", "hdf5")
FILES = ("labels.h5", "labels.json", "labels.png", "labels_pixels.png", "labels_layover_shadow.png")


def test_render_and_focus_write_the_same_labels(tmp_path: Path, capsys: Any) -> None:
    out, again, named = (tmp_path / name for name in ("out", "again", "named"))
    assert cli.main(["render", "dihedral", "-o", str(out), "--labels", *SMALL]) == 0
    raw = str(out / "raw.h5")
    plain = ["--labels", "--no-chart", "--format", "hdf5"]
    assert cli.main(["focus", raw, "-o", str(again), *plain]) == 0
    assert cli.main(["focus", raw, "-o", str(named), "--scene", "dihedral", *plain, "--grid", "ground"]) == 0
    labels, other = (sarmitsuba.Labels.load(folder / "labels.h5") for folder in (out, again))
    assert labels.grid.shape == (24, 31)
    for name in labels.layers:
        np.testing.assert_array_equal(labels[name], other[name])
    assert sarmitsuba.Labels.load(named / "labels.h5").grid.kind == "ground"
    for name in FILES:
        assert (out / name).stat().st_size > 0
    with Image.open(out / "labels_layover_shadow.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture), labels["layover_shadow"])
    with Image.open(out / "labels_pixels.png") as picture:
        assert np.asarray(picture).shape == labels.grid.shape
    shapes = {entry["name"] for entry in json.loads((out / "labels.json").read_text())["annotations"]}
    own = labels["instance"][labels["instance_here"] != 0]
    assert shapes == {labels.layers["instance"].codes[int(code)] for code in np.unique(own) if code > 0}
    listed = json.loads((out / ".sarmitsuba.json").read_text())["files"]
    assert set(FILES) <= set(listed)


@pytest.mark.parametrize(
    "arguments, text",
    [
        (["--no-focus"], "are of the image, and --no-focus"),
        (
            [
                "-D",
                "sar_antenna.mode=circular",
                "-D",
                "sar_antenna.arc_deg=360",
                "-D",
                "azimuth_resolution=0",
            ],
            "opposite sides",
        ),
    ],
)
def test_what_has_no_labels_is_refused_before_the_run(
    tmp_path: Path, capsys: Any, arguments: list[str], text: str
) -> None:
    assert cli.main(["render", "dihedral", "-o", str(tmp_path / "out"), "--labels", *SMALL, *arguments]) != 0
    said = capsys.readouterr().err.strip().splitlines()
    assert text in said[-1]
    assert not (tmp_path / "out").exists()


def test_the_scene_of_other_data_is_refused(tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "out"
    assert cli.main(["render", "dihedral", "-o", str(out), "--no-focus", *SMALL[:3]]) == 0
    arguments = [
        "focus",
        str(out / "raw.h5"),
        "-o",
        str(tmp_path / "again"),
        "--labels",
        "--scene",
        "trihedral",
    ]
    assert cli.main(arguments) != 0
    assert "its radar has another track" in capsys.readouterr().err


def test_classes_of_a_table_are_a_layer_and_the_categories(tmp_path: Path, capsys: Any) -> None:
    table = tmp_path / "classes.toml"
    table.write_text('"wa*" = "corner"\n', encoding="utf-8")
    out = tmp_path / "out"
    arguments = ["render", "dihedral", "-o", str(out), "--labels", *SMALL, "--method", "image"]
    assert cli.main([*arguments, "--classes", str(table)]) == 0
    labels = sarmitsuba.Labels.load(out / "labels.h5")
    assert set(labels.layers["class"].codes.values()) == {"none", "corner", "no class"}
    assert (out / "labels_class.png").stat().st_size > 0
    assert {one.name: one.semantic_class for one in labels.instances}["wall"] == "corner"
    categories = json.loads((out / "labels.json").read_text())["categories"]
    assert [one["name"] for one in categories] == ["corner"]
    table.write_text('"building" = "building"\n', encoding="utf-8")
    assert cli.main([*arguments, "--classes", str(table), "--force"]) == 2
    assert 'the scene has no shape "building"' in capsys.readouterr().err
    assert cli.main([one for one in arguments if one != "--labels"] + ["--classes", str(table)]) == 2
    assert "add --labels" in capsys.readouterr().err
