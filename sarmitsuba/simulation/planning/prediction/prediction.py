"""Predicted time by stage and memory of a run, from tracing one batch of it; and its explanation before it starts.

An explanation has the effects with their reasons, time and memory.
"""

import gc
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from sarmitsuba.core.arrays import C64
from sarmitsuba.core.timing import Clock, StageTimer
from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.plan import Decision, EffectsPlan
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.machine.memory import format_bytes
from sarmitsuba.scene.ground import continue_ground
from sarmitsuba.scene.scene import Scene, SceneLike
from sarmitsuba.signal.focusing import default_grid, focus
from sarmitsuba.signal.focusing.focuser import EXACT
from sarmitsuba.signal.raw_data import Layer, RawData
from sarmitsuba.simulation.execution.blocks import Blocks
from sarmitsuba.simulation.execution.points import add_points
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.statistics import TraceStatistics
from sarmitsuba.simulation.planning.pilot import plan_scene
from sarmitsuba.simulation.planning.prediction.both_ways import NOTHING, measured_both_ways
from sarmitsuba.simulation.planning.prediction.counting import default_focuser
from sarmitsuba.simulation.planning.prediction.needs import Needs, duration
from sarmitsuba.simulation.planning.prediction.speed import SpeedModel, Work
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.planning.sampling.piece import middle_pulses

# bytes that a run may add to the process for a part of it to be traced for the prediction
MEASURED_MEMORY = 1_000_000_000
# share of the pulses on which the focuser is timed, and the least number
FOCUS_SHARE, FOCUS_PULSES = 16, 32
# shorter measurements are repeated, at most this often, and the least counts: disturbances only lengthen them
STEADY, TRIES = 0.2, 4
# bound on the rays traced only for the error of blocks: all blocks of a run of seconds
BOUNDARY_RAYS = 20_000_000
# longest time for loading compiled kernels and planning transforms at the first batch, s; a longer one is compilation
FIRST_USE = 0.06


@dataclass(frozen=True)
class Prediction:
    """Predicted time and memory of a run, without start-up and compilation of kernels (once per machine).

    Parameters
    ----------
    seconds : by stage, in the order of the run
    measured : whether they are measured on a part of the run; else from a model of speed
    memory : bytes, peak memory of the process, interpreter and libraries included
    refusal : why the run does not fit into memory, and the remedy; empty where it fits
    rays, key_pulses, contributions : numbers in the whole run
    pixels : of the image, all layers
    key_pulse_interval : pulses that share one tracing; 0 where nothing is traced
    rays_per_second, pixel_pulses_per_second : measured rates
    raw_bytes : of the raw data
    """

    seconds: Mapping[str, float]
    measured: bool
    memory: int
    refusal: str
    rays: int
    key_pulses: int
    contributions: int
    pixels: int
    key_pulse_interval: int
    rays_per_second: float
    pixel_pulses_per_second: float
    raw_bytes: int

    @staticmethod
    def of(needs: Needs, *, processor: bool = False) -> "Prediction":
        """Prediction from the needs of a run, elapsed or processor seconds, without tracing (no contributions)."""
        seconds = needs.processor if processor else needs.elapsed
        trace, focus = seconds.get("trace", 0.0), seconds.get("focus", 0.0)
        return Prediction(
            seconds=seconds,
            measured=False,
            memory=needs.memory,
            refusal=needs.refusal,
            rays=needs.rays,
            key_pulses=needs.key_pulses,
            contributions=0,
            pixels=needs.pixels,
            key_pulse_interval=needs.key_pulse_interval,
            rays_per_second=needs.rays / trace if trace else 0.0,
            pixel_pulses_per_second=needs.pixel_pulses / focus if focus else 0.0,
            raw_bytes=needs.raw_bytes,
        )

    @property
    def total(self) -> float:
        """Total seconds of all stages."""
        return float(sum(self.seconds.values()))


@dataclass(frozen=True)
class _TracingForecast:
    """Predicted tracing and synthesis of the whole run.

    Parameters
    ----------
    seconds : by stage
    statistics : of the whole run
    interval : pulses that share one tracing
    error_db : error of blocks against tracing every pulse
    boundaries : number of block boundaries at which it was measured, and of all boundaries
    """

    seconds: Mapping[str, float]
    statistics: TraceStatistics
    interval: int
    error_db: float
    boundaries: tuple[int, int]


def predict(
    scene: Scene,
    *,
    plan: EffectsPlan | None = None,
    both_ways: bool = False,
    clock: Clock = time.perf_counter,
) -> tuple[EffectsPlan, Prediction]:
    """Predicted time and memory for simulating and focusing a scene.

    First the needs of the run are counted (:mod:`sarmitsuba.simulation.planning.prediction.needs`). For raw data of up
    to ``MEASURED_MEMORY`` the two blocks of pulses in the middle of the run are traced (which also compiles its
    kernels), one of them a second time, further ones for the error of blocks, and a sixteenth of the pulses is focused
    onto the whole image. Otherwise the seconds are those of a model of speed.

    Parameters
    ----------
    scene : as loaded
    plan : overrides the automatic effects plan
    both_ways : whether to measure the influence and cost of every effect as well
    clock : measure of time; ``time.process_time`` predicts processor seconds of all threads

    Notes
    -----
    Assumes that all batches cost the same. Ignores reading the scene, writing the results, and passes of rays beyond
    the first.
    """
    scene = continue_ground(scene)
    run = Run(scene, plan=plan, clock=clock)
    seconds, planned, needs = dict(run.timer.seconds), run.plan, run.needs()
    memory = needs.memory
    run.choose_threads()
    if not needs.raw_bytes or needs.bytes > MEASURED_MEMORY or needs.refusal:
        if both_ways and needs.bytes <= MEASURED_MEMORY and not needs.refusal:
            pulses = run.scene.radar.track.n_pulses
            planned = measured_both_ways(run, scene, -(-pulses // max(needs.key_pulses, 1)))
        return planned, Prediction.of(needs, processor=clock is time.process_time)
    if planned.pilot and plan is None:  # the first time may have compiled the pilot's kernel
        start = clock()
        plan_scene(scene, run.trace_scene, clock=clock)
        seconds["plan"] = clock() - start
    radar, layers = run.scene.radar, run.layers.layers
    data = np.zeros((len(layers), radar.track.n_pulses, radar.window.n_samples), dtype=np.complex64)
    stats, interval = TraceStatistics(), needs.key_pulse_interval
    if run.sampling is not None:
        traced = _tracing(run, run.sampling, data, clock)
        for stage, value in traced.seconds.items():
            seconds[stage] = seconds.get(stage, 0.0) + value
        modelled = needs.processor if clock is time.process_time else needs.elapsed
        seconds["witnesses"] = modelled.get("witnesses", 0.0)
        stats, interval = traced.statistics, traced.interval
        if both_ways:
            planned = measured_both_ways(run, scene, interval)
        planned = planned.with_key_pulses(
            interval, traced.error_db, run.scene.settings.key_pulse_interval > 0, traced.boundaries
        )
    if run.scene.points:
        seconds["points"] = _points_seconds(run, clock)
    seconds["focus"], pixels, loading = _focus_seconds(run.scene, layers, data, clock)
    if run.trace_scene is None:  # else tracing has started the back end before
        seconds["first use"] = min(FIRST_USE, loading)
    prediction = Prediction(
        seconds=seconds,
        measured=True,
        memory=memory,
        refusal="",
        rays=stats.rays,
        key_pulses=stats.key_pulses,
        contributions=stats.contributions,
        pixels=pixels,
        key_pulse_interval=interval,
        rays_per_second=stats.rays / max(seconds.get("trace", 0.0), 1e-9),
        pixel_pulses_per_second=pixels * radar.track.n_pulses / max(seconds["focus"], 1e-9),
        raw_bytes=data.nbytes,
    )
    del data
    gc.collect()
    return planned, prediction


def _tracing(run: Run, sampling: SamplingPlan, data: C64, clock: Clock) -> _TracingForecast:
    """Determine the block length as the run does, trace one block again, and extrapolate to all others."""
    run.timer = StageTimer(clock)
    rays = run.rays(sampling, 0)
    lattices = rays.at(run.scene.radar.track.center_index)
    seconds = dict(run.timer.seconds)

    def choosing() -> Mapping[str, float]:
        again = replace(sampling)  # computes the interval again
        start = clock()
        _ = again.key_pulse_interval
        return {"plan": clock() - start}

    seconds["plan"] = _steady(choosing)["plan"]
    start = clock()
    tracer = run.tracer(sampling)
    seconds["launch grid"] = seconds.get("launch grid", 0.0) + clock() - start  # lattices of sources
    _ = sampling.key_pulse_interval  # kept from here on
    blocks = Blocks(tracer, rays, run.layers.layers, data, run.layers.max_order)
    start = clock()
    settled = blocks.settle()  # also compiles
    first = clock() - start
    done, stats = 0.0, TraceStatistics()

    def batch() -> Mapping[str, float]:
        nonlocal done, stats
        timer = StageTimer(clock)
        tracer.use_timer(timer)
        done, stats = blocks.sample()
        return {stage: timer.seconds.get(stage, 0.0) for stage in ("trace", "synthesise")}

    stages = _steady(batch)
    more = sum(g.n_rays for grids in lattices for g in grids) / sum(g.n_rays for g in lattices[0])
    whole = replace(stats.scaled(more / done), key_pulses=round(stats.key_pulses / done))
    layers = len(data) / len(lattices)
    speed = SpeedModel.measured(Work(rays=stats.rays, samples=layers * data[0].size * done), stages)
    predicted = speed.stages(Work(rays=stats.rays * more / done, samples=data.size))
    seconds |= {stage: predicted[stage] for stage in stages}
    batches = settled.rays / max(stats.rays, 1)
    seconds["first use"] = min(FIRST_USE, max(0.0, first - max(batches, 1.0) * sum(stages.values())))
    boundaries = blocks.survey(BOUNDARY_RAYS)
    return _TracingForecast(seconds, whole, blocks.interval, blocks.error_db, boundaries)


def _points_seconds(run: Run, clock: Clock) -> float:
    """Seconds for ideal points, from a sixteenth of the pulses."""
    scene, layers = run.scene, run.layers.layers
    radar = scene.radar
    few = middle_pulses(radar, 1 + radar.track.n_pulses // FOCUS_SHARE)
    part = np.zeros((len(layers), few.track.n_pulses, radar.window.n_samples), dtype=np.complex64)
    start = clock()
    add_points(replace(scene, radar=few), run.plan.flags, run.trace_scene, part, layers)
    return (clock() - start) * radar.track.n_pulses / few.track.n_pulses


def _focus_seconds(
    scene: Scene, layers: tuple[Layer, ...], data: C64, clock: Clock
) -> tuple[float, int, float]:
    """Seconds to focus all pulses, from a part of them on the whole grid; pixels; extra seconds at first use.

    Backprojection's grow with the pulses and are measured on two numbers of them; those of another focuser as its own
    model of them, and all pulses are focused where it refuses a part.
    """
    radar = scene.radar
    n = radar.track.n_pulses
    few = min(n, max(FOCUS_PULSES, n // FOCUS_SHARE))
    grid = default_grid(radar, scene.image)
    stopped = radar.as_recorded().start_stop()
    focuser = default_focuser(radar, grid, exact=not scene.traced)
    linear = focuser.name == EXACT
    if not linear and focuser.objection(middle_pulses(stopped, few), grid):
        few = n

    def taken(k: int) -> Mapping[str, float]:
        part = middle_pulses(radar, k)
        start = (n - k) // 2
        raw = RawData(data[:, start : start + k], layers, "compressed", part)
        before = clock()
        focus(raw, grid, focuser=focuser)
        return {"focus": clock() - before}

    def steady(k: int) -> float:
        return _steady(partial(taken, k))["focus"]

    least = min(8, few) if linear else few
    first = taken(least)["focus"]  # compiles
    loading = max(0.0, first - taken(least)["focus"])
    while True:
        most = steady(few)
        if most >= STEADY or few == n:
            break
        few = min(n, 4 * few)
    pixels = int(np.prod(grid.shape)) * len(layers)
    if few == n:
        return most, pixels, loading
    if not linear:
        whole, part = (focuser.cpu_seconds(radar, grid) for radar in (stopped, middle_pulses(stopped, few)))
        return most * whole / part, pixels, loading
    less = max(1, few // 4)
    slope = max(0.0, (most - steady(less)) / (few - less))
    return most + slope * (n - few), pixels, loading


def _steady(measure: Callable[[], Mapping[str, float]]) -> dict[str, float]:
    """Least of a few measurements (by their sum); only one where it takes long."""
    best = dict(measure())
    for _ in range(TRIES - 1):
        if sum(best.values()) >= STEADY:
            break
        again = dict(measure())
        best = min(best, again, key=lambda stages: sum(stages.values()))
    return best


# weaker changes of the image are rounding, dB
NOTHING_DB = db_from_power(NOTHING)
# shares of the processor time below this are within the scatter of timing
LEAST_TOLD = 0.1


@dataclass(frozen=True, eq=False)
class Explanation:
    """Plan and prediction of a run; ``str`` of it is a readable table.

    Parameters
    ----------
    scene : as loaded
    plan : decided effects
    prediction : time and memory; None if not requested
    """

    scene: Scene
    plan: EffectsPlan
    prediction: Prediction | None

    def __repr__(self) -> str:
        return f"Explanation({self.scene.name!r}: {self.plan.summary()})"

    def as_dict(self) -> Mapping[str, object]:
        """JSON-able form."""
        out: dict[str, object] = {
            "scene": self.scene.name,
            "method": self.scene.settings.method,
            "notes": list(self.scene.notes),
            "plan": dict(self.plan.as_dict()),
        }
        p = self.prediction
        if p is None:
            return out
        out["prediction"] = {
            "seconds": {stage: round(s, 4) for stage, s in p.seconds.items()},
            "measured": p.measured,
            "fits": not p.refusal,
            "refusal": p.refusal,
            "total_seconds": round(p.total, 4),
            "memory_bytes": p.memory,
            "rays": p.rays,
            "key_pulses": p.key_pulses,
            "contributions": p.contributions,
            "pixels": p.pixels,
            "facts": {
                "key_pulse_interval": float(p.key_pulse_interval),
                "rays_per_second": p.rays_per_second,
                "pixel_pulses_per_second": p.pixel_pulses_per_second,
                "raw_bytes": float(p.raw_bytes),
            },
        }
        return out

    def __str__(self) -> str:
        """One line per effect, then the pilot, the scene's notes and the prediction."""
        plan = self.plan
        rows = [("effect", "", "change", "cost", "why")]
        for d in plan.decisions:
            state = str(d.value) if d.value is not None else "on" if d.on else "off"
            last = "" if d.deepest is None else f"; bounce {d.deepest} is the last with an echo"
            rows.append((d.name, state, _error(d), _cost(d.cost), d.why + last))
        widths = [max(len(row[i]) for row in rows) for i in range(4)]
        lines = [
            "  ".join([*(cell.ljust(w) for cell, w in zip(row, widths, strict=False)), row[4]])
            for row in rows
        ]
        lines.insert(1, "-" * len(lines[0]))
        lines.insert(
            0, f"{self.scene.name}: {self.scene.settings.method}, channels {', '.join(plan.flags.channels)}"
        )
        lines.append(
            "change: energy of the change of the image, relative to the image, if the effect were switched on or off "
            "(max_depth: without the last bounce with an echo); law: foretold and not measured here, ? unknown"
        )
        if not all(np.isnan(d.cost) for d in plan.decisions):
            lines.append(
                "cost: share of the simulation's processor time that the effect takes, or would take; timed on the "
                "same pulses, accurate to about 10 %"
            )
        idle = [
            f"{d.name} ({_cost(d.cost)})"
            for d in plan.decisions
            if d.on and d.measured and d.error_db <= NOTHING_DB
        ]
        if idle:
            lines.append(
                f"on, without a change of this image (and their cost): {', '.join(idle)}; the plan is decided before "
                "tracing, and a proof would cost more than the effect"
            )
        if plan.pilot:
            p = plan.pilot
            lines.append(
                f"pilot: {p['rays']} rays at pulses {', '.join(str(i) for i in p['pulses'])}, "
                f"{1e3 * p['seconds']:.0f} ms"
            )
        lines += [f"note: {' '.join(note.split())}" for note in self.scene.notes]
        if self.prediction is not None:
            lines.append(_prediction_text(self.prediction))
        return "\n".join(lines)


@exclusive
def explain(scene: SceneLike, *, predicted: bool = True, measured: bool = False) -> Explanation:
    """Explanation of a scene's effects plan, with the predicted time and memory of simulation and focusing.

    Parameters
    ----------
    scene : as loaded, a scene file, or the name of a shipped scene
    predicted : whether to predict time and memory, from counts and a model of speed; nothing beyond the pilot is traced
    measured : whether to trace a part of the run for it, and every effect with and without it; takes several times
        as long as the run where that takes seconds
    """
    scene = continue_ground(Scene.of(scene))
    if measured:
        return Explanation(scene, *predict(scene, both_ways=True))
    if not predicted:
        return Explanation(scene, plan_scene(scene), None)
    run = Run(scene)
    return Explanation(scene, run.plan, Prediction.of(run.needs()))


def _prediction_text(prediction: Prediction) -> str:
    stages = ", ".join(f"{stage} {duration(s)}" for stage, s in prediction.seconds.items())
    rates = "measured here on a part of it" if prediction.measured else "law"
    text = (
        f"predicted: {duration(prediction.total)} ({stages}; {rates}), {format_bytes(prediction.memory)} of memory; "
        f"{prediction.rays / 1e6:.3g} million rays at {prediction.key_pulses} key pulses, "
        f"{prediction.pixels / 1e6:.3g} million pixels"
    )
    return f"{text}\nrefused: {prediction.refusal}" if prediction.refusal else text


def _error(decision: Decision) -> str:
    if np.isnan(decision.error_db):
        return "?"
    if decision.error_db <= (NOTHING_DB if decision.measured else -200.0):
        return "none"
    kind = "measured here" if decision.measured or decision.source == "pilot" else "law"
    return f"{round(decision.error_db)} dB, {kind}"  # never -0


def _cost(share: float) -> str:
    if np.isnan(share):
        return "-"
    return f"{100 * share:.0f} %" if share >= LEAST_TOLD else f"< {100 * LEAST_TOLD:.0f} %"
