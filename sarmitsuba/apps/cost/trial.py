"""One scene under many settings: error against a reference, seconds by stage, memory."""

import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from sarmitsuba.apps.cost.clock import MeasuredClock, StudyClock
from sarmitsuba.core.arrays import C64
from sarmitsuba.core.timing import Clock, StageTimer
from sarmitsuba.machine.backend import dr
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.image.metrics import image_error_db
from sarmitsuba.signal.image.sar_image import ImageGrid, SarImage
from sarmitsuba.signal.raw.raw_data import RawData
from sarmitsuba.simulation.execution.render import RenderOptions, focus_echoes, trace_run
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.statistics import TraceStatistics
from sarmitsuba.simulation.planning.prediction.speed import Work

# value of a setting: number, switch, name
Value = float | str
Changes = Mapping[str, Value]

MEASURED_CLOCK = MeasuredClock()
_TRACE_FIELDS = {f.name for f in fields(TraceSettings)}


@dataclass(frozen=True)
class TrialSetting:
    """Changes of a scene's settings in a trial.

    Parameters
    ----------
    changes : values by fields of ``TraceSettings``; also ``focuser`` (with its options), ``interpolation`` (an option
        of backprojection), and names of effects (``on``, ``off``)
    """

    changes: Changes = field(default_factory=dict)

    def apply(self, scene: Scene) -> Scene:
        """The scene with these settings."""
        settings = scene.settings
        own = {k: v for k, v in self.changes.items() if k in _TRACE_FIELDS}
        effects = {name: self.changes.get(name, switch) for name, switch in settings.effects.items()}
        changed = replace(settings, **own, effects=effects)  # type: ignore[arg-type]
        return replace(scene, settings=changed)

    @property
    def focuser(self) -> str:
        """As ``render`` takes it."""
        text = str(self.changes.get("focuser", "backprojection"))
        return (
            f"{text},interpolation={self.changes['interpolation']}"
            if "interpolation" in self.changes
            else text
        )

    @property
    def traced(self) -> "TrialSetting":
        """The settings without the focuser: those of the echoes."""
        return TrialSetting({k: v for k, v in self.changes.items() if k not in ("focuser", "interpolation")})

    def but(self, **changes: Value) -> "TrialSetting":
        """A copy with some values replaced."""
        return TrialSetting({**self.changes, **changes})


@dataclass(frozen=True, eq=False)
class Trial:
    """Result of one run.

    Parameters
    ----------
    setting : of the run
    image : (n_azimuth, n_range) complex64, first channel, orders and subsets summed
    stages : seconds by stage, without compiling
    compile_seconds : spent on compiling kernels
    peak_bytes : largest growth of the resident memory; -1: unknown
    statistics : of the tracing
    key_pulse_interval : pulses per tracing; 1 for methods without raw data
    raw : echoes; None: not kept, or a method without
    """

    setting: TrialSetting
    image: C64
    stages: Mapping[str, float]
    compile_seconds: float
    peak_bytes: int
    statistics: TraceStatistics
    key_pulse_interval: int
    raw: RawData | None = None

    @property
    def seconds(self) -> float:
        """Total seconds of all stages."""
        return float(sum(self.stages.values()))

    def error_db(self, reference: C64) -> float:
        """Energy of the difference from a reference, relative to the reference, dB."""
        return image_error_db(self.image, reference)


@dataclass(frozen=True, eq=False)
class Prepared:
    """Geometry and pilot of a scene, shared by its trials.

    Parameters
    ----------
    run : of the scene's own settings, not traced
    seconds : of preparing it, by stage
    """

    run: Run
    seconds: Mapping[str, float]

    @staticmethod
    def of(scene: Scene, clock: Clock) -> "Prepared":
        """Build and plan."""
        run = Run(scene, clock=clock)
        return Prepared(run, dict(run.timer.seconds))

    def trial(self, scene: Scene) -> Run:
        """Run with other settings, whose stages include the preparation."""
        run = self.run.otherwise(scene)
        for stage in ("build", "plan"):
            run.timer.seconds[stage] = run.timer.seconds.get(stage, 0.0) + self.seconds.get(stage, 0.0)
        return run


@exclusive
def run_trial(
    scene: Scene,
    setting: TrialSetting,
    grid: ImageGrid | None = None,
    *,
    pass_index: int = 0,
    clock: StudyClock = MEASURED_CLOCK,
    prepared: Prepared | None = None,
    echoes_of: Trial | None = None,
) -> Trial:
    """Run a setting; Dr.Jit's compile time is counted separately.

    Parameters
    ----------
    scene, setting : to run
    grid : of the image; None: the default
    pass_index : other values shift the lattices
    clock : time source
    prepared : geometry and pilot of the scene; None: made here
    echoes_of : earlier trial with the same settings but the focuser, whose echoes are focused and whose seconds count
    """
    changed = setting.apply(scene)
    grid = grid or default_grid(scene.radar, scene.image)
    options = RenderOptions(
        grid=grid,
        focuser=setting.focuser,
        range_window="rectangular",
        azimuth_window="rectangular",
        pass_index=pass_index,
    )
    compiled, raw = 0.0, None
    with memory() as peak:
        if echoes_of is not None and echoes_of.raw is not None:
            raw, statistics, interval = echoes_of.raw, echoes_of.statistics, echoes_of.key_pulse_interval
            stages = {k: v for k, v in echoes_of.stages.items() if k != "focus"}
        else:
            with compiling() as spent:
                run = Run(changed, clock=clock.source) if prepared is None else prepared.trial(changed)
                traced = trace_run(run, options)
                stages = dict(traced.metadata["seconds"])
                if isinstance(traced, SarImage):
                    image = traced
                else:
                    raw = traced
            compiled += _take(stages, spent[0], ("trace", "raster", "plan", "points"))
            statistics, interval = run.statistics, run.report.key_pulse_interval if run.report else 1
        if raw is not None:
            timer = StageTimer(clock.source)
            with compiling() as spent:
                image = focus_echoes(raw, options)
            timer.lap("focus")
            stages |= timer.seconds
            compiled += _take(stages, spent[0], ("focus",))
    work = Work(
        rays=statistics.rays,
        launches=statistics.key_pulses,
        path_pulses=statistics.path_pulses,
        samples=raw.data.size if raw is not None else 0,
        pixel_pulses=image.data.size * changed.radar.track.n_pulses,
    )
    stages = clock.stages(stages, work, compiled)
    return Trial(setting, image.total(), stages, compiled, peak[0], statistics, interval, raw)


@contextmanager
def compiling() -> Iterator[list[float]]:
    """Measure Dr.Jit's time for compiling kernels within the block; yields ``[seconds]``."""
    spent = [0.0]
    flag = dr.JitFlag.KernelHistory
    before = dr.flag(flag)
    dr.set_flag(flag, True)
    dr.kernel_history_clear()
    try:
        yield spent
    finally:
        history = dr.kernel_history()
        dr.kernel_history_clear()
        dr.set_flag(flag, before)
        spent[0] = 1e-3 * sum(
            float(entry.get("codegen_time", 0.0)) + float(entry.get("backend_time", 0.0)) for entry in history
        )


def _take(stages: dict[str, float], seconds: float, names: tuple[str, ...]) -> float:
    """Subtract compile time from the stages that compile, from the first up to its whole time, then from the next."""
    left = seconds
    for name in names:
        part = min(left, stages.get(name, 0.0))
        if part > 0.0:
            stages[name] -= part
            left -= part
    return seconds - left


def mean_image(
    scene: Scene, setting: TrialSetting, grid: ImageGrid, passes: int, first_pass: int = 1000
) -> C64:
    """Mean of passes with lattices not used by any trial: the reference of the trials."""
    total = np.zeros(grid.shape, dtype=np.complex128)
    for index in range(passes):
        total += run_trial(scene, setting, grid, pass_index=first_pass + index).image
    return (total / passes).astype(np.complex64)


@contextmanager
def memory() -> Iterator[list[int]]:
    """Measure the growth of the resident memory during the block; yields ``[bytes]``, -1: unknown."""
    peak = [-1]
    if not sys.platform.startswith("linux"):
        yield peak
        return
    flush_caches()
    statm, page = Path("/proc/self/statm"), 4096
    base = int(statm.read_text().split()[1]) * page
    done = threading.Event()

    def watch() -> None:
        while not done.wait(0.01):
            peak[0] = max(peak[0], int(statm.read_text().split()[1]) * page - base)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield peak
    finally:
        done.set()
        watcher.join()


def flush_caches() -> None:
    """Release Dr.Jit's pooled memory, so that the next run is measured alone."""
    if "drjit" not in sys.modules:
        return
    dr.flush_malloc_cache()
