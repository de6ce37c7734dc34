"""The documented commands on shipped scenes and on broken ones, from the file to the picture."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import OpenEXR
import pytest

from sarmitsuba import cli
from sarmitsuba.files import read_image, read_raw
from sarmitsuba.loading.library import scenes_dir
from sarmitsuba.loading.load import load_scene
from sarmitsuba.simulation.execution.fingerprint import fingerprint

RESULTS = {
    "accuracy.png",
    "raw.h5",
    "image.h5",
    "image.exr",
    "quicklook.png",
    "parameters.json",
    ".sarmitsuba.json",
}


def render(scene: str, out: Path, *options: str) -> Path:
    assert cli.main(["render", scene, "-o", str(out), "--quiet", *options]) == 0
    return out


def difference_db(a: Any, b: Any) -> float:
    return float(20 * np.log10(np.linalg.norm(a - b) / np.linalg.norm(b) + 1e-30))


@pytest.fixture(scope="module")
def point(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return render("point", tmp_path_factory.mktemp("point") / "out", "--seed", "5")


def test_point_target_ends_up_where_it_is_with_its_rcs(point: Path) -> None:
    assert {p.name for p in point.iterdir()} == RESULTS
    image = read_image(point / "image.h5")
    power = image.rcs()
    row, column = np.unravel_index(power.argmax(), power.shape)
    assert abs(image.grid.azimuth[row]) <= 0.5 * image.grid.azimuth_spacing
    assert abs(image.grid.range[column] - 10_000.0) <= 0.5 * image.grid.range_spacing
    # tol: 0.05 dB, gridding kernels and interpolation
    assert 10 * np.log10(power.max()) == pytest.approx(0.0, abs=0.05)
    record = json.loads((point / "parameters.json").read_text())
    assert record["seed"] == 5
    assert record["seconds"]["total"] > 0


def test_raw_data_alone_focus_to_the_same_image_without_mitsuba(point: Path, tmp_path: Path) -> None:
    code = f"""
import sys
from sarmitsuba import cli
status = cli.main(["focus", {str(point / "raw.h5")!r}, "-o", {str(tmp_path)!r}, "--quiet"])
unused = ("mitsuba", "scipy.linalg", "scipy.ndimage", "scipy.optimize", "scipy.sparse", "trimesh")
print(status, [name for name in unused if name in sys.modules])
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.stdout.strip() == "0 []", run.stderr
    again, image = read_image(tmp_path / "image.h5"), read_image(point / "image.h5")
    np.testing.assert_array_equal(again.grid.positions(), image.grid.positions())
    np.testing.assert_array_equal(again.data, image.data)


def test_the_command_line_overrides_the_image_request(point: Path, tmp_path: Path) -> None:
    options = ("--grid", "ground", "--center", "-2", "3", "--extent", "20", "10", "--spacing", "0.5", "0")
    assert cli.main(["focus", str(point / "raw.h5"), "-o", str(tmp_path), "--quiet", *options]) == 0
    grid = read_image(tmp_path / "image.h5").grid
    assert grid.kind == "ground" and grid.azimuth_spacing == 0.5
    np.testing.assert_allclose(grid.origin[:2], [-2.0, 3.0])
    assert np.ptp(grid.azimuth) == 20.0 and 10.0 <= np.ptp(grid.range) <= 11.0
    record = json.loads((tmp_path / "parameters.json").read_text())
    assert record["image_request"]["extent_range"] == 10.0


def test_focusers_and_windows_that_do_not_exist_are_refused_at_once(tmp_path: Path, capsys: Any) -> None:
    for wrong, reason in (
        (("--focuser", "polar"), "focuser 'polar' is unknown"),
        (("--focuser", "backprojection,width=3"), "option 'width' is unknown"),
        (("--window", "taylor:4:35"), "level_db must be"),
    ):
        assert cli.main(["render", "no_such_scene", "-o", str(tmp_path / "o"), *wrong]) == 2
        assert reason in capsys.readouterr().err


def test_chirped_echoes_compress_to_the_same_image(point: Path, tmp_path: Path) -> None:
    chirped = render("point", tmp_path / "chirped", "--seed", "5", "--raw", "chirped")
    raw = read_raw(chirped / "raw.h5")
    assert raw.domain == "chirped"
    assert raw.data.shape[2] > read_raw(point / "raw.h5").data.shape[2]
    image = read_image(chirped / "image.h5")
    # tol: the receive window cuts the profile's sinc tails and the pulse smears the cut over its length
    assert difference_db(image.data, read_image(point / "image.h5").data) < -40.0


def test_omega_k_from_the_command_line(point: Path, tmp_path: Path) -> None:
    arguments = ["focus", str(point / "raw.h5"), "-o", str(tmp_path), "--focuser", "omega_k", "--quiet"]
    assert cli.main(arguments) == 0
    # tol: 0.1 dB, Stolt interpolation
    assert 10 * np.log10(read_image(tmp_path / "image.h5").rcs().max()) == pytest.approx(0.0, abs=0.1)


def test_the_same_seed_gives_the_same_result(tmp_path: Path) -> None:
    first = read_raw(render("flat_ground", tmp_path / "a", "--seed", "1", "--no-focus") / "raw.h5")
    second = read_raw(render("flat_ground", tmp_path / "b", "--seed", "1", "--no-focus") / "raw.h5")
    other = read_raw(render("flat_ground", tmp_path / "c", "--seed", "2", "--no-focus") / "raw.h5")
    # tol: threads add contributions in any order, float32 rounding
    assert difference_db(second.data, first.data) < -100.0
    assert difference_db(other.data, first.data) > -3.0  # another random surface


def test_every_channel_has_a_picture(tmp_path: Path) -> None:
    out = render("dihedral", tmp_path / "out", "-D", "polarisation=HH,VV")
    assert {p.name for p in out.iterdir()} == RESULTS | {"quicklook_VV.png"}


@pytest.mark.parametrize("method", ["image", "raster"])
def test_methods_without_raw_data(tmp_path: Path, capsys: Any, method: str) -> None:
    out = render("dihedral", tmp_path / "out", "--method", method, "-D", "polarisation=VV")
    assert {p.name for p in out.iterdir()} == RESULTS - {"raw.h5"}
    assert json.loads((out / "parameters.json").read_text())["settings"]["method"] == method
    assert cli.main(["render", "dihedral", "-o", str(tmp_path / "o"), "--method", method, "--no-focus"]) == 2
    assert "makes an image without raw data" in capsys.readouterr().err


def test_a_folder_of_results_does_not_hide_a_shipped_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["render", "point", "-o", "point", "--no-focus"]) == 0
    assert cli.main(["render", "point", "-o", "point"]) == 0
    assert "used again" in capsys.readouterr().out
    # a file of the user's own is taken in its stead, and that is said
    text = (scenes_dir() / "point.xml").read_text(encoding="utf-8")
    Path("point.xml").write_text(text.replace('name="rcs_dbsm" value="0"', 'name="rcs_dbsm" value="20"'))
    assert cli.main(["render", "point", "-o", "own"]) == 0
    (line,) = (line for line in capsys.readouterr().err.splitlines() if "point.xml" in line)
    assert (
        line
        == "warning: point: the file point.xml in this folder is used, not the shipped scene of that name"
    )
    # tol: 0.05 dB, gridding kernels and interpolation
    assert 10 * np.log10(read_image("own/image.h5").rcs().max()) == pytest.approx(20.0, abs=0.05)


def test_focusing_saved_data_gives_the_same_error_bars(tmp_path: Path) -> None:
    out = render("flat_ground", tmp_path / "out")
    assert cli.main(["focus", str(out / "raw.h5"), "-o", str(tmp_path / "again"), "--quiet"]) == 0
    first, again = (
        json.loads((folder / "parameters.json").read_text())["sampling_error"]
        for folder in (out, tmp_path / "again")
    )
    assert first == again and set(first) == {"VV"}
    # the image itself, whatever the subsets are
    with h5py.File(out / "image.h5") as file:
        whole = file["image/VV"][()]
        parts = [file[f"subsets/{s}/image/VV"][()] for s in (1, 2)]
    np.testing.assert_allclose(sum(parts), whole, rtol=0, atol=1e-6 * np.abs(whole).max())  # tol: float32
    np.testing.assert_array_equal(whole, read_image(out / "image.h5").total("VV"))


FAR = np.array([456789.25, 5600123.5, 512.0])
FAR_SCENE = """<scene version="3.0.0">
  <integrator type="sar_path"><string name="method" value="{method}"/></integrator>
  <sensor type="sar_antenna">
    <float name="slant_range" value="10000"/> <float name="look_angle_deg" value="45"/>
    <float name="heading_deg" value="30"/> <float name="bandwidth" value="300e6"/>
    <float name="azimuth_resolution" value="0.5"/>
    <float name="aim_x" value="{x}"/> <float name="aim_y" value="{y}"/> <float name="aim_z" value="{z}"/>
    <film type="range_film">
      <string name="image_grid" value="{grid}"/>
      <float name="image_extent_azimuth" value="40"/> <float name="image_extent_range" value="40"/>
    </film>
  </sensor>
  <shape type="sphere">
    <point name="center" x="{px}" y="{py}" z="{z}"/> <bsdf type="point_scatterer"/>
  </shape>
</scene>
"""


def brightest(path: Path) -> Any:
    """Where the brightest pixel of an image file stands, by nothing but the layout in docs/files.md."""
    if path.suffix == ".exr":
        with OpenEXR.File(str(path), separate_channels=True) as file:
            header = dict(file.header())
            power = np.hypot(*(file.channels()[f"VV.{part}"].pixels for part in ("re", "im")))
        row, column = np.unravel_index(power.argmax(), power.shape)
        a, r = (header[name] @ [1, i] for name, i in (("row_azimuth_m", row), ("column_range_m", column)))
        kind, along, across = header["grid"], header["along"], header["across"]
        origin, plane = header["origin_m"], header["image_plane_origin_m"]
    else:
        with h5py.File(path) as file:
            power = np.abs(file["image/VV"][()])
            grid = {name: file[f"grid/{name}"][()] for name in file["grid"]}
            kind = file["grid"].attrs["kind"]
        row, column = np.unravel_index(power.argmax(), power.shape)
        a, r, along, across = grid["azimuth"][row], grid["range"][column], grid["along"], grid["across"]
        origin, plane = grid["origin"], np.array([*grid["origin"][:2], grid["height"]])
    g = r if kind == "ground" else np.sqrt(r**2 - (origin - plane)[2] ** 2)
    return plane + a * along + g * across


@pytest.mark.parametrize(("method", "grid"), [("hybrid", "slant"), ("hybrid", "ground"), ("image", "slant")])
def test_files_are_in_the_frame_of_the_scene_file(tmp_path: Path, method: str, grid: str) -> None:
    point = FAR + np.array([6.0, -4.0, 0.0])
    values = dict(zip("xyz", FAR, strict=True)) | {"px": point[0], "py": point[1], "method": method}
    (tmp_path / "far.xml").write_text(FAR_SCENE.format(**values, grid=grid))
    out = render(str(tmp_path / "far.xml"), tmp_path / "out")
    # tol: 0.4 m, half the diagonal of a pixel on the ground
    for name in ("image.h5", "image.exr"):
        assert np.linalg.norm(brightest(out / name) - point) < 0.4
    record = json.loads((out / "parameters.json").read_text())
    np.testing.assert_allclose(record["radar"]["aim_point_m"], FAR, rtol=0, atol=1e-8)  # tol: float64
    assert record["radar"]["anchor"] == {"latitude_deg": 0.0, "longitude_deg": 0.0, "height_m": 0.0}
    asked = record["image_request"]
    np.testing.assert_allclose([asked["center_x"], asked["center_y"], asked["height"]], FAR, atol=1e-8)
    if method == "image":
        return
    with h5py.File(out / "raw.h5") as file:
        np.testing.assert_allclose(file["radar/aim_point"][()], FAR, rtol=0, atol=1e-8)  # tol: float64
        middle = file["track/position"][()].mean(axis=0)
    assert np.linalg.norm(middle - FAR) == pytest.approx(10e3, abs=1.0)  # tol: sampling of the track
    # what is asked of `focus` is in that frame too
    center = [f"{v:.3f}" for v in point[:2]]
    options = ("--center", *center, "--extent", "4", "4", "--quiet")
    assert cli.main(["focus", str(out / "raw.h5"), "-o", str(tmp_path / "again"), *options]) == 0
    assert np.linalg.norm(brightest(tmp_path / "again" / "image.h5") - point) < 0.4
    image = read_image(tmp_path / "again" / "image.h5")
    # tol: 0.1 dB, half a pixel off
    assert 10 * np.log10(image.rcs().max()) == pytest.approx(0.0, abs=0.1)


def test_a_fingerprint_is_the_same_in_every_process_and_sees_every_setting(tmp_path: Path) -> None:
    code = """
import sys
from sarmitsuba.loading.load import load_scene
from sarmitsuba.simulation.execution.fingerprint import fingerprint
print(fingerprint(load_scene("dihedral"), [sys.argv[1]]))
"""
    extension = tmp_path / "mine.py"

    def mark(text: str = "a = 1", **parameters: str) -> str:
        extension.write_text(text)
        return fingerprint(load_scene("dihedral", parameters=parameters), [str(extension)])

    first = mark()
    # a process of its own hashes strings and orders sets in its own way
    command = [sys.executable, "-c", code, str(extension)]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip() == first
    marks = {
        first,
        mark(look_angle_deg="40"),
        mark(**{"sar_path.seed": "4"}),
        mark(**{"sar_path.visibility": "off"}),
        mark(**{"range_film.image_extent_range": "31"}),
        mark("a = 2"),
    }
    assert len(marks) == 6


SCENE = """<scene version="3.0.0">
  <integrator type="sar_path"/>
  <sensor type="sar_antenna">
    <float name="slant_range" value="10000"/> <float name="look_angle_deg" value="45"/>
    <float name="center_frequency" value="9.65e9"/> <float name="bandwidth" value="300e6"/>
    <float name="azimuth_resolution" value="5"/> {sensor}
    <film type="range_film">{film}</film>
  </sensor>
  {shape}
</scene>
"""
AWAY = """<float name="image_center_x" value="900"/> <float name="image_extent_range" value="20"/>
    <float name="image_extent_azimuth" value="20"/>"""
BOX = '<shape type="cube"><bsdf type="radar_material"><string name="material" value="pec"/></bsdf></shape>'


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("<scene", "scene.xml"),
        (SCENE.format(sensor='<float name="bandwith" value="1"/>', film="", shape=BOX), "bandwith"),
        (SCENE.format(sensor='<float name="speed" value="fast"/>', film="", shape=BOX), "fast"),
        (SCENE.format(sensor='<float name="losses_db" value="-3"/>', film="", shape=BOX), "losses_db"),
        (
            SCENE.format(
                sensor="", film="", shape='<shape type="ply"><string name="filename" value="no.ply"/></shape>'
            ),
            "no.ply",
        ),
        (SCENE.format(sensor="", film="", shape=""), "scene.xml"),
        (SCENE.format(sensor="", film=AWAY, shape=BOX), "image"),
    ],
    ids=[
        "malformed",
        "unknown parameter",
        "not a number",
        "out of bounds",
        "missing mesh",
        "empty",
        "nothing in the image",
    ],
)
def test_bad_scenes_get_one_line(tmp_path: Path, capsys: Any, text: str, expected: str) -> None:
    (tmp_path / "scene.xml").write_text(text)
    command = ["render", str(tmp_path / "scene.xml"), "-o", str(tmp_path / "out"), "--quiet"]
    assert cli.main(command) == 2
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert line.startswith("error: ") and expected in line
    assert not (tmp_path / "out").exists()


def test_a_process_says_one_line_too_and_fails(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text(
        SCENE.format(sensor='<float name="bandwith" value="1"/>', film="", shape=BOX)
    )
    paths = [str(tmp_path / "scene.xml"), "-o", str(tmp_path / "out")]
    command = [sys.executable, "-m", "sarmitsuba", "render", *paths, "--quiet"]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.returncode == 2, run.stderr
    assert run.stdout == ""
    (line,) = run.stderr.splitlines()
    assert line.startswith("error: ") and "bandwith" in line


def test_unknown_names_suggest_the_right_one(tmp_path: Path, capsys: Any) -> None:
    assert cli.main(["render", "dihedrall", "-o", str(tmp_path / "o")]) == 2
    assert "dihedral" in capsys.readouterr().err
    assert cli.main(["render", "dihedral", "-o", str(tmp_path / "o"), "--radar", "airborne"]) == 2
    assert "airborne_x" in capsys.readouterr().err
    assert cli.main(["render", "dihedral", "-o", str(tmp_path / "o"), "-D", "heigth=3"]) == 2
    assert "heigth" in capsys.readouterr().err


def test_radar_is_put_over_another_scene(tmp_path: Path) -> None:
    text = f'<scene version="3.0.0">{BOX}</scene>'
    (tmp_path / "mine.xml").write_text(text)
    options = ("--radar", "airborne_x", "--no-focus")
    out = render(str(tmp_path / "mine.xml"), tmp_path / "out", *options)
    record = json.loads((out / "parameters.json").read_text())
    assert record["radar"]["center_frequency_hz"] > 8e9
