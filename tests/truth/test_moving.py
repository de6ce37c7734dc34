"""Shapes that move, against scenes rebuilt pulse by pulse, against the antenna moved instead, and against theory.

Where they show, how much they smear and their phase along the track are cases of the validation page
(`sarmitsuba/truth/validation/cases/moving.py`).
"""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba import FilmDescription, RadarDescription, SceneMesh, Track, build_scene, focus, simulate
from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.errors import RadarError
from sarmitsuba.machine.backend import dr
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.mesh.tessellate import cube
from sarmitsuba.scene.motion import Motion
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import Switch, TraceSettings
from sarmitsuba.signal.metrics import point_target_in
from sarmitsuba.simulation.execution.image import Imager
from sarmitsuba.simulation.execution.path_table import PathTracer
from sarmitsuba.simulation.execution.raw import echoes
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.truth.theory import moving as theory
from sarmitsuba.truth.validation import targets

RANGE, SPEED = 1500.0, 80.0
PEC = "pec"
ROUGH = {"material": "concrete", "diffuse_law": "constant", "diffuse_level_db": 0.0}

pytestmark = pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")


def error_db(data: C64, truth: C64) -> float:
    ratio = np.sum(np.abs(data - truth) ** 2) / np.sum(np.abs(truth) ** 2)
    return float(10.0 * np.log10(max(ratio, 1e-30)))


def slow(seed: int) -> object:
    return pytest.param(seed, marks=pytest.mark.slow)


class Drawn:
    """A car at a random place, turned and moving at random, seen from a random side."""

    def __init__(self, seed: int, pulses: int, span: float) -> None:
        rng = np.random.default_rng(seed)
        self.time = np.linspace(-0.5 * span, 0.5 * span, pulses)
        heading, look = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.6, 0.9)
        self.along = np.array([np.sin(heading), np.cos(heading), 0.0])
        self.away = np.array([self.along[1], -self.along[0], 0.0])
        self.center = RANGE * (np.array([0.0, 0.0, np.cos(look)]) - np.sin(look) * self.away)
        vertices, self.faces = cube()
        turn = rng.uniform(0.0, 2.0 * np.pi)
        c, s = np.cos(turn), np.sin(turn)
        self.top = np.flatnonzero((vertices[self.faces][..., 2] > 0.0).all(axis=1))
        turned = (
            (vertices + np.array([0.0, 0.0, 1.0]))
            * [2.2, 0.9, 0.75]
            @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        )
        self.vertices = turned + np.array([*rng.uniform(-3.0, 3.0, 2), 0.0])
        self.motion = Motion.of(
            np.append(rng.uniform(-15.0, 15.0, 2), 0.0), np.append(rng.uniform(-3.0, 3.0, 2), 0.0)
        )

    def scene(
        self,
        *,
        place: F64 | None = None,
        antenna_moves: bool = False,
        ground: bool = True,
        material: object = PEC,
        **settings: object,
    ) -> Scene:
        """The scene; with the car at rest at ``place`` off its own, or the antenna moved in its stead."""
        motion, vertices = self.motion, self.vertices
        position = self.center + self.time[:, None] * SPEED * self.along
        velocity = np.broadcast_to(SPEED * self.along, position.shape).copy()
        if place is not None:
            motion, vertices = Motion(), vertices + place
        if antenna_moves:
            position, velocity = (
                position - motion.displacement(self.time),
                velocity - motion.velocity_at(self.time),
            )
            motion = Motion()
        meshes = [SceneMesh(vertices, self.faces, material, "car", motion=motion)]  # type: ignore[arg-type]
        if ground:
            # smaller than the image: what is lit is then the same whether the car moves or not
            floor = targets.parallelogram([-9.0, -9.0, 0.0], [18.0, 0.0, 0.0], [0.0, 18.0, 0.0])
            meshes.append(SceneMesh(*floor, PEC, "ground"))
        return build_scene(
            meshes,
            radar=RadarDescription(center_frequency=9.6e9, bandwidth=3e8),
            film=FilmDescription(
                image_extent_azimuth=30.0,
                image_extent_range=40.0,
                near_range=RANGE - 20.0,
                far_range=RANGE + 20.0,
            ),
            track=Track(self.time, position, velocity),
            settings=TraceSettings(
                endless_ground="off",
                **{
                    "max_depth": 3,
                    "scatterer_cell": 0.25,
                    "ray_spacing": 0.06,
                    "effects": {"edge_diffraction": "off"},  # of what moves there is none
                    **settings,
                },
            ),  # type: ignore[arg-type]
        )


@pytest.mark.parametrize("seed", [11, slow(12), slow(13), slow(14), slow(15)])
def test_every_pulse_is_that_of_the_scene_rebuilt_there(seed: int) -> None:
    """Corner of car and ground included: no mesh moves in the scenes that this is compared with."""
    drawn = Drawn(seed, 3, 0.6)
    moving = simulate(drawn.scene(method="raw")).total()
    for i, time in enumerate(drawn.time):
        rebuilt = simulate(drawn.scene(method="raw", place=drawn.motion.displacement(time))).total()
        # tol: float32: a ray that grazes an edge may pass it on the other side; asked for: -40 dB
        assert error_db(moving[i], rebuilt[i]) < -50.0
        if i != 1:
            assert error_db(moving[1], rebuilt[i]) > -3.0  # where it stood in the middle is another scene


@pytest.mark.parametrize("seed", [21, slow(22), slow(23), slow(24)])
def test_speckle_belongs_to_the_shape(seed: int) -> None:
    """A rough flatbed that drives by is one at rest that the antenna flies past the other way."""
    drawn = Drawn(seed, 5, 0.6)
    drawn.vertices, drawn.faces = (
        drawn.vertices[drawn.faces[drawn.top].reshape(-1)],
        np.arange(6).reshape(2, 3),
    )
    asked = {
        "ground": False,
        "material": ROUGH,
        "max_depth": 1,
        "method": "raw",
        "diffuse_ray_spacing": 0.012,
    }
    driving = drawn.scene(**asked)  # type: ignore[arg-type]
    flown = drawn.scene(antenna_moves=True, **asked)  # type: ignore[arg-type]
    flown = replace(flown, radar=replace(flown.radar, window=driving.radar.window))
    a, b = simulate(driving).total(), simulate(flown).total()
    # tol: another lattice of rays, dense enough to miss no scatterer at the rim, cuts tubes otherwise there
    assert [round(error_db(a[i], b[i])) for i in range(5) if error_db(a[i], b[i]) > -40.0] == []


@pytest.mark.parametrize("seed", [31, slow(32), slow(33), slow(34)])
def test_a_block_holds_what_moves(seed: int) -> None:
    """Range rates within a block, its length chosen by the program, over many pulses of a lone car."""
    drawn = Drawn(seed, 48, 47.0 / 400.0)
    truth = simulate(drawn.scene(ground=False, method="raw", max_depth=1, ray_spacing=0.1)).total()
    raw = simulate(drawn.scene(ground=False, max_depth=1, ray_spacing=0.1))
    interval = raw.metadata["effects"]["effects"]["key_pulse_interval"]["value"]  # type: ignore[index]
    assert 8 <= interval < 48
    # tol: blocks are cut where 0.05 rad rms are left of the phase of what moves (-26 dB), about its mean, which
    # tracing each pulse does not have, over the block: twice that at most
    assert error_db(raw.total(), truth) < -20.0


def test_off_is_the_scene_at_rest() -> None:
    drawn = Drawn(41, 16, 0.04)
    moving = drawn.scene(effects={"moving_targets": "off"})
    frozen = replace(drawn.scene().frozen(), settings=moving.settings)
    a, b = Run(moving), Run(frozen)
    assert a.plan.flags == b.plan.flags and not a.plan.flags.motion
    assert a.trace_scene is not None and a.trace_scene.movers is None
    np.testing.assert_array_equal(echoes(a).data, echoes(b).data)
    assert frozen.geometry.mesh_motion == () and drawn.scene().geometry.moves


def test_what_moves_is_no_kernel_of_each_time() -> None:
    """Another place, speed or pulse compiles nothing."""
    simulate(Drawn(51, 4, 0.3).scene(method="raw"))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        simulate(Drawn(52, 4, 0.4).scene(method="raw"))
        traced = [
            k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT and k["uses_optix"] is not None
        ]
    assert traced and all(k["cache_hit"] for k in traced)


def test_small_shapes_keep_their_rays_on_the_way() -> None:
    """A corner smaller than the rays' distance has finer ones, which go with it over ten times its size."""
    drawn = Drawn(61, 3, 1.0)
    edge, n = 0.25, (drawn.center / RANGE)
    x = np.cross(n, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    turn = 2.0 * np.pi / 3.0 * np.arange(3)[:, None]
    axes = n / np.sqrt(3.0) + np.sqrt(2.0 / 3.0) * (np.cos(turn) * x + np.sin(turn) * np.cross(x, n))
    faces = [targets.parallelogram(np.zeros(3), edge * axes[i], edge * axes[(i + 1) % 3]) for i in range(3)]
    body = targets.geometry(faces)
    drawn.vertices, drawn.faces = body.vertices, body.faces
    drawn.motion = Motion.of(5.0 * drawn.along)
    driving, flown = (
        drawn.scene(ground=False, method="raw", ray_spacing=0.3, antenna_moves=m) for m in (False, True)
    )
    flown = replace(flown, radar=replace(flown.radar, window=driving.radar.window))
    peaks = [np.max(np.abs(simulate(scene).total()), axis=1) for scene in (driving, flown)]
    # tol: rays that find the rim by chance
    np.testing.assert_allclose(20.0 * np.log10(peaks[0] / peaks[1]), 0.0, atol=0.1)


@pytest.mark.parametrize("seed", [71, slow(72)])
def test_one_look_shows_it_where_its_range_rate_puts_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    speed = float(rng.uniform(-2.0, 2.0))
    parameters = RadarDescription(
        center_frequency=9.65e9,
        bandwidth=1.5e8,
        slant_range=5e3,
        look_angle_deg=40.0,
        heading_deg=float(rng.uniform(0.0, 360.0)),
        azimuth_resolution=1.0,
        speed=150.0,
    )
    at_rest = build_scene(points=[PointTarget("point", np.zeros(3))], radar=parameters)
    track = at_rest.radar.track
    away = at_rest.radar.across * np.sign(-track.center_position @ at_rest.radar.across)
    slope = float(-track.center_position @ away) / 5e3
    motion = Motion.of(speed / slope * away)
    shows = theory.apparent_place(
        track.center_position, track.velocity[0], np.zeros(3), np.asarray(motion.velocity), 0.0
    )
    scene = build_scene(
        points=[PointTarget("point", np.zeros(3), motion=motion), PointTarget("mark", shows, 1e-12)],
        radar=parameters,
        film=FilmDescription(
            image_center_x=shows[0],
            image_center_y=shows[1],
            image_extent_azimuth=32.0,
            image_extent_range=32.0,
        ),
    )
    image = Imager(Run(scene)).image()
    found = point_target_in(image)
    grid = image.grid
    first = grid.positions()[0, grid.shape[1] // 2]
    ahead = (first - grid.along * (grid.azimuth[0] - found.azimuth_position)) @ track.along
    # tol: a look is one place of the antenna: a twentieth of the 1 m cell
    assert ahead == pytest.approx(float(theory.azimuth_displacement(5e3, speed, 150.0)), abs=0.05)


def test_raster_refuses_what_moves() -> None:
    scene = Drawn(81, 16, 0.04).scene(method="raster")
    with pytest.raises(
        RadarError, match=r"method raster shows objects at rest only, and a mesh moves; .* moving_targets off"
    ):
        Imager(Run(scene)).raster()
    off: dict[str, Switch] = {"moving_targets": "off"}
    Imager(Run(replace(scene, settings=replace(scene.settings, effects=off)))).raster()


def test_paths_know_where_the_shape_is_and_how_fast() -> None:
    """Range rates of single paths are the slopes of the lengths of the same scatterer, 1 ms apart."""
    drawn = Drawn(91, 3, 2e-3)
    rays = PathTracer(
        drawn.scene(
            ground=False, material=ROUGH, max_depth=1, diffuse_ray_spacing=0.05, effects={"coherent": "off"}
        )
    )
    before, here, after = (rays.trace(pulse) for pulse in range(3))
    matched = 0
    for path in range(0, len(here.length), max(1, len(here.length) // 60)):
        place = here.points[path, 0]
        step = drawn.motion.displacement(drawn.time)
        ways = []
        for table, i in ((before, 0), (after, 2)):
            distance = np.linalg.norm(table.points[:, 0] - (place + step[i] - step[1]), axis=1)
            near = int(np.argmin(distance))
            if distance[near] < 1e-6:
                ways.append(table.slant_range[near])
        if len(ways) == 2:
            matched += 1
            # tol: the difference of two slant ranges of 1.5 km in float64 over 2 ms
            assert here.range_rate[path] == pytest.approx((ways[1] - ways[0]) / 2e-3, abs=1e-5)
    assert matched > 20


def test_the_beam_is_where_the_shape_is_not_where_its_doppler_is() -> None:
    """In a beam narrower than the shape's Doppler shift its echo stays as strong as at rest."""
    drawn = Drawn(101, 16, 0.04)
    drawn.motion = Motion.of(10.0 * drawn.away)
    radar = {"pattern": "gaussian", "azimuth_beamwidth_deg": 3.0, "elevation_beamwidth_deg": 20.0}
    energy = []
    for motion in (drawn.motion, Motion()):
        drawn.motion = motion
        scene = drawn.scene(ground=False, max_depth=1, material=ROUGH)
        antenna = replace(scene.description.sensor, **radar)  # type: ignore[union-attr,arg-type]
        beam = build_scene(
            [SceneMesh(drawn.vertices, drawn.faces, ROUGH, "car", motion=motion)],  # type: ignore[arg-type]
            radar=antenna,
            film=FilmDescription(image_extent_azimuth=16.0, image_extent_range=16.0),
            track=scene.radar.track,
            settings=scene.settings,
        )
        energy.append(float(np.sum(np.abs(simulate(beam).total()) ** 2)))
    # 10 m/s are 7 degrees of Doppler at 80 m/s: twice the beam's width off its middle
    # tol: 1 dB: 0.3 m of drive change the speckle of a car of a dozen cells
    assert 10.0 * np.log10(energy[0] / energy[1]) == pytest.approx(0.0, abs=1.0)


def test_the_shadow_stays() -> None:
    """A black van that drives away returns nothing: its shadow lies behind it, and clutter where it would show."""
    rng = np.random.default_rng(111)
    heading = float(rng.uniform(0.0, 2.0 * np.pi))
    along = np.array([np.sin(heading), np.cos(heading), 0.0])
    away = np.array([along[1], -along[0], 0.0])
    vertices, faces = cube()
    local = (vertices + np.array([0.0, 0.0, 1.0])) * [2.0, 4.0, 2.5]  # away, along, up
    van = local[:, :1] * away + local[:, 1:2] * along + local[:, 2:] * [0.0, 0.0, 1.0]
    floor = targets.parallelogram([-30.0, -30.0, 0.0], [60.0, 0.0, 0.0], [0.0, 60.0, 0.0])
    speed = 2.0
    scene = build_scene(
        [
            SceneMesh(*floor, ROUGH, "ground"),
            SceneMesh(van, faces, targets.BLACK, "van", motion=Motion.of(speed * away)),
        ],
        radar=RadarDescription(
            center_frequency=9.65e9,
            bandwidth=1.5e8,
            slant_range=2e3,
            look_angle_deg=45.0,
            heading_deg=float(np.degrees(heading)),
            azimuth_resolution=1.0,
            speed=150.0,
        ),
        film=FilmDescription(image_grid="ground", image_extent_azimuth=50.0, image_extent_range=30.0),
        settings=TraceSettings(max_depth=1, effects={"coherent": "off"}),
    )
    raw = simulate(scene)
    image = focus(raw, request=scene.image, azimuth_window="taylor:4:-35", range_window="taylor:4:-35")
    power = np.abs(image.total()) ** 2
    places = image.grid.positions()
    x, y = places @ away, places @ along

    def mean(at: float, ahead: float) -> float:
        return float(power[(np.abs(x - at) < 1.3) & (np.abs(y - ahead) < 2.5)].mean())

    shows = float(theory.azimuth_displacement(2e3, speed * np.sin(np.pi / 4.0), 150.0))
    clutter = np.median(
        [mean(at, ahead) for at in (-12.0, 11.0) for ahead in (-20.0, -10.0, 0.0, 10.0, 20.0)]
    )
    # 5 m high and seen at 45 degrees: dark from its far side at 2 m to 7 m
    assert 10.0 * np.log10(mean(4.5, 0.0) / clutter) < -10.0
    # tol: 10 cells: three deviations of speckle are 3 dB
    assert 10.0 * np.log10(mean(4.5, shows) / clutter) == pytest.approx(0.0, abs=3.0)


def test_the_echo_walks_through_range() -> None:
    """The peak of every pulse's echo of a car that drives away, by blocks, against the way that it goes."""
    drawn = Drawn(121, 64, 0.4)
    drawn.motion = Motion.of(12.0 * drawn.away)
    scene = drawn.scene(
        ground=False, material=ROUGH, max_depth=1, ray_spacing=0.2, effects={"coherent": "off"}
    )
    raws = [simulate(scene), simulate(scene.frozen())]
    assert raws[0].metadata["moving"] == {
        "car": {"velocity": list(drawn.motion.velocity), "acceleration": [0.0] * 3}
    }
    assert raws[1].metadata["moving"] == {}
    centroid = []
    for raw in raws:
        power = np.abs(raw.total()) ** 2
        ranges = (
            raw.radar.window.start_range[:, None]
            + np.arange(power.shape[1]) * raw.radar.window.sample_spacing
        )
        centroid.append((power * ranges).sum(axis=1) / power.sum(axis=1))
    walked = centroid[0] - centroid[1]
    sight = drawn.vertices.mean(axis=0) - drawn.center
    speed = float(np.asarray(drawn.motion.velocity) @ sight / np.linalg.norm(sight))
    slope = float(np.polyfit(drawn.time, walked, 1)[0])
    # tol: 0.4 m/s: speckle moves the centroid of a car 4 m long by a cell's quarter
    assert slope == pytest.approx(float(theory.range_walk(speed, 1.0)), abs=0.4)
