"""The explain command, and its prediction against a run."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.cli import main
from sarmitsuba.core.arrays import C64
from sarmitsuba.effects.effect import Decision
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.plan import DEFAULT_DEPTH, EffectsPlan
from sarmitsuba.loading.library import resolve
from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.planning.prediction import prediction
from sarmitsuba.simulation.planning.prediction.both_ways import (
    CONFIDENCE,
    measured_both_ways,
    ratio_margin,
    share_of,
    switch_effect,
)
from sarmitsuba.simulation.planning.prediction.prediction import Explanation, explain, predict
from tests.support.unweighted import focus


def test_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "plate", "--no-error-bars", "--measure"]) == 0
    text = capsys.readouterr().out
    assert "one flat surface cannot reflect onto itself" in text
    assert "predicted:" in text and "B of memory" in text and "measured here on a part of it" in text
    assert "max_depth" in text and "key_pulse_interval" in text


def test_json(capsys: pytest.CaptureFixture[str]) -> None:
    # of a scene with few effects to try both ways
    assert main(["explain", "point", "--json", "-D", "polarisation=HH"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["plan"]["channels"] == ["HH"]
    assert record["prediction"]["total_seconds"] > 0.0 and record["prediction"]["memory_bytes"] > 1e7
    assert main(["explain", "dihedral", "--json", "--plan-only"]) == 0
    assert "prediction" not in json.loads(capsys.readouterr().out)


def test_unknown_scene_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "no_such_scene"]) == 2
    assert capsys.readouterr().err.startswith("error: no_such_scene")


def test_prediction_counts_what_the_run_does() -> None:
    scene = load_scene(resolve("dihedral"))
    _, prediction = predict(scene)
    raw = simulate(scene)
    image = focus(raw)
    statistics = raw.metadata["statistics"]
    assert prediction.rays == statistics["rays"]
    assert prediction.key_pulses == statistics["key_pulses"]
    # tol: all blocks are taken to be like one of them; rays at the rims hit in some and miss in others
    assert prediction.contributions == pytest.approx(statistics["contributions"], rel=1e-3)
    assert prediction.pixels == image.data.size
    assert prediction.raw_bytes == raw.data.nbytes
    assert prediction.key_pulse_interval == raw.metadata["sampling"]["key_pulse_interval"]
    # it has the run's own stages, focusing, and what a first use loads
    assert set(prediction.seconds) == {*raw.metadata["seconds"], "focus", "first use"}


@pytest.mark.filterwarnings("ignore:.*edge_diffraction is switched off")
def test_prediction_takes_every_batch_to_be_like_the_first() -> None:
    """On a clock that counts its readings a batch lasts as many seconds as it has stages, whatever the machine."""
    # one launch a block: edges would take another
    parameters = {"sar_path.key_pulse_interval": "8", "sar_path.edge_diffraction": "off"}
    parameters["sar_path.keep_subsets"] = "false"
    scene = load_scene(resolve("dihedral"), parameters=parameters)
    readings = itertools.count()
    _, prediction = predict(scene, clock=lambda: float(next(readings)))
    batches = -(-scene.radar.track.n_pulses // prediction.key_pulse_interval)
    assert batches > 1
    # tol: the last block may be shorter than the first
    assert prediction.seconds["trace"] == pytest.approx(batches, abs=1.0)
    assert prediction.seconds["synthesise"] == pytest.approx(batches, abs=1.0)


def test_cost_is_the_share_of_the_longer_way() -> None:
    """From a table of seconds: as planned, the other way, what is on."""
    assert share_of(True, 2.0, 1.5) == 0.25  # without it three quarters are left
    assert share_of(False, 1.5, 2.0) == 0.25  # it would come on top
    assert share_of(True, 1.0, 1.1) == 0.0  # scatter of timing: nothing takes less than nothing


def test_margin_of_a_change_seen_in_some_blocks() -> None:
    """It covers the ratio over all parts of drawn populations about as often as it says; 0 where all are known."""
    rng = np.random.default_rng(5)
    covered, draws = 0, 400
    for _ in range(draws):
        n = int(rng.integers(8, 60))
        below = rng.gamma(4.0, 1.0, n)
        above = below * rng.gamma(4.0, 0.25, n) * 10.0 ** rng.uniform(-6, 2)
        known = rng.choice(n, int(rng.integers(3, 7)), replace=False)
        margin = ratio_margin(above[known], below[known], n)
        upper = above[known].sum() / below[known].sum() * (1.0 + margin)
        covered += above.sum() / below.sum() <= upper
    # tol: of few parts, and what is above is skewed: some per cent below the stated confidence
    assert covered >= (CONFIDENCE - 0.03) * draws
    assert ratio_margin(above, below, n) == 0.0
    assert ratio_margin(below[:5] / 7.0, below[:5], 50) == pytest.approx(0.0, abs=1e-12)
    assert ratio_margin(above[:1], below[:1], 50) == np.inf


def test_table_tells_measured_bounds_and_what_timing_cannot_tell() -> None:
    decisions = (
        Decision("one", True, "", error_db=-12.4, measured=True, cost=0.31),
        Decision("two", False, "", error_db=-12.4, cost=0.02),
        Decision("three", True, "", error_db=-140.0, measured=True, cost=0.25),
        Decision("four", True, ""),
        Decision("five", False, "", error_db=-np.inf),
    )
    scene = load_scene(resolve("plate"))
    lines = str(Explanation(scene, EffectsPlan(KernelFlags(), 1, decisions), None)).splitlines()
    rows = {line.split()[0]: " ".join(line.split()[2:]) for line in lines[3:8]}
    assert rows == {
        "one": "-12 dB, measured here 31 %",
        "two": "-12 dB, law < 10 %",
        "three": "none 25 %",
        "four": "? -",
        "five": "none -",
    }
    (idle,) = [line for line in lines if line.startswith("on, without a change of this image")]
    assert "three (25 %);" in idle and "one" not in idle.split(":")[1]


def test_a_run_with_other_settings_keeps_the_ground_that_goes_on() -> None:
    """Ground continued beyond its rim has more shapes than the scene: a plan on the scene alone does not fit."""
    scene = load_scene(resolve("tower"))
    run = Run(scene)
    other = run.otherwise(replace(scene, settings=replace(scene.settings, max_depth=1)))
    assert other.plan.max_depth == 1
    assert other.trace_scene is run.trace_scene


def _true_db(scene: Scene, run: Run, decision: Decision, interval: int) -> float:
    """Change of the focused image of the whole run, the other way with the same blocks, worst channel, dB."""

    def images(way: Scene, plan: EffectsPlan) -> dict[str, C64]:
        blocks = replace(way, settings=replace(way.settings, key_pulse_interval=interval))
        image = focus(simulate(blocks, plan=plan))
        return {channel: image.total(channel) for channel in image.channels}

    other = switch_effect(scene, decision)
    base, changed = images(scene, run.plan), images(other, run.otherwise(other).plan)
    ratios = [np.sum(np.abs(changed[c] - x) ** 2) / np.sum(np.abs(x) ** 2) for c, x in base.items()]
    return float(10.0 * np.log10(max(ratios)))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
def test_stated_changes_are_those_of_whole_images() -> None:
    """An effect switched the other way changes the image by what explain states; a bound from a few blocks is above."""
    for name, parameters, checked in (
        ("dihedral", {}, ("tube_phase", "edge_diffraction", "spreading", "wideband", "motion_in_pulse")),
        (
            "tower",
            {"sar_antenna.azimuth_resolution": "1.2", "sar_antenna.bandwidth": "125e6"},
            ("max_depth", "coherent", "fresnel", "speckle", "diffuse_double"),
        ),
    ):
        scene = load_scene(resolve(name), parameters=parameters)
        found = explain(scene, measured=True)
        assert found.prediction is not None
        interval = found.prediction.key_pulse_interval
        stated = {d.name: d for d in found.plan.decisions}
        run = Run(scene)
        depth = stated["max_depth"]
        deepest = depth.deepest or depth.value
        # two faces, and their edges over both of them
        assert (depth.value, deepest) == {"dihedral": (DEFAULT_DEPTH, 3), "tower": (2, 2)}[name]
        few = {d.name: d for d in measured_both_ways(run, scene, interval, most_places=3).decisions}
        for effect in checked:
            true = _true_db(scene, run, stated[effect], interval)
            assert stated[effect].measured and 0.0 <= stated[effect].cost < 1.0
            # tol: the change is focused, not the two images
            assert stated[effect].error_db == pytest.approx(true, abs=0.1)
            # tol: what blocks tell well is stated as measured, within their scatter
            assert np.isnan(few[effect].error_db) or few[effect].error_db >= true - 2.0
    assert stated["visibility"].error_is in ("none", "measured")
    # by the pilot; without one (dihedral) the last bounce with an echo is looked for
    assert depth.value == 2 and depth.error_db > -20.0


def test_nothing_beyond_the_pilot_is_traced_unless_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without ``measured`` the plan keeps its bounds, and rays and seconds are counted."""
    scene = load_scene(resolve("plate"))

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a part of the run is traced")

    monkeypatch.setattr(prediction, "predict", refuse)
    found = explain(scene)
    assert found.prediction is not None and not found.prediction.measured
    assert found.prediction.rays == Run(scene).needs().rays > 0 and found.prediction.total > 0.0
    assert not any(d.measured for d in found.plan.decisions)
    with pytest.raises(AssertionError, match="traced"):
        explain(scene, measured=True)


def test_python_says_what_the_command_says() -> None:
    found = explain(load_scene(resolve("plate")), predicted=False)
    assert found.prediction is None and "prediction" not in found.as_dict()
    assert "one flat surface cannot reflect onto itself" in str(found)
    json.dumps(found.as_dict())
