"""Scenes without a file: built in Python, given as a dict, or loaded by Mitsuba; all the same as the file."""

import os
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
import trimesh

import sarmitsuba
from sarmitsuba.core.errors import RadarError, SceneError
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.loading.load import load_scene
from sarmitsuba.radar.description import SENSOR, RadarDescription
from sarmitsuba.radar.film import FILM, FilmDescription
from sarmitsuba.radar.track import Track
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh.tessellate import cube, rectangle
from sarmitsuba.scene.settings import TraceSettings

RADAR = RadarDescription(
    slant_range=10000.0,
    look_angle_deg=45.0,
    aim_x=0.0,
    aim_y=0.0,
    aim_z=0.0,
    center_frequency=9.65e9,
    bandwidth=300e6,
    n_pulses=32,
    azimuth_resolution=20.0,
    polarisation="HH,VV",
)
FILM_80 = FilmDescription(image_extent_azimuth=80.0, image_extent_range=16.0)


def placed(scale: float, y_deg: float, shift: tuple[float, float, float]) -> np.ndarray:
    angle = np.radians(y_deg)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    matrix = np.eye(4)
    matrix[:3, :3] = turn * scale
    matrix[:3, 3] = shift
    return matrix


def python_dihedral():
    return build_scene(
        meshes=[
            SceneMesh(*rectangle(), "pec", "floor", to_world=placed(0.5, 0, (-0.5, 0, 0))),
            SceneMesh(*rectangle(), "pec", "wall", to_world=placed(0.5, -90, (0, 0, 0.5))),
        ],
        radar=RADAR,
        film=FILM_80,
        name="dihedral",
    )


def test_a_scene_built_in_python_gives_the_raw_data_of_the_file_to_the_bit() -> None:
    # a scene made in memory keeps one set of rays unless its settings ask for two
    ours, shipped = python_dihedral().replace(keep_subsets=True), load_scene("dihedral")
    # tol: the cosine of 90 degrees
    np.testing.assert_allclose(ours.geometry.vertices, shipped.geometry.vertices, atol=1e-30)
    assert ours.geometry.mesh_names == shipped.geometry.mesh_names
    assert (ours.settings, ours.image) == (shipped.settings, shipped.image)
    np.testing.assert_array_equal(
        sarmitsuba.simulate(ours, seed=3).data, sarmitsuba.simulate(shipped, seed=3).data
    )


def dict_dihedral() -> dict[str, object]:
    from mitsuba import ScalarTransform4d

    t = ScalarTransform4d
    return {
        "type": "scene",
        "integrator": {"type": "sar_path"},
        "sensor": {
            "type": "sar_antenna",
            **{f.name: getattr(RADAR, f.name) for f in fields(RADAR) if getattr(RADAR, f.name) != f.default},
            "mode": "stripmap",
            "film": {"type": "range_film", "image_extent_azimuth": 80.0, "image_extent_range": 16.0},
        },
        "floor": {
            "type": "rectangle",
            "to_world": t().translate([-0.5, 0, 0]).scale(0.5),
            "bsdf": {"type": "radar_material", "material": "pec"},
        },
        "wall": {
            "type": "rectangle",
            "to_world": t().translate([0, 0, 0.5]).rotate([0, 1, 0], -90).scale(0.5),
            "surface": {"type": "radar_material", "id": "metal", "material": "pec"},
        },
    }


@pytest.fixture
def description() -> dict[str, object]:
    sarmitsuba.register_plugins()
    scene = dict_dihedral()
    scene["sensor"].pop("mode_parameters", None)
    return scene


def test_a_dict_is_read_like_the_file(description: dict[str, object]) -> None:
    ours, shipped = load_scene(description), load_scene("dihedral")
    # tol: float64 rounding of the transforms
    np.testing.assert_allclose(ours.geometry.vertices, shipped.geometry.vertices, atol=1e-12)
    assert (ours.settings, ours.image) == (shipped.settings, shipped.image)
    assert [m.pec for m in ours.materials] == [True, True]
    assert [m.name for m in ours.materials] == ["radar_material_1", "metal"]


def test_what_mitsuba_loaded_from_the_dict_is_taken_as_it_is(description: dict[str, object]) -> None:
    import mitsuba as mi

    ours, shipped = load_scene(mi.load_dict(description)), load_scene("dihedral")
    np.testing.assert_allclose(ours.geometry.bounds, shipped.geometry.bounds, atol=1e-6)  # tol: float32
    assert (ours.settings, ours.image) == (shipped.settings, shipped.image)
    with_object = {**description, "floor": mi.load_dict(description["floor"])}
    np.testing.assert_array_equal(load_scene(with_object).geometry.bounds, ours.geometry.bounds)


def test_overrides_and_a_radar_file_hold_for_every_source(description: dict[str, object]) -> None:
    import mitsuba as mi

    given = {"sar_path.max_depth": "3", "bandwidth": "1"}
    with pytest.raises(SceneError, match='parameter "bandwidth" = 1 is not used; only a file has any'):
        load_scene(description, parameters=given)
    del given["bandwidth"]
    for source in (description, mi.load_dict(description)):
        scene = load_scene(
            source, radar="airborne_x", parameters={**given, "range_film.image_grid": "ground"}
        )
        assert (scene.settings.max_depth, scene.image.grid) == (3, "ground")
        assert scene.radar.track.n_pulses > 32


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"sensor": {"type": "sar_antena"}},
            'dict: there is no plugin "sar_antena"; did you mean "sar_antenna"',
        ),
        (
            {"sensor": {"type": "sar_antenna", "prf": -1.0}},
            'dict: sensor "sensor": prf = -1 Hz is below the bound',
        ),
        (
            {"sensor": {"type": "sar_antenna", "film": {"type": "hdrfilm"}}},
            "cannot record echoes; use range_film",
        ),
        (
            {"floor": {"type": "rectangle", "bsdf": {"type": "radar_material", "material": "irn"}}},
            'dict: bsdf "floor.bsdf": material = "irn" is not one of',
        ),
        ({"type": "cube"}, "dict: "),
    ],
)
def test_a_dict_that_is_wrong_is_refused_in_one_line(
    description: dict[str, object], change: dict[str, object], message: str
) -> None:
    with pytest.raises((SceneError, RadarError), match=message) as caught:
        load_scene({**description, **change})
    assert "\n" not in str(caught.value)


class _Text(str):
    """Text of a user's own class."""


@pytest.mark.parametrize(
    "value",
    [
        None,
        b"x",
        1j,
        object(),
        {1, 2},
        10**400,
        2**63,
        [None],
        [[1.0], "a"],
        int,
        Path("x"),
        np.array(["a", None]),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_dict_with_a_foreign_type_is_refused_by_its_key(
    description: dict[str, object], value: object
) -> None:
    """Mitsuba's parser ends the interpreter (SIGSEGV) on None, and on integers of 400 digits."""
    for change, key in (
        ({"ball": {"type": "sphere", "radius": value}}, '"ball.radius"'),
        ({"extra": value}, '"extra"'),
        ({"ball": {"type": value}}, '"ball.type"'),
    ):
        with pytest.raises(SceneError, match=rf"dict: {key} is of type \w+; give") as caught:
            load_scene({**description, **change})
        assert "\n" not in str(caught.value)


def test_a_dict_that_holds_itself_or_has_other_keys_is_refused_in_one_line(
    description: dict[str, object],
) -> None:
    ring: dict[str, object] = {"type": "scene"}
    ring["again"] = ring
    for change, message in (
        ({"ring": ring}, "more than 200 dicts within each other"),
        ({5: {"type": "cube"}}, "the key 5 is no text"),
        ({None: {"type": "cube"}}, "the key None is no text"),
    ):
        with pytest.raises(SceneError, match=message):
            load_scene({**description, **change})  # type: ignore[dict-item]


def test_numbers_and_texts_of_other_libraries_are_numbers_and_texts(description: dict[str, object]) -> None:
    metal = {"type": "radar_material", "material": "pec"}
    own = MappingProxyType({"type": _Text("sphere"), "radius": np.float32(2.0), "bsdf": metal})
    plain = {"type": "sphere", "radius": 2.0, "bsdf": metal}
    one, other = (load_scene({**description, "ball": ball}) for ball in (own, plain))
    np.testing.assert_array_equal(one.geometry.vertices, other.geometry.vertices)


@pytest.mark.parametrize("seed", [1.5, 2**70, -1, "7", None, True, float("nan")])
def test_a_seed_of_another_type_is_refused_in_one_line(seed: object) -> None:
    with pytest.raises(SceneError, match="is not a whole number between 0 and 2147483647"):
        TraceSettings(seed=seed)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "parameters", [{5: "1"}, {None: "1"}, {"sar_path.seed": None}, {"a": [1]}, ["a=1"], 3]
)
def test_parameters_of_other_types_are_refused_in_one_line(parameters: object) -> None:
    with pytest.raises(SceneError, match="parameters"):
        load_scene("point", parameters=parameters)  # type: ignore[arg-type]


def test_something_else_is_no_scene() -> None:
    with pytest.raises(SceneError, match="list: not a scene; give a file, a shipped name, a dict or an mi"):
        load_scene([1, 2])  # type: ignore[arg-type]


FIRST = """
import mitsuba as mi
mi.set_variant({variant!r})
import sarmitsuba
sarmitsuba.register_plugins()
scene = sarmitsuba.load_scene(mi.load_dict({{
    "type": "scene",
    "integrator": {{"type": "sar_path"}},
    "radar": {{"type": "sar_antenna", "film": {{"type": "range_film", "image_grid": "ground"}}}},
    "box": {{"type": "cube", "bsdf": {{"type": "radar_material", "material": "concrete"}}}},
    "corner": {{"type": "sphere", "bsdf": {{"type": "point_scatterer", "rcs_dbsm": 10.0}}}},
}}))
print(mi.variant(), scene.image.grid, scene.geometry.n_faces, round(scene.points[0].rcs), len(scene.materials))
"""


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "scalar_rgb"])
def test_mitsuba_imported_and_its_variant_set_first(variant: str) -> None:
    code = FIRST.format(variant=variant)
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=os.environ.copy())
    assert run.returncode == 0, run.stderr
    assert run.stdout.split()[1:] == ["ground", "12", "10", "1"]
    kept = variant.startswith("llvm")
    assert (run.stdout.split()[0] == variant) == kept
    assert (f"Mitsuba's variant {variant} traces no radar paths and is replaced" in run.stderr) == (not kept)


def test_meshes_materials_and_points_as_they_come() -> None:
    soil = Material("soil", permittivity=4.0 - 0.1j)
    scene = build_scene(
        [
            SceneMesh.of(trimesh.creation.box(extents=(2, 4, 6)), "concrete", "box"),
            SceneMesh(*cube(), {"material": "concrete", "rms_height": 0.005}, "rough"),
            SceneMesh([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 2]], soil),
            SceneMesh(*cube(), "concrete", "second box", to_world=placed(1.0, 0.0, (8, 0, 0))),
        ],
        [PointTarget("corner", np.array([1.0, 2.0, 3.0]), rcs=10.0)],
        settings=TraceSettings(method="raw", seed=7),
    )
    assert [m.name for m in scene.materials] == ["concrete", "concrete_2", "soil"]
    assert scene.materials[1].rms_height == 0.005
    assert np.bincount(scene.geometry.face_material).tolist() == [24, 12, 1]
    assert (scene.settings.method, scene.settings.seed, scene.path) == ("raw", 7, None)
    assert scene.points[0].rcs == 10.0


def test_a_track_in_python_replaces_angles_and_range() -> None:
    time = np.arange(64) * 0.01
    position = np.stack([np.full(64, -3000.0), 100.0 * (time - 0.3), np.full(64, 4000.0)], axis=1)
    track = Track.from_samples(time, position)
    scene = build_scene([SceneMesh(*cube(), "pec")], track=track)
    np.testing.assert_array_equal(scene.radar.track.position, position)
    with pytest.raises(RadarError, match="speed has no effect beside track"):
        build_scene([SceneMesh(*cube(), "pec")], track=track, radar=RadarDescription(speed=50.0))


@pytest.mark.parametrize(
    ("meshes", "options", "message"),
    [
        ([], {}, "scene: the scene has no scatterers: there is no shape"),
        (
            [SceneMesh(*cube(), "irn")],
            {},
            'material of mesh "mesh": material = "irn" is not one of .* "iron"|irn',
        ),
        (
            [SceneMesh([[0, 0]], [[0, 1, 2]], "pec", "flat")],
            {},
            r'mesh "flat": vertices have the shape \(1, 2\)',
        ),
        ([SceneMesh(np.zeros((3, 3)), [[0, 1, 3]], "pec")], {}, "faces refer to vertices 0 to 3 of 3"),
        ([SceneMesh(np.zeros((3, 3)), [[0.5, 1, 2]], "pec")], {}, "type float64, not .* integers"),
        ([SceneMesh(*cube(), "pec", to_world=np.eye(3))], {}, "to_world is not an affine"),
        ([SceneMesh(*cube(), {"rms": 1.0})], {}, 'unknown parameter "rms"'),
        (
            [SceneMesh(*cube(), "pec")],
            {"radar": RadarDescription(prf=-1.0)},
            "RadarDescription: prf = -1 Hz is below .*, for example prf=0.0$",
        ),
        ([SceneMesh(*cube(), "pec")], {"radar": RadarDescription(mode="side")}, "RadarDescription: mode = "),
        (
            [SceneMesh(*cube(), "pec")],
            {"settings": TraceSettings(effects={"specle": "on"})},
            'TraceSettings: unknown parameter "specle"; did you mean "speckle"',
        ),
        (
            [SceneMesh(*cube(), "pec")],
            {"settings": TraceSettings(max_depth=-1)},
            "TraceSettings: max_depth = -1 is below the bound 0",
        ),
        (
            [SceneMesh(*cube(), Material("a", pec=True)), SceneMesh(*cube(), Material("a"))],
            {},
            'two materials are named "a"',
        ),
        (
            [SceneMesh(*cube(), "pec")],
            {"film": FilmDescription(gridding_width=6), "settings": TraceSettings(gridding_width=5)},
            "gridding_width = 6, but the settings say 5",
        ),
    ],
)
def test_mistakes_in_python_are_said_in_one_line(meshes, options, message) -> None:
    with pytest.raises((SceneError, RadarError), match=message) as caught:
        build_scene(meshes, **options)
    assert "\n" not in str(caught.value)


def test_an_image_centre_of_zero_is_not_the_aim_point() -> None:
    radar = RadarDescription(aim_x=3.0, aim_y=4.0)
    mesh = [SceneMesh(*cube(), "pec")]
    absent = build_scene(mesh, radar=radar).image
    zero = build_scene(mesh, radar=radar, film=FilmDescription(image_center_x=0.0, image_center_y=0.0)).image
    assert (absent.center_x, absent.center_y) == (3.0, 4.0)
    assert (zero.center_x, zero.center_y) == (0.0, 0.0)


@pytest.mark.parametrize(("table", "kind"), [(SENSOR, RadarDescription), (FILM, FilmDescription)])
def test_every_field_is_a_documented_parameter(table, kind) -> None:
    names = [f.name for f in fields(kind) if f.name != "mode_parameters"]
    assert [p.name for p in table.params] == names
    of_modes = {p.name: p.default for p in (*table.params, *table.more()) if p.name not in names}
    assert table.read({}, "x") == {name: getattr(kind(), name) for name in names} | of_modes


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rcs": float("nan")}, r'point "a": rcs = nan m\^2 is outside 0 to 1e\+20'),
        ({"rcs": -1.0}, r"rcs = -1 m\^2 is outside"),
        ({"phase": float("inf")}, "its phase is not finite"),
        ({"position": np.zeros((3, 1))}, r"position \[\[0.0\], .* is not three finite numbers"),
        ({"rcs": "one"}, "position, rcs and phase must be numbers"),
    ],
)
def test_points_without_sense_are_refused_by_name(change: dict[str, Any], message: str) -> None:
    point = PointTarget(**{"name": "a", "position": np.zeros(3), **change})
    with pytest.raises(SceneError, match=message):
        build_scene(points=[point])
