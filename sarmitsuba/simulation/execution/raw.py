"""Raw data of a scene: trace key pulses, synthesise the pulses around each, add ideal points, and receive."""

import warnings
from dataclasses import replace
from functools import partial

import numpy as np

from sarmitsuba.core.arrays import C64
from sarmitsuba.core.constants import SUBSET_SHARES
from sarmitsuba.core.errors import RadarError, SarmitsubaWarning
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.core.timing import StageTimer
from sarmitsuba.core.witness import Witness
from sarmitsuba.radar.height_error import NOTED_DB, WARNED_DB, height_error
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.signal.receive import receive
from sarmitsuba.simulation.execution.blame import check_traced
from sarmitsuba.simulation.execution.blocks import Blocks
from sarmitsuba.simulation.execution.metadata import raw_metadata
from sarmitsuba.simulation.execution.points import add_points
from sarmitsuba.simulation.execution.ray_witness import halved_plan, say_rays
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.statistics import LatticeSpacings, SamplingReport, TraceStatistics
from sarmitsuba.simulation.execution.witnesses import (
    Allowance,
    block_witness,
    bounce_witness,
    contradictions,
    effect_witness,
)
from sarmitsuba.simulation.planning.prediction.counting import WITNESS_LEAST
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.planning.sampling.folding import check_folding
from sarmitsuba.simulation.planning.sampling.rays import check_sampling, check_small_parts

# error of blocks of pulses from which on a note says so, dB of the energy
BLOCKS_SAID_DB = -20.0
# share of the echoes' power outside the receive window that gives a warning
LOST_POWER = 0.05


def echoes(run: Run, *, pass_index: int = 0, progress: Progress | None = None) -> RawData:
    """Range-compressed echoes of a prepared run; see :func:`simulate`. The caller holds the lock of the back end."""
    scene, plan = run.scene, run.plan
    radar, settings = scene.radar, scene.settings
    layers = run.layers.layers
    data = np.zeros((len(layers), radar.track.n_pulses, radar.window.n_samples), dtype=np.complex64)
    run.statistics, run.report, run.witnesses = TraceStatistics(), None, {}
    notes = list(run.notes)
    if run.sampling is not None:
        sampling = run.sampling
        blocks, rays = _trace(run, sampling, data, pass_index, progress or silent)
        if halved := halved_plan(sampling, blocks.rays.at(radar.track.center_index), rays):
            assert rays is not None
            notes.append(
                f"{scene.name}: the error of the rays, measured against finer ones, was "
                f"{rays.error_db:.1f} dB; all is traced again at half the spacing"
            )
            if run.finished is not None:
                run.finished.begin_again(f"pass {pass_index}, halved")
            blocks, rays = _trace(run, halved, data, pass_index, progress or silent)
        run.report = _report(run, blocks, rays)
        notes += [said] if (said := say_rays(scene.name, rays)) else []
        notes += contradictions(scene.name, run.witnesses, settings.tolerance_db)
    if scene.points:
        n = add_points(scene, plan.flags, run.trace_scene, data, layers, plan.sub_bands)
        run.statistics = run.statistics.plus(TraceStatistics(contributions=n, path_pulses=n))
        run.timer.lap("points")
    for plane in data:
        check_traced(plane, 0.0, scene.name)
    notes += _check_energy(scene, run.statistics, data) + _check_heights(scene)
    notes += _check_blocks(run)
    notes += check_folding(scene, run.sampling.windows if run.sampling is not None else ())
    if run.sampling is not None and run.report is not None:
        notes += check_sampling(run.sampling, run.report.spacings)
        notes += check_small_parts(run.sampling, run.shortfalls)
        plan = plan.with_key_pulses(
            run.report.key_pulse_interval, run.report.block_error_db, settings.key_pulse_interval > 0
        )
    flown = radar.track if radar.recorded is not None else None
    raw = RawData(data, layers, "compressed", radar.as_recorded(), request=scene.image, flown=flown)
    if radar.noise_temperature > 0.0 or radar.received:
        raw = receive(raw, seed=settings.seed, days=settings.pass_days)
        run.timer.lap("noise")
    metadata = raw_metadata(run, plan, notes)
    return replace(raw, metadata={**metadata, **raw.metadata})


def _trace(
    run: Run, sampling: SamplingPlan, data: C64, pass_index: int, progress: Progress
) -> tuple[Blocks, Witness | None]:
    """Blocks of pulses with a sampling plan, traced into ``data``, and the witness of their rays."""
    data[:] = 0.0
    blocks = _blocks(run, sampling, data, pass_index)
    for done, batch in blocks.trace():
        run.statistics = run.statistics.plus(batch)
        _tell(run, done, progress)
    run.timer.lap("trace")
    allowance = Allowance.of(run.statistics, len(run.layers.subsets))
    rays = blocks.witness(max(allowance.allowed, WITNESS_LEAST))
    run.timer.lap("witnesses")
    return blocks, rays


def _blocks(run: Run, sampling: SamplingPlan, data: C64, pass_index: int) -> Blocks:
    """Blocks of pulses that fill ``data`` (layers, pulses, samples) when they are traced."""
    tracer, rays = run.tracer(sampling), run.rays(sampling, pass_index)
    spread = None if run.workers is None else partial(run.workers.trace, run.job(sampling, pass_index))
    blocks = Blocks(tracer, rays, run.layers.layers, data, run.layers.max_order, run.finished, spread)
    run.timer.lap("plan")
    return blocks


def _tell(run: Run, done: float, progress: Progress) -> None:
    """Report the share of the pulses that is traced, and the rate."""
    workers = run.workers
    if workers is not None:  # the rate is that of all workers together
        run.timer.lap("trace")
    rate = run.statistics.rays / max(run.timer.seconds.get("trace", 0.0), 1e-9)
    counted = {} if workers is None else {"workers": float(workers.n_workers)}
    progress("trace", done, 1.0, {"rays/s": rate, **counted})


def _witnesses(
    run: Run, blocks: Blocks, rays: Witness | None, shared: Witness | None, allowance: Allowance
) -> dict[str, Witness]:
    """Errors measured on drawn pulses, by stage; see :mod:`sarmitsuba.simulation.execution.witnesses`."""
    found = {
        "rays": rays,
        "blocks": shared,
        "bounces": bounce_witness(run, blocks.tracer, blocks.data, allowance),
        "effects": effect_witness(run, blocks.tracer, blocks.data, allowance),
    }
    return {stage: witness for stage, witness in found.items() if witness is not None}


def _report(run: Run, blocks: Blocks, rays: Witness | None) -> SamplingReport:
    """Report on traced blocks, whose data are weighted by the shares of the ray subsets; finds the run's witnesses."""
    error_db = blocks.error_db
    allowance, timer = Allowance.of(run.statistics, len(run.layers.subsets)), run.timer
    blocks.tracer.use_timer(StageTimer(timer.clock))  # the seconds of tracing are those of the data
    shared = block_witness(run, blocks, allowance)
    for plane, layer in zip(
        blocks.data, run.layers.layers, strict=True
    ):  # each subset is a whole image of its own
        plane *= np.float32(SUBSET_SHARES[layer.subset])
    run.witnesses = _witnesses(run, blocks, rays, shared, allowance)
    blocks.tracer.use_timer(timer)
    timer.lap("witnesses")
    pulse = run.scene.radar.track.center_index
    middle = [tuple(grid for grid in grids if grid.serves(pulse)) for grids in blocks.rays.at(pulse)]
    return SamplingReport(
        spacings=LatticeSpacings.of(middle),
        rays_per_key_pulse=sum(g.n_rays for grids in middle for g in grids),
        scatterer_cell=blocks.tracer.sampling.scatterer_cell,
        key_pulse_interval=blocks.interval,
        block_error_db=error_db,
        grid_bytes=blocks.tracer.largest_grid,
    )


def _check_energy(scene: Scene, stats: TraceStatistics, data: C64) -> list[str]:
    """Raise an error if there is no echo; warn if much power is outside the receive window, and return the text."""
    if scene.geometry.n_faces and stats.hits == 0 and not scene.points and not scene.has_sources:
        raise RadarError(
            f"{scene.name}: none of {stats.rays} rays hits the scene; check that the image footprint "
            f"(image_center_x, image_center_y, image extents) lies on the geometry"
        )
    if not np.any(data) and stats.power == 0.0 and not scene.points:
        raise RadarError(
            f"{scene.name}: {stats.hits} hits, but every echo has the amplitude 0; check the materials' diffuse laws, "
            "the effects that are off, and stages of extensions"
        )
    if not np.any(data):
        raise RadarError(
            f"{scene.name}: {stats.hits} hits, but no echo falls within the receive window; widen near_range ... "
            "far_range "
            f"of the range_film"
        )
    if stats.power_outside <= LOST_POWER * stats.power:
        return []
    text = (
        f"{scene.name}: {100.0 * stats.power_outside / stats.power:.1f} % of the echoes' power falls outside the "
        f"receive window and is not recorded; widen near_range ... far_range of the range_film"
    )
    warnings.warn(text, SarmitsubaWarning, stacklevel=3)
    return [text]


def _check_blocks(run: Run) -> list[str]:
    """Say where blocks of pulses, chosen automatically, have a large error."""
    report = run.report
    if report is None or run.scene.settings.key_pulse_interval or not report.block_error_db > BLOCKS_SAID_DB:
        return []
    return [
        f"{run.scene.name}: sharing one tracing by {report.key_pulse_interval} pulses has an error of "
        f"{report.block_error_db:.0f} dB of the energy in the worst channel; for less, set key_pulse_interval below "
        f"{report.key_pulse_interval}, or method raw"
    ]


def _check_heights(scene: Scene) -> list[str]:
    """Notes on errors of the beam correction at points off the image plane, with a warning where they are large."""
    places = np.concatenate([scene.geometry.vertices, scene.places])
    found = height_error(scene.radar.as_recorded(), scene.image, places)
    if found is None or abs(found.error_db) < NOTED_DB:
        return []
    text = f"{scene.name}: {found.text()}"
    if abs(found.error_db) >= WARNED_DB:
        warnings.warn(text, SarmitsubaWarning, stacklevel=3)
    return [text]
