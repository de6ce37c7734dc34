"""Every stage that takes time or memory in a run has its term in the forecast; nothing here depends on elapsed time."""

from dataclasses import replace

import pytest

from sarmitsuba.commands.results import Formats, add_file_needs, least_bytes
from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.chirp import n_fast_chirped, to_chirped
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.planning.prediction.prediction import Prediction, predict
from sarmitsuba.simulation.planning.prediction.speed import Machine
from sarmitsuba.simulation.planning.site import RunSite
from sarmitsuba.tracing.scatterers.sources import expected_sources

# stages that are over when the forecast is said
BEFORE = {"build", "plan"}


@pytest.mark.parametrize("name", ["plate", "dihedral", "point"])
def test_every_stage_of_a_run_has_its_seconds(name: str) -> None:
    scene = load_scene(name)
    said: list[dict[str, float]] = []
    raw = simulate(scene, ready=lambda run: said.append(run.needs().seconds))  # type: ignore[arg-type]
    assert set(raw.metadata["seconds"]) - BEFORE <= set(said[0])
    assert {"focus"} <= set(said[0]) and all(seconds > 0.0 for seconds in said[0].values())


def scene_of(name: str, **parameters: str) -> Scene:
    scene = load_scene(name, parameters=parameters)
    return replace(scene, settings=replace(scene.settings, effects={"diffuse_pairs": "off"}))


@pytest.mark.parametrize("name", ["railing", "street_trees", "dihedral"])
def test_sources_are_counted_before_they_are_made(name: str) -> None:
    """Wires, vegetation and edges, against those that are made."""
    run = Run(scene_of(name))
    assert run.sampling is not None
    expected = expected_sources(RunSite(run.sampling))
    made = run.tracer(run.sampling).sources[1:]  # without surfaces
    assert len(expected) == len(made)
    for each, source in zip(expected, made, strict=True):
        # tol: bodies that are cut by cells of their lattice; ends of wires that two share
        assert each.scatterers == pytest.approx(source.scatterers.n, rel=0.05)  # type: ignore[attr-defined]
    needs = run.needs()
    assert needs.seconds["trace"] > sum(each.scatterers * each.each for each in expected)
    assert needs.stages["launch grid"] >= max(each.bytes for each in expected)


def test_pairs_are_counted_by_the_level_that_the_plan_measured() -> None:
    run = Run(load_scene("courtyard"))
    assert run.context is not None and "pairs" in run.context.measured and run.sampling is not None
    known, unknown = (
        expected_sources(RunSite(run.sampling, None, run.trace_scene, level))[-1]
        for level in (run.context.measured, None)
    )
    # what is not known is bounded
    assert 0.0 < known.scatterers <= unknown.scatterers
    assert run.needs().stages["launch grid"] > known.bytes
    assert run.needs().parts["sources"] > 0


@pytest.mark.parametrize("name", ["tower", "sphere"])
def test_memory_is_not_below_the_arrays(name: str) -> None:
    """Arrays that a run holds, counted by NumPy, against the stage that the forecast has them in."""
    run = Run(load_scene(name))
    assert run.sampling is not None
    needs = run.needs()
    grids = [grid for grids in run.lattices(run.sampling, 0) for grid in grids]
    rays = sum(grid.x.nbytes + grid.y.nbytes for grid in grids)
    raw = 8 * needs.layers * run.scene.radar.track.n_pulses * run.scene.radar.window.n_samples
    image = 8 * needs.pixels
    # tol: nodes along the rim of a lattice and over small parts
    assert needs.stages["trace"] >= 0.85 * rays + raw
    assert needs.stages["image"] >= 0.85 * rays + raw + image
    assert needs.kept >= raw + image


def test_needs_are_worked_out_once() -> None:
    run = Run(load_scene("sphere"))
    assert run.needs() is run.needs()
    assert run.at(2.0).needs().rays < run.needs().rays


def test_files_and_pictures_are_in_what_a_command_says() -> None:
    run = Run(load_scene("plate"))
    needs, formats = run.needs(), Formats.parse("hdf5")
    whole = add_file_needs(needs, formats, ("HH",), image=True)
    assert whole.seconds["files"] > 0.2 and whole.memory > needs.memory
    more = add_file_needs(needs, formats, ("HH", "VV"), image=True)
    assert more.seconds["files"] > whole.seconds["files"]
    raw_only = add_file_needs(needs, formats, ("HH",), image=False)
    assert "focus" not in raw_only.seconds and raw_only.seconds["files"] < whole.seconds["files"]


def test_elapsed_seconds_share_the_threads() -> None:
    seconds = {"launch grid": 1.0, "trace": 10.0}
    machine = Machine(slowness=2.0, threads=4)
    assert machine.processor(seconds) == {"launch grid": 2.0, "trace": 20.0}
    # a fifth of tracing is one thread's
    assert machine.elapsed(seconds) == {"launch grid": 2.0, "trace": pytest.approx(8.0)}
    assert machine.elapsed(seconds)["trace"] < Machine(2.0, 1).elapsed(seconds)["trace"]


def test_forecasts_of_both_clocks() -> None:
    needs = Run(load_scene("plate")).needs()
    elapsed, processor = Prediction.of(needs), Prediction.of(needs, processor=True)
    assert dict(elapsed.seconds) == needs.elapsed and dict(processor.seconds) == needs.processor
    assert elapsed.total <= processor.total


def test_chirped_records_are_longer_by_their_pulse() -> None:
    """Sizes of the raw data as they are made and written, against what is said before."""
    scene = load_scene("point", parameters={"sar_antenna.pulse_width": "2e-5"})
    raw = simulate(scene)
    record = to_chirped(raw)
    window = scene.radar.window
    plain = Run(scene).needs()
    needs = plain.recorded(window.n_samples, n_fast_chirped(scene.radar))
    assert plain.raw_bytes == raw.data.nbytes and needs.raw_bytes == record.data.nbytes
    assert needs.bytes >= record.data.nbytes and needs.seconds["chirp"] > 0.0
    small, large = (
        least_bytes(scene, Formats.parse("hdf5"), raw=True, image=False, chirped=chirped)
        for chirped in (False, True)
    )
    assert large - small == pytest.approx(record.data.nbytes - raw.data.nbytes)


def test_tracing_at_several_frequencies_has_its_seconds() -> None:
    """Each frequency has its own tracer, and all one timer."""
    scene = load_scene("plate").replace(wideband="on")
    predicted = predict(scene)[1]
    assert predicted.measured and predicted.seconds["trace"] > 0.0


def test_the_forecast_is_of_the_whole_command() -> None:
    """Start, loading and labels are in the line that `render` prints, which is called a law."""
    run = Run(load_scene("plate"))
    needs = replace(run.needs(), spent=(3.0, 100.0))
    assert "100.0" not in str(run.needs()) and str(needs).endswith("; law")
    assert "s of it spent" in str(needs) or "min of it spent" in str(needs)
    labelled = needs.labelled(run.label_needs())
    assert labelled.seconds["labels"] > 0.0 and labelled.bytes >= needs.bytes
    assert set(labelled.by_progress) == set(needs.by_progress)
    assert needs.seconds["witnesses"] >= 0.02 * 2 * needs.seconds["trace"]
