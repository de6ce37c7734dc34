"""The cost study's arithmetic: combinations, corrections by what was run, recommendations."""

import json
from pathlib import Path

import numpy as np
import pytest

from sarmitsuba import RadarDescription, Scene, SceneMesh, build_scene
from sarmitsuba.apps.cost import REFERENCES, field_of_proof, reference_depth, study_cost
from sarmitsuba.apps.cost_model import CostModel, correct_predictions
from sarmitsuba.apps.cost_report import Candidate, ProofRun, Reference, options_of, pareto, recommend
from sarmitsuba.apps.cost_sweeps import LEAST_DEPTH, SPACINGS, depths
from sarmitsuba.apps.cost_trials import (
    MeasuredClock,
    Trials,
    TrialSetting,
    WorkClock,
    _part,
    mean_image,
    run_trial,
)
from sarmitsuba.core.errors import OutputError
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.loading.load import load_scene
from sarmitsuba.machine.journal import Journal
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.simulation.planning.pilot import plan_scene
from sarmitsuba.simulation.planning.prediction.speed import SpeedModel, Work, split_trace
from sarmitsuba.simulation.planning.sampling.density_plan import RaySpacings, SamplingPlan


def candidate(error_db: float, seconds: float, spacing: float = 1.0, method: str = "hybrid") -> Candidate:
    return Candidate({"method": method, "ray_spacing": spacing}, error_db, seconds)


def v_groove(opening_deg: float) -> Scene:
    """Groove of two metal walls of 0.6 m, its axis along the track, symmetric about the line of sight."""
    walls = []
    for name, side in (("one", -0.5), ("other", 0.5)):
        angle = np.radians(45.0 + side * opening_deg)
        x, z = -0.6 * np.sin(angle), 0.6 * np.cos(angle)
        corners = np.array([[0.0, -0.4, 0.0], [0.0, 0.4, 0.0], [x, 0.4, z], [x, -0.4, z]])
        walls.append(SceneMesh(corners, [[0, 1, 2], [0, 2, 3]], "pec", name))
    radar = RadarDescription(
        slant_range=2e3, bandwidth=300e6, azimuth_resolution=1.0, aim_x=0.0, aim_y=0.0, aim_z=0.0
    )
    film = FilmDescription(image_extent_azimuth=12.0, image_extent_range=12.0)
    return build_scene(walls, radar=radar, film=film)


def model() -> CostModel:
    plain = {
        "ray_spacing": 0.25,
        "max_depth": 7,
        "gridding_width": 4,
        "key_pulse_interval": 64,
        "focuser": "backprojection",
    }
    full = {
        "hybrid": {"build": 1.0, "launches": 0.5, "rays": 4.0, "focus": 2.0},
        "image": {"build": 1.0, "rays": 0.5, "form image": 0.1},
    }
    return CostModel(RaySpacings(0.25, 0.0), full, plain)


def test_times_are_scaled_by_stage_and_fixed_ones_stay() -> None:
    m = model()
    m.ratios["max_depth", 3] = {"build": 9.0, "rays": 0.5, "focus": 9.0}
    m.ratios["key_pulse_interval", 32] = {"launches": 2.0, "rays": 2.0}
    # twice the spacing is a quarter of the rays and changes their time only
    assert m.seconds("hybrid", {"ray_spacing": 0.5}) == pytest.approx(1.0 + 0.5 + 1.0 + 2.0)
    # so does the depth, whatever else the two timed runs differ in
    assert m.seconds("hybrid", {"max_depth": 3}) == pytest.approx(1.0 + 0.5 + 2.0 + 2.0)
    both = {"ray_spacing": 0.5, "key_pulse_interval": 32}
    assert m.seconds("hybrid", both) == pytest.approx(1.0 + 1.0 + 2.0 + 2.0)
    assert m.seconds("image", {"ray_spacing": 0.5}) == pytest.approx(1.0 + 0.125 + 0.1)


def test_two_runs_tell_launches_from_rays() -> None:
    found = split_trace({"build": 1.0, "trace": 8.5}, {"build": 1.0, "trace": 1.5}, 8.0)
    assert found == pytest.approx({"build": 1.0, "rays": 8.0, "launches": 0.5})
    # a disturbed run leaves neither negative
    odd = split_trace({"trace": 1.0}, {"trace": 2.0}, 8.0)
    assert odd == pytest.approx({"rays": 0.05, "launches": 0.95})


def test_error_energies_add_without_what_the_spacing_sweep_holds_already() -> None:
    m = model()
    m.errors |= {
        ("ray_spacing", 0.25): -30.0,
        ("max_depth", 3): -30.0,
        ("gridding_width", 4): -40.0,
        ("gridding_width", 2): -25.0,
        ("image", 0.25): -20.0,
    }
    found = {(c.changes["method"], c.changes.get("gridding_width")): c.error_db for c in m.combine()}
    assert found["hybrid", 4] == pytest.approx(10 * np.log10(2e-3), abs=1e-3)
    assert found["hybrid", 2] == pytest.approx(10 * np.log10(2e-3 + 10**-2.5 - 1e-4), abs=1e-3)
    assert found["image", None] == pytest.approx(10 * np.log10(1e-2 + 1e-3), abs=1e-3)


def test_runs_correct_their_neighbours_of_the_same_method() -> None:
    predicted = [
        candidate(-30.0, 1.0, 1.0),
        candidate(-36.0, 4.0, 0.5),
        candidate(-42.0, 16.0, 0.25),
        candidate(-20.0, 0.1, 1.0, "image"),
    ]
    found = correct_predictions(predicted, {0: ProofRun(-25.0, 1.5), 1: ProofRun(-33.0, 4.0)})
    assert [c.measured for c in found] == [True, True, False, False]
    assert (found[0].error_db, found[0].seconds) == (-25.0, 1.5)
    # the third is nearer to the second; the image has no neighbour, so its time stays, its error moves by the median
    assert (found[2].error_db, found[2].seconds) == (-39.0, 16.0)
    assert (found[3].error_db, found[3].seconds) == (-16.0, 0.1)


def test_front_and_recommendation() -> None:
    some = [candidate(-18.0, 0.3), candidate(-27.0, 0.5), candidate(-27.2, 0.7), candidate(-35.0, 2.0)]
    assert [c.error_db for c in pareto(some)] == [-18.0, -27.0, -35.0]
    found = recommend(some, -20.0)
    assert found.met and found.setting.error_db == -27.0
    assert "-18.0 dB in 0.30 s" in found.remark  # 7 dB better than wanted is explained
    assert found.setting.estimate().endswith("(predicted)")
    assert recommend(some, -26.0).remark == ""
    assert "common to all runs" in recommend(some, -10.0).remark
    # of what was not tried nothing is claimed
    cut = recommend(some, -10.0, ["ray_spacing", "focuser"]).remark
    assert "not all was tried: no time was left for ray_spacing, focuser" in cut and "common" not in cut
    most = recommend(some, -50.0)
    assert not most.met and most.setting.error_db == -35.0


def test_reference_takes_its_own_noise_off() -> None:
    rng = np.random.default_rng(1)

    def noise(power: float) -> np.ndarray:
        return np.sqrt(0.5 * power) * (rng.standard_normal((200, 200)) + 1j * rng.standard_normal((200, 200)))

    clean = noise(1.0)
    a, b = clean + noise(2e-3), clean + noise(2e-3)
    mean = 0.5 * (a + b)
    reference = Reference(mean, float(np.mean(np.abs(a - b) ** 2)) / 4.0)
    # tol: 0.3 dB, Monte Carlo of 40000 pixels (0.02 dB) and the mean's energy, 0.1 % above one
    assert reference.error_db(clean + noise(3e-3)) == pytest.approx(10 * np.log10(3e-3), abs=0.3)
    assert reference.error_db(mean) == pytest.approx(-120.0)
    # bounces that the reference lacks are an error of every image
    blind = Reference(mean, 0.0, 0.1)
    assert blind.error_db(mean) == pytest.approx(-10.0)


def test_a_reference_has_all_bounces_that_the_scene_needs() -> None:
    def found(planned: int, energies: list[float | None]) -> tuple[int, float]:
        plan = EffectsPlan(KernelFlags(), planned, pilot={"energy_from_order_upper_db": energies})  # type: ignore[typeddict-item]
        return reference_depth(scene, plan)

    scene = load_scene("dihedral")
    assert found(2, [0.0, -3.0, None, None, None, None, None, None]) == (LEAST_DEPTH, 0.0)
    # until the rest is below -60 dB, and where it is not by what the pilot traced, as many as planned
    assert found(10, [0.0] * 10 + [-50.0, -65.0]) == (11, pytest.approx(10**-6.5))
    assert found(10, [0.0] * 10 + [-50.0, -55.0]) == (10, pytest.approx(1e-5))
    # the pilot itself ends there: as much as its last bounce has may be missing
    assert found(12, [0.0] * 11 + [-20.0]) == (12, pytest.approx(1e-2))
    assert reference_depth(scene, EffectsPlan(KernelFlags(), 8)) == (8, 0.0)
    assert depths(10, 10) == [1, 2, 3, 4, 6, 8] and depths(6, 5) == [1, 2, 3, 4, 5] and depths(24, 7)[5] == 7


def test_the_reference_does_not_obey_the_scenes_own_limit() -> None:
    """Perpendicular walls of 18 deg between them return after ten bounces, and they alone."""
    scene = v_groove(18.0)
    for limited in (scene.replace(max_depth=4), scene.replace(method="raster")):
        assert reference_depth(limited, EffectsPlan(KernelFlags(), 4))[0] == 10


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*echoes of objects that shadow or mirror each other")
def test_the_recommendation_for_a_groove_has_its_bounces() -> None:
    """Errors stated are those against a run with more bounces and denser rays than any of the study."""
    scene = v_groove(18.0)
    found = study_cost(scene, budget=4.5, clock=WorkClock())
    best = found.recommendation
    assert best.met and best.setting.changes["max_depth"] == 10 and "10 bounces" in found.reference
    assert any(row.parameter == "max_depth" and row.value == "10" for row in found.rows)
    fewer = [row for row in found.rows if row.parameter == "max_depth" and row.value in ("4", "6", "8")]
    assert len(fewer) == 3 and min(row.error_db for row in fewer) > -3.0
    grid = default_grid(scene.radar, scene.image)
    spacings = SamplingPlan.of(scene, plan_scene(scene).flags).spacings
    truth = mean_image(scene, TrialSetting({"max_depth": 14, **spacings.at(0.45)}), grid, 2)
    error = run_trial(scene, TrialSetting(best.setting.changes), grid, pass_index=3).error_db(truth)
    # tol: 2 dB, what the study estimates: one run is one realisation of its rays
    assert error < best.setting.error_db + 2.0 and error < -20.0


def test_compiling_is_not_counted() -> None:
    seconds = 0.0
    clock = MeasuredClock(lambda: seconds)
    begin, seconds = clock.now(), 7.0
    assert clock.stages({"trace": 1.0}, Work(rays=1.0), 5.5) == {"trace": 1.0}
    assert clock.now() - begin == pytest.approx(1.5)


def test_options_trace_the_rays_that_were_timed() -> None:
    text = options_of({"ray_spacing": 0.25, "method": "hybrid", "key_pulse_interval": 64})
    assert (
        text
        == "-D sar_path.ray_spacing=0.25 -D sar_path.key_pulse_interval=64 --method hybrid --no-error-bars"
    )
    assert options_of({"keep_orders": False}) == "-D sar_path.keep_orders=false --no-error-bars"


def test_the_reference_is_of_as_much_of_the_scene_as_the_budget_allows() -> None:
    scene = load_scene("dihedral")

    def field(rays: float, budget: float) -> tuple[float, float]:
        stages = {"build": 1.0, "rays": rays, "focus": 1.0}
        found, factor, _ = field_of_proof(scene, stages, budget, budget)
        return (found.image.extent_range / scene.image.extent_range if found else 0.0), factor

    # a quarter is allowed: two passes, twice the key pulses, 1 / factor^2 as many rays
    assert field(4.0, 360.0) == (1.0, 0.5)
    assert field(7.0, 360.0) == (1.0, 0.6)
    assert field(60.0, 2480.0) == (pytest.approx(0.7), 0.5)
    # less than 40 runs: the swept piece serves
    assert field(60.0, 2400.0) == (0.0, 0.0)
    # never as coarse as what is measured against it
    assert max(factor for _, factor in REFERENCES) < min(SPACINGS)


def test_counted_seconds_are_the_work_and_nothing_else() -> None:
    model = SpeedModel(ray=1e-6, launch=0.1, scatterer=0.0, path_pulse=0.0, sample=0.0, pixel_pulse=1e-9)
    clock = WorkClock(model, 0.5)
    work = Work(rays=2e6, launches=3, samples=1e9, pixel_pulses=1e9)
    found = clock.stages({"build": 123.0, "trace": 456.0, "focus": 789.0}, work)
    assert found == pytest.approx({"build": 0.5, "trace": 0.5 + 0.3 + 2.0, "focus": 0.5 + 1.0})
    assert clock.now() == pytest.approx(4.8)
    assert clock.stages({"raster": 9.0}, work) == pytest.approx({"raster": 0.5 + 0.3 + 2.0})


def test_a_measured_speed_predicts_more_of_the_same_work() -> None:
    part = Work(rays=1e6, samples=2e5, pixel_pulses=3e6)
    speed = SpeedModel.measured(part, {"trace": 0.2, "synthesise": 0.1, "focus": 0.3})
    whole = Work(rays=5e6, samples=4e5, pixel_pulses=3e6)
    assert speed.stages(whole) == pytest.approx({"trace": 1.0, "synthesise": 0.2, "focus": 0.3})
    assert speed.seconds(whole) == pytest.approx(1.5)


def test_every_setting_runs_once_and_is_kept(tmp_path: Path) -> None:
    scene = load_scene("dihedral")
    state, setting = tmp_path / "cost.trials", TrialSetting({"method": "image", "max_depth": 2})
    first = Trials(WorkClock(), state, "one")
    made = first.run(scene, setting)
    assert first.run(scene, setting) is made and first.count == 1
    first.close()
    again = Trials(WorkClock(), state, "one")
    kept = again.run(scene, setting)
    assert again.reused == 1 and kept.stages == made.stages and kept.statistics == made.statistics
    np.testing.assert_array_equal(kept.image, made.image)
    again.close()
    other = Trials(WorkClock(), state, "another")  # another scene or program: nothing is taken
    assert other.stale and str(other).startswith(f"{state}: trials of another scene") and not str(again)
    assert str(other).endswith("; begun anew")
    other.close()
    empty = Journal(state, lambda label, payload: True)
    assert [label["kind"] for label in empty.labels] == ["cost study"]
    key = json.dumps([_part(scene), dict(sorted(setting.changes.items())), 0, 0])
    empty.clear()
    empty.append({"kind": "cost study", "hash": "one"}, np.empty(0, np.uint8))
    empty.append({"kind": "trial", "key": key, "stages": {"trace": "soon"}}, made.image)
    empty.close()
    hostile = Trials(WorkClock(), state, "one")  # no trial that the program writes: it is run again
    np.testing.assert_array_equal(hostile.run(scene, setting).image, made.image)
    assert hostile.reused == 0
    hostile.close()
    state.write_bytes(b"my own notes")
    with pytest.raises(OutputError, match="was not written by the program"):
        Trials(WorkClock(), state, "one")
    assert state.read_bytes() == b"my own notes"
