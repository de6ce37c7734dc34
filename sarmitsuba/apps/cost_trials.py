"""Trials of a cost study: one scene under many settings, with error against a reference, seconds by stage and memory.

Each trial is run once and kept in a file, from which an interrupted study continues. Seconds are processor seconds of
this machine, or computed from the work for a machine of given speed.
"""

import json
import math
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from sarmitsuba.core.arrays import C64
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.core.timing import Clock, StageTimer
from sarmitsuba.machine.backend import dr
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.machine.journal import Journal, Label, fits, is_echo
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.execution.render import RenderOptions, focus_echoes, trace_run
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.statistics import STATISTICS_FORM, TraceStatistics
from sarmitsuba.simulation.planning.prediction.speed import USUAL_CORE, SpeedModel, Work


class StudyClock(Protocol):
    """Clock of a cost study.

    Attributes
    ----------
    source : of the seconds that the stages of a run measure
    """

    source: Clock

    def now(self) -> float:
        """Seconds since a fixed moment, without compiling."""
        ...

    def stages(
        self, measured: Mapping[str, float], work: Work, compile_seconds: float = 0.0
    ) -> dict[str, float]:
        """Seconds by stage of a run that took ``measured`` seconds here to do ``work``, and others for compiling."""
        ...


class MeasuredClock:
    """Seconds of this machine's processors, of all threads of the process, which other programs change little.

    Parameters
    ----------
    source : ``time.perf_counter`` measures elapsed seconds instead
    """

    def __init__(self, source: Clock = time.process_time) -> None:
        self.source = source
        self._compiling = 0.0

    def now(self) -> float:
        """Seconds since a fixed moment, without those of compiling in the runs so far."""
        return self.source() - self._compiling

    def stages(
        self, measured: Mapping[str, float], work: Work, compile_seconds: float = 0.0
    ) -> dict[str, float]:
        """As measured."""
        self._compiling += compile_seconds
        return dict(measured)


class WorkClock:
    """Time computed from the work for a machine of given speed: the same budget allows the same runs everywhere.

    Parameters
    ----------
    speed : of that machine
    stage_seconds : s, additional time of every stage
    """

    def __init__(self, speed: SpeedModel = USUAL_CORE, stage_seconds: float = 5e-3) -> None:
        self.speed, self.stage_seconds = speed, stage_seconds
        self.source: Clock = time.perf_counter
        self._elapsed = 0.0

    def now(self) -> float:
        """Total seconds of all runs so far."""
        return self._elapsed

    def stages(
        self, measured: Mapping[str, float], work: Work, compile_seconds: float = 0.0
    ) -> dict[str, float]:
        """Seconds by stage from the work; one of the stages ``trace`` and ``raster`` has the rays."""
        counted = self.speed.stages(work)
        counted["raster"] = counted["trace"]
        out = {stage: self.stage_seconds + counted.get(stage, 0.0) for stage in measured}
        self._elapsed += sum(out.values())
        return out


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
    run : of the scene's settings, not traced
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


_FIRST = "cost study"
_FORMS = {
    _FIRST: {"kind": str, "hash": str},
    "trial": {
        **{"kind": str, "key": str, "shape": [int, int], "stages": {str: float}, "compile_seconds": float},
        **{"peak_bytes": int, "statistics": STATISTICS_FORM, "interval": int},
    },
}
# two runs agree whose seconds differ by less than this factor; a third decides between others
AGREE = 1.1


class Trials:
    """Trials of one study.

    Parameters
    ----------
    clock : time source
    state : file that keeps every finished trial; None: none
    run_hash : of scene, settings and program; trials of another study are dropped
    done : called after every trial

    Attributes
    ----------
    reused : number of trials taken from the file
    compile_seconds : of the trials that were run here
    stale : whether the file had trials of another study, now dropped
    """

    def __init__(
        self,
        clock: StudyClock,
        state: Path | None = None,
        run_hash: str = "",
        done: Callable[[], None] = lambda: None,
    ) -> None:
        self.clock, self.done, self.reused, self.stale = clock, done, 0, False
        self.compile_seconds = 0.0
        self._made: dict[str, Trial] = {}
        self._prepared: dict[str, Prepared] = {}
        self._last: tuple[str, Trial] | None = None
        self._journal = (
            Journal(state, _is_record, "the same command with --resume resumes")
            if state is not None
            else None
        )
        if self._journal is None:
            return
        first = {"kind": _FIRST, "hash": run_hash}
        if self._journal.labels[:1] != [first]:
            self.stale = bool(self._journal.labels)
            self._journal.clear()
            self._journal.append(first, np.empty(0, np.uint8))

    def run(
        self,
        scene: Scene,
        setting: TrialSetting,
        grid: ImageGrid | None = None,
        *,
        pass_index: int = 0,
        again: int = 0,
        refocus: bool = False,
    ) -> Trial:
        """The trial of a setting on a part of the scene, run once.

        Parameters
        ----------
        again : number of a repetition
        refocus : whether a repetition focuses the same echoes again, where they are still held
        """
        part = _part(scene)
        key = _key(part, setting, pass_index, again)
        if key not in self._made:
            kept = self._kept(key, setting, scene, grid)
            echoes = 0 if refocus else again
            self._made[key] = kept or self._run(key, part, scene, setting, grid, pass_index, echoes)
            self.done()
        return self._made[key]

    def steady(
        self,
        scene: Scene,
        setting: TrialSetting,
        grid: ImageGrid | None = None,
        *,
        pass_index: int = 0,
        refocus: bool = False,
    ) -> Trial:
        """The trial by its seconds of two runs, the faster one, or of three if two differ: the one in the middle.

        A run is slower where another program disturbs it. One that compiled kernels may be faster, where more was
        subtracted for compiling than it took.
        """

        def made(again: int) -> Trial:
            return self.run(scene, setting, grid, pass_index=pass_index, again=again, refocus=refocus)

        runs = sorted((made(again) for again in range(2)), key=lambda trial: trial.seconds)
        if runs[1].seconds <= AGREE * runs[0].seconds:
            return runs[0]
        return sorted((*runs, made(2)), key=lambda trial: trial.seconds)[1]

    @property
    def count(self) -> int:
        """Number of trials so far."""
        return len(self._made)

    def close(self) -> None:
        """Close the file; its trials are kept."""
        if self._journal is not None:
            self._journal.close()

    def _run(
        self,
        key: str,
        part: str,
        scene: Scene,
        setting: TrialSetting,
        grid: ImageGrid | None,
        pass_index: int,
        again: int,
    ) -> Trial:
        if part not in self._prepared:
            self._prepared[part] = Prepared.of(scene, self.clock.source)
        traced = _key(part, setting.traced, pass_index, again)
        same = self._last[1] if self._last is not None and self._last[0] == traced else None
        with warnings.catch_warnings():
            if self._made:  # the first has the scene's own settings; those that a study tries concern nobody
                warnings.simplefilter("ignore", SarmitsubaWarning)
            trial = run_trial(
                scene,
                setting,
                grid,
                pass_index=pass_index,
                clock=self.clock,
                prepared=self._prepared[part],
                echoes_of=same,
            )
        self._last = (traced, trial)
        self.compile_seconds += trial.compile_seconds
        trial = replace(trial, raw=None)  # echoes of the latest trial alone are held
        if self._journal is not None:
            label = {
                "kind": "trial",
                "key": key,
                "shape": list(trial.image.shape),
                "stages": dict(trial.stages),
                "compile_seconds": trial.compile_seconds,
                "peak_bytes": trial.peak_bytes,
                "statistics": vars(trial.statistics),
                "interval": trial.key_pulse_interval,
            }
            self._journal.append(label, trial.image.astype(np.complex64))
        return trial

    def __str__(self) -> str:
        """One line about dropped trials of another study; empty where there are none."""
        if not self.stale or self._journal is None:
            return ""
        return (
            f"{self._journal.path}: trials of another scene, of other settings or of another version of the program; "
            "begun anew"
        )

    def _kept(self, key: str, setting: TrialSetting, scene: Scene, grid: ImageGrid | None) -> Trial | None:
        """The trial from the file."""
        if self._journal is None:
            return None
        row = next((i for i, x in enumerate(self._journal.labels) if x.get("key") == key), None)
        if row is None:
            return None
        shape = (grid or default_grid(scene.radar, scene.image)).shape
        label, image = self._journal.labels[row], self._journal.payload(row, np.complex64)
        if tuple(label["shape"]) != shape:
            return None
        self.reused += 1
        return Trial(
            setting,
            image.reshape(shape),
            dict(label["stages"]),
            label["compile_seconds"],
            label["peak_bytes"],
            TraceStatistics(**label["statistics"]),
            label["interval"],
        )


def _is_record(label: Label, payload: bytes) -> bool:
    """Whether a record is one that a study writes."""
    kind = label.get("kind")
    if not isinstance(kind, str) or not fits(label, _FORMS.get(kind, None)):
        return False
    if kind == _FIRST:
        return not payload
    times = (*label["stages"].values(), label["compile_seconds"], *label["statistics"].values())
    return bool(label["stages"]) and min(times) >= 0.0 and is_echo(payload, math.prod(label["shape"]))


def _part(scene: Scene) -> str:
    """Which part of the scene it is."""
    image, track = scene.image, scene.radar.track
    return f"{image.extent_azimuth:.9g} {image.extent_range:.9g} {track.n_pulses}"


def _key(part: str, setting: TrialSetting, pass_index: int, again: int) -> str:
    return json.dumps([part, dict(sorted(setting.changes.items())), pass_index, again])
