"""Volumes in the kernel: ways through drawn bodies, scatterers that stay where they are, volumes off."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba import FilmDescription, RadarDescription, Scene, SceneMesh, SceneVolume, build_scene
from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.effects.plan import plan_effects
from sarmitsuba.machine.backend import ensure_backend, mi
from sarmitsuba.scene.materials.vegetation.canopy import water_cloud
from sarmitsuba.scene.mesh import tessellate
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.scene.volumes import Volume
from sarmitsuba.signal.image import SarImage
from sarmitsuba.simulation.execution.turntable import Aspects, rcs_sweep
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.planning.sources.kind import passages_of, sources_of
from sarmitsuba.simulation.planning.sources.site import RunSite
from sarmitsuba.tracing.scatterers.volumes.volume_scatterers import (
    VolumeScatterers,
    VolumeSurfaces,
    scatterer_spacing,
    volume_scatterers,
)
from sarmitsuba.truth import theory
from tests.support.unweighted import render

CLOUD = water_cloud("cloud", (0.1, 0.05), (0.2, 0.4), 0.2)
GROUND = np.array([[-30.0, -30, 0], [30, -30, 0], [30, 30, 0], [-30, 30, 0]])


def cube(low: F64, high: F64, name: str = "box") -> Volume:
    vertices, faces = tessellate.cube()
    return Volume(name, low + (vertices + 1.0) * 0.5 * (high - low), faces, CLOUD)


def ball(center: F64, radius: float) -> Volume:
    vertices, faces = tessellate.sphere(radius, 1e-3 * radius)
    return Volume("ball", vertices + center, faces, CLOUD)


def lengths(volumes: list[Volume], origin: F64, direction: F64, way: F64) -> F64:
    """Length of ways within volumes, as the kernel finds them."""
    ensure_backend()
    bodies = VolumeSurfaces.of(volumes, [0] * len(volumes))

    def one(body: mi.UInt32, medium: mi.UInt32, active: mi.Bool) -> tuple[mi.Float, mi.Float]:
        return mi.Float(1.0), mi.Float(0.0)

    o, d = (
        mi.Vector3f(*(mi.Float(np.ascontiguousarray(c, dtype=np.float32)) for c in v.T))
        for v in (origin, direction)
    )
    found, _ = bodies.within(o, d, mi.Float(way.astype(np.float32)), mi.Bool(True), one)
    return np.asarray(found.numpy(), dtype=np.float64)


def drawn_paths(rng: np.random.Generator, n: int) -> tuple[F64, F64, F64]:
    origin = rng.uniform([-25.0, -25.0, -1.0], [25.0, 25.0, 12.0], (n, 3))
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return origin, direction, rng.uniform(0.0, 60.0, n)


@pytest.mark.parametrize("seed", [1, 2])
def test_ways_through_drawn_bodies(seed: int) -> None:
    """Balls and boxes that overlap, ways that begin and end within them: no pair of surfaces is left open."""
    rng = np.random.default_rng(seed)
    ways, volumes, wanted = drawn_paths(rng, 50_000), [], np.zeros(50_000)
    for i in range(20):
        center = rng.uniform([-20.0, -20.0, 2.0], [20.0, 20.0, 8.0])
        if i % 2:
            radius = float(rng.uniform(1.0, 4.0))
            volumes.append(ball(center, radius))
            wanted += theory.path_in_ball(*ways, center, radius)
        else:
            half = rng.uniform(1.0, 4.0, 3)
            volumes.append(cube(center - half, center + half))
            wanted += theory.path_in_box(*ways, center - half, center + half)
    error = lengths(volumes, *ways) - wanted
    assert (
        np.sqrt(np.mean(error**2)) < 0.004
    )  # tol: facets of balls, 1e-3 of the radius, and the gap between bodies
    assert np.abs(error).max() < 0.5  # tol: the same along a surface; an open pair is off by metres


def test_bodies_side_by_side_and_in_one_place() -> None:
    """Layers that touch and one body twice: surfaces that no ray can tell apart."""
    rng = np.random.default_rng(3)
    corners = [
        ([-5, -5, 0], [5, 5, 2]),
        ([-5, -5, 2], [5, 5, 6]),
        ([-5, -5, 2], [5, 5, 6]),
        ([5, -5, 2], [15, 5, 6]),
    ]
    boxes = [(np.array(a, dtype=float), np.array(b, dtype=float)) for a, b in corners]
    origin, direction, way = drawn_paths(rng, 50_000)
    direction[:10_000] = [0.0, 0.0, -1.0]  # along the axes
    wanted = sum(theory.path_in_box(origin, direction + 1e-12, way, *box) for box in boxes)
    error = lengths([cube(*box) for box in boxes], origin, direction, way) - wanted
    assert (
        np.mean(np.abs(error) > 0.1) < 1e-4
    )  # tol: ways along a face, by the gap between bodies on either side of it


def scatterers(volumes: list[Volume], seed: int = 0) -> tuple[VolumeScatterers, F64]:
    ensure_backend()
    found = volume_scatterers(volumes, 1.0, seed)
    return found, found.place.numpy().reshape(-1, 3)


def test_scatterers_fill_their_bodies_evenly() -> None:
    body = ball(np.array([3.0, -2.0, 6.0]), 3.0)
    found, place = scatterers([body, body])
    away = np.linalg.norm(place - [3.0, -2.0, 6.0], axis=1)
    assert away.max() < 3.0
    expected = 2.0 * body.content / scatterer_spacing(body, 1.0) ** 3
    assert found.n == pytest.approx(expected, rel=0.1)  # tol: cells that the surface cuts
    assert np.mean(away**3) == pytest.approx(0.5 * 27.0, rel=0.05)  # tol: 3 sigma of n draws
    assert found.weight.numpy() ** 2 * found.n == pytest.approx(
        np.full(found.n, 2.0 * body.content), rel=0.05
    )


def test_a_resolution_cell_holds_ten_scatterers() -> None:
    for radius in (0.5, 3.0, 20.0):
        body = ball(np.zeros(3), radius)
        spacing = scatterer_spacing(body, 1.0)
        assert body.mean_chord / spacing**3 >= 10.0 * (1.0 - 1e-9) and body.content / spacing**3 >= 8.0
        assert np.log2(spacing) * 2.0 == pytest.approx(round(np.log2(spacing) * 2.0))


def test_scatterers_stay_where_they_are() -> None:
    """Another body beside leaves them alone; another seed draws others."""
    first, second = ball(np.array([0.0, 0.0, 5.0]), 2.0), ball(np.array([9.0, 0.0, 5.0]), 2.0)
    alone, place = scatterers([first])
    both, places = scatterers([second, first])
    mine = places[:, 0] < 4.0
    assert np.array_equal(places[mine], place)
    assert np.array_equal(both.key.numpy()[mine], alone.key.numpy())
    assert not np.isin(alone.key.numpy(), scatterers([first], seed=1)[0].key.numpy()).any()


def layer(**settings: object) -> Scene:
    """A layer over ground that returns nothing."""
    box = cube(np.array([-26.0, -26, 0.1]), np.array([26.0, 26, 3]))
    return build_scene(
        [SceneMesh(GROUND, [[0, 1, 2], [0, 2, 3]], {"permittivity_real": 4.0, "rms_height": 0.2}, "ground")],
        volumes=[SceneVolume(box.vertices, box.faces, CLOUD)],
        radar=RadarDescription(
            slant_range=6e3,
            look_angle_deg=40.0,
            bandwidth=300e6,
            azimuth_resolution=0.5,
            polarisation="HH,VV,HV",
        ),
        film=FilmDescription(image_extent_azimuth=24.0, image_extent_range=24.0),
        settings=TraceSettings(method="image", max_depth=1, **settings),  # type: ignore[arg-type]
    )


def test_speckle_of_a_layer_is_polarimetric_and_does_not_depend_on_rays() -> None:
    def data(image: SarImage, channel: str) -> C64:
        return np.asarray(image.data[image.channels.index(channel)])

    image, other = render(layer()), render(layer(ray_spacing=0.9))
    hh, vv, hv = (data(image, channel) for channel in ("HH", "VV", "HV"))
    powers = [float(np.mean(np.abs(x) ** 2)) for x in (hh, vv, hv)]
    # with extinction apart the far end of the layer counts less in V than in H
    depth = 2.9 / np.cos(np.radians(40.0))
    mean = [-np.expm1(-2.0 * k * depth) / (2.0 * k) for k in (0.2, 0.4, 0.3)]
    rho = 0.6 * mean[2] / np.sqrt(mean[0] * mean[1])
    n = hh.size / 4.0  # pixels lie half a cell apart
    assert abs(np.mean(hh * vv.conj())) / np.sqrt(powers[0] * powers[1]) == pytest.approx(
        rho, abs=4.0 / np.sqrt(n)
    )
    assert abs(np.mean(hh * hv.conj())) < 4.0 / np.sqrt(n) * np.sqrt(powers[0] * powers[2])
    # contrast of developed speckle
    assert np.std(np.abs(hh) ** 2) / powers[0] == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / n))
    again = data(other, "HH")
    assert abs(np.vdot(hh, again)) / np.linalg.norm(hh) / np.linalg.norm(again) > 0.9999  # tol: float32 sums


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")  # that the effect is off
def test_volumes_can_be_left_out() -> None:
    scene = layer()
    plan = plan_effects(scene)
    decision = plan.decision("vegetation")
    assert decision is not None and decision.on and "1 volume: extinction" in decision.why
    assert plan.on("visibility") and plan.on("fresnel")
    off = replace(scene, settings=replace(scene.settings, effects={"vegetation": "off"}))
    bare = plan_effects(off)
    assert not bare.on("vegetation") and not bare.apply(off).volumes
    assert not plan_effects(replace(scene, volumes=())).on("vegetation")


def test_a_scene_without_volumes_has_no_crossing() -> None:
    """Neither passage nor source is made: the kernel is that of a scene that never heard of volumes."""
    ensure_backend()
    bare = replace(layer(), volumes=())
    assert passages_of(bare) == ()
    plan = plan_effects(bare)
    assert sources_of(RunSite(SamplingPlan.of(bare), plan.flags)) == ()


def test_what_does_not_hold_volumes_says_so() -> None:
    scene = layer()
    raster = plan_effects(replace(scene, settings=replace(scene.settings, method="raster")))
    decision = raster.decision("vegetation")
    assert decision is not None and not decision.on and "surfaces only" in decision.why


ELEVATION = 0.6


@pytest.mark.slow
def test_rcs_of_a_ball_of_scatterers() -> None:
    """Mean over aspects against the integral of the water cloud."""
    radius = 2.0
    body = ball(np.zeros(3), radius)
    speck = SceneMesh(GROUND * 2e-4, [[0, 1, 2], [0, 2, 3]], "pec", "speck")  # volumes stand on something
    inside = [SceneVolume(body.vertices, body.faces, CLOUD)]
    cloud = build_scene([speck], volumes=inside, radar=RadarDescription())
    aspects = Aspects(np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False), np.full(720, ELEVATION))
    sweep = rcs_sweep(cloud, aspects, channels=("HH", "VV", "HV"), checked=0)
    rho = (np.arange(2000) + 0.5) / 2000 * radius
    chord = 2.0 * np.sqrt(radius**2 - rho**2)
    for channel, back, kappa in (("HH", 0.1, 0.2), ("VV", 0.05, 0.4)):
        seen = -np.expm1(-2.0 * kappa * chord) / (2.0 * kappa)
        want = back * np.sum(2.0 * np.pi * rho * seen) * radius / 2000
        got = np.mean(10.0 ** (0.1 * sweep.dbsm(channel)))
        # tol: four standard deviations of speckle over the aspects, and of the scatterers' own draw
        assert got == pytest.approx(want, rel=4.0 / np.sqrt(720.0) + 4.0 / np.sqrt(8000.0))


@pytest.mark.filterwarnings(
    "ignore::sarmitsuba.core.errors.SarmitsubaWarning"
)  # a plate far smaller than the window
def test_rcs_of_what_stands_in_a_ball() -> None:
    """A plate across the line of sight at the middle of the ball loses exp(-2 k s)."""
    radius, one = 2.0, Aspects(np.zeros(1), np.full(1, ELEVATION))
    body, look = ball(np.zeros(3), radius), one.directions[0]
    across = np.array([[0.0, 1.0, 0.0], np.cross([0.0, 1.0, 0.0], look)])
    corners = 0.2 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) @ across
    plate = SceneMesh(corners, [[0, 1, 2], [0, 2, 3]], "pec", "plate")
    dark = water_cloud("dark", (1e-12, 1e-12), (0.2, 0.4), 0.0)
    levels = []
    for volumes in ([], [SceneVolume(body.vertices, body.faces, dark)]):
        scene = build_scene([plate], volumes=volumes, radar=RadarDescription())
        levels.append([rcs_sweep(scene, one, channels=(c,), checked=0).dbsm(c)[0] for c in ("HH", "VV")])
    want = 20.0 / np.log(10.0) * np.array([0.2, 0.4]) * radius
    # tol: facets of the ball, and where a leg starts
    assert np.array(levels[0]) - np.array(levels[1]) == pytest.approx(want, abs=0.03)
