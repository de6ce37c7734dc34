"""Motion of shapes: from files, dicts and Python into the scene, and through what is done with scenes."""

import pickle
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sarmitsuba import PointTarget, RadarDescription, SceneMesh, build_scene, load_scene, simulate
from sarmitsuba.analysis.point_quality import scene_points
from sarmitsuba.core.errors import SceneError
from sarmitsuba.effects.plan import plan_effects
from sarmitsuba.scene.mesh.tessellate import cube
from sarmitsuba.scene.motion import Motion
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.fingerprint import fingerprint
from sarmitsuba.simulation.planning.sampling.launch_window import launch_windows
from sarmitsuba.simulation.planning.sampling.movers import azimuth_shift, describe_vanished, fastest, swept
from tests.support.unweighted import focus


def scene_of(tmp_path: Path, shapes: str) -> Scene:
    path = tmp_path / "scene.xml"
    path.write_text(
        '<scene version="3.0.0"><integrator type="sar_path"/><sensor type="sar_antenna"/>'
        f'<bsdf type="radar_material" id="metal"><string name="material" value="pec"/></bsdf>{shapes}</scene>',
        encoding="utf-8",
    )
    return load_scene(path)


def shape(inner: str = "", kind: str = "cube", name: str = "car", bsdf: str = '<ref id="metal"/>') -> str:
    return f'<shape type="{kind}" id="{name}">{inner}{bsdf}</shape>'


VECTOR = '<vector name="velocity" x="1" y="-2" z="0.5"/>'


def test_vectors_and_strings_say_the_same(tmp_path: Path) -> None:
    texts = (
        VECTOR,
        '<string name="velocity" value="1 -2 0.5"/>',
        '<string name="velocity" value="1, -2, 0.5"/>',
    )
    for text in texts:
        scene = scene_of(tmp_path, shape(text) + shape(name="house"))
        assert scene.geometry.mesh_motion == (Motion((1.0, -2.0, 0.5)), Motion())
        ((motion, faces),) = scene.geometry.moving_meshes()
        assert motion == Motion((1.0, -2.0, 0.5)) and faces == slice(0, 12)


def test_to_world_turns_the_shape_and_not_its_way(tmp_path: Path) -> None:
    turned = '<transform name="to_world"><rotate z="1" angle="90"/></transform>'
    scene = scene_of(tmp_path, shape(VECTOR + '<string name="acceleration" value="0 0 -9.8"/>' + turned))
    assert scene.geometry.mesh_motion == (Motion((1.0, -2.0, 0.5), (0.0, 0.0, -9.8)),)


def test_groups_carry_their_shapes(tmp_path: Path) -> None:
    inner = shape(name="body") + shape(name="cabin")
    scene = scene_of(tmp_path, shape(VECTOR + inner, "merge", "car", "") + shape(name="house"))
    moves = dict(zip(scene.geometry.mesh_names, scene.geometry.mesh_motion, strict=True))
    assert moves == {"body": Motion((1.0, -2.0, 0.5)), "cabin": Motion((1.0, -2.0, 0.5)), "house": Motion()}
    group = f'<shape type="shapegroup" id="cars">{shape(name="one")}</shape>'
    scene = scene_of(tmp_path, group + shape(VECTOR, "instance", "a", '<ref id="cars"/>'))
    assert scene.geometry.mesh_motion == (Motion((1.0, -2.0, 0.5)),)


def test_points_move(tmp_path: Path) -> None:
    point = shape(VECTOR, "sphere", "buoy", '<bsdf type="point_scatterer"/>')
    scene = scene_of(tmp_path, point + shape(name="house"))
    (buoy,) = scene.points
    np.testing.assert_allclose(buoy.position_at(np.array([0.0, 2.0])), [[0.0, 0.0, 0.0], [2.0, -4.0, 1.0]])
    assert scene.moves and not scene.geometry.moves and "1 moving" in repr(scene)
    assert not scene.frozen().moves and scene.frozen().geometry is scene.geometry


def test_where_nothing_moves_nothing_is_kept(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, shape() + shape('<string name="velocity" value="0 0 0"/>', name="house"))
    assert scene.geometry.mesh_motion == () and not scene.moves and scene.frozen() is scene
    assert "moving" not in repr(scene)


@pytest.mark.parametrize(
    ("inner", "message"),
    [
        (
            '<string name="velocity" value="fast"/>',
            "velocity = .* is not three finite numbers; give east, north, up in m/s",
        ),
        ('<string name="velocity" value="1 2"/>', "velocity = .* is not three finite numbers"),
        (
            '<float name="acceleration" value="1"/>',
            "acceleration = .* is not three finite numbers; .* in m/s\\^2",
        ),
        ('<string name="velocity" value="2e4 0 0"/>', "velocity = 20000 m/s is above the bound 10000 m/s"),
        ('<string name="speed" value="1 0 0"/>', 'unknown parameter "speed"'),
    ],
)
def test_wrong_motion_is_refused_in_one_line(tmp_path: Path, inner: str, message: str) -> None:
    with pytest.raises(SceneError, match=rf'scene.xml: shape "car": {message}') as error:
        scene_of(tmp_path, shape(inner))
    assert "\n" not in str(error.value)
    twice = shape(VECTOR + shape(VECTOR, name="body"), "merge", "car", "")
    with pytest.raises(
        SceneError, match="a velocity inside a shape that moves; give the velocity to one of the two"
    ):
        scene_of(tmp_path, twice)


def built(**motion: object) -> Scene:
    """A cube of 2 m at rest or moving, and a point that moves with it."""
    move = Motion.of(**motion)  # type: ignore[arg-type]
    return build_scene(
        [SceneMesh(*cube(), "pec", "car", motion=move), SceneMesh(*cube(), "pec", "house")],
        [PointTarget("light", np.array([0.0, 0.0, 3.0]), motion=move)],
        radar=RadarDescription(slant_range=5e3, azimuth_resolution=1.0, speed=100.0),
    )


def test_scenes_keep_motion_through_what_is_done_with_them() -> None:
    scene = built(velocity=[3.0, 4.0, 0.0])
    for other in (
        pickle.loads(pickle.dumps(scene)),
        scene.replace(look_angle_deg=35.0),
        scene.replace(prf=900.0),
    ):
        assert other.geometry.mesh_motion == scene.geometry.mesh_motion
        assert other.points[0].motion == Motion((3.0, 4.0, 0.0))
    still, faster = built(), built(velocity=(3.0, 4.0, 0.001))
    assert len({fingerprint(s) for s in (scene, still, faster)}) == 3
    assert fingerprint(scene) == fingerprint(built(velocity=np.array([3, 4, 0])))


def test_the_plan_says_what_moves_and_how_far() -> None:
    scene = built(velocity=(3.0, 4.0, 0.0))
    span = float(np.ptp(scene.radar.track.time))
    decision = plan_effects(scene).decision("moving_targets")
    assert decision is not None and decision.on
    (way,) = re.findall(r"2 shapes move, up to (.*) m during the aperture", decision.why)
    assert float(way) == pytest.approx(5.0 * span, rel=5e-3)  # tol: three digits
    at_rest = plan_effects(built()).decision("moving_targets")
    assert at_rest is not None and not at_rest.on and at_rest.why == "no shape moves"
    assert plan_effects(scene).flags.motion and not plan_effects(built()).flags.motion


def test_light_goes_where_the_shape_goes() -> None:
    scene = built(velocity=(0.0, 20.0, 0.0))
    track, (at_rest,) = scene.radar.track, launch_windows(scene.frozen())
    (window,) = launch_windows(scene)
    ends = 20.0 * track.time[[0, -1]]
    assert window.box[0, 1] == pytest.approx(at_rest.box[0, 1] + ends[0])
    assert window.box[1, 1] == pytest.approx(at_rest.box[1, 1] + ends[1])
    (corners,) = swept(scene, (0, track.n_pulses))
    np.testing.assert_allclose(corners[[0, -1], :, 1].mean(axis=1), ends)
    assert fastest(scene) == 20.0
    # 5 km, 100 m/s: 1 m/s of range speed is 50 m of the track
    los = -track.center_position / np.linalg.norm(track.center_position)
    shift = azimuth_shift(scene.radar, np.zeros((1, 3)), los[None], np.zeros(1))
    assert shift[0] == pytest.approx(-np.linalg.norm(track.center_position) / 100.0)


def test_a_shape_whose_image_is_elsewhere_is_lit_for_it() -> None:
    """Off the image itself, but it shows there; beside both it gets no light."""
    meshes = [SceneMesh(*cube(), "pec", "house")]
    radar = RadarDescription(slant_range=5e3, azimuth_resolution=1.0, speed=100.0, look_angle_deg=45.0)
    far = np.eye(4)
    far[1, 3] = 150.0  # north, along the flight
    speed = 150.0 / 50.0 * np.sqrt(2.0)  # eastwards, away: shows 150 m to the south
    for velocity, lit in ((speed, True), (-speed, False), (0.1, False)):
        car = SceneMesh(*cube(), "pec", "car", to_world=far, motion=Motion((velocity, 0.0, 0.0)))
        scene = build_scene([*meshes, car], radar=radar)
        image = replace(scene.image, center_x=0.0, center_y=0.0, extent_azimuth=40.0, extent_range=40.0)
        (window,) = launch_windows(replace(scene, image=image))
        assert bool(window.box[1, 1] > 149.0) is lit


def test_a_shape_displaced_out_of_the_image_is_named_with_the_size_that_shows_it() -> None:
    """5 km, 100 m/s: 2 m/s eastwards at a look angle of 45 deg displace the echo by 71 m."""
    for velocity, extent, gone in (
        (2.0, 40.0, True),
        (2.0, 160.0, False),
        (0.2, 40.0, False),
        (0.0, 40.0, False),
    ):
        car = SceneMesh(*cube(), "pec", "car", motion=Motion((velocity, 0.0, 0.0)))
        radar = RadarDescription(slant_range=5e3, azimuth_resolution=1.0, speed=100.0, look_angle_deg=45.0)
        scene = build_scene([SceneMesh(*cube(), "pec", "house"), car], radar=radar)
        image = replace(scene.image, center_x=0.0, center_y=0.0, extent_azimuth=extent, extent_range=40.0)
        said = describe_vanished(replace(scene, image=image))
        assert ("car: the range rate displaces the echo by up to 7" in said) == gone
        assert not gone or float(said.split("image_extent_azimuth to ")[1].split(" m")[0]) > 2.0 * 70.7


def test_quality_leaves_out_points_that_show_elsewhere() -> None:
    scene = build_scene(
        points=[
            PointTarget("rests", np.zeros(3)),
            PointTarget("moves", np.array([3.0, 0.0, 0.0]), motion=Motion((0.0, 1.0, 0.0))),
        ],
        radar=RadarDescription(slant_range=5e3, azimuth_resolution=2.0, speed=100.0),
    )
    assert [point.name for point in scene_points(focus(simulate(scene), request=scene.image))] == ["rests"]
