"""Measured influence and cost of an effect in one scene: pulses are traced and focused with it and without it.

Changes are those of the focused image, inside its grid (raw data also hold echoes from outside the image). All blocks
of pulses are traced if that is cheap; else some of them, distributed over the aperture, and their scatter gives a bound
for the others.
"""

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import Literal

import numpy as np
from scipy.special import stdtrit

from sarmitsuba.core.arrays import C64, F64, sum_energies
from sarmitsuba.core.constants import SUBSET_SHARES
from sarmitsuba.core.errors import SarmitsubaError, SarmitsubaWarning
from sarmitsuba.core.timing import Clock
from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.effect import EFFECTS, Decision, Effect, effects
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing import default_grid, focus
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.raw_data import Layer, RawData
from sarmitsuba.simulation.execution.blocks import partition
from sarmitsuba.simulation.execution.points import add_points
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.tracing import Batch, BatchTracer

# least and largest number of blocks that are traced both ways, and most pulses of one where every pulse is traced
PLACES, MOST_PLACES, LONGEST = 5, 48, 256
# bounds on the rays traced both ways, all effects together: for all blocks to be used, and for effects to be tried
MOST_RAYS = 100_000_000
# bound on pixels times pulses of one image; above it the grid is made coarser
MOST_PIXEL_PULSES = 5e8
# largest number of rounds of the timing with an effect and without it, in turn, besides the tracing of the echoes and
# the round of the effect before; the least of each counts. Only one without it where so many seconds are timed then
MOST_ROUNDS, LONG_ENOUGH = 2, 0.4
# rounds of the timing of a whole short run
BESIDES_ROUNDS = 2
# blocks in the middle that are timed
TIMED = 2
# number of blocks from which on the median of their seconds does not include the compilation of kernels
UNCOMPILED = 5
# a change of larger uncertainty than this is stated as a bound, dB
WELL_KNOWN_DB = 2.0
# relative energy of a change that is rounding
NOTHING = 1e-9
# one-sided confidence of such a bound
CONFIDENCE = 0.99


class _BlockPulses:
    """Blocks of pulses of a run with one setting of the effects, traced and focused.

    Parameters
    ----------
    run : prepared run
    loaded : its scene, as loaded
    blocks : first pulse of each, and the one after its last
    together : whether the pulses of a block share one tracing

    clock : measure of time; None: nothing is timed

    Attributes
    ----------
    rays : of one block
    least : seconds of the whole run, least of the last rounds; infinite before the first
    """

    def __init__(
        self,
        run: Run,
        loaded: Scene,
        blocks: Sequence[tuple[int, int]],
        together: bool,
        clock: Clock | None = None,
    ) -> None:
        self.run, self.loaded, self.blocks, self.together = run, loaded, tuple(blocks), together
        self.clock, self.least = clock, np.inf
        self.batches, self.subsets = _batches(run)
        self.rays = self._rays()

    def _rays(self) -> int:
        first, stop = self.blocks[0]
        lattices = self.batches.rays.at(first)
        launched = sum(grid.n_rays for grids in lattices for grid in grids) * self.run.plan.sub_bands
        return launched * (1 if self.together else stop - first)

    def echoes(self, places: Sequence[int]) -> C64:
        """Echoes (channels, pulses, samples) of all pulses; 0 outside the blocks with these numbers."""
        run, n = self.run, self.run.scene.radar.track.n_pulses
        channels, radar = run.layers.channels, run.scene.radar
        out = np.zeros((len(channels), n, radar.window.n_samples), dtype=np.complex64)
        taken = []  # seconds of every block
        for place in places:
            start, stop = self.blocks[place]
            before = self.clock() if self.clock else 0.0
            for subset, share in enumerate(self.subsets):
                found = _trace_block(self.batches, subset, start, stop, n, self.together)
                parts = found.reshape(-1, len(channels), *found.shape[1:]).sum(axis=0)
                out[:, start:stop] += np.float32(share) * parts[:, : stop - start]
            taken.append(self.clock() - before if self.clock else 0.0)
        if self.clock and len(taken) >= UNCOMPILED:
            self.least = self._setup(self.clock) + float(np.median(taken)) * len(self.blocks)
        self._points(out)
        return out

    def _setup(self, clock: Clock) -> float:
        """Seconds for planning and laying out the lattices of the run."""
        start = clock()
        _batches(Run(self.loaded, plan=self.run.plan, clock=clock, geometry=self.run.trace_scene))
        return clock() - start

    def _points(self, out: C64) -> None:
        """Add ideal points at the traced pulses."""
        run = self.run
        pulses = np.flatnonzero(out.any(axis=(0, 2)))
        if not run.scene.points or not len(pulses):
            return
        scene = replace(run.scene, radar=run.scene.radar.of_pulses(pulses))
        part = np.ascontiguousarray(out[:, pulses])
        add_points(scene, run.plan.flags, run.trace_scene, part, self._labels, run.plan.sub_bands)
        out[:, pulses] = part

    @property
    def _labels(self) -> tuple[Layer, ...]:
        return tuple(Layer(channel) for channel in self.run.layers.channels)

    def focused(self, data: C64, grid: ImageGrid) -> C64:
        """Images (channels, n_azimuth, n_range) of echoes."""
        radar, scene = self.run.scene.radar, self.run.scene
        flown = radar.track if radar.recorded is not None else None
        raw = RawData(data, self._labels, "compressed", radar.as_recorded(), request=scene.image, flown=flown)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SarmitsubaWarning)  # the run itself issues them
            return focus(raw, grid, range_window="rectangular", azimuth_window="rectangular").data

    def seconds(self, clock: Clock) -> float:
        """Seconds for lattices, tracing and synthesis of the whole run, extrapolated from its blocks in the middle."""
        start = clock()
        run = Run(self.loaded, plan=self.run.plan, clock=clock, geometry=self.run.trace_scene)
        batches, subsets = _batches(run)
        setup = clock() - start
        middle = max(0, (len(self.blocks) - TIMED) // 2)
        timed = self.blocks[middle : middle + TIMED]
        n = run.scene.radar.track.n_pulses
        start = clock()
        for first, stop in timed:
            for subset in range(len(subsets)):
                _trace_block(batches, subset, first, stop, n, self.together)
        traced = clock() - start
        if self.together:
            return setup + traced * len(self.blocks) / len(timed)
        return setup + traced * n / sum(stop - first for first, stop in timed)


def _batches(run: Run) -> tuple[BatchTracer, tuple[float, ...]]:
    """Tracer of the blocks of a run, and the share of each ray subset."""
    assert run.sampling is not None
    rays, tracer = run.rays(run.sampling, 0), run.tracer(run.sampling)
    subsets = tuple(SUBSET_SHARES[subset] for subset in run.layers.subsets)
    return BatchTracer(tracer, rays, run.layers.per_subset, run.layers.max_order), subsets


def _trace_block(batches: BatchTracer, subset: int, start: int, stop: int, n: int, together: bool) -> C64:
    """Profiles (layers of the subset, pulses, samples) of a block, including the first pulse of the next block."""
    return batches.trace(Batch(subset, start, stop + int(together and stop < n), together)).profiles


def measured_both_ways(
    run: Run,
    loaded: Scene,
    interval: int,
    *,
    clock: Clock | None = time.process_time,
    most_places: int = MOST_PLACES,
) -> EffectsPlan:
    """Plan with the measured influence and cost of its effects, from pulses traced with and without each.

    Parameters
    ----------
    run : prepared run with the automatic plan
    loaded : its scene, as loaded
    interval : pulses that share one tracing in the whole run
    clock : for the cost; processor seconds of all threads are least disturbed by other programs. None leaves the cost
        out
    most_places : largest number of blocks that are traced

    Notes
    -----
    The same blocks of pulses are traced with and without the effect. Where not all blocks are traced, the change counts
    as measured only if they agree within ``WELL_KNOWN_DB``, else an upper bound is stated; changes visible only at
    pulses between the blocks are missed. Effects that are proven to change nothing, or that the user has switched off,
    are not tried. Effects that change the
    focusing (:attr:`Effect.at_key_pulses`) are focused with the corresponding radar. The cost covers lattices, tracing
    and synthesis, without reading, planning and ideal points.
    """
    plan = run.plan
    if run.context is None or run.sampling is None or loaded.settings.method == "raster":
        return plan
    tried = [effect for effect in effects() if _worth_trying(effect, plan)]
    n = run.scene.radar.track.n_pulses
    together = interval > 1
    blocks = partition(n, interval if together else min(LONGEST, run.sampling.block_length(LONGEST)))
    together = together or blocks[0][1] > 1
    base = _BlockPulses(run, loaded, blocks, together, clock)
    number = int(MOST_RAYS / max(1, base.rays * (len(tried) + 1)))
    places = _spread(len(blocks), min(most_places, max(PLACES, number)))
    whole = len(places) == len(blocks)
    grid = _grid(run)
    data = base.echoes(places)
    image = base.focused(data, grid)
    more = _besides(base, clock) if clock is not None and whole and interval > 1 else 0.0
    left = MOST_RAYS - len(places) * base.rays
    for effect in tried:
        decision = plan.decision(effect.name)
        assert decision is not None
        if left < 0:
            continue
        found = _other_way(base, decision, data, image, grid, places)
        if found is None:
            continue
        left -= len(places) * found.way.rays
        # most runs trace more bounces than have an echo: the change is that of the last bounce with an echo
        if whole and effect.name == "max_depth" and decision.on and found.ratio <= NOTHING:
            found = _last_that_returns(base, decision, data, image, grid, places) or found
        way, deepest = found.way, found.deepest
        spread = (
            None if whole else _spread_of(found.echoes - data, data, [blocks[i] for i in places], len(blocks))
        )
        error_db, measured = _state_change(found.ratio, spread)
        cost = np.nan
        if clock is not None:
            here, there = _least(base, way, clock)
            cost = share_of(decision.on, more + here, more + there)
        if measured or error_db > -np.inf:
            plan = plan.with_measured(effect.name, error_db, cost, measured=measured, deepest=deepest)
        else:  # no change in the traced blocks, but there are others
            plan = plan.with_measured(effect.name, decision.error_db, cost, measured=False)
    return plan


@dataclass(frozen=True, eq=False)
class _SwitchedRun:
    """Result of a run with an effect switched: echoes, change of the image (energy), and ``Decision.deepest``."""

    way: _BlockPulses
    echoes: C64
    ratio: float
    deepest: int | None = None


def _other_way(
    base: _BlockPulses, decision: Decision, data: C64, image: C64, grid: ImageGrid, places: Sequence[int]
) -> _SwitchedRun | None:
    """Run with an effect switched, traced at the blocks of ``base``; None where no echo would remain."""
    run = base.run
    try:
        scene = switch_effect(base.loaded, decision)
        other = run.otherwise(scene)
        if other.sampling is None or other.layers.channels != run.layers.channels:
            return None
        way = _BlockPulses(other, scene, base.blocks, base.together, base.clock)
        echoes = way.echoes(places)
    except SarmitsubaError:
        return None
    if EFFECTS[decision.name].at_key_pulses:
        change = base.focused(echoes - data, grid)
    else:
        change = way.focused(echoes, grid) - image
    return _SwitchedRun(way, echoes, _ratio(change, image), decision.deepest)


def _last_that_returns(
    base: _BlockPulses, decision: Decision, data: C64, image: C64, grid: ImageGrid, places: Sequence[int]
) -> _SwitchedRun | None:
    """Run without the last bounce that has an echo, found by bisection; without the second, where none has."""
    low, high = 1, (decision.value or 2) - 1  # bounces beyond ``high`` have no echo
    best = None
    while low < high:
        middle = (low + high) // 2
        found = _other_way(base, replace(decision, deepest=middle + 1), data, image, grid, places)
        if found is None:
            return None
        if found.ratio > NOTHING:
            low, best = middle + 1, found
        else:
            high = middle
    if best is None or best.deepest != high:
        best = _other_way(base, replace(decision, deepest=max(high, 2)), data, image, grid, places)
    return None if best is None else replace(best, deepest=high)


def _besides(base: _BlockPulses, clock: Clock) -> float:
    """Seconds of a short run apart from lattices and tracing: geometry on the device, checks, metadata."""
    settings = base.loaded.settings
    length = 0 if settings.method == "raw" else max(stop - start for start, stop in base.blocks)
    one_pass = replace(settings, key_pulse_interval=length, target_error_db=0.0, time_limit=0.0)
    scene = replace(base.loaded, settings=one_pass)
    whole, parts = np.inf, np.inf
    for _ in range(BESIDES_ROUNDS):
        start = clock()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SarmitsubaWarning)
            simulate(scene, plan=base.run.plan)
        whole, parts = min(whole, clock() - start), min(parts, base.seconds(clock))
    return max(0.0, whole - parts)


def _least(base: _BlockPulses, way: _BlockPulses, clock: Clock) -> tuple[float, float]:
    """Seconds of both runs: the least of a few alternating rounds, since disturbances only lengthen them.

    Both runs bring a round with them: ``way`` from the tracing of its echoes, ``base`` from the effect before.
    """
    here, there = base.least, way.least
    base.least = base.seconds(clock)
    here, total = min(here, base.least), base.least
    for i in range(MOST_ROUNDS):
        if np.isfinite(there) and total >= LONG_ENOUGH:
            break
        if i:
            one = base.seconds(clock)
            here, total = min(here, one), total + one
        there = min(there, way.seconds(clock))
    return here, there


def _spread(n: int, wanted: int) -> list[int]:
    """Indices of ``wanted`` of ``n`` blocks, distributed over the aperture; all where they are few."""
    number = min(n, wanted)
    return [int((i + 0.5) * n / number) for i in range(number)]


def _grid(run: Run) -> ImageGrid:
    """Grid of the image, thinned out where focusing would take long."""
    radar, request = run.scene.radar.as_recorded(), run.scene.image
    grid = default_grid(radar, request)
    much = prod(grid.shape) * radar.track.n_pulses / MOST_PIXEL_PULSES
    if much <= 1.0:
        return grid
    coarser = float(np.sqrt(much))
    return default_grid(radar, request.coarser(coarser, (grid.azimuth_spacing, grid.range_spacing)))


def _worth_trying(effect: Effect, plan: EffectsPlan) -> bool:
    """Whether tracing with and without an effect gives any information about it."""
    decision = plan.decision(effect.name)
    if decision is None or decision.error_db == -np.inf or effect.of_receiver:
        return False
    if not decision.on and decision.source == "user" and effect.name != "max_depth":
        return False  # somebody may have switched it off because it cannot be traced
    return bool(effect.documentation) or effect.name == "max_depth"


def switch_effect(loaded: Scene, decision: Decision) -> Scene:
    """Scene with an effect switched; max_depth: without the last bounce (with an echo), or with the second."""
    settings = loaded.settings
    if decision.name == "max_depth":
        depth = decision.deepest or decision.value or 1
        return replace(loaded, settings=replace(settings, max_depth=depth - 1 if depth > 1 else 2))
    switch: Literal["on", "off"] = "off" if decision.on else "on"
    switches = {**settings.effects, decision.name: switch}
    return replace(loaded, settings=replace(settings, effects=switches))


def _ratio(change: C64, image: C64) -> float:
    """Energy of the change relative to the image, worst channel."""
    return float(np.max(sum_energies(change) / np.maximum(sum_energies(image), 1e-300)))


def _spread_of(change: C64, data: C64, blocks: Sequence[tuple[int, int]], n: int) -> float:
    """Relative upper confidence margin of the ratio of the energies, from ``blocks`` of ``n`` in all, worst channel.

    Standard error of a ratio of sums (W. G. Cochran, Sampling Techniques, 1977, 6.13) times Student's t.
    """
    parts = [(sum_energies(change[:, a:b]), sum_energies(data[:, a:b])) for a, b in blocks]
    above, below = (np.stack(x) for x in zip(*parts, strict=True))
    return float(max(ratio_margin(a, b, n) for a, b in zip(above.T, below.T, strict=True)))


def ratio_margin(above: F64, below: F64, n: int) -> float:
    """Relative margin by which the ratio of two sums over ``n`` parts may exceed that over a sample of them.

    Parameters
    ----------
    above, below : (k,) float64, numerator and denominator of the known parts
    n : number of all parts

    Returns
    -------
    margin : of the ratio, at ``CONFIDENCE``; 0 where all parts are known or the numerator is zero
    """
    k = len(above)
    if k >= n or not above.any():
        return 0.0
    if k < 2:
        return np.inf
    left = above - above.sum() / below.sum() * below
    error = np.sqrt((1.0 - k / n) * k / (k - 1.0) * np.sum(left**2)) / above.sum()
    return float(stdtrit(k - 1, CONFIDENCE) * error)


def _state_change(ratio: float, margin: float | None) -> tuple[float, bool]:
    """Stated value of a change, dB, and whether it is measured or an upper bound."""
    if ratio == 0.0:
        return -np.inf, margin is None
    upper = 1.0 + (margin or 0.0)
    if db_from_power(upper) <= WELL_KNOWN_DB:
        return db_from_power(ratio), True
    return db_from_power(ratio * upper), False


def share_of(on: bool, here: float, there: float) -> float:
    """Share of the simulation's time that an effect takes (on), or would take (off).

    Parameters
    ----------
    on : whether the plan has the effect on
    here, there : seconds as planned, and with the effect switched
    """
    with_it, without = (here, there) if on else (there, here)
    return max(0.0, 1.0 - without / with_it)
