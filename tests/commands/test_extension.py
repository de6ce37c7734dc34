"""``--extension``: a user's file adds a radar mode, and a scene file uses it."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from sarmitsuba.cli import EXIT_OK, EXIT_USER, main

MODE = """
from sarmitsuba.core.parameters import Param
from sarmitsuba.radar.mode import MODES
from sarmitsuba.radar.modes.stripmap import Stripmap

class Wobbling(Stripmap):
    name = "wobbling"
    doc = "fixed to the track"
    parameters = (Param("wobble_deg", "float", 0.0, "of the beam", "deg", 0.0, 5.0),)

    def boresight(self, track, axes, geometry, values):
        print("wobble", values["wobble_deg"])
        return super().boresight(track, axes, geometry, values)

MODES.register(Wobbling())
"""
SCENE = """<scene version="3.0.0"><integrator type="sar_path"/><sensor type="sar_antenna">
<string name="mode" value="{mode}"/><float name="wobble_deg" value="{wobble}"/></sensor>
<shape type="cube"><bsdf type="radar_material"><string name="material" value="pec"/></bsdf></shape></scene>"""


RUN = """
import sys
from pathlib import Path
from sarmitsuba.cli import main
extension, scene, text = sys.argv[1:]
for mode, wobble, arguments in (
    ("wobbling", 1.5, ["--extension", extension, "explain", scene, "--plan-only"]),
    ("wobbling", 1.5, ["explain", scene, "--plan-only", "--extension", extension]),
    ("wobbling", 7.0, ["--extension", extension, "explain", scene, "--plan-only"]),
    ("stripmap", 1.0, ["--extension", extension, "explain", scene, "--plan-only"]),
):
    Path(scene).write_text(text.format(mode=mode, wobble=wobble))
    print("status", main(arguments))
"""


def test_a_mode_from_a_file_is_used_by_a_scene(tmp_path: Path) -> None:
    extension = tmp_path / "wobbling.py"
    extension.write_text(MODE, encoding="utf-8")
    # in a process of its own, so that the mode is unknown to other tests
    run = subprocess.run(
        [sys.executable, "-c", RUN, str(extension), str(tmp_path / "scene.xml"), SCENE],
        capture_output=True,
        text=True,
        check=True,
    )
    assert re.findall(r"^(?:status|wobble) .*", run.stdout, re.MULTILINE) == [
        "wobble 1.5",
        "status 0",
        "wobble 1.5",
        "status 0",
        "status 2",
        "status 2",
    ]
    assert "wobble_deg = 7 deg is above the bound 5 deg" in run.stderr
    assert "wobble_deg has no effect with mode = stripmap; take mode = wobbling" in run.stderr


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "no such extension file"),
        ("import nowhere_to_be_found", "No module named"),
        ("1 +", "invalid"),
    ],
)
def test_an_extension_that_cannot_be_loaded_is_one_line(tmp_path: Path, capsys, text, message) -> None:
    path = tmp_path / "broken.py"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    assert main(["--extension", str(path), "scenes"]) == EXIT_USER
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_a_module_by_its_name(capsys) -> None:
    assert main(["--extension", "sarmitsuba.radar.modes.stripmap", "scenes"]) == EXIT_OK
    assert main(["--extension", "no.such.module", "scenes"]) == EXIT_USER
    assert "no.such.module: cannot be imported" in capsys.readouterr().err
