"""Disturbed seconds in a cost study: samples are faked by a law of seconds and errors, one of them disturbed."""

import itertools
import zlib
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sarmitsuba import RadarDescription, Scene, SceneMesh, build_scene
from sarmitsuba.apps import cost_trials as trials_module
from sarmitsuba.apps.cost import study_cost
from sarmitsuba.apps.cost_model import correct_predictions
from sarmitsuba.apps.cost_report import Candidate, CostReport, ProofRun, beaten, recommend
from sarmitsuba.apps.cost_trials import Changes, Trial, Trials, TrialSetting
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.focuser import parse_focuser
from sarmitsuba.simulation.execution.statistics import TraceStatistics
from sarmitsuba.simulation.planning.prediction.speed import Work

SPACING, PULSES, INTERVAL, DEPTH = 0.0069, 54, 27, 6
FOCUS = {"auto": 0.4, "factorised": 0.4, "backprojection": 1.0}


def plate() -> Scene:
    corners = np.array([[-0.3, -0.4, 0.0], [0.3, -0.4, 0.0], [0.3, 0.4, 0.0], [-0.3, 0.4, 0.0]])
    radar = RadarDescription(
        slant_range=2e3, bandwidth=300e6, azimuth_resolution=1.0, aim_x=0.0, aim_y=0.0, aim_z=0.0
    )
    film = FilmDescription(image_extent_azimuth=12.0, image_extent_range=12.0)
    return build_scene([SceneMesh(corners, [[0, 1, 2], [0, 2, 3]], "pec", "one")], radar=radar, film=film)


def law(changes: Changes, share: float = 1.0) -> tuple[dict[str, float], float]:
    """Seconds by stage for a share of the image's area, and energy of the error relative to the image."""
    rays = (SPACING / float(changes.get("ray_spacing", SPACING))) ** 2
    depth = int(changes.get("max_depth", DEPTH))
    keys = -(-PULSES // int(changes.get("key_pulse_interval", INTERVAL)))
    bounces = 1.0 - 0.6**depth
    error = 1e-3 * rays**-1.5 + 0.1 * 0.02**depth
    if changes["method"] != "hybrid":
        return {"build": 0.1, "trace": 0.05 + 0.2 * share * rays * bounces, "form image": 0.05}, error + 0.02
    focuser = str(changes.get("focuser", "backprojection")).partition(",")[0]
    error += {"backprojection": 1e-6}.get(focuser, 1e-5) + 1e-4 / keys
    seconds = {
        "build": 0.1,
        "trace": keys * (0.02 + 0.5 * share * rays * bounces),
        "synthesise": 0.1,
        "focus": share * FOCUS.get(focuser, 0.7),
    }
    return seconds, error


class FakedRuns:
    """Stands in for ``run_trial``: the law, with a run that took several times as long."""

    def __init__(self, disturbed: int, factor: float) -> None:
        self.disturbed, self.factor, self.count = disturbed, factor, 0
        self.elapsed, self.whole = 0.0, plate()
        self.source = lambda: 0.0

    def now(self) -> float:
        return self.elapsed

    def stages(
        self, measured: Mapping[str, float], work: Work, compile_seconds: float = 0.0
    ) -> dict[str, float]:
        return dict(measured)

    def run(self, scene: Scene, setting: TrialSetting, grid: Any = None, **given: Any) -> Trial:
        share = scene.image.extent_azimuth * scene.image.extent_range / 144.0
        seconds, energy = law({"method": "hybrid", **setting.changes}, share)
        if "focus" in seconds:  # as each focuser's own model
            here, whole = (
                parse_focuser(setting.focuser).cpu_seconds(
                    x.radar.start_stop(), default_grid(x.radar, x.image)
                )
                for x in (scene, self.whole)
            )
            seconds["focus"] *= here / whole / share
        if given.get("echoes_of") is not None:
            kept = given["echoes_of"].stages
            seconds = {stage: kept.get(stage, s) if stage != "focus" else s for stage, s in seconds.items()}
        rng = np.random.default_rng(self.count)
        noise = 1.0 + 0.02 * rng.standard_normal()  # of the clock
        if self.count == self.disturbed:
            noise *= self.factor
        seconds = {stage: noise * s for stage, s in seconds.items()}
        self.count += 1
        self.elapsed += sum(seconds.values())
        shape = (grid or default_grid(scene.radar, scene.image)).shape
        rng = np.random.default_rng(
            zlib.crc32(f"{sorted(setting.changes.items())} {given['pass_index']}".encode())
        )
        image = 1.0 + np.sqrt(0.5 * energy) * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
        statistics = TraceStatistics(rays=1000, key_pulses=2)
        interval = int(setting.changes.get("key_pulse_interval", INTERVAL))
        raw: Any = SimpleNamespace()
        return Trial(setting, image.astype(np.complex64), seconds, 0.0, 0, statistics, interval, raw)


def study(monkeypatch: pytest.MonkeyPatch, disturbed: int = -1, factor: float = 1.0) -> CostReport:
    runs = FakedRuns(disturbed, factor)
    monkeypatch.setattr(trials_module, "run_trial", runs.run)
    return study_cost(plate(), target_error_db=-20.0, clock=runs)


@pytest.fixture(scope="module")
def drawn() -> list[tuple[int, float]]:
    """Numbers of the disturbed run, all of the first ones, which the others are compared to; and its factor."""
    rng = np.random.default_rng(28)
    later = rng.integers(14, 90, 10)
    return [(int(k), float(rng.choice([0.3, 1.8, 4.0]))) for k in (*range(14), *later)]


def test_one_disturbed_sample_changes_neither_estimates_nor_the_recommendation(
    monkeypatch: pytest.MonkeyPatch, drawn: list[tuple[int, float]]
) -> None:
    for disturbed, factor in drawn:
        found = study(monkeypatch, disturbed, factor)
        case = f"run {disturbed} took {factor:g} times as long"
        own_stages, own_error = law(found.own.changes)
        own = Candidate({}, 10.0 * np.log10(own_error), sum(own_stages.values()))
        assert found.own.measured and found.own.seconds == pytest.approx(own.seconds, rel=0.1), case
        for target in (-10.0, -20.0, -25.0, -40.0):
            best = found.recommend(target).setting
            stages, error = law(best.changes)
            true = Candidate({}, 10.0 * np.log10(error), sum(stages.values()))
            # tol: 5 % of the seconds and 0.3 dB, twice the scatter of the faked clock and of the faked images
            assert not (
                true.seconds > 1.05 * own.seconds
                and true.error_db > own.error_db - 0.3
                and best is not found.own
            ), (case, target, best)
            assert best.seconds == pytest.approx(true.seconds, rel=0.3), (case, target, best)
        near = [c for c in found.candidates if c.error_db < -10.0]
        ratios = [c.seconds / sum(law(c.changes)[0].values()) for c in near]
        within = np.mean([1.0 / 1.3 < r < 1.3 for r in ratios])
        assert within > 0.95, (case, within)
        assert found.seconds < 1.1 * found.budget, case


def test_a_run_that_another_does_not_confirm_is_made_a_third_time() -> None:
    def steady(*seconds: float) -> tuple[float, int]:
        made = itertools.count()
        trials = Trials(FakedRuns(-1, 1.0))

        def run(*given: Any, **options: Any) -> Any:
            next(made)
            return SimpleNamespace(seconds=seconds[options["again"]])

        trials.run = run  # type: ignore[method-assign]
        return trials.steady(plate(), TrialSetting()).seconds, next(made)

    assert steady(1.0, 1.05) == (1.0, 2)
    assert steady(3.0, 1.0, 1.05) == (1.05, 3)  # disturbed
    assert steady(0.2, 1.0, 1.05) == (1.0, 3)  # too much was subtracted for compiling


def test_an_outlier_among_measured_candidates_corrects_no_other() -> None:
    predicted = [
        Candidate({"method": "hybrid", "ray_spacing": s}, -30.0, 1.0 / s)
        for s in (1.0, 0.5, 0.25, 0.125, 0.0625)
    ]
    runs = {i: ProofRun(-30.0, 1.1 * predicted[i].seconds) for i in range(3)}
    runs[3] = ProofRun(-30.0, 4.0 * predicted[3].seconds)
    found = correct_predictions(predicted, runs)
    assert found[3].seconds == pytest.approx(32.0)  # as measured
    assert found[4].seconds == pytest.approx(1.1 * 16.0)
    # systematic differences stay: they are as many as the others
    runs[2] = ProofRun(-30.0, 4.0 * predicted[2].seconds)
    assert correct_predictions(predicted, runs)[4].seconds == pytest.approx(4.0 * 16.0)


def test_nothing_slower_and_no_more_accurate_than_the_scenes_own_setting_is_recommended() -> None:
    rng = np.random.default_rng(3)
    for _ in range(300):
        some = [
            Candidate(
                {"method": "hybrid", "ray_spacing": 1.0}, rng.uniform(-40.0, -10.0), rng.uniform(0.1, 10.0)
            )
            for _ in range(6)
        ]
        own = some[-1]
        for target in (-12.0, -25.0, -45.0):
            best = recommend(some, target, own=own).setting
            assert not beaten(best, own)
            if best.error_db > target:
                assert min(c.error_db for c in some if not beaten(c, own)) > target - 0.5
