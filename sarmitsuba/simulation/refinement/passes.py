"""Passes of rays until the image is as good as asked for; nothing is thrown away, interrupted runs go on."""

import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.echo.noise import add_noise
from sarmitsuba.echo.raw_data import Layer, RawData, channels_of
from sarmitsuba.errors import DataError
from sarmitsuba.exclusive import exclusive
from sarmitsuba.focusing import default_grid, focus
from sarmitsuba.image.sar_image import ImageGrid, SarImage
from sarmitsuba.progress import Progress, silent
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.batches import Workers
from sarmitsuba.simulation.fingerprint import fingerprint
from sarmitsuba.simulation.finished import FinishedBlocks
from sarmitsuba.simulation.raw import echoes
from sarmitsuba.simulation.refinement.error_bars import (
    PASSES,
    SUBSETS,
    ErrorBars,
    Source,
    estimate_error,
    estimate_pass_error,
    with_error_bars,
)
from sarmitsuba.simulation.refinement.running_mean import Passes, PassLayout, by_channel
from sarmitsuba.simulation.run import Ready, Run
from sarmitsuba.timing import Clock

STATE_FILE = "passes.npz"
# error energy falls as the rays to this power: 2.5 dB where they double (benchmarks/suite/error_bars.py)
ORDER = 0.83
# most rays of one lattice; denser passes are repeated instead
MAX_RAYS = 16_000_000


@dataclass(frozen=True, eq=False)
class Refinement:
    """What :func:`refine` came to.

    Parameters
    ----------
    raw : mean over all passes, subsets apart
    image : focused from it, with ``sampling_error`` in its metadata
    passes : done, over all runs
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
    scene: Scene,
    *,
    target_error_db: float | None = None,
    time_limit: float | None = None,
    state: Path | str | None = None,
    grid: ImageGrid | None = None,
    range_window: str = "rectangular",
    azimuth_window: str = "rectangular",
    max_passes: int = 1000,
    progress: Progress | None = None,
    ready: Ready | None = None,
    clock: Clock = time.perf_counter,
    workers: Workers | None = None,
) -> Refinement:
    """Add passes of rays until the estimated sampling error meets the target or the time is up.

    Every pass traces the scene anew with lattices of its own, shifted and turned at random, and twice the rays of the
    pass before as far as memory and the time left allow: what all lattices of a density blur alike only denser ones
    undo. The result is the mean of all passes, weighted by their rays. The error of the image is estimated from what
    the last pass changed, so that a target takes two passes at least; after one pass it is that of the two ray subsets.

    Parameters
    ----------
    scene : method ``hybrid`` or ``raw``
    target_error_db : energy of the error over that of the image; default the scene's; 0 = no target
    time_limit : s, of this run; default the scene's; 0 = no limit. At least one pass is made
    state : file that holds the passes between runs; the finished blocks of the pass in work stand beside it, in a
        file that ends in ``.blocks``. None keeps nothing
    grid : of the image; default what the scene asks for
    range_window, azimuth_window : of the image
    max_passes : bound on all passes
    progress : called after every pass with the error and, where there is one, the limit
    ready : called once the first pass is planned and fits, before it is traced
    clock : that ``time_limit`` is measured with
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
    The passes reduce the error of ray sampling and no other; see
    :func:`sarmitsuba.simulation.refinement.error_bars.estimate_pass_error`.
    """
    target = scene.settings.target_error_db if target_error_db is None else target_error_db
    limit = scene.settings.time_limit if time_limit is None else time_limit
    if target >= 0.0 and limit <= 0.0:
        raise DataError(
            f"{scene.name}: adding passes needs target_error_db below 0 dB or time_limit above 0 s; set one of them"
        )
    if not scene.traced:
        raise DataError(
            f"{scene.name}: ideal points alone take no rays, and their echoes are exact; leave out target_error_db and "
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
            run.finished = FinishedBlocks(blocks_of(file), run_hash, run.plan, part)
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
            blocks_of(file).unlink()  # they are in the pass now
    return _finished(focuser, goal, noisy)


@dataclass(frozen=True)
class _Goal:
    """What ends the passes: the error wanted (dB; 0: none), a time limit (s; 0: none), the most passes."""

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
        # the subsets of one pass are too uncertain to end it
        return (self.met(error) and passes.count > 1) or passes.count >= self.max_passes

    def share(self, error: float, elapsed: float) -> tuple[float, float]:
        """Progress in per cent: by the passes that the target still needs, or by the time, whichever is further on."""
        by_error = 10.0 ** ((self.target - error) / (10.0 * ORDER)) if self.target < 0.0 else 0.0
        by_time = elapsed / self.limit if self.limit > 0.0 else 0.0
        return 100.0 * min(1.0, max(by_error, by_time)), 100.0


class _PassImage:
    """Image of the passes so far, and its error; focused only when it matters, else the raw data's error stands in."""

    def __init__(
        self, scene: Scene, passes: Passes, grid: ImageGrid, range_window: str, azimuth_window: str
    ) -> None:
        self.scene, self.passes, self.grid = scene, passes, grid
        self.range_window, self.azimuth_window = range_window, azimuth_window
        self.image: SarImage | None = None  # of the passes so far, where it was focused

    def raw(self) -> RawData:
        passes = self.passes
        assert passes.data is not None
        return self._raw(passes.data, passes.layers)

    def _raw(self, data: NDArray[np.complex64], layers: tuple[Layer, ...]) -> RawData:
        scene, radar = self.scene, self.scene.radar
        flown = radar.track if radar.recorded is not None else None
        return RawData(
            data, layers, "compressed", radar.as_recorded(), self.passes.metadata, scene.image, flown
        )

    def focus(self, raw: RawData) -> SarImage:
        return focus(raw, self.grid, range_window=self.range_window, azimuth_window=self.azimuth_window)

    def bars(self, image: SarImage) -> ErrorBars:
        """Of the image of all passes."""
        change = self.passes.change
        if change is None:
            return estimate_error(image.data, image.layers, pixels=False)
        channels = channels_of(image.layers)
        changed = self.focus(self._raw(change, tuple(Layer(c) for c in channels)))
        mean = by_channel(image.data, image.layers)
        return estimate_pass_error(changed.data, mean, channels, self.passes.share)

    def _raw_error_db(self) -> float:
        """Of the raw data, worst channel."""
        passes = self.passes
        assert passes.data is not None
        if passes.change is None:
            return max(estimate_error(passes.data, passes.layers, pixels=False).error_db)
        mean = by_channel(passes.data, passes.layers)
        channels = channels_of(passes.layers)
        return max(estimate_pass_error(passes.change, mean, channels, passes.share).error_db)

    def error_db(self, goal: _Goal) -> float:
        """Of the image, worst channel."""
        self.image = None
        raw_error, passes = self._raw_error_db(), self.passes
        source: Source = SUBSETS if passes.change is None else PASSES
        if source != passes.source:  # another estimate, another ratio
            passes.ratio_db, passes.source = None, source
        error = raw_error + (passes.ratio_db or 0.0)
        if passes.ratio_db is None or (goal.target < 0.0 and error <= goal.target + 0.3):
            self.image = self.focus(self.raw())
            error = max(self.bars(self.image).error_db)
            passes.ratio_db = error - raw_error
        return error


def blocks_of(state: Path) -> Path:
    """File beside the state file that keeps the finished blocks of the pass in work."""
    return state.with_suffix(".blocks")


def _finished(focuser: _PassImage, goal: _Goal, noisy: bool) -> Refinement:
    """Raw data and image of all passes, with their record; receiver noise last."""
    passes, raw = focuser.passes, focuser.raw()
    image = focuser.image or focuser.focus(raw)
    bars = focuser.bars(image)
    error = max(bars.error_db)
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
    image = with_error_bars(replace(image, metadata={**image.metadata, "refinement": record}))
    return Refinement(raw, image, passes.count, error, met, tuple(passes.history))


def _next_level(passes: Passes, took: float, left: float) -> int | None:
    """Density of the next pass: twice the rays if that fits time and memory, else as before, None when time is up."""
    if not passes.levels:
        return 0
    level = max(passes.levels)
    if 2.0 * took <= 1.2 * left and passes.rays <= MAX_RAYS:
        return level + 1
    return level if took <= 1.5 * left and left > 0.0 else None


__all__ = ["STATE_FILE", "Passes", "Refinement", "blocks_of", "refine"]
