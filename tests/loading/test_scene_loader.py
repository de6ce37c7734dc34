from pathlib import Path

import numpy as np
import pytest
import trimesh

from sarmitsuba.core.errors import ResourceError, SarmitsubaWarning
from sarmitsuba.effects.effect import switchable_effects
from sarmitsuba.loading.library import list_scenes
from sarmitsuba.loading.load import load_scene
from sarmitsuba.machine import memory
from sarmitsuba.scene.mesh.formats import write_ply
from tests.support.scenes import shipped

# of the default mode, stripmap, over small shapes
SMALL = "for so small an image mode = spotlight"
SENSOR = '<sensor type="sar_antenna" id="radar"/>'
PEC = '<bsdf type="radar_material"><string name="material" value="pec"/></bsdf>'


def scene_file(folder: Path, body: str, sensor: str = SENSOR, name: str = "scene.xml") -> Path:
    path = folder / name
    path.write_text(f'<scene version="3.0.0">{sensor}{body}</scene>', encoding="utf-8")
    return path


@pytest.mark.parametrize("entry", list_scenes(), ids=lambda entry: entry.name)
def test_every_shipped_scene_loads_without_a_warning(entry) -> None:
    scene = shipped(entry.name)
    assert scene.path == entry.path
    assert scene.geometry.n_faces or scene.points
    assert set(scene.settings.effects) == {e.name for e in switchable_effects()}


def test_transforms_compose_in_double_precision(tmp_path: Path) -> None:
    path = scene_file(
        tmp_path,
        '<shape type="rectangle" id="roof"><transform name="to_world"><scale x="2" y="3"/><rotate z="1" angle="90"/>'
        f'<translate x="10" y="0.1" z="7"/></transform>{PEC}</shape>',
    )
    geometry = load_scene(path).geometry
    np.testing.assert_allclose(geometry.bounds, [[7, -1.9, 7], [13, 2.1, 7]], atol=1e-12)  # tol: rounding
    assert geometry.mesh_names == ("roof",)
    assert geometry.faces.dtype == np.int32 and geometry.vertices.dtype == np.float64


def test_map_coordinates_keep_their_tenth_of_a_millimetre(tmp_path: Path) -> None:
    vertices = np.array([[0, 0, 0], [1.000123, 0, 0], [0, 1.000456, 0.25]])
    far = np.array([1_234_567.0, 5_678_901.0, 500.0])
    write_ply(tmp_path / "far.ply", vertices + far, [[0, 1, 2]])
    sensor = (
        '<sensor type="sar_antenna"><float name="aim_x" value="1234567.125"/>'
        '<float name="aim_y" value="5678901"/><float name="aim_z" value="500"/></sensor>'
    )
    body = f'<shape type="ply"><string name="filename" value="far.ply"/>{PEC}</shape>'
    scene = load_scene(scene_file(tmp_path, body, sensor))
    assert (scene.offset == np.round(scene.offset)).all()
    np.testing.assert_allclose(
        scene.geometry.vertices + scene.offset - far, vertices, atol=2e-9
    )  # tol: float64 at 5e6
    assert np.abs(scene.geometry.vertices).max() < 2.0
    np.testing.assert_allclose(
        scene.radar.aim_point + scene.offset, [1234567.125, 5678901, 500], atol=1e-9
    )  # tol: same
    # the same through to_world
    write_ply(tmp_path / "near.ply", vertices, [[0, 1, 2]])
    moved = body.replace("far.ply", "near.ply").replace(
        '<string name="filename"',
        '<transform name="to_world"><translate x="1234567" y="5678901" z="500"/></transform><string name="filename"',
    )
    again = load_scene(scene_file(tmp_path, moved, sensor))
    np.testing.assert_allclose(
        again.geometry.vertices, scene.geometry.vertices, atol=2e-9
    )  # tol: float64 at 5e6


def test_near_geometry_keeps_the_files_frame(tmp_path: Path) -> None:
    body = f'<shape type="cube"><transform name="to_world"><translate x="300"/></transform>{PEC}</shape>'
    sensor = '<sensor type="sar_antenna"><float name="aim_x" value="300"/></sensor>'
    scene = load_scene(scene_file(tmp_path, body, sensor))
    assert (scene.offset == 0).all()
    assert scene.geometry.bounds[0, 0] == 299.0


@pytest.mark.parametrize("kind", ["obj", "stl", "ply"])
def test_mesh_files(tmp_path: Path, kind: str) -> None:
    box = trimesh.creation.box(extents=(2, 4, 6))
    box.export(tmp_path / f"box.{kind}")
    body = f'<shape type="{kind}" id="box"><string name="filename" value="box.{kind}"/>{PEC}</shape>'
    geometry = load_scene(scene_file(tmp_path, body)).geometry
    assert geometry.n_faces == 12
    np.testing.assert_allclose(geometry.bounds, [[-1, -2, -3], [1, 2, 3]])
    assert np.unique(geometry.face_group).size == 6


def test_curved_shapes_lie_within_a_32nd_of_a_wavelength(tmp_path: Path) -> None:
    sensor = '<sensor type="sar_antenna"><float name="center_frequency" value="1.3e9"/></sensor>'
    body = (
        '<shape type="sphere" id="ball"><point name="center" x="3" y="0" z="2"/><float name="radius" value="0.5"/>'
        f'<transform name="to_world"><scale value="2"/></transform>{PEC}</shape>'
        '<shape type="cylinder" id="mast"><point name="p0" x="-3" y="0" z="0"/><point name="p1" x="-3" y="0" z="5"/>'
        f'<float name="radius" value="0.2"/>{PEC}</shape>'
        f'<shape type="disk" id="lid"><transform name="to_world"><translate y="4"/></transform>{PEC}</shape>'
    )
    scene = load_scene(scene_file(tmp_path, body, sensor))
    geometry = scene.geometry
    sagitta = scene.radar.waveform.wavelength / 32
    parts = [geometry.vertices[np.unique(geometry.faces[a:b])] for a, b in _spans(geometry)]
    ball = np.linalg.norm(parts[0] - [6, 0, 4], axis=1)
    assert np.abs(ball - 1.0).max() <= sagitta
    mast = np.linalg.norm(parts[1][:, :2] - [-3, 0], axis=1)
    assert np.abs(mast - 0.2).max() <= sagitta
    np.testing.assert_allclose(np.ptp(parts[1], axis=0)[2], 5.0)
    assert all("no material has a diffuse law" in note or SMALL in note for note in scene.notes)
    # every curved surface is one smooth group of its own
    assert [np.unique(geometry.face_group[a:b]).size for a, b in _spans(geometry)] == [1, 1, 1]


@pytest.mark.slow
def test_a_sphere_too_large_for_its_facets_says_so(tmp_path: Path) -> None:
    body = (
        f'<shape type="sphere" id="dome"><float name="radius" value="500"/>{PEC}</shape>'
        '<shape type="sphere"><bsdf type="point_scatterer"/></shape>'
    )
    scene = load_scene(scene_file(tmp_path, body))
    assert scene.geometry.n_faces <= 400_000
    assert any('shape "dome": tessellated to a sagitta of 0.007 m' in note for note in scene.notes)


def test_instances_stand_where_they_are_put(tmp_path: Path) -> None:
    body = (
        f'<shape type="shapegroup" id="house"><shape type="cube" id="box">{PEC}'
        '<transform name="to_world"><translate z="1"/></transform></shape></shape>'
        '<shape type="instance"><ref id="house"/><transform name="to_world"><scale value="2"/></transform></shape>'
        '<shape type="instance"><ref id="house"/><transform name="to_world"><translate x="10"/></transform></shape>'
    )
    geometry = load_scene(scene_file(tmp_path, body)).geometry
    assert geometry.mesh_names == ("box", "box.2")
    a, b = (geometry.vertices[np.unique(geometry.faces[i:j])] for i, j in _spans(geometry))
    np.testing.assert_allclose([a.min(0), a.max(0)], [[-2, -2, 0], [2, 2, 4]])
    np.testing.assert_allclose([b.min(0), b.max(0)], [[9, -1, 0], [11, 1, 2]])


def test_instances_of_several_shapes_are_objects_of_parts(tmp_path: Path) -> None:
    """A car of a body and windows was two shapes that nothing joined."""
    body = (
        f'<shape type="shapegroup" id="car"><shape type="cube" id="body">{PEC}</shape>'
        f'<shape type="cube" id="roof">{PEC}</shape></shape>'
        '<shape type="instance"><ref id="car"/></shape><shape type="instance" id="taxi"><ref id="car"/></shape>'
        '<shape type="instance"><ref id="car"/></shape>'
    )
    geometry = load_scene(scene_file(tmp_path, body)).geometry
    assert geometry.object_names == ("car", "taxi", "car.2")
    assert geometry.mesh_names[2:] == ("taxi/body", "taxi/roof", "car.2/body", "car.2/roof")


def test_more_triangles_than_the_memory_holds_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "free_memory", lambda: 100_000_000)
    ball = f'<shape type="sphere"><float name="radius" value="1.5"/>{PEC}</shape>'
    with pytest.raises(ResourceError, match="million triangles up to here: joining them needs"):
        load_scene(scene_file(tmp_path, 12 * ball))


def test_point_scatterer_is_the_spheres_centre(tmp_path: Path) -> None:
    body = (
        '<shape type="sphere" id="corner"><point name="center" x="1" y="2" z="3"/>'
        '<transform name="to_world"><rotate z="1" angle="90"/></transform>'
        '<bsdf type="point_scatterer"><float name="rcs_dbsm" value="20"/><float name="phase_deg" value="90"/></bsdf>'
        "</shape>"
    )
    scene = load_scene(scene_file(tmp_path, body))
    (point,) = scene.points
    assert point.name == "corner"
    np.testing.assert_allclose(point.position, [-2, 1, 3], atol=1e-12)  # tol: rounding
    assert (point.rcs, point.phase) == (pytest.approx(100.0), pytest.approx(np.pi / 2))  # tol: rounding
    assert scene.geometry.n_faces == 0


def test_one_material_for_every_bsdf_element(tmp_path: Path) -> None:
    body = (
        '<bsdf type="radar_material" id="a"><string name="material" value="concrete"/></bsdf>'
        '<shape type="cube"><ref id="a"/></shape><shape type="cube"><ref id="a"/>'
        f'<transform name="to_world"><translate x="5"/></transform></shape><shape type="rectangle">{PEC}</shape>'
    )
    scene = load_scene(scene_file(tmp_path, body))
    assert [m.name for m in scene.materials] == ["a", "radar_material_2"]
    assert np.bincount(scene.geometry.face_material).tolist() == [24, 2]


def test_one_warning_for_every_kind_of_ordinary_bsdf(tmp_path: Path) -> None:
    body = (
        '<shape type="cube"><bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>'
        '<shape type="disk"><bsdf type="diffuse"><rgb name="reflectance" value="0.1 0.2 0.3"/></bsdf></shape>'
        '<shape type="rectangle"/>'
        '<shape type="sphere"><bsdf type="mask"><float name="opacity" value="0.2"/><bsdf type="conductor"/></bsdf>'
        "</shape>"
    )
    with pytest.warns(SarmitsubaWarning) as caught:
        scene = load_scene(scene_file(tmp_path, body))
    kinds = [str(w.message).split('"')[1] for w in caught]
    assert sorted(kinds) == ["diffuse", "mask"]  # twosided is exact for a radar
    assert sum(SMALL not in note for note in scene.notes) == 2
    assert [m.invisible for m in scene.materials] == [False, False, False, True]


def test_old_sionna_names_in_ordinary_bsdfs(tmp_path: Path) -> None:
    body = (
        '<bsdf type="twosided" id="mat-itu_marble"><bsdf type="diffuse"/></bsdf>'
        '<shape type="cube"><ref id="mat-itu_marble"/></shape>'
    )
    scene = load_scene(scene_file(tmp_path, body))
    assert scene.materials[0].permittivity.real == 7.074
    assert all(SMALL in note for note in scene.notes)


def test_parameters_of_the_file_and_of_plugins(tmp_path: Path) -> None:
    sensor = (
        '<default name="size" value="1"/><sensor type="sar_antenna" id="radar"/><integrator type="sar_path">'
        '<integer name="seed" value="3"/></integrator>'
    )
    body = f'<shape type="cube"><transform name="to_world"><scale value="$size"/></transform>{PEC}</shape>'
    path = scene_file(tmp_path, body, sensor)
    plain = load_scene(path)
    assert plain.geometry.bounds[1, 0] == 1.0 and plain.settings.seed == 3
    scene = load_scene(
        path,
        parameters={
            "size": "2.5",
            "sar_path.max_depth": "5",
            "sar_path.speckle": "off",
            "radar.center_frequency": "1e10",
            "range_film.gridding_width": "6",
            "radar_material.rms_height": "0.01",
        },
    )
    assert scene.geometry.bounds[1, 0] == 2.5
    assert (scene.settings.max_depth, scene.settings.seed, scene.settings.effects["speckle"]) == (5, 3, "off")
    assert scene.settings.gridding_width == 6
    assert scene.radar.waveform.center_frequency == 1e10
    assert scene.materials[0].rms_height == 0.01


def test_a_radar_file_over_a_scene_for_light(tmp_path: Path) -> None:
    light = '<sensor type="perspective"/><integrator type="path"/><emitter type="constant"/>'
    path = scene_file(tmp_path, f'<shape type="cube">{PEC}</shape>', light)
    radar = tmp_path / "radar.xml"
    radar.write_text(
        '<scene version="3.0.0"><integrator type="sar_path"><string name="method" value="raw"/></integrator>'
        '<sensor type="sar_antenna"><float name="bandwidth" value="1e8"/><film type="range_film">'
        '<string name="image_grid" value="ground"/></film></sensor></scene>',
        encoding="utf-8",
    )
    scene = load_scene(path, radar=radar)
    assert scene.settings.method == "raw"
    assert scene.radar.waveform.bandwidth == 1e8
    assert scene.image.grid == "ground"


def test_face_order_and_duplicates_do_not_matter(tmp_path: Path) -> None:
    box = trimesh.creation.box()
    faces = np.concatenate([box.faces, box.faces[:3], box.faces[3:5][:, ::-1], [[0, 0, 1]]])
    write_ply(tmp_path / "box.ply", box.vertices, faces)
    body = f'<shape type="ply" id="box"><string name="filename" value="box.ply"/>{PEC}</shape>'
    scene = load_scene(scene_file(tmp_path, body))
    assert scene.geometry.n_faces == 12
    assert any('mesh "box": removed 1 of 18 faces without area' in note for note in scene.notes)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*of round metal")  # its domes are faceted
def test_munich_loads_unchanged() -> None:
    # the file is enough: nothing of Sionna RT is imported
    spec = pytest.importorskip("importlib.util").find_spec("sionna")
    if spec is None or not spec.submodule_search_locations:
        pytest.skip("sionna-rt, which carries the Munich scene, is not installed")
    path = Path(next(iter(spec.submodule_search_locations))) / "rt" / "scenes" / "munich" / "munich.xml"
    if not path.is_file():
        pytest.skip("this sionna-rt carries no Munich scene")
    scene = load_scene(path, radar="airborne_x")  # warnings are errors
    assert sum("is given an rms height of 1 mm" in note for note in scene.notes) == 1
    smooth = load_scene(path, radar="airborne_x", parameters={"sar_path.default_rms_height": "0"})
    assert {m.rms_height for m in scene.materials} == {1e-3}
    assert {m.rms_height for m in smooth.materials} == {0.0}
    assert scene.geometry.n_faces > 30_000
    assert {m.name for m in scene.materials} >= {"marble", "metal", "brick", "wood", "concrete"}
    assert len(scene.geometry.mesh_names) > 2000


def _spans(geometry):
    return list(zip(geometry.mesh_face_offset[:-1], geometry.mesh_face_offset[1:], strict=True))


LAW = """<scene version="3.0.0"><sensor type="sar_antenna"><float name="look_angle_deg" value="{angle}"/></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="40"/></transform>
<bsdf type="radar_material" id="soil"><string name="material" value="medium_dry_ground"/>
<float name="rms_height" value="0.001"/><float name="correlation_length" value="0.03"/>
<string name="diffuse_law" value="small_perturbation"/></bsdf></shape></scene>"""


def test_a_law_seen_outside_its_angles_is_said(tmp_path: Path) -> None:
    path = tmp_path / "soil.xml"
    path.write_text(LAW.format(angle=5))
    with pytest.warns(SarmitsubaWarning, match="outside the 15 ... 75 deg"):
        load_scene(path)
    path.write_text(LAW.format(angle=40))
    assert not any("outside the" in note for note in load_scene(path).notes)
