"""Two diffuse scatterers in a row: lengths, persistence, statistics, reciprocity; the cases have their levels."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from sarmitsuba import RadarDescription, Scene, SceneMesh, build_scene, load_scene, simulate
from sarmitsuba.core.arrays import F64
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.plan import Decision
from sarmitsuba.machine.backend import dr, ensure_backend
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh import surface_samples as sampling
from sarmitsuba.scene.mesh.surface_samples import SurfaceSamples, surface_samples
from sarmitsuba.simulation.planning.pilot import plan_scene
from sarmitsuba.tracing.kernel.accumulators import SumAccumulator
from sarmitsuba.tracing.kernel.kernel import KernelSettings
from sarmitsuba.tracing.kernel.launch import LaunchFrame, LaunchGrid, PulseBatch
from sarmitsuba.tracing.kernel.leg import Surroundings
from sarmitsuba.tracing.kernel.scene_tables import TraceScene, build_trace_scene
from sarmitsuba.tracing.kernel.source import launches
from sarmitsuba.tracing.kernel.state import Kernel
from sarmitsuba.tracing.scatterers.pairs.diffuse_pairs import PairSource
from sarmitsuba.tracing.scatterers.pairs.pair_estimate import PairEcho, pair_echo
from sarmitsuba.tracing.scatterers.pairs.pair_search import SurfacePairs, find_pairs
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets

WAVELENGTH, FAR = 0.03, 2e3
# of a pane whose TE and TM differ little
FOAM, THICK = 1.3 - 0.2j, 0.02
THROUGH = KernelFlags(slabs=True, transmission=True)
BOX = np.array([[-6.0, -6.0, -6.0], [6.0, 6.0, 6.0]])
FLOOR = ([1.0, -2.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0])
WALL = ([0.0, -2.0, 0.3], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0])
GROUND = np.array([[-12.0, -12.0, 0.0], [12.0, -12.0, 0.0], [12.0, 12.0, 0.0], [-12.0, 12.0, 0.0]])
UPRIGHT = np.array([[2.0, -8.0, 0.0], [3.0, 8.0, 0.0], [3.0, 8.0, 6.0], [2.0, -8.0, 6.0]])
FACES = [[0, 1, 2], [0, 2, 3]]
ROUGH = {"material": "concrete", "rms_height": 0.02, "diffuse_law": "lambert", "diffuse_level_db": 2.0}


def corner(*panes: targets.Mesh) -> TraceScene:
    """A floor and a wall of rough stone, and panes of a lossy foam."""
    ensure_backend()
    stone = Material(
        "stone", pec=True, diffuse_law="lambert", diffuse_level_db=0.0, cross_polar_ratio_db=-9.0
    )
    foam = Material("foam", permittivity=FOAM, thickness=THICK)
    meshes = [targets.parallelogram(*FLOOR), targets.parallelogram(*WALL), *panes]
    geometry = targets.geometry(meshes, [0, 0, *[1] * len(panes)])
    return build_trace_scene(geometry, (stone, foam), WAVELENGTH)


def points(scene: TraceScene, cell: float, seed: int) -> SurfaceSamples:
    """Of the floor's two triangles and the wall's two, in whatever order the tables have them."""
    rows = np.flatnonzero(stone(scene))
    samples = surface_samples(scene.triangles[rows], cell, BOX, seed)
    return replace(samples, face=rows[samples.face])


def stone(scene: TraceScene) -> NDArray[np.bool_]:
    return np.asarray(scene.geometry_faces < 4)


def drawn(
    scene: TraceScene, to_radar: F64, cell: float, seed: int, flags: KernelFlags = THROUGH
) -> SurfacePairs:
    around = Surroundings.of(scene, flags, WAVELENGTH)
    samples = points(scene, cell, seed)
    return find_pairs(around, samples, (FAR * to_radar)[None], cell, BOX, scatters=stone(scene))


def echo(
    scene: TraceScene, pairs: SurfacePairs, to_radar: F64, *channels: str, depolarised: bool = False
) -> PairEcho:
    flags = replace(THROUGH, channels=channels, depolarisation=depolarised)
    return pair_echo(pairs, scene, FAR * to_radar, np.zeros(3), flags, wavelength=WAVELENGTH)


def direction(rng: np.random.Generator) -> F64:
    azimuth, elevation = rng.uniform(-1.0, 1.0), rng.uniform(0.3, 1.1)
    return np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )


@pytest.mark.parametrize("seed", [3, 4])
def test_length_and_reciprocity(seed: int) -> None:
    """The length is that of the three legs in float64, HV = VH whatever the surfaces do to the polarisation."""
    scene, to_radar = corner(), direction(np.random.default_rng(seed))
    pairs = drawn(scene, to_radar, 0.15, seed)
    found = echo(scene, pairs, to_radar, "HH", "HV", "VH", "VV", depolarised=True)
    a, b = pairs.point[:, 0], pairs.point[:, 1]
    legs = [np.linalg.norm(x - FAR * to_radar, axis=1) for x in (a, b)]
    length = legs[0] + np.linalg.norm(b - a, axis=1) + legs[1]
    assert pairs.n > 100
    assert (
        np.abs(found.slant_range - 0.5 * length).max() < 1e-6
    )  # tol: float32 of the way between, a metre or four
    top = np.abs(found.amplitude).max()
    assert np.abs(found.amplitude[:, 1] - found.amplitude[:, 2]).max() < 1e-5 * top  # tol: float32
    assert np.abs(found.amplitude[:, 1]).max() > 0.05 * top
    # each is drawn once, from the floor or from the wall
    assert np.unique(pairs.key).size == pairs.n
    assert 0.2 < np.mean(np.abs(pairs.normal[:, 0, 2]) > 0.5) < 0.8


@pytest.mark.parametrize("seed", [1, 2])
def test_panes_stand_in_all_three_legs(seed: int) -> None:
    """A pane between floor and wall: the wall's leg to the radar and the one between the two go through it."""
    to_radar = direction(np.random.default_rng(seed))
    pane = targets.parallelogram([0.5, -9.0, -2.0], [0.0, 18.0, 0.0], [0.0, 0.0, 12.0])
    free, behind = (corner(), corner(pane))
    both = [drawn(scene, to_radar, 0.15, seed) for scene in (free, behind)]
    _, i, j = np.intersect1d(both[0].key, both[1].key, return_indices=True)
    # what starts on the pane or ends on it is no pair of scatterers
    assert i.size == both[0].n == both[1].n > 100
    echoes = [echo(s, p, to_radar, "HH") for s, p in zip((free, behind), both, strict=True)]
    (one, r1), (two, r2) = (
        (e.amplitude[k, 0], e.slant_range[k]) for e, k in zip(echoes, (i, j), strict=True)
    )
    got = two * np.exp(-4j * np.pi / WAVELENGTH * (r2 - r1))
    a, b = both[0].point[i, 0], both[0].point[i, 1]
    between = np.abs((b - a)[:, 0]) / np.linalg.norm(b - a, axis=1)
    # of one foot on either side of the pane
    assert (np.sign(a[:, 0] - 0.5) * np.sign(b[:, 0] - 0.5) == -1).all()
    te, tm = (
        np.asarray(x)
        for x in theory.slab_insertion(np.append(between, to_radar[0]), FOAM, THICK, WAVELENGTH, 0.0)
    )
    mean, spread = 0.5 * (te + tm), 0.5 * np.abs(te - tm)
    want = mean[:-1] * mean[-1]
    # tol: TE and TM differ by 1 to 6 %, and each pair has its own mixture of them
    either = np.abs(mean[-1]) * spread[:-1] + np.abs(mean[:-1]) * spread[-1]
    assert np.linalg.norm(got - want * one) < np.linalg.norm(either * one)
    assert np.abs(want).max() < 0.75
    assert (r2 - r1 > 0.0).all()
    # off: the pane is a wall, and no point of the stone lands on the stone
    blocked = drawn(behind, to_radar, 0.15, seed, KernelFlags())
    assert not stone(behind)[blocked.face].all(axis=1).any()


def test_another_pass_has_the_same_pairs() -> None:
    """Ten milliradians apart: all but those at the rim of what is seen, at the same places."""
    rng = np.random.default_rng(9)
    scene, to_radar = corner(), direction(rng)
    other = to_radar + 0.01 * rng.standard_normal(3)
    one, two = (drawn(scene, d / np.linalg.norm(d), 0.1, 1) for d in (to_radar, other))
    common, i, j = np.intersect1d(one.key, two.key, return_indices=True)
    assert common.size > 0.98 * max(one.n, two.n) > 300
    assert np.array_equal(one.point[i], two.point[j]) and np.array_equal(one.weight[i], two.weight[j])


def test_speckle_and_stated_error() -> None:
    """Sums of all pairs over looks are exponential, of a power that varies by the stated error over draws."""
    rng = np.random.default_rng(5)
    scene, to_radar = corner(), direction(rng)
    deviations = []
    for seed in range(12):
        pairs = drawn(scene, to_radar, 0.12, seed)
        power = np.square(np.abs(echo(scene, pairs, to_radar, "VV").amplitude[:, 0]))
        # two halves of one draw, each with half of the pairs
        half = (pairs.key >> np.uint32(7)) & np.uint32(1) == 1
        sums = [power[half].sum(), power[~half].sum()]
        errors = [np.square(power[half]).sum(), np.square(power[~half]).sum()]
        deviations.append((sums[0] - sums[1]) / np.sqrt(sum(errors)))
    # chi squared of 12: below 2.4 and above 0.29 in all but one of 100 each
    assert 0.29 < np.mean(np.square(deviations)) < 2.4
    found = echo(scene, pairs, to_radar, "VV")
    # looks that turn by many lobes of the corner, too little for an amplitude to change
    turned = to_radar + 0.02 * rng.standard_normal((400, 3))
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    phase = 2.0 * np.pi / WAVELENGTH * ((turned - to_radar) @ pairs.point.sum(axis=1).T)
    start = found.amplitude[:, 0] * np.exp(-4j * np.pi / WAVELENGTH * (found.slant_range - FAR))
    intensity = np.square(np.abs(np.exp(1j * phase) @ start))
    # known mean: fails in one of a thousand draws
    assert theory.intensity_test(intensity, float(power.sum())).p_value > 1e-3


def test_another_antenna_at_the_same_place_hears_the_same() -> None:
    """Both orders of a pair apart, or as one return."""
    to_radar = direction(np.random.default_rng(6))
    scene = corner()
    pairs = drawn(scene, to_radar, 0.2, 1)
    position, none = (FAR * to_radar)[None], np.zeros(0, np.float32)
    along = np.cross(to_radar, [0.0, 0.0, 1.0])
    frame = LaunchFrame(np.zeros((1, 3)), along[None], np.cross(along, -to_radar)[None])
    batch = PulseBatch(position, np.array([[10.0, 20.0, 5.0]]), frame)
    grid = LaunchGrid(none, none, 1.0, 0.0, 8.0, 8.0, 0.0)
    settings = KernelSettings(WAVELENGTH, 1, 1.0, 0, 1.0, FAR)
    flags = KernelFlags(channels=("HH", "RV"), antenna_pattern=False)
    sums = []
    for both in (batch, replace(batch, receiver=batch)):
        kernel = Kernel.of(scene, grid, both, flags, settings)
        accumulator = SumAccumulator(1, 2, 0, WAVELENGTH, FAR)
        for launch in launches([PairSource(pairs)], [grid], 1):
            _, state = launch.record(kernel, Antenna(), accumulator)
            dr.eval(state, accumulator.memory)
        sums.append(accumulator.grid().ravel())
    assert np.abs(sums[0]).min() > 0.0
    assert np.abs(sums[1] - sums[0]).max() < 1e-4 * np.abs(sums[0]).max()  # tol: float32 sums


def test_points_of_surfaces_are_the_scene_s(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another cut of a surface, more of the scene about it and smaller pieces of work make the same points."""
    rng = np.random.default_rng(8)
    for _ in range(3):
        triangle = rng.uniform(-5.0, 5.0, (1, 3, 3))
        middle = triangle.mean(axis=1)
        cut = np.concatenate(
            [np.stack([triangle[:, i], triangle[:, (i + 1) % 3], middle], axis=1) for i in range(3)]
        )
        whole, parts = (surface_samples(t, 0.1, BOX, 2) for t in (triangle, cut))
        assert np.array_equal(np.sort(whole.key), np.sort(parts.key))
        area = 0.5 * np.linalg.norm(
            np.cross(triangle[0, 1] - triangle[0, 0], triangle[0, 2] - triangle[0, 0])
        )
        assert (1.0 / whole.density).sum() == pytest.approx(
            area, rel=0.05
        )  # tol: one point more or less at the rim
        small = surface_samples(triangle, 0.1, 0.5 * BOX, 2)
        inside = (np.abs(whole.point) <= 3.0).all(axis=1)
        assert np.array_equal(np.sort(small.key), np.sort(whole.key[inside]))
        with monkeypatch.context() as patch:
            patch.setattr(sampling, "CHUNK", 50)
            assert np.array_equal(surface_samples(cut, 0.1, BOX, 2).point, parts.point)
    assert surface_samples(np.zeros((0, 3, 3)), 0.1, BOX, 2).n == 0


def yard(**settings: object) -> Scene:
    """Rough ground and a wall, and a radar with few pulses."""
    radar = RadarDescription(
        slant_range=1e3, look_angle_deg=40.0, heading_deg=20.0, bandwidth=150e6, azimuth_resolution=2.0,
        polarisation="HH", pattern="rectangular", antenna_length=1.0, elevation_beamwidth_deg=20.0,
        aim_x=0.0, aim_y=0.0, aim_z=0.0,
    )  # fmt: skip
    shapes = [SceneMesh(GROUND, FACES, ROUGH, "ground"), SceneMesh(UPRIGHT, FACES, ROUGH, "wall")]
    scene = build_scene(
        shapes, radar=radar, film=FilmDescription(image_extent_azimuth=20.0, image_extent_range=20.0)
    )
    return scene.replace(ray_spacing=0.4, **settings)


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
def test_pairs_persist_from_pulse_to_pulse() -> None:
    """Blocks that trace one of their pulses return what the tracing of every pulse does, and nothing when off."""
    data = {
        (method, pairs): simulate(yard(method=method, diffuse_pairs=pairs), seed=1).data
        for method in ("raw", "hybrid")
        for pairs in ("on", "off")
    }
    plain = simulate(yard(method="hybrid"), seed=1).data  # a draw of pairs is looked at in the shortest run
    assert np.array_equal(data["hybrid", "on"], plain)
    raw, hybrid = (data[m, "on"] - data[m, "off"] for m in ("raw", "hybrid"))
    energy = np.square(np.abs(raw)).sum()
    assert energy > 1e-3 * np.square(np.abs(data["raw", "off"])).sum()
    assert (
        np.square(np.abs(hybrid - raw)).sum() < 1e-4 * energy
    )  # tol: the -40 dB that blocks are laid out for


def decided(name: str, **settings: object) -> Decision:
    decision = plan_scene(load_scene(name).replace(**settings)).decision("diffuse_pairs")
    assert decision is not None
    return decision


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
def test_the_plan_has_pairs_where_they_change_a_level() -> None:
    court = decided("courtyard")
    assert court.on and court.source == "pilot" and -16.0 < court.error_db < -10.0
    flat = decided("flat_ground")
    assert not flat.on and flat.error_db == -np.inf


@pytest.mark.parametrize("method", ["raw", "hybrid", "image"])
def test_small_runs_and_all_methods_have_one_plan(method: str) -> None:
    """At 1.5 m resolution the courtyard is a run of half a second, and pairs are as strong as ever."""
    plan = plan_scene(load_scene("courtyard").replace(azimuth_resolution=1.5, method=method))
    court = plan.decision("diffuse_pairs")
    # -12.6 dB by the draws of the benchmark; tol: four standard errors of a draw
    assert court is not None and court.on and court.error_db == pytest.approx(-12.6, abs=1.0)
    other = plan_scene(load_scene("courtyard").replace(azimuth_resolution=1.5))
    assert (plan.flags, plan.max_depth) == (other.flags, other.max_depth)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
def test_the_plan_leaves_out_what_hardly_changes_a_level() -> None:
    city = decided("urban_block")
    assert not city.on and city.source == "pilot" and -27.0 < city.error_db < -22.0 and "left out" in city.why
    assert decided("urban_block", tolerance_db=-50.0).on
    assert not decided("courtyard", diffuse_pairs="off").on


def test_a_cross_polar_channel_has_a_limit_of_its_own() -> None:
    """Ground that does not depolarise returns nothing in HV but by pairs: they stay where that is recorded."""
    scene = load_scene("tower")
    one, both = (
        plan_scene(scene.replace(polarisation=channels)).decision("diffuse_pairs")
        for channels in ("VV", "VV,HV")
    )
    assert one is not None and both is not None
    assert not one.on and both.on and "the only cross-polar return" in both.why
