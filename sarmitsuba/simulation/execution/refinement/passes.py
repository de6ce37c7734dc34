"""Passes of rays until the image reaches a target error; all passes are averaged, interrupted runs continue."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import C64
from sarmitsuba.core.constants import DEFAULT_WINDOW, RAY_ERROR_ORDER
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.core.timing import Clock
from sarmitsuba.core.units import power_from_db
from sarmitsuba.core.witness import Witness
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.scene.scene import Scene, SceneLike
from sarmitsuba.signal.focusing import default_grid, focus
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.raw.noise import add_noise
from sarmitsuba.signal.raw.raw_data import Layer, RawData, channels_of
from sarmitsuba.simulation.execution.tracing import Workers
from sarmitsuba.simulation.execution.fingerprint import fingerprint
from sarmitsuba.simulation.execution.finished import FinishedBlocks
from sarmitsuba.simulation.execution.raw import echoes
from sarmitsuba.simulation.execution.refinement.error_bars import (
    PASSES,
    SUBSETS,
    ErrorBars,
    Source,
    add_error_bars,
    estimate_error,
    estimate_pass_error,
)
from sarmitsuba.simulation.execution.refinement.running_mean import Passes, PassLayout, sum_layers
from sarmitsuba.simulation.execution.run import Ready, Run

STATE_FILE = "passes.npz"
# most rays of one lattice; denser passes are repeated instead
MAX_RAYS = 16_000_000


@dataclass(frozen=True, eq=False)
class Refinement:
    """Result of :func:`refine`.

    Parameters
    ----------
    raw : mean over all passes, subsets kept separately
    image : focused from it, with ``sampling_error`` in its metadata
    passes : number, over all runs
    error_db : estimated sampling error of the image (worst channel), dB
    met : whether the target was reached
    history : after every pass: seconds so far, error (dB)
    """

    raw: RawData
    image: SarImage
    passes: int
    error_db: float
    met: bool
    history: tuple[tuple[float, float], ...]


@exclusive
def refine(
    scene: SceneLike,
    *,
    target_error_db: float | None = None,
    time_limit: float | None = None,
    state: Path | str | None = None,
    grid: ImageGrid | None = None,
    range_window: str = DEFAULT_WINDOW,
    azimuth_window: str = DEFAULT_WINDOW,
    max_passes: int = 1000,
    progress: Progress | None = None,
    ready: Ready | None = None,
    clock: Clock = time.perf_counter,
    workers: Workers | None = None,
) -> Refinement:
    """Raw data and image from several passes of rays, until the sampling error or the time reaches its limit.

    Every pass traces the scene with new lattices, shifted and rotated at random, and with twice the rays of the
    previous pass as far as memory and time allow: errors common to all lattices of one density fall only with denser
    ones. The result is the mean of all passes, weighted by their rays. The error of the image is estimated from the
    change by the last pass, so that a target needs at least two passes; after one pass it is that of the two subsets.

    Parameters
    ----------
    scene : method ``hybrid`` or ``raw``
    target_error_db : energy of the error over that of the image; default the scene's; 0 = no target
    time_limit : s, of this run; default the scene's; 0 = no limit. At least one pass is made
    state : file that holds the passes between runs; the finished blocks of the current pass are in a second file that
        ends in ``.blocks``. None: no file
    grid : of the image; default that of the scene
    range_window, azimuth_window : of the image
    max_passes : bound on all passes
    progress : called after every pass with the error and, where there is one, the limit
    ready : called once the first pass is planned and fits into memory, before it is traced
    clock : for ``time_limit``
    workers : workers that share the tracing of every pass

    Returns
    -------
    Refinement

    Raises
    ------
    DataError
        Neither a target nor a limit is given, nothing is traced, or the state file belongs to another scene.

    Notes
    -----
    The passes reduce only the error of ray sampling; see
    :func:`sarmitsuba.simulation.execution.refinement.error_bars.estimate_pass_error`.
    """
    scene = Scene.of(scene)
    target = scene.settings.target_error_db if target_error_db is None else target_error_db
    limit = scene.settings.time_limit if time_limit is None else time_limit
    if target >= 0.0 and limit <= 0.0:
        raise DataError(
            f"{scene.name}: adding passes needs target_error_db below 0 dB or time_limit above 0 s; set one of them"
        )
    if not scene.traced:
        raise DataError(
            f"{scene.name}: ideal points alone need no rays, and their echoes are exact; leave out target_error_db and "
            "time_limit"
        )
    noisy = scene.settings.effects.get("noise", "auto") != "off" and scene.radar.noise_temperature > 0.0
    quiet = {**scene.settings.effects, "noise": "off"}
    scene = replace(scene, settings=replace(scene.settings, keep_subsets=True, effects=quiet))
    file = Path(state) if state is not None else None
    run_hash = fingerprint(scene)
    # noise is added to the sum of all passes
    noiseless = replace(scene, radar=replace(scene.radar, noise_temperature=0.0))
    whole = Run(noiseless, clock=clock, workers=workers)
    layout = PassLayout.of(whole.scene, whole.layers.layers)
    passes = Passes.load(file, run_hash, layout) if file else Passes(run_hash)
    focuser = _PassImage(
        scene,
        passes,
        grid or default_grid(scene.radar.as_recorded(), scene.image),
        range_window,
        azimuth_window,
    )
    goal = _Goal(target, limit, max_passes, clock)
    took = 0.0  # seconds of the last pass with its check
    while True:
        error, elapsed = np.inf, goal.elapsed
        if passes.data is not None:
            error = focuser.error_db(goal)
            elapsed = goal.elapsed
            info = {"dB error": error} | ({"dB wanted": target} if target < 0.0 else {})
            (progress or silent)("refine", *goal.share(error, elapsed), info)
            passes.history[-1] = (passes.seconds, error)
        level = None if goal.reached(error, passes) else _next_level(passes, took, goal.left(elapsed))
        if level is None:
            break
        start = clock()
        run = whole.at(2.0 ** (-0.5 * level))
        run.needs().of_passes.check()
        if file:
            part = f"pass {passes.count}, level {level}"
            run.finished = FinishedBlocks(blocks_of(file), run_hash, run.plan, part, run.batch_shape)
        try:
            if ready:
                ready(run)
                ready = None
            passes.add(echoes(run, pass_index=passes.count), level)
        finally:
            if run.finished is not None:
                run.finished.close()
        took = clock() - start
        passes.seconds += took
        passes.history.append((passes.seconds, float("nan")))
        if file:
            passes.save(file)
            blocks_of(file).unlink()  # now contained in the pass
    return _finish_passes(focuser, goal, noisy)


@dataclass(frozen=True)
class _Goal:
    """Stopping criteria: target error (dB; 0: none), time limit (s; 0: none), largest number of passes."""

    target: float
    limit: float
    max_passes: int
    clock: Clock
    begin: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "begin", self.clock())

    @property
    def elapsed(self) -> float:
        return self.clock() - self.begin

    def left(self, elapsed: float) -> float:
        return self.limit - elapsed if self.limit > 0.0 else np.inf

    def met(self, error: float) -> bool:
        return self.target < 0.0 and error <= self.target

    def reached(self, error: float, passes: Passes) -> bool:
        # the error from the subsets of one pass is too uncertain to stop
        return (self.met(error) and passes.count > 1) or passes.count >= self.max_passes

    def share(self, error: float, elapsed: float) -> tuple[float, float]:
        """Progress in per cent: by the passes still needed for the target, or by the time, whichever is larger."""
        by_error = power_from_db((self.target - error) / RAY_ERROR_ORDER) if self.target < 0.0 else 0.0
        by_time = elapsed / self.limit if self.limit > 0.0 else 0.0
        return 100.0 * min(1.0, max(by_error, by_time)), 100.0


class _PassImage:
    """Image of the passes so far, and its error; focused only when needed, else the error of the raw data is used."""

    def __init__(
        self, scene: Scene, passes: Passes, grid: ImageGrid, range_window: str, azimuth_window: str
    ) -> None:
        self.scene, self.passes, self.grid = scene, passes, grid
        self.range_window, self.azimuth_window = range_window, azimuth_window
        self.image: SarImage | None = None  # image of the passes so far, if focused

    def raw(self) -> RawData:
        passes = self.passes
        assert passes.data is not None
        return self._raw(passes.data, passes.layers)

    def _raw(self, data: C64, layers: tuple[Layer, ...]) -> RawData:
        scene, radar = self.scene, self.scene.radar
        flown = radar.track if radar.recorded is not None else None
        return RawData(
            data, layers, "compressed", radar.as_recorded(), self.passes.metadata, scene.image, flown
        )

    def focus(self, raw: RawData) -> SarImage:
        return focus(raw, self.grid, range_window=self.range_window, azimuth_window=self.azimuth_window)

    def bars(self, image: SarImage) -> ErrorBars:
        """Error bars of the image of all passes."""
        change = self.passes.change
        if change is None:
            return estimate_error(image.data, image.layers, pixels=False)
        channels = channels_of(image.layers)
        changed = self.focus(self._raw(change, tuple(Layer(c) for c in channels)))
        mean = sum_layers(image.data, image.layers)
        return estimate_pass_error(changed.data, mean, channels, self.passes.share)

    def _raw_error_db(self) -> float:
        """Error of the raw data, worst channel, dB."""
        passes = self.passes
        assert passes.data is not None
        if passes.change is None:
            return max(estimate_error(passes.data, passes.layers, pixels=False).error_db)
        mean = sum_layers(passes.data, passes.layers)
        channels = channels_of(passes.layers)
        return max(estimate_pass_error(passes.change, mean, channels, passes.share).error_db)

    def error_db(self, goal: _Goal) -> float:
        """Error of the image, worst channel, dB."""
        self.image = None
        raw_error, passes = self._raw_error_db(), self.passes
        source: Source = SUBSETS if passes.change is None else PASSES
        if source != passes.source:  # the ratio depends on the kind of estimate
            passes.ratio_db, passes.source = None, source
        error = self.counting_bias(raw_error + (passes.ratio_db or 0.0))
        if passes.ratio_db is None or (goal.target < 0.0 and error <= goal.target + 0.3):
            self.image = self.focus(self.raw())
            of_image = max(self.bars(self.image).error_db)
            passes.ratio_db = of_image - raw_error
            error = self.counting_bias(of_image)
        return error

    def counting_bias(self, error_db: float) -> float:
        """Error with that of the ray spacing, dB, which all passes share, as measured in the last and densest one."""
        witnesses = self.passes.metadata.get("witnesses")
        found = Witness.read(witnesses.get("rays")) if isinstance(witnesses, Mapping) else None
        return error_db if found is None else found.with_part(error_db).error_db


def blocks_of(state: Path) -> Path:
    """Path of the file of finished blocks of the current pass, next to the state file."""
    return state.with_suffix(".blocks")


def _finish_passes(focuser: _PassImage, goal: _Goal, noisy: bool) -> Refinement:
    """Raw data and image of all passes, with receiver noise added last."""
    passes, raw = focuser.passes, focuser.raw()
    image = focuser.image or focuser.focus(raw)
    bars = focuser.bars(image)
    error = focuser.counting_bias(max(bars.error_db))
    passes.history[-1] = (passes.seconds, error)
    if noisy:
        settings = focuser.scene.settings
        raw = add_noise(raw, seed=settings.seed, days=settings.pass_days)
        image = focuser.focus(raw)
    met = goal.met(error)
    record = {
        "passes": passes.count,
        "levels": passes.levels,
        "seconds": passes.seconds,
        "target_error_db": goal.target,
        "time_limit_s": goal.limit,
        "met": met,
        "sampling_error": bars.as_dict(),
        "history": [[round(s, 3), round(e, 3)] for s, e in passes.history],
    }
    raw = replace(raw, metadata={**raw.metadata, "refinement": record})
    image = add_error_bars(replace(image, metadata={**image.metadata, "refinement": record}))
    return Refinement(raw, image, passes.count, error, met, tuple(passes.history))


def _next_level(passes: Passes, took: float, left: float) -> int | None:
    """Density level of the next pass: twice the rays if time and memory allow, else unchanged; None when time is up."""
    if not passes.levels:
        return 0
    level = max(passes.levels)
    if 2.0 * took <= 1.2 * left and passes.rays <= MAX_RAYS:
        return level + 1
    return level if took <= 1.5 * left and left > 0.0 else None


__all__ = ["STATE_FILE", "Passes", "Refinement", "blocks_of", "refine"]
