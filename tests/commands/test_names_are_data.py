"""A scene's name is data: it ends no run, whatever is in it; a picture that fails costs a warning."""

import ast
import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import matplotlib.image
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

import sarmitsuba
from sarmitsuba import cli
from sarmitsuba.loading.build import build_scene
from sarmitsuba.scene.geometry import PointTarget

SCENE = """<scene version="3.0.0">
  <integrator type="sar_path"/>
  <sensor type="sar_antenna">
    <float name="slant_range" value="3000"/>
    <float name="bandwidth" value="100e6"/>
    <float name="azimuth_resolution" value="1.5"/>
    <film type="range_film">
      <float name="image_extent_azimuth" value="20"/>
      <float name="image_extent_range" value="20"/>
    </film>
  </sensor>
  <shape type="sphere" id="aim"><bsdf type="point_scatterer"/></shape>
</scene>
"""
NAMES = [
    "cost $100 and $5",
    "$\\frac{a}{",
    "a$^$b",
    "<script>alert('1')<&amp;",
    "\x1b[31m\x07\x7f red",
    '100 %s {0} "quoted" \\n',
    "Überländ 城 \u202e ",
    "_" + "x" * 120,
]


@pytest.mark.parametrize(
    "name", [NAMES[0], *(pytest.param(name, marks=pytest.mark.slow) for name in NAMES[1:])]
)
@pytest.mark.filterwarnings("ignore:Glyph")  # that a font lacks
def test_a_run_ends_well_whatever_the_scene_is_called(name: str, tmp_path: Path, capsys: Any) -> None:
    scene, out = tmp_path / f"{name}.xml", tmp_path / "out"
    scene.write_text(SCENE)
    formats = "hdf5,openexr,geojson,kml"
    assert cli.main(["render", str(scene), "-o", str(out), "--format", formats]) == 0
    assert "Traceback" not in capsys.readouterr().err
    record = json.loads((out / "parameters.json").read_text())
    shown = record["simulation"]["scene"]
    assert shown.isprintable()
    (warning,) = record["warnings"]
    assert warning.startswith("the scene has no place on the Earth")
    assert shown == name or not name.isprintable() or name != name.strip()
    assert matplotlib.image.imread(out / "quicklook.png").ndim == 3
    assert ElementTree.parse(out / "image.kml").find(".//{*}name").text == shown
    assert json.loads((out / "image.geojson").read_text())["properties"]["name"] == shown
    figure = sarmitsuba.read_image(out / "image.h5").plot()
    assert isinstance(figure, Figure)
    titles = [text for text in figure.findobj(Text) if text.get_text().split("\n")[0] == shown]
    assert titles and not any(text.get_parse_math() for text in titles)


def test_names_given_in_python_are_cleaned_likewise() -> None:
    scene = build_scene(points=[PointTarget("p", (0.0, 0.0, 0.0))], name="a\nb\ud800\x00c")
    assert scene.name == "a?b??c"


def test_a_picture_that_fails_costs_a_warning(
    tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is dear is written before: raw data, image and parameters."""
    (tmp_path / "a.xml").write_text(SCENE)
    there: list[set[str]] = []

    def fails(*args: object, **kept: object) -> Figure:
        there.append({path.name for path in (tmp_path / "out").iterdir()})
        raise ValueError("a glyph\nis missing")

    monkeypatch.setattr("sarmitsuba.view.quicklook.quicklook", fails)
    assert cli.main(["render", str(tmp_path / "a.xml"), "-o", str(tmp_path / "out")]) == 0
    assert there and {"raw.h5", "image.h5", "image.exr", "parameters.json"} <= there[0]
    lines = capsys.readouterr().err.splitlines()
    (line,) = [line for line in lines if line.startswith("warning")]
    assert "quicklook.png: the picture could not be drawn (a glyph is missing)" in line
    assert not (tmp_path / "out" / "quicklook.png").exists()
    record = json.loads((tmp_path / "out" / "parameters.json").read_text())
    assert len(record["warnings"]) == 1


def test_no_text_of_data_is_read_as_mathematics() -> None:
    """Every title and remark of a picture that is not a constant says so."""
    folder = Path(sarmitsuba.__file__).parent / "view"
    calls = 0
    for path in sorted(folder.glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
                continue
            if node.func.attr not in ("set_title", "suptitle", "annotate", "text"):
                continue
            if all(isinstance(a, ast.Constant) for a in node.args):
                continue
            calls += 1
            given = {key.arg: key.value for key in node.keywords}
            plain = given.get("parse_math")
            assert isinstance(plain, ast.Constant) and plain.value is False, f"{path.name}:{node.lineno}"
    assert calls > 10
