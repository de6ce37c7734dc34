"""Mesh files as scenes: up axis, unit and materials come out right or are asked for; nothing is dropped silently."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

from sarmitsuba import cli
from sarmitsuba.commands.scene_arguments import material_choice
from sarmitsuba.core.errors import RadarError, SarmitsubaWarning, SceneError
from sarmitsuba.loading.from_mesh import MeshOptions
from sarmitsuba.loading.load import load_scene
from sarmitsuba.loading.names_of_materials import kind_of
from sarmitsuba.scene.materials.named_materials import MATERIALS
from sarmitsuba.scene.mesh.model_units import ShapeExtent, doubtful_size, y_ground
from sarmitsuba.scene.scene import Scene

RADAR = "airborne_x"


def town() -> trimesh.Scene:
    """A wide ground, a tall wall of brick on it, and a window pane: 40 m x 30 m x 12 m, z up, metres."""
    scene = trimesh.Scene()
    parts = (
        ("Ground", (40.0, 30.0, 0.2), (0.0, 0.0, -0.1)),
        ("BrickWall", (8.0, 6.0, 12.0), (5.0, 3.0, 6.0)),
        ("window.001", (2.0, 0.1, 2.0), (5.0, -0.05, 3.0)),
    )
    for grey, (name, size, place) in enumerate(parts):
        box = trimesh.creation.box(size, transform=trimesh.transformations.translation_matrix(place))
        material = trimesh.visual.material.PBRMaterial(name=name, baseColorFactor=[10 * grey] * 3)
        box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(box.vertices), 2)), material=material)
        scene.add_geometry(box, node_name=name)
    return scene


def upright(scene: trimesh.Scene) -> trimesh.Scene:
    return scene.apply_transform(trimesh.transformations.rotation_matrix(-0.5 * np.pi, [1, 0, 0]))


def check(scene: Scene, kinds: tuple[str, ...]) -> None:
    low, high = scene.geometry.bounds + scene.offset
    # tol: float32 coordinates of glTF, text of obj
    np.testing.assert_allclose(low, [-20.0, -15.0, -0.2], atol=1e-4)
    np.testing.assert_allclose(high, [20.0, 15.0, 12.0], atol=1e-4)
    assert scene.geometry.n_faces == 36
    expected = {kind_of(name, {}) for name in kinds}
    epsilon = {m.permittivity for m in scene.materials}
    assert len(scene.materials) == len(kinds) and len(epsilon) == len(expected)


NAMES = ("Ground", "BrickWall", "window.001")


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("suffix", ["glb", "gltf", "obj"])
def test_a_model_is_turned_upright_with_its_materials(tmp_path: Path, suffix: str, up: str) -> None:
    scene = upright(town()) if up == "y" else town()
    path = tmp_path / f"town.{suffix}"
    scene.export(path)
    options = None
    if up == "z" and suffix != "obj":
        options = MeshOptions(up="z")  # against the standard of glTF, which has y up
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loaded = load_scene(path, radar=RADAR, mesh=options)
    check(loaded, NAMES)
    assert any(f"{up} up" in note and "40 m x 30 m wide and 12.2 m high" in note for note in loaded.notes)
    assert any('"BrickWall" brick' in note and '"window.001" glass' in note for note in loaded.notes)
    # the radar aims at the middle, on the ground
    # tol: one ground box is 0.2 m thick
    np.testing.assert_allclose(loaded.radar.aim_point + loaded.offset, [0.0, 0.0, -0.1], atol=0.11)


def test_an_obj_keeps_its_materials_without_its_mtl_file(tmp_path: Path) -> None:
    town().export(tmp_path / "town.obj")
    for other in tmp_path.glob("*.mtl"):
        other.unlink()
    check(load_scene(tmp_path / "town.obj", radar=RADAR), NAMES)


def test_the_unit_is_asked_for_where_it_cannot_be_metres(tmp_path: Path) -> None:
    town().apply_scale(1000.0).export(tmp_path / "town.obj")
    with pytest.raises(
        SceneError, match=r"is its unit the metre\? Then it has walls of 1.2e\+04 m; give --unit"
    ):
        load_scene(tmp_path / "town.obj", radar=RADAR)
    check(load_scene(tmp_path / "town.obj", radar=RADAR, mesh=MeshOptions(unit="mm")), NAMES)


@pytest.mark.parametrize("command", ["render", "import"])
@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")  # the box has no material
def test_a_house_in_centimetres_is_a_question_with_its_answer(
    tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A box of 800 units of height, and one of 250 m, which may be in metres."""
    for height in (250.0, 800.0):
        trimesh.creation.box((900.0, 1000.0, height)).export(tmp_path / f"box{height:.0f}.obj")
    path = str(tmp_path / "box800.obj")
    more = {
        "render": ["-o", str(tmp_path / "out"), "--radar", RADAR],
        "import": ["-o", str(tmp_path / "box.xml")],
    }
    assert cli.main([command, path, *more[command]]) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1 and "walls of 800 m; give --unit cm (8 m high), --unit mm (0.8 m high)" in error[0]
    assert "--unit m if it is right" in error[0] and not (tmp_path / "box.xml").exists()
    for unit, metres in (("cm", 8.0), ("m", 800.0)):
        scene = load_scene(path, radar=RADAR, mesh=MeshOptions(unit=unit))
        assert np.ptp(scene.geometry.bounds[:, 2]) == pytest.approx(metres)
    load_scene(tmp_path / "box250.obj", radar=RADAR)


def test_a_gltf_part_without_a_material_is_named_by_itself(tmp_path: Path) -> None:
    parts = {
        "concrete_3": trimesh.creation.box((10, 10, 10)),
        "medium_dry_ground": trimesh.creation.box((50, 1, 50)),
    }
    trimesh.Scene(parts).export(tmp_path / "a.glb")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = load_scene(tmp_path / "a.glb", radar=RADAR)
    assert {m.name for m in scene.materials} >= {"concrete_3", "medium_dry_ground"}


def test_names_that_say_nothing_are_said(tmp_path: Path) -> None:
    trimesh.creation.box((10, 10, 10)).export(tmp_path / "box.ply")
    with pytest.warns(SarmitsubaWarning, match="materials with unknown names are read as concrete: no name"):
        load_scene(tmp_path / "box.ply", radar=RADAR)
    (tmp_path / "a.obj").write_text("usemtl M17\nv 0 0 0\nv 9 0 0\nv 0 9 0\nv 0 0 9\nf 1 2 3\nf 1 2 4\n")
    with pytest.warns(SarmitsubaWarning, match='read as concrete: "M17"'):
        load_scene(tmp_path / "a.obj", radar=RADAR)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        chosen = load_scene(tmp_path / "a.obj", radar=RADAR, mesh=MeshOptions(materials={"M17": "pec"}))
    assert [m.pec for m in chosen.materials] == [True]
    with pytest.raises(SceneError, match='no material "M18" in this file; did you mean "M17"'):
        load_scene(tmp_path / "a.obj", radar=RADAR, mesh=MeshOptions(materials={"M18": "pec"}))
    with pytest.raises(SceneError, match='"brik" is no known material; did you mean "brick"'):
        load_scene(tmp_path / "a.obj", radar=RADAR, mesh=MeshOptions(materials={"M17": "brik"}))


def test_a_mesh_needs_a_radar_and_its_options_need_a_mesh(tmp_path: Path) -> None:
    town().export(tmp_path / "town.glb")
    with pytest.raises(RadarError, match="lay a radar over the scene with --radar"):
        load_scene(tmp_path / "town.glb")
    with pytest.raises(SceneError, match="materials by name are given to mesh files only"):
        load_scene("tower", mesh=MeshOptions(materials={"a": "brick"}))


def made_for_light(folder: Path, seed: int, style: str, y_up: bool = True) -> tuple[Path, list[np.ndarray]]:
    """Scene file of drawn boxes, balls and ground with a camera and no radar; vertices (n, 3) of its shapes, z up.

    Style ``blender``: meshes in their own coordinates with transforms and the exporter's ids; ``world``: the same ids,
    meshes in the coordinates of the scene; ``bare``: such meshes without ids that say anything.
    """
    rng = np.random.default_rng(seed)
    wide = rng.uniform(15.0, 60.0, 2)
    bodies = [trimesh.creation.box((*wide, 0.0 if seed % 2 else 0.3))]
    places = [trimesh.transformations.translation_matrix([*rng.uniform(-500, 500, 2), 0.0])]
    for _ in range(int(rng.integers(1, 6))):
        size = rng.uniform(0.5, 0.3 * wide.min(), 3)
        if rng.random() < 0.7:
            body = trimesh.creation.box(size)
        else:
            body = trimesh.creation.icosphere(2, 0.5 * size[2])
        turn = trimesh.transformations.rotation_matrix(rng.uniform(0, 6), [0, 0, 1])
        turn[:3, 3] = places[0][:3, 3] + [*(rng.uniform(-0.3, 0.3, 2) * wide), 0.5 * size[2]]
        bodies.append(body)
        places.append(turn)
    axes = trimesh.transformations.rotation_matrix(-0.5 * np.pi if y_up else 0.0, [1, 0, 0])
    shapes, truth, grey = [], [], '<float name="reflectance" value="0.{}"/>'
    for i, (body, place) in enumerate(zip(bodies, places, strict=True)):
        truth.append(trimesh.transformations.transform_points(body.vertices, place))
        name, whole = f"Körper_{i} ({i}).ply", axes @ place
        if style != "blender":
            body = body.copy().apply_transform(whole)
        body.export(folder / name)
        identity = f' id="elm__{i}"' if style != "bare" else ""
        matrix = " ".join(f"{v:.17g}" for v in whole.ravel())
        moved = (
            f'<transform name="to_world"><matrix value="{matrix}"/></transform>' if style == "blender" else ""
        )
        shapes.append(
            f'<shape type="ply"{identity}><string name="filename" value="{name}"/>{moved}'
            f'<bsdf type="twosided"><bsdf type="diffuse">{grey.format(i)}</bsdf></bsdf></shape>'
        )
    order = rng.permutation(len(shapes))
    path = folder / "scene.xml"
    camera = '<sensor type="perspective"/><integrator type="path"/><emitter type="constant"/>'
    path.write_text(f'<scene version="3.0.0">{camera}{"".join(shapes[i] for i in order)}</scene>')
    return path, [truth[i] for i in order]


def bounds(scene: Scene) -> np.ndarray:
    """(n, 2, 3) bounds of every shape, file frame."""
    geometry = scene.geometry
    cuts = zip(geometry.mesh_face_offset[:-1], geometry.mesh_face_offset[1:], strict=True)
    corners = [geometry.vertices[geometry.faces[a:b]].reshape(-1, 3) + scene.offset for a, b in cuts]
    return np.array([[c.min(axis=0), c.max(axis=0)] for c in corners])


def check_shapes(scene: Scene, truth: list[np.ndarray], scale: float = 1.0) -> None:
    want = scale * np.array([[v.min(axis=0), v.max(axis=0)] for v in truth])
    # tol: meshes in float32, 500 m from the origin
    np.testing.assert_allclose(bounds(scene), want, atol=scale * 1e-3)


@pytest.mark.filterwarnings("ignore:.*has no radar parameters:sarmitsuba.core.errors.SarmitsubaWarning")
@pytest.mark.parametrize("seed", range(8))
def test_scenes_with_y_up_are_turned_where_that_is_sure(tmp_path: Path, seed: int) -> None:
    for style in ("blender", "world"):
        path, truth = made_for_light(tmp_path, seed, style)
        scene = load_scene(path, radar=RADAR)
        check_shapes(scene, truth)
        said = 'scene.xml: y up by its ground "Körper_0 (0)", unit m, which the file does not say: '
        assert any(said in note for note in scene.notes)
        check_shapes(load_scene(path, radar=RADAR, mesh=MeshOptions(up="y", unit="cm")), truth, 0.01)
        path, truth = made_for_light(tmp_path, seed, style, y_up=False)
        scene = load_scene(path, radar=RADAR)
        check_shapes(scene, truth)
        assert any("scene.xml: z up, unit m, which the file does not say: " in note for note in scene.notes)


@pytest.mark.filterwarnings("ignore:.*has no radar parameters:sarmitsuba.core.errors.SarmitsubaWarning")
@pytest.mark.parametrize("seed", range(8, 12))
def test_scenes_that_only_look_like_y_up_are_asked_about(tmp_path: Path, seed: int) -> None:
    path, truth = made_for_light(tmp_path, seed, "bare")
    with pytest.warns(SarmitsubaWarning, match=r"scene.xml: is y up\? .* give --up y, or --up z"):
        load_scene(path, radar=RADAR)
    check_shapes(load_scene(path, radar=RADAR, mesh=MeshOptions(up="y")), truth)
    # a radar of its own has a frame, and the scene is in it
    text = path.read_text().replace('<sensor type="perspective"/>', '<sensor type="sar_antenna"/>')
    path.write_text(text)
    turned = [v @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]) for v in truth]
    check_shapes(load_scene(path), turned)
    check_shapes(load_scene(path, mesh=MeshOptions(up="y")), truth)
    # but not where Blender wrote it
    path, truth = made_for_light(tmp_path, seed, "blender")
    path.write_text(path.read_text().replace('<sensor type="perspective"/>', '<sensor type="sar_antenna"/>'))
    with pytest.warns(
        SarmitsubaWarning, match=r'is y up\? "Körper_0 \(0\)" looks like ground below all else; give --up y'
    ):
        load_scene(path)
    check_shapes(load_scene(path, mesh=MeshOptions(up="y")), truth)


@pytest.mark.parametrize("number", [np.nan, np.inf, 1e300])
def test_broken_meshes_of_scenes_made_for_light_end_in_one_line(tmp_path: Path, number: float) -> None:
    path, _ = made_for_light(tmp_path, 2, "world")
    text = f"v 0 0 0\nv {number} {-number} 1\nv 0 1 0\nf 1 2 3\n"
    (tmp_path / "odd.obj").write_text(text)
    shape = '<shape type="obj"><string name="filename" value="odd.obj"/><bsdf type="radar_material">'
    shape += '<string name="material" value="metal"/></bsdf></shape></scene>'
    path.write_text(path.read_text().replace("</scene>", shape))
    with pytest.raises(SceneError) as caught, warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", ".*has no radar parameters", SarmitsubaWarning)
        load_scene(path, radar=RADAR)
    assert ("\n" not in str(caught.value) and "odd" in str(caught.value)) or "obj" in str(caught.value)


@pytest.mark.filterwarnings("ignore:.*has no radar parameters:sarmitsuba.core.errors.SarmitsubaWarning")
def test_a_loaded_scene_with_y_up_is_asked_about(tmp_path: Path) -> None:
    from sarmitsuba.loading.plugins import register_plugins
    from sarmitsuba.machine.backend import mi

    register_plugins()
    path, _ = made_for_light(tmp_path, 1, "blender")
    with pytest.warns(SarmitsubaWarning, match=r"is y up\? .* looks like ground below all else"):
        load_scene(mi.load_file(str(path), parallel=False), radar=RADAR)
    with pytest.raises(SceneError, match="unit and up axis are given to files and dicts"):
        load_scene(mi.load_file(str(path), parallel=False), radar=RADAR, mesh=MeshOptions(up="y"))


def test_walls_are_no_ground() -> None:
    """Drawn facades, fences and streets without ground, z up: none is taken for ground that lies on its side."""
    rng = np.random.default_rng(3)
    for _ in range(60):
        boxes = []
        for _ in range(int(rng.integers(2, 9))):
            size = rng.uniform([1.0, 0.1, 2.0], [30.0, 12.0, 15.0])
            box, place = trimesh.creation.box(size), np.array([*rng.uniform(-40, 40, 2), 0.5 * size[2]])
            boxes.append(box.triangles + place)
        assert y_ground([ShapeExtent.of(b) for b in boxes]) < 0
        assert y_ground([ShapeExtent.of(b[:, :, [1, 0, 2]]) for b in boxes]) < 0


def test_motion_turns_with_the_shapes_and_level_ground_does_not(tmp_path: Path) -> None:
    text = """<scene version="3.0.0"><sensor type="sar_antenna"/>
    <shape type="radar_ground" id="soil"><string name="material" value="soil"/><float name="level" value="-1"/>
      <float name="extent" value="90"/></shape>
    <shape type="cube" id="block"><vector name="velocity" x="0" y="0" z="-500"/>
      <bsdf type="radar_material"><string name="material" value="metal"/></bsdf></shape></scene>"""
    (tmp_path / "a.xml").write_text(text)
    loaded = load_scene(tmp_path / "a.xml", mesh=MeshOptions(up="y", unit="cm"))
    block = loaded.geometry.mesh_names.index("block")
    np.testing.assert_allclose(loaded.geometry.mesh_motion[block].velocity, [0.0, 5.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(bounds(loaded)[block], [[-0.01] * 3, [0.01] * 3], atol=1e-12)
    soil = bounds(loaded)[loaded.geometry.mesh_names.index("soil")]
    np.testing.assert_allclose(soil[:, 2], -1.0)


@pytest.mark.parametrize(
    ("name", "length", "said"),
    [
        ("Car.001", 445.0, "--unit cm"),
        ("parked_car_2", 4450.0, "--unit mm"),
        ("PKW", 14.6, "--unit ft"),
        ("sportsCar", 175.0, "--unit in"),
        ("person", 180.0, "--unit cm"),
        ("bus", 0.012, "--unit km"),
        *(
            ("car", 4.4, ""),
            ("car_park", 445.0, ""),
            ("cars", 90.0, ""),
            ("carpet", 20.0, ""),
            ("", 445.0, ""),
        ),
    ],
)
def test_things_of_a_known_size_show_the_unit(name: str, length: float, said: str) -> None:
    found = doubtful_size(name, length)
    assert said in found and bool(found) == bool(said)


def test_a_car_of_445_m_is_asked_about(tmp_path: Path) -> None:
    trimesh.creation.box((445.0, 180.0, 150.0)).export(tmp_path / "Car.ply")
    metal = '<bsdf type="radar_material"><string name="material" value="metal"/></bsdf>'
    body = f'<shape type="ply"><string name="filename" value="Car.ply"/>{metal}</shape>'
    (tmp_path / "a.xml").write_text(f'<scene version="3.0.0">{body}</scene>')
    with pytest.warns(SarmitsubaWarning, match=r'a.xml: "Car" is 445 m long; give --unit cm .*if that is'):
        load_scene(tmp_path / "a.xml", radar=RADAR)
    scene = load_scene(tmp_path / "a.xml", radar=RADAR, mesh=MeshOptions(unit="cm"))
    assert np.ptp(scene.geometry.bounds[:, 0]) == pytest.approx(4.45)
    trimesh.creation.box((445.0, 180.0, 150.0)).export(tmp_path / "red_car.stl")
    metal_car = MeshOptions(materials={"*": "metal"})
    with pytest.warns(SarmitsubaWarning, match=r'red_car.stl: "red_car" is 445 m long; give --unit cm'):
        load_scene(tmp_path / "red_car.stl", radar=RADAR, mesh=metal_car)
    trimesh.creation.box((900.0, 500.0, 800.0)).export(tmp_path / "Car.ply")
    (tmp_path / "a.xml").write_text(f'<scene version="3.0.0">{body.replace("Car", "B")}</scene>')
    (tmp_path / "Car.ply").rename(tmp_path / "B.ply")
    with pytest.warns(
        SarmitsubaWarning, match=r"a.xml: is its unit the metre\? Then it has walls of 800 m; give"
    ):
        load_scene(tmp_path / "a.xml", radar=RADAR)


XML = """<scene version="3.0.0"><sensor type="sar_antenna"/>
<bsdf type="radar_material" id="steel"><string name="material" value="pec"/></bsdf>
<shape type="obj"><string name="filename" value="town.obj"/>{bsdf}</shape></scene>"""


def test_materials_of_an_obj_in_a_scene_file(tmp_path: Path) -> None:
    town().export(tmp_path / "town.obj")
    (tmp_path / "own.xml").write_text(XML.format(bsdf=""))
    check(load_scene(tmp_path / "own.xml"), NAMES)
    (tmp_path / "bsdf.xml").write_text(XML.format(bsdf='<ref id="steel"/>'))
    replaced = load_scene(tmp_path / "bsdf.xml")
    assert [m.name for m in replaced.materials] == ["steel"]
    assert any('"steel" replaces the materials of town.obj: ' in note for note in replaced.notes)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("itu_concrete", "concrete"),
        ("mat-itu_wood", "wood"),
        ("Brick.003", "brick"),
        ("old StoneWall", "marble"),
        ("wet ground", "wet_ground"),
        ("steel_beam", "metal"),
        ("broadway", ""),  # no road in it
        ("Material.001", ""),
    ],
)
def test_kinds_by_name(name: str, kind: str) -> None:
    assert kind_of(name, {}) == kind


def test_a_scene_of_mirrors_says_that_it_is_black(tmp_path: Path) -> None:
    mirrors = load_scene("dihedral")
    assert any("no material has a diffuse law: the image is black" in note for note in mirrors.notes)
    assert not any("image is black" in note for note in load_scene("tower").notes)


def test_a_material_alone_is_that_of_all_names(tmp_path: Path) -> None:
    """An stl file names no material: there was no way to choose one."""
    trimesh.creation.box().export(tmp_path / "box.stl")
    chosen = load_scene(
        tmp_path / "box.stl", radar=RADAR, mesh=MeshOptions(materials=dict([material_choice("Stahl")]))
    )
    assert [m.name for m in chosen.materials] == ["metal"]
    assert [m.permittivity for m in chosen.materials] == [
        MATERIALS["metal"].permittivity(chosen.radar.waveform.center_frequency)
    ]
    town().export(tmp_path / "town.glb")
    some = next(iter(NAMES))
    given = dict([material_choice("grass"), material_choice(f"{some}=pec")])
    scene = load_scene(tmp_path / "town.glb", radar=RADAR, mesh=MeshOptions(materials=given))
    grass = MATERIALS["grass"].permittivity(scene.radar.waveform.center_frequency)
    assert {m.name for m in scene.materials if m.pec} == {some}
    assert all(m.pec or m.permittivity == grass for m in scene.materials) and len(scene.materials) == len(
        NAMES
    )


def test_shapes_that_blender_numbers_have_the_names_of_its_objects(tmp_path: Path) -> None:
    """Ids ``elm__N``; a house of two materials is one object, and one whose name only looks so is another."""
    files = {
        "Plane": "Lawn",
        "House_001-Brick wall.003": "Brick wall_003",
        "House_001-Tin": "Tin",
        "Shed-old": "Tin",
    }
    shapes = ""
    for i, (name, material) in enumerate(files.items()):
        trimesh.creation.box((3.0, 4.0, 5.0)).export(tmp_path / f"{name}.ply")
        shapes += f'<shape type="ply" id="elm__{10 + i}"><string name="filename" value="{name}.ply"/>'
        shapes += f'<ref id="mat-{material}"/></shape>'
    materials = "".join(PRINCIPLED.format(name=one, metallic=0.0) for one in dict.fromkeys(files.values()))
    (tmp_path / "scene.xml").write_text(EXPORTED.format(materials=materials, shapes=shapes))
    with pytest.warns(SarmitsubaWarning):
        scene = load_scene(tmp_path / "scene.xml", radar=RADAR)
    names = scene.geometry.mesh_names
    assert names == ("Plane", "House_001/Brick wall_003", "House_001/Tin", "Shed-old")
    assert scene.geometry.object_names == ("Plane", "House_001", "Shed-old")


def test_a_lone_body_is_told_of_ground(tmp_path: Path) -> None:
    """A box without ground, not a town that stands on some, nor one with --ground."""
    body = trimesh.creation.box((10.0, 8.0, 12.0))
    body.export(tmp_path / "body.ply")
    town().export(tmp_path / "town.glb")
    options = MeshOptions(up="z")
    hint = "--ground soil adds some"

    def notes(name: str, **more: str) -> str:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SarmitsubaWarning)
            return "\n".join(load_scene(tmp_path / name, radar="airborne_x", mesh=options, **more).notes)

    assert hint in notes("body.ply")
    assert hint not in notes("body.ply", ground="soil") and hint not in notes("town.glb")


def test_names_of_missing_files_are_guessed(tmp_path: Path) -> None:
    trimesh.creation.box().export(tmp_path / "house.ply")
    with pytest.raises(SceneError, match=r'no such scene file; did you mean "house\.ply"\?'):
        load_scene(tmp_path / "hause.ply")
    with pytest.raises(SceneError, match=r"no such scene file; check the path"):
        load_scene(tmp_path / "quite_another.ply")


EXPORTED = """<scene version="2.1.0">
<default name="spp" value="64"/>
<integrator type="path" id="elm__1" name="elm__1"><integer name="max_depth" value="8"/></integrator>
<sensor type="perspective" id="elm__2" name="elm__2"><float name="fov" value="39.6"/><film type="hdrfilm" name="film">
<integer name="width" value="1920"/></film><sampler type="independent" name="sampler">
<integer name="sample_count" value="$spp"/></sampler></sensor>
<emitter type="point" id="elm__3" name="elm__3"><point name="position" x="4" y="6" z="-1"/></emitter>
{materials}<bsdf type="mask" id="mat-Leaf"><float name="opacity" value="0.5"/><bsdf type="diffuse"/></bsdf>
{shapes}</scene>"""
PRINCIPLED = """<bsdf type="twosided" id="mat-{name}" name="mat-{name}"><bsdf type="principled" name="bsdf">
<rgb value="0.8 0.8 0.8" name="base_color"/><float name="metallic" value="{metallic}"/>
<float name="specular" value="0.5"/><float name="roughness" value="0.4"/></bsdf></bsdf>"""


def test_what_blender_exports_is_read_without_options(tmp_path: Path) -> None:
    """Version 2.1.0, y up in the vertices, materials by their names, a car of bare metal, metres."""
    bodies = {
        "Plane": ((80.0, 80.0, 0.0), (0, 0, 0)),
        "Cube_001": ((10.0, 8.0, 12.0), (0, 0, 6)),
        "Car": ((4, 2, 1.5), (12, 5, 0.75)),
    }
    kinds = {"Plane": "Lawn.001", "Cube_001": "Brick wall.003", "Car": "Material.002"}
    shapes = ""
    for name, (size, place) in bodies.items():
        body = trimesh.creation.box(size)
        body.apply_translation(place)
        upright(trimesh.Scene(body)).to_geometry().export(tmp_path / f"{name}.ply")
        shapes += (
            f'<shape type="ply" id="elm__{name}" name="elm__{name}"><string name="filename" value="{name}.ply"/>'
            f'<boolean name="face_normals" value="true"/><ref id="mat-{kinds[name]}" name="bsdf"/></shape>'
        )
    materials = "".join(
        PRINCIPLED.format(name=kind, metallic=float(kind == "Material.002")) for kind in kinds.values()
    )
    path = tmp_path / "scene.xml"
    path.write_text(EXPORTED.format(materials=materials, shapes=shapes))
    with pytest.warns(SarmitsubaWarning, match="perfect conductor .* if metallic"):
        scene = load_scene(path, radar=RADAR)
    low, high = scene.geometry.bounds + scene.offset
    np.testing.assert_allclose([low, high], [[-40, -40, 0], [40, 40, 12]], atol=1e-5)  # tol: float32 meshes
    assert scene.geometry.mesh_names == ("elm__Plane", "elm__Cube_001", "elm__Car")
    lawn, brick, metal = scene.materials
    assert lawn.diffuse_law == "constant_gamma" and brick.diffuse_law == "lambert"
    assert metal.metallic and not brick.metallic and not lawn.metallic
