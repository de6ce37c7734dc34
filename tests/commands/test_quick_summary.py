"""`explain --quick` shows a scene without importing what plans and traces; one default window everywhere."""

import argparse
import inspect
import json
import subprocess
import sys

import numpy as np
import pytest
import scipy

import sarmitsuba
from sarmitsuba import cli
from sarmitsuba.commands import focus, link, rcs, render
from sarmitsuba.radar.swath import fast_length

HEAVY = (
    "sarmitsuba.simulation",
    "sarmitsuba.tracing.kernel",
    "sarmitsuba.signal.focusing",
    "matplotlib",
    "trimesh",
)
SCIPY = ("scipy.special", "scipy.fft", "scipy.sparse", "scipy.optimize", "scipy.ndimage", "scipy.linalg")


def test_a_quick_summary_imports_neither_planning_nor_tracing() -> None:
    code = f"""
import sys
from sarmitsuba import cli
status = cli.main(["explain", "tower", "--quick"])
print(status, sorted(name for name in sys.modules if name in {SCIPY!r} or name.startswith({HEAVY!r})))
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    lines = run.stdout.strip().splitlines()
    assert lines[-1] == "0 []", run.stderr
    assert "14 faces in 3 meshes" in run.stdout and "1407 pulses" in run.stdout and "9.65 GHz" in run.stdout


def test_a_quick_summary_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["explain", "sphere", "--quick", "--json", "--ground", "soil"]) == 0
    facts = json.loads(capsys.readouterr().out)
    scene = sarmitsuba.load_scene("sphere", ground="soil")
    assert facts["faces"] == scene.geometry.n_faces and facts["notes"] == list(scene.notes)
    assert facts["pulses"] == scene.radar.track.n_pulses and facts["meshes"] == 2
    assert cli.main(["explain", "sphere", "--quick", "--workers", "2"]) == 2
    assert "leave --workers out" in capsys.readouterr().err


@pytest.mark.parametrize("first", [1, 1021, 65521, 99999989])
def test_fast_lengths_are_those_of_scipy(first: int) -> None:
    for n in range(first, first + 300):
        assert fast_length(n) == scipy.fft.next_fast_len(n)


def test_the_default_window_is_one() -> None:
    parsers = {}
    for command in (focus, render, link, rcs):
        parser = argparse.ArgumentParser()
        command.add_arguments(parser)
        parsers[command.NAME] = parser.get_default("window")
    for function in (sarmitsuba.focus, sarmitsuba.render, sarmitsuba.refine, sarmitsuba.link_budget):
        names = ("range_window", "azimuth_window")
        parsers |= {
            f"{function.__name__} {n}": inspect.signature(function).parameters[n].default for n in names
        }
    assert set(parsers.values()) == {"taylor"}, parsers


def test_python_and_the_command_line_make_the_same_image(tmp_path: pytest.TempPathFactory) -> None:
    raw = sarmitsuba.simulate(sarmitsuba.load_scene("point"), seed=3)
    sarmitsuba.write_raw(raw, f"{tmp_path}/raw.h5")
    assert cli.main(["focus", f"{tmp_path}/raw.h5", "-o", f"{tmp_path}/out", "--quiet"]) == 0
    image, own = sarmitsuba.read_image(f"{tmp_path}/out/image.h5"), sarmitsuba.focus(raw)
    np.testing.assert_array_equal(image.data, own.data)
