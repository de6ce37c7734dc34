"""The registry and each effect's rule, from static context alone."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest

from sarmitsuba.core.errors import RadarError, SarmitsubaError, SarmitsubaWarning, SceneError
from sarmitsuba.effects.context import PilotResult, SamplingFacts, SceneContext
from sarmitsuba.effects.effect import effects
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.plan import EffectsPlan, plan_effects
from sarmitsuba.loading.library import resolve
from sarmitsuba.loading.load import load_scene
from sarmitsuba.loading.tables import INTEGRATOR
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.track import Track
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.scene import Scene


@pytest.fixture(scope="module")
def corner() -> Scene:
    """A dihedral of perfect conductors: two bounces, isotropic beam, HH and VV."""
    return load_scene(resolve("dihedral"))


@pytest.fixture(scope="module")
def ground() -> Scene:
    """Flat rough soil."""
    return load_scene(resolve("flat_ground"))


def decide(scene: Scene, name: str, sampling: SamplingFacts | None = None) -> tuple[bool, float]:
    decision = plan_effects(scene, sampling, warn=False).decision(name)
    assert decision is not None
    return decision.on, decision.error_db


def with_material(scene: Scene, **changes: object) -> Scene:
    return replace(scene, materials=(replace(Material("m", pec=True), **changes),))  # type: ignore[arg-type]


def switched(scene: Scene, **switches: str) -> Scene:
    return replace(scene, settings=replace(scene.settings, effects=switches))  # type: ignore[arg-type]


def test_every_switch_of_the_scene_file_has_an_effect() -> None:
    names = [e.name for e in effects()]
    assert len(set(names)) == len(names)
    switches = {p.name for p in INTEGRATOR.rows if p.choices == ("auto", "on", "off")}
    assert switches - {"endless_ground"} == set(names) - {"max_depth"}  # ground is geometry, not an effect
    assert all(e.title for e in effects())


def test_every_kernel_flag_is_declared_by_the_one_effect_that_sets_it(corner: Scene) -> None:
    context = SceneContext(corner)
    plan = plan_effects(corner)
    decided = {d.name: d for d in plan.decisions}
    for effect in effects():
        for on in (False, True):
            assert set(effect.flags(on, context, decided)) == set(effect.kernel_flags)
        assert all(effect.kernel_flags.values())
    declared = [name for effect in effects() for name in effect.kernel_flags]
    own = {"double_phase", "taper", "extra"}  # no effects
    assert len(declared) == len(set(declared)) and not own & set(declared)
    assert {f.name for f in fields(KernelFlags)} < own | set(declared)
    # flags of kinds of scatterers that can be deleted have no field
    assert set(declared) - {f.name for f in fields(KernelFlags)} == {"diffuse_pairs", "edge_diffraction"}
    assert plan.flags.extra <= set(declared)


def test_a_switch_that_no_effect_has_is_refused(corner: Scene) -> None:
    with pytest.raises(SceneError, match="there is no effect 'frensel' to switch; did you mean"):
        plan_effects(switched(corner, frensel="off"))


def test_perfect_conductors_need_no_fresnel(corner: Scene) -> None:
    assert decide(corner, "fresnel") == (False, -np.inf)
    on, error = decide(with_material(corner, pec=False, permittivity=5.0 - 0.5j), "fresnel")
    assert on and np.isnan(error)  # perfect conductors return more than all there is
    # copper is a perfect conductor to the tolerance: |1 + R| is about 2 sqrt(2 w eps0 / sigma) / cos, -53 dB at 60 deg
    on, error = decide(with_material(corner, pec=False, permittivity=1.0 - 1e10j), "fresnel")
    assert not on and -90.0 < error < -40.0


def test_roughness_below_the_tolerance_is_left_out(corner: Scene) -> None:
    k = 2 * np.pi / corner.radar.waveform.wavelength
    for ks, expected in ((0.0, False), (0.05, False), (0.1, True), (1.0, True)):
        on, error = decide(with_material(corner, rms_height=ks / k), "roughness")
        assert on == expected
        if ks:
            bound = np.nan if expected else 20 * np.log10(1 - np.exp(-2 * ks**2))
            assert error == pytest.approx(bound, nan_ok=True)


def test_rough_ground_returns_nothing_coherent(ground: Scene) -> None:
    sampling = SamplingFacts(0.2, 100_000, 0.45, ground.geometry.bounds, 8, 0.4, 0.4)
    assert decide(ground, "coherent", sampling)[0] is False
    smooth = replace(ground, materials=tuple(replace(m, rms_height=1e-4) for m in ground.materials))
    assert decide(smooth, "coherent", sampling)[0] is True
    assert plan_effects(ground, sampling).flags.tube_phase is False


def test_beam_counts_where_it_varies(corner: Scene) -> None:
    assert decide(corner, "antenna_pattern") == (False, -np.inf)
    for width, expected in ((0.5, False), (1e-3, True)):  # the dihedral is 1.4 m at 10 km: 1.4e-4 rad
        scene = replace(corner, radar=replace(corner.radar, antenna=Antenna("gaussian", 1.0, width, width)))
        assert decide(scene, "antenna_pattern")[0] is expected
        seen = plan_effects(scene).apply(scene)
        assert (seen.radar.antenna.pattern == "isotropic") is not expected
        assert seen.radar.antenna.gain == scene.radar.antenna.gain


def test_spreading_counts_near_the_antenna(corner: Scene, ground: Scene) -> None:
    assert decide(corner, "spreading")[0] is False
    near = np.array([[-200.0, -200.0, 0.0], [200.0, 200.0, 0.0]])
    assert decide(ground, "spreading", SamplingFacts(0.2, 1, 0.4, near, 1, 0.3, 0.3))[0] is True


def test_a_tighter_tolerance_leaves_less_out(corner: Scene) -> None:
    def at(tolerance_db: float) -> EffectsPlan:
        scene = replace(corner, settings=replace(corner.settings, tolerance_db=tolerance_db))
        energy, peak = [1.0, 1e-3, 1e-5, 1e-9], [2.0, 1e-2, 1e-5, 1e-9]
        return plan_effects(scene, pilot=pilot(energy, peak, 0.0), warn=False)

    spreading = plan_effects(corner, warn=False).decision("spreading")
    assert spreading is not None and -95.0 < spreading.error_db < -45.0
    assert [at(t).on("spreading") for t in (-40.0, spreading.error_db - 1.0)] == [False, True]
    assert [at(t).max_depth for t in (-20.0, -40.0, -60.0, -100.0)] == [1, 2, 3, 4]
    assert at(-60.0).pilot["tolerance_db"] == -60.0


@pytest.mark.parametrize("value", ["0", "10", "nan", "-inf", "low"])
def test_a_tolerance_is_finite_and_negative(value: str) -> None:
    with pytest.raises(SarmitsubaError, match=r"-D sar_path.tolerance_db=.*tolerance_db = "):
        load_scene(resolve("dihedral"), parameters={"sar_path.tolerance_db": value})


def test_the_tolerance_of_the_scene_holds() -> None:
    assert load_scene(resolve("dihedral")).settings.tolerance_db == -40.0
    asked = load_scene(resolve("dihedral"), parameters={"sar_path.tolerance_db": "-50"})
    assert asked.settings.tolerance_db == SceneContext(asked).tolerance_db == -50.0


def test_coherent_is_a_switch(ground: Scene, corner: Scene) -> None:
    smooth = replace(ground, materials=tuple(replace(m, rms_height=1e-4) for m in ground.materials))
    sampling = SamplingFacts(0.2, 100_000, 0.45, ground.geometry.bounds, 8, 0.4, 0.4)
    with pytest.warns(SarmitsubaWarning, match="coherent is switched off; predicted error at most 0 dB"):
        plan = plan_effects(switched(smooth, coherent="off"), sampling)
    assert not plan.flags.coherent and not plan.flags.tube_phase and plan.flags.diffuse
    assert plan_effects(switched(ground, coherent="on"), sampling).flags.coherent
    with pytest.raises(SceneError, match="coherent = off leaves no echo at all"):
        plan_effects(switched(corner, coherent="off"))


def test_fine_tubes_need_no_phase_integral(corner: Scene) -> None:
    wavelength = corner.radar.waveform.wavelength
    for part, expected in ((4.5, True), (8.0, True), (60.0, False)):
        sampling = SamplingFacts(wavelength / part, 1, 1.0, corner.geometry.bounds, 1, 0.8, 0.8)
        assert decide(corner, "tube_phase", sampling)[0] is expected


def test_channels_follow_the_switch(corner: Scene) -> None:
    cross = replace(corner, radar=replace(corner.radar, channels=("HH", "HV")))
    assert plan_effects(cross).flags.channels == ("HH", "HV")
    with pytest.warns(SarmitsubaWarning, match="cross_polarisation is switched off"):
        plan = plan_effects(switched(cross, cross_polarisation="off"))
    assert plan.flags.channels == plan.apply(cross).radar.channels == ("HH",)
    only = replace(corner, radar=replace(corner.radar, channels=("HV",)))
    with pytest.raises(RadarError, match="leaves none of the channels HV"):
        plan_effects(switched(only, cross_polarisation="off"))


@pytest.mark.parametrize(
    ("ratio", "channels", "expected"),
    [
        (-np.inf, ("HH", "HV"), False),
        (-12.0, ("HH", "HV"), True),
        (-12.0, ("HH",), True),
        (-50.0, ("HH",), False),
        (-50.0, ("HH", "HV"), True),
    ],
)
def test_depolarisation_needs_a_channel_that_shows_it(
    corner: Scene, ratio: float, channels: tuple[str, ...], expected: bool
) -> None:
    scene = with_material(corner, diffuse_law="lambert", diffuse_level_db=-10.0, cross_polar_ratio_db=ratio)
    scene = replace(scene, radar=replace(scene.radar, channels=channels))
    assert decide(scene, "depolarisation")[0] is expected


def test_only_laws_that_tell_h_from_v_are_polarised(corner: Scene) -> None:
    lambert = with_material(corner, diffuse_law="lambert", diffuse_level_db=-10.0)
    assert plan_effects(lambert).flags.polarised_diffuse is False
    bragg = with_material(
        corner,
        pec=False,
        permittivity=20 - 5j,
        diffuse_law="small_perturbation",
        rms_height=1e-3,
        correlation_length=0.02,
    )
    assert plan_effects(bragg).flags.polarised_diffuse is True
    rough = with_material(corner, pec=False, permittivity=5 - 0.5j, diffuse_law="roughness", rms_height=1e-3)
    assert plan_effects(rough).flags.polarised_diffuse is True
    metal = with_material(corner, diffuse_law="roughness", rms_height=1e-3)
    assert plan_effects(metal).flags.polarised_diffuse is False


def test_a_bent_track_is_flown_unless_switched_off(corner: Scene) -> None:
    assert decide(corner, "trajectory")[0] is False
    track = corner.radar.track
    bent = track.position + np.array([0.0, 0.0, 0.05]) * np.sin(np.linspace(0, 6, track.n_pulses))[:, None]
    scene = replace(corner, radar=replace(corner.radar, track=Track(track.time, bent, track.velocity)))
    assert decide(scene, "trajectory")[0] is True
    with pytest.warns(SarmitsubaWarning, match="trajectory is switched off"):
        plan = plan_effects(switched(scene, trajectory="off"))
    assert plan.apply(scene).radar.track.is_straight and not scene.radar.track.is_straight


def test_noise_follows_the_temperature(corner: Scene) -> None:
    assert decide(corner, "noise")[0] is False
    warm = replace(corner, radar=replace(corner.radar, noise_temperature=290.0))
    assert decide(warm, "noise")[0] is True
    plan = plan_effects(switched(warm, noise="off"), warn=False)
    assert plan.apply(warm).radar.noise_temperature == 0.0


def pilot(
    energy: list[float], peak: list[float], clutter: float = 1.0, deviation: float = 0.0
) -> PilotResult:
    mean = np.zeros((4, len(energy)))
    mean[3], mean[0] = energy, energy
    mean[1, 0] = clutter
    peaks = np.zeros((4, len(energy)))
    peaks[3] = peaks[0] = peak
    return PilotResult((0,), 1, 100, 0, 0, mean, deviation * mean, np.ones(len(energy)), peaks, 1.0, 0.1)


@pytest.mark.parametrize(
    ("energy", "peak", "clutter", "deviation", "depth"),
    [
        ([1, 1e-6, 0, 0], [2, 1e-4, 0, 0], 1.0, 0.0, 1),  # weak in both respects
        ([1, 1e-2, 1e-6, 0], [2, 1e-3, 1e-4, 0], 1.0, 0.0, 2),  # energy keeps the second bounce
        ([1, 1e-6, 1e-6, 0], [2, 1e-4, 50, 0], 1.0, 0.0, 3),  # one bright cell keeps the third
        ([1, 9e-5, 0, 0], [2, 1e-3, 0, 0], 1.0, 0.5, 2),  # below the tolerance, but not surely
        ([1, 1e-6, 0, 0], [2, 1e-3, 0, 0], 0.0, 0.0, 2),  # without clutter the peak is what counts
        ([1, 1, 1, 1], [2, 2, 2, 2], 1.0, 0.0, 4),  # never enough
    ],
)
def test_depth_from_a_pilot(
    corner: Scene, energy: list[float], peak: list[float], clutter: float, deviation: float, depth: int
) -> None:
    plan = plan_effects(corner, pilot=pilot(energy, peak, clutter, deviation), warn=False)
    assert plan.max_depth == depth
    assert plan.flags.multi_bounce == (depth > 1)
    decision = plan.decision("max_depth")
    assert decision is not None and decision.source == "pilot"


def test_an_explicit_depth_is_obeyed(corner: Scene, ground: Scene) -> None:
    two = replace(corner, settings=replace(corner.settings, max_depth=2))
    assert plan_effects(two).max_depth == 2
    # five bounces on flat ground: the first is the last
    five = replace(ground, settings=replace(ground.settings, max_depth=5))
    assert plan_effects(five).max_depth == 1


def test_summary_and_json(corner: Scene) -> None:
    plan = plan_effects(corner).with_key_pulses(32, -40.0, asked=False)
    assert plan.summary().startswith("max_depth 8, key_pulse_interval 32; on: coherent")
    blocks = plan.decision("key_pulse_interval")
    assert blocks is not None and blocks.error_db == -40.0 and "-40 dB, measured" in blocks.why
    record = json.loads(json.dumps(plan.as_dict()))
    assert record["effects"]["fresnel"] == {
        "on": False,
        "why": "all surfaces are perfect conductors",
        "value": None,
        "error_db": None,
        "error_is": "none",
        "cost": None,
        "source": "fact",
    }
    # a plan without decisions, as others make it, changes nothing
    bare = EffectsPlan(KernelFlags(), 3)
    assert bare.apply(corner) is corner and not bare.on("noise") and "max_depth 3" in bare.summary()
