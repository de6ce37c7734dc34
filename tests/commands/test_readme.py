"""The commands of the README and of the page on running, run from top to bottom."""

import json
import os
import re
import shlex
import sys
from pathlib import Path

import pytest
import trimesh

from sarmitsuba import cli

ROOT = Path(__file__).parents[2]
# a city of the user's own: Mitsuba's XML without a radar, and a mesh
CITY = """<scene version="3.0.0">
    <bsdf type="itu-radio-material" id="walls"><string name="type" value="concrete"/></bsdf>
    <shape type="rectangle" id="ground">
        <transform name="to_world"><scale x="30" y="30"/></transform><ref id="walls"/></shape>
    <shape type="cube" id="house">
        <transform name="to_world"><scale x="6" y="8" z="5"/><translate z="5"/></transform><ref id="walls"/></shape>
</scene>"""


PAGES = ("README.md", "docs/running.md")


def commands(page: str) -> list[str]:
    """Lines of a page's shell blocks that run the program."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return [
        line.partition("#")[0].strip()
        for block in re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
        for line in block.splitlines()
        if line.startswith("python -m sarmitsuba ")
    ]


# what Blender's exporter writes: y up, a camera, two-sided principled materials, ids of its own
STREET = """<scene version="3.0.0">
    <integrator type="path"/><emitter type="constant"/><sensor type="perspective"/>
    <bsdf type="twosided" id="mat-brick">
        <bsdf type="principled"><rgb name="base_color" value="0.6 0.3 0.2"/></bsdf></bsdf>
    <shape type="rectangle" id="elm__0">
        <transform name="to_world"><scale x="30" y="30"/><rotate x="1" angle="-90"/></transform>
        <ref id="mat-brick"/></shape>
    <shape type="cube" id="elm__1"><transform name="to_world"><scale x="6" y="5" z="8"/><translate y="5"/></transform>
        <ref id="mat-brick"/></shape>
</scene>"""


def own_files(folder: Path) -> None:
    (folder / "city.xml").write_text(CITY)
    (folder / "street.xml").write_text(STREET)
    house = trimesh.creation.box(extents=(8.0, 10.0, 6.0))
    house.apply_translation([0.0, 0.0, 3.0])
    ground = trimesh.creation.box(extents=(30.0, 30.0, 6.0))  # no thin sides, which take many rays
    ground.apply_translation([0.0, 0.0, -3.0])
    scene = trimesh.Scene({"concrete": house, "medium_dry_ground": ground})
    scene.apply_transform(
        trimesh.transformations.rotation_matrix(-1.5707963267948966, [1.0, 0.0, 0.0])
    )  # glTF: y up
    scene.export(folder / "city.glb")
    ring = [[11.575, 48.137], [11.5752, 48.137], [11.5752, 48.1371], [11.575, 48.137]]
    house_on_a_map = {"type": "Polygon", "coordinates": [ring]}
    row = {"type": "Feature", "properties": {"building": "yes", "height": 9}, "geometry": house_on_a_map}
    (folder / "city.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [row]}))


def run_as_notebook(cells: list[str], folder: Path) -> None:
    nbformat = pytest.importorskip("nbformat", reason="runs notebooks; in the test extra")
    nbclient = pytest.importorskip("nbclient", reason="runs notebooks; in the test extra")
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    os.environ.setdefault("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    client = nbclient.NotebookClient(book, resources={"metadata": {"path": str(folder)}})
    client.execute()


def shell_cell(line: str) -> str:
    """A command as IPython runs it, with this interpreter, and an error where it fails.

    Of a data set only two samples, where its recipe has thousands.
    """
    words = line.replace("python -m", f"{sys.executable} -m", 1)
    if line.split()[3] == "dataset":
        words += " --sample 0 --sample 1"
    return f"!{words}\nassert _exit_code == 0, _exit_code"


QUICK = ("scenes", "render city.glb", "render street.xml", "picture", "import")


def test_readme_is_short() -> None:
    """A newcomer reads one page: a sentence, two pictures, thirteen commands; everything else is in docs."""
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 95
    thirteen = [line for line in commands("README.md") if not line.endswith("doctor")]
    assert len(thirteen) == 13
    assert {line.split()[3] for line in thirteen} <= {line.split()[3] for line in commands("docs/running.md")}


def test_quick_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands that take seconds, in this process: starting one takes longer."""
    own_files(tmp_path)
    monkeypatch.chdir(tmp_path)
    lines = dict.fromkeys(line for page in PAGES for line in commands(page))
    quick = [line.removeprefix("python -m sarmitsuba ") for line in lines]
    quick = [line for line in quick if line.startswith(QUICK)]
    assert len(quick) >= 4
    for line in quick:
        assert cli.main(shlex.split(line)) == 0, line
    for name in ("mesh", "street"):
        assert (tmp_path / "out" / name / "quicklook.png").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_all_commands(page: str, tmp_path: Path) -> None:
    """The same from top to bottom as a notebook."""
    own_files(tmp_path)
    # tests/files/test_phase_histories.py and test_chirped_echoes.py have such files
    ours = [line for line in commands(page) if "gotcha/" not in line and "radarsat.toml" not in line]
    assert len(ours) >= 11
    run_as_notebook([shell_cell(line) for line in ours], tmp_path)
