"""What a run will take before it is made: time by stage and memory, from one batch of the run itself."""

import gc
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from sarmitsuba.backend import ensure_backend
from sarmitsuba.echo.block import choose_block_length
from sarmitsuba.echo.raw import Layer, RawData
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.focusing import default_grid, focus
from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.pilot import plan_scene
from sarmitsuba.simulation.points import add_points
from sarmitsuba.simulation.raw import Timer, TraceJob, TraceStatistics, block_error_db
from sarmitsuba.simulation.window import launch_window, ray_lattices
from sarmitsuba.trace.geometry import build_trace_scene

Clock = Callable[[], float]

# part of the pulses that the focuser is timed on, and the least number
FOCUS_SHARE, FOCUS_PULSES = 16, 32
# shorter times are taken again, at most so often, and the least counts: what disturbs them only makes them longer
STEADY, TRIES = 0.2, 4
# most that loading compiled kernels and making transforms ready takes at the first batch, s; more was compilation
FIRST_USE = 0.06


@dataclass(frozen=True)
class Prediction:
    """Time and memory of a run, start-up and compilation of kernels (once a machine) left out.

    Parameters
    ----------
    seconds : by stage, in the order of the run
    memory : bytes, most that the process will hold at a time, interpreter and libraries included
    rays, key_pulses, contributions : of the whole run
    pixels : of the image, all layers
    facts : what else the prediction rests on: ray rate, adds per second, sizes
    """

    seconds: Mapping[str, float]
    memory: int
    rays: int
    key_pulses: int
    contributions: int
    pixels: int
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def total(self) -> float:
        """Seconds of all stages."""
        return float(sum(self.seconds.values()))


class ClockTimer(Timer):
    """The run's stage timer on another clock."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self.clock, self.before = clock, clock()

    def lap(self, stage: str) -> None:
        """Book the time since the last lap on ``stage``."""
        now = self.clock()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self.before
        self.before = now


def predict(
    scene: Scene, *, plan: EffectsPlan | None = None, clock: Clock = time.perf_counter
) -> tuple[EffectsPlan, Prediction]:
    """Plan a scene and predict what simulating and focusing it takes.

    One batch of the real run is traced and synthesised twice (the first time compiles its kernels, which the run then
    finds compiled), and a sixteenth of the pulses is focused onto the whole image.

    Parameters
    ----------
    scene : as loaded, with the method ``raw`` or ``hybrid``
    plan : overrides the automatic effects plan
    clock : what seconds are; ``time.process_time`` predicts processor seconds of all threads

    Notes
    -----
    Takes every batch to cost what the first costs. Ignores reading the scene, writing the results, and passes of
    rays beyond the first.
    """
    ensure_backend()
    seconds: dict[str, float] = {}
    start = clock()
    geometry, wavelength = scene.geometry, scene.radar.waveform.wavelength
    trace_scene = build_trace_scene(geometry, scene.materials, wavelength) if geometry.n_faces else None
    seconds["build"] = clock() - start
    start = clock()
    planned = plan or plan_scene(scene, trace_scene)
    if planned.pilot:  # the first time may have compiled the pilot's kernel
        start = clock()
        planned = plan or plan_scene(scene, trace_scene)
    seconds["plan"] = clock() - start
    scene = planned.apply(scene)
    radar, settings = scene.radar, scene.settings
    orders = tuple(range(1, planned.max_depth + 1)) if settings.keep_orders else (0,)
    subsets = (1, 2) if settings.keep_subsets else (0,)
    layers = tuple(Layer(c, o, s) for s in subsets for o in orders for c in radar.channels)
    shape = (len(layers), radar.track.n_pulses, radar.window.n_samples)
    data = np.zeros(shape, dtype=np.complex64)
    stats, done = TraceStatistics(), 1.0
    facts: dict[str, Any] = {}
    if trace_scene is not None:
        window = launch_window(scene)
        flags = replace(planned.flags, taper=planned.flags.taper and window.taper > 0)
        start = clock()
        sets = [ray_lattices(scene, window, planned.flags, draw=s, subset=s) for s in subsets]
        seconds["launch grid"] = clock() - start
        rays = sets[0]
        more = sum(g.n_rays for grids in sets for g in grids) / sum(g.n_rays for g in rays)
        job = TraceJob(scene, replace(planned, flags=flags), window, trace_scene, ClockTimer(clock))
        target = data[: len(layers) // len(subsets)]
        max_order = len(orders) if settings.keep_orders else 0
        start = clock()
        done, stats = next(job.run(rays, target, max_order, facts))
        first = clock() - start
        # again for the time: the first took the compilation along, and the choice of the block length
        job.scene = replace(
            scene, settings=replace(settings, key_pulse_interval=int(facts["key_pulse_interval"]))
        )

        def batch() -> Mapping[str, float]:
            job.timer = ClockTimer(clock)
            next(job.run(rays, target, max_order, dict(facts)))
            return job.timer.seconds

        stages = _steady(batch)
        seconds["trace"] = stages.get("trace", 0.0) * more / done
        seconds["synthesise"] = stages.get("synthesise", 0.0) * len(subsets) / done
        seconds["plan"] += sum(_steady(lambda: {"": _choosing(job, scene, clock)}).values())
        seconds["first use"] = min(FIRST_USE, max(0.0, first - sum(stages.values())))
        stats = _scaled(stats, more / done)
        interval = int(facts["key_pulse_interval"])
        planned = planned.with_key_pulses(interval, block_error_db(settings), settings.key_pulse_interval > 0)
    if scene.points:
        start = clock()
        few = _some_pulses(radar, 1 + radar.track.n_pulses // FOCUS_SHARE)
        part = np.zeros((len(layers), few.track.n_pulses, shape[2]), dtype=np.complex64)
        add_points(replace(scene, radar=few), planned.flags, trace_scene, part, layers)
        seconds["points"] = (clock() - start) * radar.track.n_pulses / few.track.n_pulses
    seconds["focus"], pixels, loading = _focus_seconds(scene, layers, data, clock)
    if trace_scene is None:  # else tracing has started the back end before
        seconds["first use"] = min(FIRST_USE, loading)
    untouched = data.nbytes * max(0.0, 1.0 - done / len(subsets)) if trace_scene is not None else 0
    facts.update(
        rays_per_second=stats.rays / max(seconds.get("trace", 0.0), 1e-9),
        pixel_pulses_per_second=pixels * radar.track.n_pulses / max(seconds["focus"], 1e-9),
        raw_bytes=data.nbytes,
    )
    prediction = Prediction(
        seconds=seconds,
        memory=int(peak_memory() + untouched),
        rays=stats.rays,
        key_pulses=stats.key_pulses,
        contributions=stats.contributions,
        pixels=pixels,
        facts=facts,
    )
    del data
    gc.collect()
    return planned, prediction


def _choosing(job: TraceJob, scene: Scene, clock: Clock) -> float:
    """Seconds to choose the block length."""
    settings = scene.settings
    if settings.method == "raw" or settings.key_pulse_interval:
        return 0.0
    start = clock()
    choose_block_length(
        scene.radar,
        job.window.center,
        job.phase_box(),
        settings.gridding_width,
        settings.tolerance_db,
        extra_slant_range=job.extra_slant_range(),
    )
    return clock() - start


def _scaled(stats: TraceStatistics, factor: float) -> TraceStatistics:
    return TraceStatistics(**{name: round(value * factor) for name, value in vars(stats).items()})


def _some_pulses(radar: Radar, n: int) -> Radar:
    """The radar with the ``n`` pulses about the middle of its track."""
    start = (radar.track.n_pulses - n) // 2
    pick = slice(start, start + n)
    p, w = radar.pointing, radar.window
    return replace(
        radar,
        track=radar.track.slice(start, start + n),
        pointing=Pointing(p.boresight[pick], p.azimuth_axis[pick], p.elevation_axis[pick]),
        window=ReceiveWindow(w.start_range[pick], w.sample_spacing, w.n_samples),
    )


def _focus_seconds(
    scene: Scene, layers: tuple[Layer, ...], data: Any, clock: Clock
) -> tuple[float, int, float]:
    """Seconds to focus all pulses, from two numbers of pulses onto the whole grid; pixels; what the first time adds."""
    radar = scene.radar
    n = radar.track.n_pulses
    few = min(n, max(FOCUS_PULSES, n // FOCUS_SHARE))
    grid = default_grid(radar, scene.image)

    def taken(k: int) -> Mapping[str, float]:
        part = _some_pulses(radar, k)
        start = (n - k) // 2
        raw = RawData(data[:, start : start + k], layers, "compressed", part)
        before = clock()
        focus(raw, grid)
        return {"focus": clock() - before}

    def steady(k: int) -> float:
        return _steady(partial(taken, k))["focus"]

    first = taken(min(8, few))["focus"]  # compiles
    loading = max(0.0, first - taken(min(8, few))["focus"])
    while True:
        most = steady(few)
        if most >= STEADY or few == n:
            break
        few = min(n, 4 * few)
    pixels = int(np.prod(grid.shape)) * len(layers)
    if few == n:
        return most, pixels, loading
    less = max(1, few // 4)
    slope = max(0.0, (most - steady(less)) / (few - less))
    return most + slope * (n - few), pixels, loading


def _steady(measure: Callable[[], Mapping[str, float]]) -> dict[str, float]:
    """Least of a few measurements (by their sum), one only where it takes long."""
    best = dict(measure())
    for _ in range(TRIES - 1):
        if sum(best.values()) >= STEADY:
            break
        again = dict(measure())
        best = min(best, again, key=lambda stages: sum(stages.values()))
    return best


def peak_memory() -> int:
    """Most bytes that this process held at a time so far."""
    try:
        import resource
    except ImportError:  # Windows
        return 0
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(most if sys.platform == "darwin" else most * 1024)


__all__ = ["ClockTimer", "Prediction", "peak_memory", "predict"]
