"""Plugins under Mitsuba's own loader, and the scene read back from what it loaded."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.core.errors import RadarError, SceneError
from sarmitsuba.loading.from_mitsuba import scene_from_mitsuba
from sarmitsuba.loading.library import resolve
from sarmitsuba.loading.load import load_scene
from sarmitsuba.loading.tables import TABLES
from sarmitsuba.scene.scatterers import SCATTERERS

MIXED = """<scene version="3.0.0">
<integrator type="sar_path"><integer name="max_depth" value="2"/><string name="speckle" value="off"/></integrator>
<sensor type="sar_antenna" id="radar"><float name="slant_range" value="8123.456789012345"/>
<film type="range_film"><string name="image_grid" value="ground"/></film></sensor>
<bsdf type="radar_material" id="steel"><string name="material" value="metal"/></bsdf>
<shape type="sphere" id="ball"><point name="center" x="1" y="2" z="3"/><float name="radius" value="0.5"/>
<transform name="to_world"><scale value="2"/></transform><ref id="steel"/></shape>
<shape type="cylinder"><point name="p0" x="-4" y="0" z="0"/><point name="p1" x="-3" y="1" z="2"/>
<float name="radius" value="0.3"/><ref id="steel"/></shape>
<shape type="disk"><transform name="to_world"><translate y="-6"/></transform>
<bsdf type="itu-radio-material" id="stone"><string name="type" value="marble"/>
<float name="scattering_coefficient" value="0.2"/></bsdf></shape>
<shape type="rectangle"><bsdf type="radio-material" id="soil"><float name="relative_permittivity" value="4"/>
<float name="scattering_coefficient" value="0.3"/></bsdf></shape>
<shape type="cube"><transform name="to_world"><translate x="9"/></transform><ref id="steel"/></shape>
<shape type="sphere" id="corner"><point name="center" x="0" y="5" z="1"/>
<bsdf type="point_scatterer" id="pt"><float name="rcs_dbsm" value="7"/></bsdf></shape>
</scene>"""


@pytest.fixture(scope="module")
def mi():
    sarmitsuba.register_plugins()
    import mitsuba

    return mitsuba


def test_every_documented_plugin_is_registered() -> None:
    names = set(sarmitsuba.register_plugins())
    left_to_sionna = {"itu-radio-material", "radio-material", "absorber-radio-material", "holder-material"}
    assert names | (left_to_sionna if "sionna.rt" in sys.modules else set()) == {
        *TABLES,
        *SCATTERERS.own_names,
    }


def test_the_same_scene_by_both_routes(mi, tmp_path: Path) -> None:
    path = tmp_path / "mixed.xml"
    path.write_text(MIXED, encoding="utf-8")
    ours, theirs = load_scene(path), scene_from_mitsuba(mi.load_file(str(path)))
    assert theirs.settings == ours.settings
    assert theirs.materials and set(theirs.materials) == set(ours.materials)
    # tol: Mitsuba's vertices are float32
    np.testing.assert_allclose(theirs.geometry.bounds, ours.geometry.bounds, atol=2e-4)
    np.testing.assert_allclose(theirs.points[0].position, ours.points[0].position, atol=1e-6)
    assert theirs.points[0].rcs == ours.points[0].rcs
    assert theirs.image.grid == "ground"
    line = theirs.radar.track.center_position - theirs.radar.aim_point
    assert np.linalg.norm(line) == pytest.approx(8123.456789012345, rel=1e-12)  # tol: float64 differences


def test_curved_shapes_keep_their_size(mi, tmp_path: Path) -> None:
    path = tmp_path / "mixed.xml"
    path.write_text(MIXED, encoding="utf-8")
    geometry = scene_from_mitsuba(mi.load_file(str(path))).geometry
    first = geometry.mesh_names.index("ball")
    faces = geometry.faces[geometry.mesh_face_offset[first] : geometry.mesh_face_offset[first + 1]]
    radius = np.linalg.norm(geometry.vertices[np.unique(faces)] - [2, 4, 6], axis=1)
    assert np.abs(radius - 1.0).max() < 2e-3  # tol: sagitta of lambda / 32 at X band
    assert (
        np.unique(
            geometry.face_group[geometry.mesh_face_offset[first] : geometry.mesh_face_offset[first + 1]]
        ).size
        == 1
    )


@pytest.mark.parametrize("name", ["dihedral", "tower", "point", "bridge"])
def test_shipped_scenes_by_both_routes(mi, name: str) -> None:
    ours, theirs = load_scene(name), scene_from_mitsuba(mi.load_file(str(resolve(name))))
    assert theirs.geometry.n_faces == ours.geometry.n_faces
    assert theirs.image == ours.image
    assert theirs.radar.track.n_pulses == ours.radar.track.n_pulses


def test_render_returns_the_focused_image(mi) -> None:
    tensor = mi.render(mi.load_file(str(resolve("point"))))
    pixels = np.array(tensor)
    power = pixels[..., 0] ** 2 + pixels[..., 1] ** 2
    rcs = load_scene("point").points[0].rcs
    assert power.max() == pytest.approx(rcs, rel=0.01)  # tol: the peak may lie half a pixel off the grid
    assert pixels.ndim == 3


def test_plugins_print_their_parameters(mi) -> None:
    scene = mi.load_file(str(resolve("point")))
    assert "max_depth = 0" in str(scene.integrator())
    assert "center_frequency" in str(scene.sensors()[0]) and "gridding_width = 4" in str(
        scene.sensors()[0].film()
    )


def test_a_bad_value_keeps_its_line_inside_mitsubas_error(mi) -> None:
    with pytest.raises(RuntimeError, match="prf = -1 Hz is below the bound 0 Hz"):
        mi.load_dict({"type": "sar_antenna", "prf": -1.0})
    with pytest.raises(RuntimeError, match='unknown parameter "max_dept"; did you mean "max_depth"'):
        mi.load_dict({"type": "sar_path", "max_dept": 3})


def test_radar_materials_can_be_looked_at_with_light(mi) -> None:
    scene = mi.load_dict(
        {
            "type": "scene",
            "light": {"type": "constant"},
            "plate": {"type": "rectangle", "bsdf": {"type": "radar_material", "material": "pec"}},
            "camera": {
                "type": "perspective",
                "fov": 20,
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
            },
        }
    )
    picture = np.array(mi.render(scene, integrator=mi.load_dict({"type": "direct"}), spp=256))
    assert picture[1:3, 1:3].mean() == pytest.approx(0.5, abs=0.05)  # tol: Monte Carlo, albedo 0.5


def test_ordinary_bsdfs_of_a_loaded_scene(mi) -> None:
    scene = mi.load_dict(
        {
            "type": "scene",
            "sensor": {"type": "sar_antenna"},
            "a": {"type": "cube", "bsdf": {"type": "twosided", "inner": {"type": "conductor"}}},
            "b": {"type": "sphere", "bsdf": {"type": "null"}},
        }
    )
    with pytest.warns(sarmitsuba.core.errors.SarmitsubaWarning) as caught:
        loaded = scene_from_mitsuba(scene)
    assert sorted(str(w.message).split('"')[1] for w in caught) == ["conductor", "null"]
    assert sorted((m.pec, m.invisible) for m in loaded.materials) == [(False, True), (True, False)]


CONCRETE = {"type": "radar_material", "material": "concrete"}
FILM = {"type": "range_film", "image_extent_range": 33.0, "rfilter": {"type": "box"}}
METAL = {"type": "conductor"}


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
@pytest.mark.parametrize(
    ("bsdf", "seen"),
    [
        ({"type": "twosided", "bsdf": CONCRETE}, "concrete"),
        (
            {"type": "mask", "opacity": 0.9, "nested_bsdf": {"type": "twosided", "brdf_0": CONCRETE}},
            "concrete",
        ),
        ({"type": "mask", "opacity": 0.2, "nested_bsdf": CONCRETE}, "nothing"),
        ({"type": "blendbsdf", "weight": 0.9, "bsdf_0": METAL, "bsdf_1": CONCRETE}, "concrete"),
        ({"type": "blendbsdf", "weight": 0.1, "bsdf_0": METAL, "bsdf_1": CONCRETE}, "metal"),
        ({"type": "holder-material", "bsdf": CONCRETE}, "concrete"),
    ],
)
def test_nested_bsdfs_and_films_by_both_routes(mi, bsdf, seen: str) -> None:
    radar = {"type": "sar_antenna", "film": FILM, "sampler": {"type": "independent"}}
    plain = {"type": "cube", "bsdf": {"type": "radar_material", "material": "wood"}}
    description = {"type": "scene", "radar": radar, "a": {"type": "cube", "bsdf": bsdf}, "b": plain}
    concrete = load_scene({**description, "a": {"type": "cube", "bsdf": CONCRETE}}).materials[0].permittivity
    for scene in (load_scene(description), load_scene(mi.load_dict(description))):
        assert scene.image.extent_range == 33.0
        first = next(m for m in scene.materials if m.permittivity != load_scene_of(plain).permittivity)
        assert first.invisible == (seen == "nothing") and first.pec == (seen == "metal")
        if seen == "concrete":
            assert first.permittivity == pytest.approx(concrete, rel=1e-6)


def load_scene_of(shape: dict[str, object]):
    """The one material of a shape."""
    return load_scene({"type": "scene", "radar": {"type": "sar_antenna"}, "shape": shape}).materials[0]


def test_the_radar_is_found_among_cameras(mi) -> None:
    description = {
        "type": "scene",
        "camera": {"type": "perspective"},
        "radar": {"type": "sar_antenna", "prf": 321.0},
        "a": {"type": "cube", "bsdf": CONCRETE},
    }
    tracks = [load_scene(s).radar.track.time for s in (description, mi.load_dict(description))]
    assert np.diff(tracks[1]) == pytest.approx(1.0 / 321.0)
    np.testing.assert_array_equal(*tracks)


def test_a_film_of_light_is_refused(mi) -> None:
    with pytest.raises(RuntimeError, match="cannot record echoes; use range_film"):
        mi.load_dict({"type": "sar_antenna", "film": {"type": "hdrfilm"}})


OTHER_VARIANT = """
import mitsuba as mi
mi.set_variant("scalar_rgb")
import sarmitsuba
box = {"type": "cube", "to_world": mi.ScalarTransform4f().scale(3)}
radar = {"type": "sar_antenna"}
print(sarmitsuba.load_scene({"type": "scene", "radar": radar, "box": box}).geometry.bounds[1, 0], mi.variant())
mi.set_variant("scalar_rgb")
made, loaded = mi.load_dict(box), mi.load_dict({"type": "scene", "box": box})
for scene in ({"type": "scene", "radar": radar, "box": made}, loaded):
    try:
        sarmitsuba.load_scene(scene, radar="airborne_x")
    except sarmitsuba.core.errors.SceneError as error:
        print(error)
mi.set_variant("scalar_rgb")
sarmitsuba.register_plugins()
print(mi.variant(), sarmitsuba.load_scene(mi.load_dict({"type": "scene", "r": radar, "b": box})).geometry.n_faces)
"""


def test_other_variants_before_and_after() -> None:
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", OTHER_VARIANT], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    first, made, loaded, last = run.stdout.strip().splitlines()
    assert first.startswith("3.0 llvm") or first.startswith("3.0 cuda")
    assert "under the variant scalar_rgb" in made and "register_plugins()" in loaded
    assert last.endswith(" 12")


def test_what_cannot_be_read_is_said(mi) -> None:
    light = mi.load_dict({"type": "scene", "camera": {"type": "perspective"}, "a": {"type": "cube"}})
    with pytest.raises(RadarError, match="the sensor is not a sar_antenna"):
        scene_from_mitsuba(light)
    group = {"type": "shapegroup", "box": {"type": "cube"}}
    instanced = mi.load_dict(
        {
            "type": "scene",
            "sensor": {"type": "sar_antenna"},
            "group": group,
            "one": {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}},
        }
    )
    with pytest.raises(SceneError, match=r"a instance cannot be read .* sarmitsuba.load_scene"):
        scene_from_mitsuba(instanced)


SIONNA = """
import warnings
{first}
import sarmitsuba
sarmitsuba.register_plugins()
{last}
sarmitsuba.register_plugins()
import mitsuba as mi
from sarmitsuba.loading.from_mitsuba import scene_from_mitsuba
scene = mi.load_file({path!r})
ours, theirs = sarmitsuba.load_scene({path!r}), scene_from_mitsuba(scene)
other = {{m.name: m.permittivity for m in theirs.materials}}
difference = max(abs(m.permittivity - other[m.name]) for m in ours.materials)
print(mi.variant(), type(scene.shapes()[0].bsdf()).__module__.split(".")[0], len(ours.materials), difference < 1e-5)
"""


@pytest.mark.slow
@pytest.mark.parametrize("order", ["sionna first", "sionna last"])
def test_beside_sionna_rt(tmp_path: Path, order: str) -> None:
    pytest.importorskip("importlib.util")
    import importlib.util

    if importlib.util.find_spec("sionna") is None:
        pytest.skip("sionna-rt is not installed")
    path = tmp_path / "scene.xml"
    path.write_text(MIXED, encoding="utf-8")
    load = "import sionna.rt"
    code = SIONNA.format(
        first=load if order == "sionna first" else "",
        last=load if order == "sionna last" else "",
        path=str(path),
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.split()[-2:] == ["3", "True"]
