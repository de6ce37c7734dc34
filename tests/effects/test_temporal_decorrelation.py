"""Change between passes: the random numbers themselves, the plan that turns it on, and what it leaves as it was."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.core.arrays import C128
from sarmitsuba.effects.plan import plan_effects
from sarmitsuba.loading.build import SceneMesh, SceneVolume, build_scene
from sarmitsuba.loading.load import load_scene
from sarmitsuba.machine.backend import dr, ensure_backend, mi
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh.tessellate import cube
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.noise import noise_generator
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.tracing.kernel.speckle import gaussian, mix
from sarmitsuba.tracing.kernel.temporal import Age
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets

# scatterers, every one with a key of its own
N = 2**18
# tol: five standard errors of the mean of N products of two unit Gaussians
FIVE_SIGMA = 5.0 / np.sqrt(N)


def numbers(
    long_term: float, decay: float, days: float, stream: int = 0, *, phase_only: bool = False
) -> C128:
    """Random numbers of N scatterers so many days after the first pass."""
    ensure_backend()
    key = mix(mi.UInt32(dr.arange(mi.UInt32, N)) * 0x9E3779B1 + 7)
    f32 = lambda value: dr.opaque(mi.Float, float(value))  # noqa: E731
    age = Age(f32(days), f32(long_term), f32(decay))
    got = age.unit_phase(key, stream) if phase_only else age.gaussian(key, stream)
    return np.asarray(got.real.numpy(), dtype=np.float64) + 1j * got.imag.numpy()


def coherence(a: C128, b: C128) -> complex:
    return complex(np.mean(a * b.conj()))


@pytest.mark.parametrize("seed", range(4))
def test_any_two_passes_have_the_stated_coherence_and_each_is_gaussian(seed: int) -> None:
    rng = np.random.default_rng([seed, 2012])
    long_term = float(rng.uniform(0.0, 1.0))
    decay = float(rng.uniform(2.0, 40.0)) if seed % 2 else 0.0
    days = (0.0, *np.sort(rng.uniform(0.1, 60.0, 3)))
    passes = [numbers(long_term, decay, t) for t in days]
    for i, one in enumerate(passes):
        power = np.abs(one) ** 2
        # circular, of mean power 1 and mean fourth power 2, and no number is larger than chance allows
        assert abs(one.mean()) < FIVE_SIGMA and abs((one**2).mean()) < np.sqrt(2.0) * FIVE_SIGMA
        assert power.mean() == pytest.approx(1.0, abs=FIVE_SIGMA)
        assert (power**2).mean() == pytest.approx(2.0, abs=np.sqrt(20.0) * FIVE_SIGMA)
        for j in range(i):
            gamma = float(theory.temporal_coherence(days[i] - days[j], long_term, decay))
            assert coherence(passes[j], one) == pytest.approx(gamma, abs=FIVE_SIGMA)
            if decay == 0.0:
                # all at once: jointly Gaussian; the mean product of both powers is 1 + gamma^2
                both = float(np.mean(np.abs(passes[j]) ** 2 * power))
                assert both == pytest.approx(1.0 + gamma**2, abs=np.sqrt(20.0) * FIVE_SIGMA)


def test_no_days_change_nothing_and_streams_are_independent() -> None:
    ensure_backend()
    key = mix(mi.UInt32(dr.arange(mi.UInt32, N)) * 0x9E3779B1 + 7)
    first = gaussian(key, 0)
    plain = np.asarray(first.real.numpy(), dtype=np.float64) + 1j * first.imag.numpy()
    assert np.array_equal(numbers(0.0, 0.0, 0.0), plain)
    assert np.array_equal(numbers(0.3, 12.0, 0.0), plain)
    assert np.array_equal(numbers(1.0, 5.0, 0.0), plain)
    # a decay: what has not changed keeps its bits
    kept = numbers(0.0, 10.0, 2.0) == plain
    assert kept.mean() == pytest.approx(np.exp(-0.2), abs=FIVE_SIGMA)
    later = [numbers(0.4, 6.0, 3.0, stream) for stream in range(3)]
    for a in range(3):
        for b in range(a):
            assert abs(coherence(later[a], later[b])) < FIVE_SIGMA


@pytest.mark.parametrize("long_term, decay", [(0.35, 0.0), (0.2, 10.0)])
def test_without_speckle_the_modulus_stays_one(long_term: float, decay: float) -> None:
    days = (0.0, 4.0, 11.0)
    passes = [numbers(long_term, decay, t, phase_only=True) for t in days]
    for i, one in enumerate(passes):
        assert np.abs(np.abs(one) - 1.0).max() < 1e-6  # tol: float32
        for j in range(i):
            gamma = float(theory.temporal_coherence(days[i] - days[j], long_term, decay))
            assert coherence(passes[j], one) == pytest.approx(gamma, abs=FIVE_SIGMA)


@pytest.mark.parametrize("seed", range(3))
def test_a_material_says_what_theory_says(seed: int) -> None:
    rng = np.random.default_rng([seed, 45])
    for days in (0.0, *rng.uniform(0.0, 50.0, 5)):
        for decay in (0.0, float(rng.uniform(1.0, 50.0))):
            stays = float(rng.uniform(0.0, 1.0))
            got = Material("m", temporal_coherence=stays, decorrelation_days=decay).coherence_after(days)
            assert got == pytest.approx(float(theory.temporal_coherence(days, stays, decay)), abs=1e-12)


def test_rms_coherence_is_the_second_moment_of_its_density() -> None:
    d = np.linspace(0.0, 1.0, 20001)
    for gamma, looks in ((0.0, 4.0), (0.3, 6.5), (0.8, 20.0)):
        density = theory.coherence_pdf(d, gamma, looks)
        want = np.sqrt(np.sum(density * d**2) / np.sum(density))
        assert theory.rms_coherence(gamma, looks) == pytest.approx(want, rel=1e-6)  # tol: the sum's steps


def test_the_receiver_has_other_noise_in_another_pass() -> None:
    radar = load_scene("point").radar
    one, same, later = (noise_generator(radar, 3, 0, days).standard_normal(4) for days in (0.0, 0.0, 1.0))
    assert np.array_equal(one, same) and not np.array_equal(one, later)


@pytest.fixture(scope="module")
def ground() -> Scene:
    return load_scene("flat_ground")


def in_pass(scene: Scene, days: float, **material: float) -> Scene:
    changed = tuple(replace(m, **material) for m in scene.materials)  # type: ignore[arg-type]
    return replace(scene, materials=changed, settings=replace(scene.settings, pass_days=days))


def test_the_plan_turns_it_on_in_later_passes_over_what_changes(ground: Scene) -> None:
    def decide(scene: Scene) -> tuple[bool, bool, float]:
        plan = plan_effects(scene, warn=False)
        decision = plan.decision("temporal_decorrelation")
        assert decision is not None
        return decision.on, plan.flags.temporal, decision.error_db

    assert decide(in_pass(ground, 12.0)) == (False, False, -np.inf)
    assert decide(in_pass(ground, 0.0, temporal_coherence=0.2)) == (False, False, -np.inf)
    on, flag, error = decide(in_pass(ground, 12.0, temporal_coherence=0.5))
    assert (
        on and flag and error == pytest.approx(0.0, abs=1e-9)
    )  # two passes of coherence 1/2: as large as the image
    on, flag, error = decide(in_pass(ground, 1.0, temporal_coherence=0.0, decorrelation_days=100.0))
    assert on and error == pytest.approx(10.0 * np.log10(2.0 * (1.0 - np.exp(-0.01))))
    forced = in_pass(ground, 0.0, temporal_coherence=0.2)
    forced = replace(forced, settings=replace(forced.settings, effects={"temporal_decorrelation": "on"}))
    assert decide(forced)[:2] == (True, False)


@pytest.mark.filterwarnings("ignore:.*Doppler bandwidth")  # no image is made of so few pulses
@pytest.mark.parametrize("stays, decay", [(0.0, 0.0), (0.5, 0.0), (0.2, 10.0)])
def test_what_fills_a_volume_changes_too(stays: float, decay: float) -> None:
    vertices, faces = cube()
    cloud = {
        "sigma_v_h_db": -10.0,
        "extinction_h": 0.05,
        "temporal_coherence": stays,
        "decorrelation_days": decay,
    }
    # a small sheet that mirrors away: a scene has some surface
    sheet = SceneMesh(
        [[8, -1, -6], [9, -1, -6], [9, 0, -6], [8, 0, -6]], [[0, 1, 2], [0, 2, 3]], "pec", "sheet"
    )
    scene = build_scene(
        [sheet],
        volumes=[SceneVolume([6.0, 6.0, 2.0] * vertices, faces, cloud, "crown")],
        radar=RadarDescription(slant_range=2e3, bandwidth=300e6, azimuth_resolution=0.5, n_pulses=32),
        film=FilmDescription(image_extent_azimuth=20.0, image_extent_range=20.0),
    )
    one, two = (simulate(replace(scene, settings=replace(scene.settings, pass_days=t))) for t in (0.0, 4.0))
    a, b = one.data[0], two.data[0]
    product = np.sum(a * b.conj()) / np.sqrt(np.sum(np.abs(a) ** 2) * np.sum(np.abs(b) ** 2))
    gamma = float(theory.temporal_coherence(4.0, stays, decay))
    # tol: four standard errors of 12 m by 12 m and cells of half a metre, some 500 samples
    print(product, gamma)
    assert abs(product - gamma) < 0.13
    later = plan_effects(replace(scene, settings=replace(scene.settings, pass_days=4.0)), warn=False)
    assert later.flags.temporal and later.on("temporal_decorrelation")


def test_rcs_of_a_rough_plate_has_passes_too() -> None:
    rough = Material(
        "rough",
        permittivity=4.0 + 0j,
        diffuse_law="constant",
        diffuse_level_db=0.0,
        rms_height=0.05,
        temporal_coherence=0.0,
    )
    plate = targets.geometry([targets.parallelogram((-1, -1, 0), (2, 0, 0), (0, 2, 0))])
    plan = plan_effects(in_pass(load_scene("flat_ground"), 1.0, temporal_coherence=0.0), warn=False)
    flags = replace(plan.flags, channels=("VV",))
    look = np.array([[0.6, 0.0, 0.8]])
    first, again, later = (
        monostatic_rcs(
            plate, (rough,), look, 9.65e9, channels=("VV",), ray_spacing=0.1, flags=flags, days=days
        ).amplitude
        for days in (0.0, 0.0, 5.0)
    )
    assert np.array_equal(first, again) and abs(first - later).max() > 0.1 * abs(first).max()
