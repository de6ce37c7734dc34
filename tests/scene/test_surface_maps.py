"""Maps on materials as scene files, PLY and OBJ files and Python give them; what cannot be meant is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from sarmitsuba import Scene, SceneMesh, build_scene, load_scene
from sarmitsuba.core.errors import SceneError
from sarmitsuba.effects.plan import plan_effects
from sarmitsuba.loading.plugins import register_plugins
from sarmitsuba.machine.backend import mi
from sarmitsuba.scene.materials.map_materials import (
    MOST_LEVELS,
    list_with_parts,
    map_attributes,
    vary_material,
)
from sarmitsuba.scene.materials.material import ClassMap, Material, SurfaceMaps
from sarmitsuba.scene.materials.texture import Bitmap, place_in_plan, place_on_mesh

GREY = np.array([[0, 51, 255], [102, 51, 51]], dtype=np.uint8)
LAW = '<string name="diffuse_law" value="constant"/>'
SQUARE = np.array([[-3.0, -2.0, 0.0], [3.0, -2.0, 0.0], [3.0, 2.0, 0.0], [-3.0, 2.0, 0.0]])
FACES = [[0, 1, 2], [0, 2, 3]]
SHAPE = '<shape type="rectangle"><transform name="to_world"><scale x="3" y="2"/></transform>'


def scene_file(folder: Path, bsdf: str, shape: str = SHAPE, more: str = "") -> Path:
    Image.fromarray(GREY).save(folder / "grey.png")
    Image.fromarray(np.stack([GREY, GREY // 2, GREY * 0 + 7], axis=-1)).save(folder / "colour.png")
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0"><sensor type="sar_antenna"/>{more}{shape}{bsdf}</shape></scene>')
    return path


def bitmap(name: str, file: str = "grey.png", more: str = "") -> str:
    return f'<texture type="bitmap" name="{name}"><string name="filename" value="{file}"/>{more}</texture>'


SMOOTH = '<boolean name="smooth" value="true"/>'


def material(*inside: str, law: str = LAW) -> str:
    ground = '<string name="material" value="wet_ground"/>'
    return f'<bsdf type="radar_material" id="soil">{ground}{law}{"".join(inside)}</bsdf>'


def text(name: str, value: str) -> str:
    return f'<string name="{name}" value="{value}"/>'


def named(key: str, level: float) -> str:
    inside = f'<float name="diffuse_level_db" value="{level}"/>'
    return f'<bsdf type="radar_material" name="{key}"><string name="material" value="wet_ground"/>{LAW}{inside}</bsdf>'


def maps_of(scene: Scene) -> SurfaceMaps:
    maps = scene.materials[0].maps
    assert maps is not None
    return maps


def at(scene: Scene, map_: Bitmap, points: Any) -> Any:
    """Pixels of a bitmap at points inside the first triangle, by barycentric coordinates of what the loader made."""
    geometry = scene.geometry
    triangles = geometry.vertices[geometry.faces]
    uv = map_.placement.at(triangles, geometry.corner_values)
    out = []
    for point in points:
        for corners, place in zip(triangles, uv, strict=True):
            weights = np.linalg.solve(np.vstack([corners[:, :2].T, np.ones(3)]), [*point, 1.0])
            if (weights > -1e-9).all():
                u, v = weights @ place
                rows, columns = map_.values.shape
                out.append(map_.values[int(np.floor(v * rows)) % rows, int(np.floor(u * columns)) % columns])
                break
    return np.array(out)


# three in the first row of the picture in plan, then three in the second
POINTS = [(-2.0, 1.0), (0.0, 1.0), (2.0, 1.0), (-2.0, -1.0), (0.0, -1.0), (2.0, -1.0)]


def test_a_map_in_plan_has_its_first_row_in_the_north(tmp_path: Path) -> None:
    inside = [bitmap("sigma0_map"), text("map_extent", "-3 -2 3 2"), text("sigma0_map_range", "-10 5")]
    level = maps_of(load_scene(scene_file(tmp_path, material(*inside)))).level
    assert level is not None and level.smooth and not level.repeat
    scene = load_scene(scene_file(tmp_path, material(*inside)))
    expected = 10.0 ** ((-10.0 + 15.0 * GREY.ravel() / 255.0) / 10.0)
    np.testing.assert_allclose(at(scene, level, POINTS), expected, rtol=1e-12)


def test_a_rectangle_has_mitsubas_texture_coordinates(tmp_path: Path) -> None:
    scene = load_scene(scene_file(tmp_path, material(bitmap("sigma0_map"))))
    level = maps_of(scene).level
    assert level is not None and level.repeat and map_attributes(scene.materials[0]) == ("uv",)
    ours = at(scene, level, POINTS)
    picture = mi.load_dict(
        {"type": "bitmap", "filename": str(tmp_path / "grey.png"), "raw": True, "filter_type": "nearest"}
    )
    si = mi.SurfaceInteraction3f()
    theirs = []
    for x, y in POINTS:
        si.uv = mi.Point2f((x + 3.0) / 6.0, (y + 2.0) / 4.0)
        theirs.append(float(picture.eval_1(si)[0]))
    np.testing.assert_allclose(ours, theirs, atol=1e-6)
    np.testing.assert_allclose(ours, np.concatenate([GREY[1], GREY[0]]) / 255.0)  # first row at v = 0


def test_to_uv_turns_the_bitmap_as_mitsuba_does(tmp_path: Path) -> None:
    turn = '<transform name="to_uv"><rotate z="1" angle="90"/><translate x="1"/></transform>'
    scene = load_scene(scene_file(tmp_path, material(bitmap("sigma0_map", more=turn))))
    level = maps_of(scene).level
    assert level is not None
    uv = level.placement.at(np.zeros((1, 3, 3)), {"uv": np.array([[[0.25, 0.1], [0.0, 0.0], [1.0, 0.5]]])})
    np.testing.assert_allclose(uv[0], [[0.9, 0.25], [1.0, 0.0], [0.5, 1.0]], atol=1e-12)


@pytest.mark.parametrize("colours", [False, True])
def test_classes_by_grey_value_or_colour(tmp_path: Path, colours: bool) -> None:
    keys = [f"color_{g:02x}{g // 2:02x}07" if colours else f"class_{g}" for g in (0, 51, 102, 255)]
    classes = "".join(named(key, -10.0 - i) for i, key in enumerate(keys))
    file = "colour.png" if colours else "grey.png"
    extent = text("map_extent", "-3 -2 3 2")
    cover = f'<bsdf type="land_cover">{bitmap("class_map", file)}{extent}{classes}</bsdf>'
    scene = load_scene(scene_file(tmp_path, cover))
    found = maps_of(scene).classes
    assert found is not None and len(list_with_parts(scene.materials)) == 5
    levels = np.array([m.diffuse_level_db for m in found.materials])
    want = {0: -10.0, 51: -11.0, 102: -12.0, 255: -13.0}
    numbers = at(scene, found.bitmap, POINTS)
    assert levels[numbers].tolist() == [want[int(g)] for g in GREY.ravel()]
    assert (
        scene.materials[0].diffuse_level_db == -11.0
    )  # most of the map, and what is left with the effect off


def test_permittivity_and_roughness_make_materials(tmp_path: Path) -> None:
    inside = [
        bitmap("permittivity_map"),
        bitmap("roughness_map"),
        text("permittivity_map_range", "3 28"),
        text("roughness_map_range", "0.001 0.011"),
        text("map_extent", "-3,-2,3,2"),
    ]
    scene = load_scene(scene_file(tmp_path, material(*inside)))
    found = maps_of(scene).classes
    assert found is not None
    there = [found.materials[int(i)] for i in at(scene, found.bitmap, POINTS)]
    share = GREY.ravel() / 255.0
    np.testing.assert_allclose([m.permittivity.real for m in there], 3.0 + 25.0 * share)
    np.testing.assert_allclose([m.rms_height for m in there], 0.001 + 0.01 * share)
    own = scene.materials[0].permittivity
    np.testing.assert_allclose(
        [m.permittivity.imag / m.permittivity.real for m in there], own.imag / own.real, rtol=1e-12
    )


def test_many_values_are_rounded_to_equal_steps_in_db() -> None:
    values = np.random.default_rng(3).uniform(3.0, 30.0, (70, 80))
    number, parts = vary_material(Material("soil", permittivity=9.0 - 1.0j), values, None)
    assert len(parts) <= MOST_LEVELS
    off = np.abs(np.log([parts[int(k)].permittivity.real for k in number.ravel()] / values.ravel()))
    assert off.max() <= 0.5 * np.log(10.0) / (MOST_LEVELS - 1) * (1.0 + 1e-9)


PLY = """ply
format ascii 1.0
element vertex 4
property double x
property double y
property double z
property float s
property float t
property uchar wet
element face 2
property list uchar int vertex_indices
property float rough
end_header
-3 -2 0 0 0 0
3 -2 0 1 0 255
3 2 0 1 1 255
-3 2 0 0 1 0
3 0 1 2 0.25
3 0 2 3 0.75
"""


def test_attributes_of_a_ply_file(tmp_path: Path) -> None:
    (tmp_path / "field.ply").write_text(PLY)
    shape = '<shape type="ply"><string name="filename" value="field.ply"/>'
    attribute = '<texture type="mesh_attribute" name="{}"><string name="name" value="{}"/></texture>'
    inside = [attribute.format("sigma0_map", "vertex_wet"), attribute.format("roughness_map", "face_rough")]
    scene = load_scene(scene_file(tmp_path, material(*inside, text("roughness_map_range", "0 0.1")), shape))
    maps, geometry = maps_of(scene), scene.geometry
    assert maps.level is not None and maps.classes is not None
    np.testing.assert_array_equal(geometry.corner_values["vertex_wet"][:, :, 0], [[0, 1, 1], [0, 1, 0]])
    triangles = geometry.vertices[geometry.faces]
    uv = maps.level.placement.at(triangles, geometry.corner_values)
    # bilinear between two texels' middles: linear in the attribute
    np.testing.assert_allclose(uv[..., 0], 0.25 + 0.5 * geometry.corner_values["vertex_wet"][..., 0])
    heights = [
        maps.classes.materials[int(i)].rms_height for i in at(scene, maps.classes.bitmap, [(1, -1), (-1, 1)])
    ]
    # tol: half a step of 64 from a thousandth of the largest to it, equal in dB
    np.testing.assert_allclose(heights, [0.025, 0.075], rtol=0.5 * np.log(1e3) / (MOST_LEVELS - 1))
    scene = load_scene(scene_file(tmp_path, material(bitmap("sigma0_map")), shape))
    level = maps_of(scene).level
    assert level is not None
    np.testing.assert_allclose(at(scene, level, POINTS), np.concatenate([GREY[1], GREY[0]]) / 255.0)


def test_texture_coordinates_of_an_obj_file_are_upside_down(tmp_path: Path) -> None:
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in SQUARE)
    (tmp_path / "field.obj").write_text(
        corners + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/-2 4/-1\n"
    )
    shape = '<shape type="obj"><string name="filename" value="field.obj"/>'
    scene = load_scene(scene_file(tmp_path, material(bitmap("sigma0_map")), shape))
    level = maps_of(scene).level
    assert level is not None
    np.testing.assert_allclose(at(scene, level, POINTS), GREY.ravel() / 255.0)


def test_maps_stay_where_they_are_when_the_scene_gets_a_frame_of_its_own(tmp_path: Path) -> None:
    shape = SHAPE.replace("</transform>", '<translate x="400000" y="5000000"/></transform>')
    inside = [bitmap("sigma0_map"), text("map_extent", "399997 4999998 400003 5000002")]
    scene = load_scene(scene_file(tmp_path, material(*inside), shape))
    assert scene.offset.any()
    level = maps_of(scene).level
    assert level is not None
    shift = np.array([4e5, 5e6]) - scene.offset[:2]
    np.testing.assert_allclose(at(scene, level, np.array(POINTS) + shift), GREY.ravel() / 255.0)


def test_faces_that_are_cleaned_away_take_their_attributes_along() -> None:
    own = Material(
        "ground",
        pec=True,
        diffuse_law="constant",
        diffuse_level_db=-10.0,
        maps=SurfaceMaps(level=Bitmap(np.ones((1, 1)), place_on_mesh(("face_k",)))),
    )
    faces = [[0, 1, 1], [0, 1, 2], [2, 1, 0], [0, 2, 3]]
    mesh = SceneMesh(SQUARE, faces, own, attributes={"face_k": np.array([0.1, 0.2, 0.3, 0.4])})
    scene = build_scene([mesh])
    np.testing.assert_array_equal(scene.geometry.corner_values["face_k"][:, 0, 0], [0.2, 0.4])


def test_attributes_in_python_are_checked() -> None:
    for name, values in (("uv", np.zeros((4, 3))), ("vertex_a", np.zeros(3)), ("face_b", np.zeros(4))):
        with pytest.raises(SceneError, match=f'attribute "{name}" has the shape'):
            build_scene([SceneMesh(SQUARE, FACES, "concrete", attributes={name: values})])


def test_the_plan_has_it_on_only_where_the_scene_has_it() -> None:
    planned = {name: plan_effects(load_scene(name)) for name in ("land_cover", "tower")}
    found = planned["land_cover"].decision("texture")
    assert found is not None and found.on and found.error_db > -10.0
    assert "map of 7 materials on ground_cover" in found.why and planned["land_cover"].flags.texture
    absent = planned["tower"].decision("texture")
    assert absent is not None and not absent.on and absent.error_db == -np.inf
    assert not planned["tower"].flags.texture


TWO_CLASSES = named("class_0", -10) + named("class_51", -12)
ALL_CLASSES = TWO_CLASSES + named("class_102", -3) + named("class_255", -4)
VACUUM = '<bsdf type="radar_material" name="class_255"><float name="permittivity_real" value="1"/></bsdf>'


@pytest.mark.parametrize(
    ("bsdf", "message"),
    [
        (material(text("map_extent", "0 0 1 1")), "map_extent has no effect without a map"),
        (material(text("sigma0_map_range", "0 1")), "sigma0_map_range has no effect without sigma0_map"),
        (material('<float name="sigma0_map" value="1"/>'), "sigma0_map is no texture"),
        (material(bitmap("sigma0_map"), law=SMOOTH), "sigma0_map has no effect without a diffuse return"),
        (
            material(bitmap("sigma0_map"), text("map_extent", "0 0 1")),
            'map_extent = "0 0 1" is not 4 numbers',
        ),
        (material(bitmap("sigma0_map"), text("map_extent", "0 0 -1 1")), "has no area"),
        (material(bitmap("sigma0_map", "colour.png")), "holds colours; a map of numbers is grey"),
        (material(bitmap("sigma0_map", "none.png")), 'bitmap "none.png" not found'),
        (material(bitmap("sigma0_map", "scene.xml")), "cannot read bitmap scene.xml"),
        (material(bitmap("sigma0_map", "../grey.png")), "lies outside the folder of the scene"),
        (
            material(bitmap("sigma0_map", more='<boolean name="raw" value="false"/>')),
            "raw = false is for colours",
        ),
        (material(bitmap("sigma0_map", more=text("filtre", "nearest"))), 'unknown parameter "filtre"'),
        (material(bitmap("permittivity_map", more=text("filter_type", "bilinear"))), "is not nearest"),
        (material(bitmap("permittivity_map")), "permittivity_map goes down to 0, below 1"),
        (
            material(bitmap("roughness_map"), text("roughness_map_range", "-1 1")),
            "goes down to -1 m, below 0 m",
        ),
        (material('<texture type="checkerboard" name="sigma0_map"/>'), '"checkerboard" is no map'),
        (
            material('<float name="texture_shape" value="2"/>'),
            "texture_shape is given without texture_length",
        ),
        (
            material('<float name="texture_shape" value="0.01"/><float name="texture_length" value="2"/>'),
            "texture_shape = 0.01 is not between 0.05 and 1000",
        ),
        (
            material(
                '<float name="texture_shape" value="2"/><float name="texture_length" value="2"/>', law=SMOOTH
            ),
            "texture_shape has no effect without a diffuse return",
        ),
        (f'<bsdf type="land_cover">{ALL_CLASSES}</bsdf>', "land_cover has no map"),
        (f'<bsdf type="land_cover">{bitmap("class_map")}</bsdf>', "land_cover names no material"),
        (f'<bsdf type="land_cover">{bitmap("class_map")}{TWO_CLASSES}</bsdf>', r"holds class_255 \(2 pixels"),
        (
            f'<bsdf type="land_cover">{bitmap("class_map")}{ALL_CLASSES}{named("color_000000", 0)}</bsdf>',
            "name all of them in one way",
        ),
        (
            f'<bsdf type="land_cover">{bitmap("class_map")}{named("grass", 0)}</bsdf>',
            '"grass" names no class',
        ),
        (
            f'<bsdf type="land_cover">{bitmap("class_map")}{TWO_CLASSES}{named("class_102", 0)}{VACUUM}</bsdf>',
            "is invisible: a map cannot make holes",
        ),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_line(tmp_path: Path, bsdf: str, message: str) -> None:
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(scene_file(tmp_path, bsdf))
    assert "\n" not in str(caught.value)


def test_a_disk_has_no_texture_coordinates(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="a map needs uv, which a disk does not have here; give map_extent"):
        load_scene(scene_file(tmp_path, material(bitmap("sigma0_map")), '<shape type="disk">'))


def test_maps_of_a_loaded_mitsuba_scene_are_refused(tmp_path: Path) -> None:
    register_plugins()
    loaded = mi.load_file(str(scene_file(tmp_path, material(bitmap("sigma0_map")))))
    with pytest.raises(SceneError, match="its sigma0_map cannot be read from a loaded scene"):
        load_scene(loaded)


def test_maps_of_materials_are_checked() -> None:
    own = Material("soil", permittivity=9.0 - 1.0j)
    plan = place_in_plan((0.0, 0.0, 1.0, 1.0))
    with pytest.raises(SceneError, match="holds numbers from 0 to 0"):
        ClassMap(Bitmap(np.ones((1, 1)), plan), (own,))
    with pytest.raises(SceneError, match="below 0 or no finite number"):
        SurfaceMaps(level=Bitmap(np.full((1, 1), -1.0), plan))
