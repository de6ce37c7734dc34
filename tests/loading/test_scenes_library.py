"""Shipped scenes: found by name, complete, well formed, their meshes what the build script makes."""

import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from sarmitsuba.core.errors import DataError, SarmitsubaWarning, SceneError
from sarmitsuba.files.table_file import read_table
from sarmitsuba.loading.library import list_radars, list_scenes, resolve, resolve_radar, scenes_dir
from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.mesh.cleaning import clean_mesh
from sarmitsuba.scene.mesh.formats import write_ply
from sarmitsuba.scene.mesh.tessellate import sphere
from scenes.city import city_mesh
from tests.support.city import make_city
from tests.support.scenes import shipped

WANTED = {
    "bridge",
    "buildings16",
    "car_park",
    "courtyard",
    "crane",
    "dihedral",
    "farm_yard",
    "fields",
    "flat_ground",
    "forest",
    "glass_house",
    "harbour",
    "harbour_quay",
    "land_cover",
    "moving_cars",
    "plate",
    "plate_edges",
    "point",
    "railing",
    "sphere",
    "street_trees",
    "tower",
    "trihedral",
    "trihedral_square",
    "urban_block",
    "urban_block_trees",
}
ENTRIES = [*list_scenes(), *list_radars()]


def test_every_scene_and_radar_is_listed():
    assert {s.name for s in list_scenes()} == WANTED
    assert {r.name for r in list_radars()} == {
        "airborne_ku",
        "airborne_l",
        "airborne_l_band",
        "airborne_x",
        "airborne_x_pod",
        "drone_ku",
        "iceye_spotlight",
        "radarsat2_scansar",
        "sentinel1_ew",
        "sentinel1_iw",
        "sentinel1_stripmap",
        "spaceborne_x",
        "terrasar_scansar",
        "terrasar_spotlight",
    }


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda e: e.name)
def test_entries_have_a_title_and_say_what_they_show(entry):
    assert 4 < len(entry.title) < 60
    assert len(entry.description) > 40
    assert not entry.title.endswith(".")
    assert all(len(line) < 121 for line in entry.path.read_text(encoding="utf-8").splitlines())


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda e: e.name)
def test_files_are_well_formed_and_their_meshes_and_materials_there(entry):
    root = ElementTree.parse(entry.path).getroot()
    assert root.tag == "scene"
    for include in root.findall("include"):  # a shipped radar
        assert include.get("filename") in {f"radars/{radar.name}.xml" for radar in list_radars()}
        root.extend(ElementTree.parse(entry.path.parent / include.get("filename")).getroot())
    assert len(root.findall("sensor")) == len(root.findall("integrator")) == 1
    for node in root.iter("string"):
        if node.get("name") == "filename":
            assert (entry.path.parent / node.get("value")).is_file()
    groups = root.findall("shape[@type='shapegroup']")
    ids = {b.get("id") for b in (*root.findall("bsdf"), *groups)}
    used = {r.get("id") for r in root.iter("ref")}
    assert used == ids
    defaults = {d.get("name") for d in root.findall("default")}
    refs = {v[1:] for n in root.iter() for v in n.attrib.values() if v.startswith("$")}
    assert refs == defaults


@pytest.mark.parametrize("entry", list_scenes(), ids=lambda e: e.name)
def test_shipped_scenes_load_without_a_warning(entry):
    scene = shipped(entry.name)
    # of targets alone, of named materials, of a stripmap radar over a small scene
    said = ("no material has a diffuse law", "has its typical surface", "is read as", "for so small an image")
    assert all(any(text in note for text in said) for note in scene.notes)
    assert scene.geometry.n_faces + len(scene.points) > 0
    assert scene.radar.track.n_pulses * scene.radar.window.n_samples < 4e6  # renders in seconds


@pytest.mark.parametrize("entry", list_radars(), ids=lambda e: e.name)
def test_shipped_radars_see_a_city_without_a_warning(entry, tmp_path):
    scene = load_scene(make_city(9, tmp_path), radar=entry.name)
    said = ("raise image_extent_limit", "for so small an image mode = spotlight", "pulses at ")
    assert all(any(text in note for text in said) for note in scene.notes)
    assert scene.radar.track.n_pulses > 64


def test_make_city_loads(tmp_path):
    scene = load_scene(make_city(4, tmp_path, extent=100.0))
    assert scene.notes == ()
    assert scene.geometry.n_faces == 2 + 48


def test_resolve_takes_names_paths_and_suffixes(tmp_path, monkeypatch):
    assert resolve("dihedral") == scenes_dir() / "dihedral.xml"
    assert resolve("dihedral.xml") == scenes_dir() / "dihedral.xml"
    assert resolve_radar("airborne_x").parent.name == "radars"
    monkeypatch.chdir(tmp_path)
    Path("dihedral").mkdir()  # such as one of results
    assert resolve("dihedral") == scenes_dir() / "dihedral.xml"
    Path("dihedral.xml").write_text("<scene/>", encoding="utf-8")
    assert resolve("dihedral.xml") == Path("dihedral.xml")  # an existing file wins
    with pytest.warns(
        SarmitsubaWarning, match=r"the file dihedral\.xml in this folder is used, not the shipped"
    ):
        assert resolve("dihedral") == Path("dihedral.xml")
    Path("mine.xml").write_text("<scene/>", encoding="utf-8")
    assert resolve("mine") == Path("mine.xml")
    Path("folder").mkdir()
    with pytest.raises(SceneError, match="a folder, not a scene file"):
        resolve("folder")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "dihedrl",
            'dihedrl: no such file, and no shipped scene of that name; did you mean "dihedral"?',
        ),
        ("elsewhere/dihedral.xml", "elsewhere/dihedral.xml: no such scene file"),
        ("", "a folder, not a scene file"),
    ],
)
def test_unknown_scenes_are_refused_in_one_line(name, message):
    with pytest.raises(SceneError) as caught:
        resolve(name)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("path", sorted((scenes_dir() / "meshes").glob("*.ply")), ids=lambda p: p.stem)
def test_shipped_meshes_are_clean(path):
    mesh = trimesh.load(path, process=False)
    vertices, _, notes = clean_mesh(path.stem, mesh.vertices, mesh.faces)
    assert notes == []
    assert len(vertices) == len(mesh.vertices)
    assert path.stat().st_size < 320_000


def test_every_shipped_mesh_and_map_is_used():
    used = {
        n.get("value")
        for s in list_scenes()
        for n in ElementTree.parse(s.path).iter("string")
        if n.get("name") == "filename"
    }
    there = [p for p in (*scenes_dir().glob("meshes/*"), *scenes_dir().glob("maps/*")) if p.is_file()]
    assert used == {p.relative_to(scenes_dir()).as_posix() for p in there}


def test_every_folder_of_meshes_is_that_of_a_shipped_recipe():
    recipes = [read_table(p, "a recipe", 1 << 20) for p in scenes_dir().glob("recipes/*.toml")]
    used = {layer["meshes"] for recipe in recipes for layer in _tables(recipe) if "meshes" in layer}
    assert used == {p.name for p in scenes_dir().glob("meshes/*") if p.is_dir()}


def _tables(node):
    """Every table of a document, at any depth."""
    if isinstance(node, dict):
        yield node
        node = list(node.values())
    if isinstance(node, list):
        for below in node:
            yield from _tables(below)


def test_shipped_meshes_are_those_of_the_build_script():
    shapely = pytest.importorskip("shapely", reason="the build script needs shapely >= 2.1")
    if not hasattr(shapely, "constrained_delaunay_triangles"):
        pytest.skip("the build script needs shapely >= 2.1")
    run = subprocess.run(
        [sys.executable, str(scenes_dir() / "build_meshes.py"), "--check"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])},
    )
    assert run.returncode == 0, run.stdout + run.stderr


def test_shipped_polylines_are_those_of_their_script():
    run = subprocess.run(
        [sys.executable, str(scenes_dir() / "wires.py"), "--check"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout + run.stderr


def test_ply_keeps_double_precision(tmp_path):
    v, f = sphere(1.0, 0.05)
    v += np.array([4.5e5, 5.3e6, 512.0]) + 1e-7
    write_ply(tmp_path / "far.ply", v, f)
    back = trimesh.load(tmp_path / "far.ply", process=False)
    np.testing.assert_array_equal(back.vertices, v)
    np.testing.assert_array_equal(back.faces, f)


@pytest.mark.parametrize("n", [1, 7, 16, 1024])
def test_city_boxes_are_closed_apart_and_on_the_ground(n, tmp_path):
    path = make_city(n, tmp_path / "city")
    mesh = trimesh.load(path.with_suffix(".ply"), process=False)
    assert len(mesh.faces) == 12 * n
    assert mesh.is_watertight
    assert mesh.volume > 0
    boxes = np.asarray(mesh.vertices).reshape(n, 8, 3)
    low, high = boxes.min(axis=1), boxes.max(axis=1)
    assert (np.abs(boxes[:, :, :2]) < 200).all()
    assert (low[:, 2] == -0.5).all()
    gap = np.maximum(low[:, None] - high[None], low[None] - high[:, None])[:, :, :2].max(axis=2)
    assert (gap[~np.eye(n, dtype=bool)] > 0).all()
    root = ElementTree.parse(path).getroot()
    assert (path.parent / root.find("shape[@id='buildings']/string").get("value")).is_file()


def test_cities_are_the_same_every_time():
    np.testing.assert_array_equal(city_mesh(5, 100.0, (5, 9), 3)[0], city_mesh(5, 100.0, (5, 9), 3)[0])
    with pytest.raises(SceneError, match="n_buildings = 0"):
        city_mesh(0, 100.0, (5.0, 9.0))


def test_recipes_are_read_before_python_3_11(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where Python reads no TOML the package tomli does, which is needed there; without it the error names it."""
    (recipe, *_) = scenes_dir().glob("recipes/*.toml")
    here = read_table(recipe, "a recipe", 1 << 20)
    there = {"tomli": SimpleNamespace(loads=lambda text: {"read": len(text)})}

    def found(name: str) -> object:
        if name not in there:
            raise ModuleNotFoundError(name)
        return there[name]

    monkeypatch.setattr("importlib.import_module", found)
    assert (
        read_table(recipe, "a recipe", 1 << 20) == {"read": len(recipe.read_text(encoding="utf-8"))} != here
    )
    there.clear()
    with pytest.raises(
        DataError, match=r"before Python 3\.11 TOML needs the package tomli; pip install tomli"
    ):
        read_table(recipe, "a recipe", 1 << 20)
