"""The explain command, and its prediction against a run."""

import json
from collections.abc import Callable
from itertools import count

import pytest

from sarmitsuba.cli import main
from sarmitsuba.focusing import focus
from sarmitsuba.loader.library import resolve
from sarmitsuba.loader.load import load_scene
from sarmitsuba.simulation.prediction import predict
from sarmitsuba.simulation.raw import simulate


def test_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "plate", "--no-error-bars"]) == 0
    text = capsys.readouterr().out
    assert "one flat surface cannot reflect onto itself" in text
    assert "predicted:" in text and "MiB" in text
    assert "max_depth" in text and "key_pulse_interval" in text


def test_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "dihedral", "--json", "-D", "polarisation=HH"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["plan"]["channels"] == ["HH"]
    assert facts["prediction"]["total_seconds"] > 0.0 and facts["prediction"]["memory_bytes"] > 1e7
    assert main(["explain", "dihedral", "--json", "--plan-only"]) == 0
    assert "prediction" not in json.loads(capsys.readouterr().out)


def test_unknown_scene_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "no_such_scene"]) == 2
    assert capsys.readouterr().err.startswith("error: no_such_scene")


def ticking(step: float) -> Callable[[], float]:
    """A clock that every reading moves on."""
    ticks = count()
    return lambda: step * next(ticks)


def test_prediction_counts_what_the_run_does() -> None:
    scene = load_scene(resolve("dihedral"))
    _, prediction = predict(scene, clock=ticking(1.0))
    raw = simulate(scene)
    image = focus(raw)
    statistics = raw.metadata["statistics"]
    assert prediction.rays == statistics["rays"]
    assert prediction.key_pulses == statistics["key_pulses"]
    assert prediction.contributions == statistics["contributions"]
    assert prediction.pixels == image.data.size
    # seconds are the clock's own, but for some that are known; how near they come to a run's is measured by
    # benchmarks/effects.py
    _, slower = predict(scene, clock=ticking(3.0))
    assert 2.8 < slower.total / prediction.total <= 3.0
