"""The explain command, and its prediction against a run."""

import itertools
import json
import warnings

import numpy as np
import pytest

from sarmitsuba.cli import main
from sarmitsuba.focusing import focus
from sarmitsuba.loader.library import resolve
from sarmitsuba.loader.load import load_scene
from sarmitsuba.simulation.prediction.explanation import explain
from sarmitsuba.simulation.prediction.prediction import predict
from sarmitsuba.simulation.raw import simulate


def test_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "plate", "--no-error-bars"]) == 0
    text = capsys.readouterr().out
    assert "one flat surface cannot reflect onto itself" in text
    assert "predicted:" in text and "B of memory" in text and "measured on a part of it" in text
    assert "max_depth" in text and "key_pulse_interval" in text


def test_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "dihedral", "--json", "-D", "polarisation=HH"]) == 0
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
    scene = load_scene(resolve("dihedral"), parameters=parameters)
    readings = itertools.count()
    _, prediction = predict(scene, clock=lambda: float(next(readings)))
    batches = -(-scene.radar.track.n_pulses // prediction.key_pulse_interval)
    assert batches > 1
    # tol: the last block may be shorter than the first
    assert prediction.seconds["trace"] == pytest.approx(batches, abs=1.0)
    assert prediction.seconds["synthesise"] == pytest.approx(batches, abs=1.0)


@pytest.mark.slow
def test_stated_changes_are_those_of_whole_runs() -> None:
    """An effect switched the other way changes the echoes of the whole run by what explain states."""
    scene = load_scene(resolve("dihedral"))
    stated = {d.name: d for d in explain(scene).plan.decisions}
    base = simulate(scene).data
    for name, switch in (("tube_phase", "off"), ("edge_diffraction", "off"), ("spreading", "on")):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what is switched off
            change = simulate(scene.replace(**{name: switch})).data - base
        true = 10.0 * np.log10(np.square(np.abs(change)).sum() / np.square(np.abs(base)).sum())
        assert stated[name].measured and 0.0 <= stated[name].cost < 1.0
        # tol: five blocks of the aperture stand for all of it
        assert stated[name].error_db == pytest.approx(true, abs=1.0)
    assert stated["visibility"].error_is in ("none", "measured")
    assert not stated["motion_in_pulse"].measured and stated["motion_in_pulse"].error_is == "at most"


def test_python_says_what_the_command_says() -> None:
    found = explain(load_scene(resolve("plate")), predicted=False)
    assert found.prediction is None and "prediction" not in found.as_dict()
    assert "one flat surface cannot reflect onto itself" in str(found)
    json.dumps(found.as_dict())
