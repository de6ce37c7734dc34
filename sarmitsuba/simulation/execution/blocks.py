"""Key pulses: tracing of a run block by block, and the resulting error, measured at block boundaries.

Within a block of pulses every path keeps the amplitude and the visibility that it has at the block's key pulse. The
pulse at the boundary of two blocks is synthesised from both: the two profiles would be equal if nothing changed from
one key pulse to the next, so their difference measures the changes of shadows, glints, hits of rays, curvature and
gridding. It costs no tracing, only one more synthesised pulse per block. How fast the change grows with the time
between two pulses is measured by one more traced pulse, at the boundary in the middle of the track.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F64, sum_energy
from sarmitsuba.core.constants import EMPTY_DB, SUBSET_SHARES
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.core.witness import Witness
from sarmitsuba.signal.raw_data import Layer
from sarmitsuba.simulation.execution.error_bars import estimate_error, has_subsets
from sarmitsuba.simulation.execution.finished import FinishedBlocks
from sarmitsuba.simulation.execution.ray_witness import witness_rays
from sarmitsuba.simulation.execution.statistics import TraceStatistics
from sarmitsuba.simulation.execution.tracing import Batch, BatchTracer, Traced, Tracer
from sarmitsuba.simulation.planning.sampling.rays import Rays
from sarmitsuba.tracing.kernel.launch import LaunchFrame, LaunchGrid

# exponent of the time between two pulses with which the energy of a path's change grows, least and most: one for edges
# of shadows, which cross scatterers in proportion to time, two for glints, less where rays hit other facets; a lower
# exponent gives a higher stated error
GROWTH, MOST_GROWTH = 0.5, 2.0
# standard deviation of the estimate from one block boundary, dB (n boundaries: over the root of n); added to the
# stated error (benchmarks/suite/stated_errors.py)
BOUNDARY_SCATTER_DB = 2.5
# boundaries below which the error is relative to the weaker of the pulses there and of the blocks that meet there
FEW_BOUNDARIES = 3
# margin of the error of blocks below a wanted error of the whole run, dB
BELOW_TARGET_DB = 3.0
# shortest blocks that are tried: shorter ones cost more than the direct accumulator
SHORTEST = 8
# excess over the wanted error that is tolerated, dB: the estimate at a block boundary is not more accurate
LEEWAY_DB = 1.0
# without a wanted error, blocks may exceed the error of ray sampling by this much, dB: half the error costs twice the
# time, and shadows that move in steps of less than a cell do not change the visible image
WORTH_DB = 8.0
# dB, error up to which blocks may do so where the rays err less
GOOD_DB = -15.0
# number of rays per key pulse from which their error is measured on a strip first, and the strip's share of the launch
# window: it costs a tenth of a key pulse, where shifting all rays would cost a whole one
STRIP_FROM = 1_000_000
STRIP = 0.05
# energy of a strip with raised-cosine tapers over half of its width, relative to full weight
STRIP_ENERGY = 11.0 / 16.0
# golden section: its multiples modulo one are evenly distributed
GOLDEN = 0.5 * (5.0**0.5 - 1.0)
# most pulses at which the error of the rays is measured, and rays that pay for the launches of one
RAY_PULSES, RAYS_A_PULSE = 3, 4e5
# margin required of the error on a strip, dB: bright targets elsewhere may hold more of the image than of the error
SURE_DB = 3.0


def partition(n_pulses: int, length: int) -> list[tuple[int, int]]:
    """Blocks ``start, stop`` of pulses, of about equal length, at most ``length``."""
    count = -(-n_pulses // length)
    edges = np.round(np.linspace(0, n_pulses, count + 1)).astype(int)
    return [(int(a), int(b)) for a, b in pairwise(edges)]


class Blocks:
    """Tracing of all pulses of a run.

    Parameters
    ----------
    tracer : of the run
    rays : lattices of every ray subset
    layers : labels of ``data``: subset after subset
    data : (n_layers, n_pulses, n_samples) complex64, filled; subsets are not yet weighted by their shares
    max_order : highest bounce order kept separately; 0 where all are summed
    finished : file of finished blocks, also of an interrupted run; None: none
    spread : traces batches in other processes, in any order; None: in this one. The two blocks from which the interval
        is determined are always traced in this process

    Attributes
    ----------
    interval : pulses that share one tracing; at first as the geometry allows, finally as the measured error allows
    """

    def __init__(
        self,
        tracer: Tracer,
        rays: Rays,
        layers: Sequence[Layer],
        data: C64,
        max_order: int,
        finished: FinishedBlocks | None = None,
        spread: Callable[[Sequence[Batch]], Iterator[Traced]] | None = None,
    ) -> None:
        self.finished = finished
        self.tracer, self.rays, self.layers, self.data = tracer, rays, tuple(layers), data
        self.batches = BatchTracer(tracer, rays, len(self.layers) // rays.n_subsets, max_order)
        self.spread = spread or self._here
        settings = tracer.sampling.scene.settings
        self.automatic = settings.key_pulse_interval == 0 and settings.method != "raw"
        n = data.shape[1]
        self.growth: dict[str, float] = {}  # exponent of each channel, where it is measured
        self.interval: int = min(tracer.sampling.key_pulse_interval, n)
        if self.automatic and 1 < self.interval and n < 2 * self.interval:
            self.interval = self._fitting(-(-n // 2))  # two blocks at least: their boundary gives the error
        if finished is not None:
            self.interval = finished.interval or self.interval
            tracer.largest_grid = max(tracer.largest_grid, finished.grid_bytes)
        self._cut()

    def _cut(self) -> None:
        """Divide the pulses into blocks of the current interval."""
        self.blocks = partition(self.data.shape[1], self.interval)
        if self.automatic:
            self.interval = max(stop - start for start, stop in self.blocks)
        self.boundaries = np.zeros(
            (self.data.shape[0], max(len(self.blocks) - 1, 0), self.data.shape[2]), dtype=np.complex64
        )
        self.done: set[int] = set()
        self.first = {start: index for index, (start, _) in enumerate(self.blocks)}

    def trace(self) -> Iterator[tuple[float, TraceStatistics]]:
        """Fill ``data``; yields the share done and the statistics of the batch just traced."""
        if self.interval == 1:
            yield from self._all(self._every_pulse(), 0)
            return
        stats = self.settle()
        settled = len(self.done)
        yield settled / len(self.blocks), stats
        subsets = range(self.rays.n_subsets)
        todo = [self._batch(i, k) for i in range(len(self.blocks)) if i not in self.done for k in subsets]
        yield from self._all(todo, settled * self.rays.n_subsets)
        self.done |= set(range(len(self.blocks)))

    def every_batch(self) -> list[Batch]:
        """Batches of the whole track at the current interval, subset by subset within each block."""
        if self.interval == 1:
            return self._every_pulse()
        subsets = range(self.rays.n_subsets)
        return [self._batch(i, k) for i in range(len(self.blocks)) for k in subsets]

    def _all(self, todo: Sequence[Batch], before: int) -> Iterator[tuple[float, TraceStatistics]]:
        """Trace batches after ``before`` others; statistics are yielded in order, so that sums have the same bits."""
        waiting: dict[Batch, TraceStatistics] = {}
        told = 0
        for n, traced in enumerate(self._trace(todo, self.spread), before + 1):
            waiting[traced.batch] = traced.statistics
            share = n / (before + len(todo))
            if todo[told] not in waiting:
                yield share, TraceStatistics()
            while told < len(todo) and todo[told] in waiting:
                yield share, waiting.pop(todo[told])
                told += 1

    def _trace(
        self, batches: Sequence[Batch], spread: Callable[[Sequence[Batch]], Iterator[Traced]]
    ) -> Iterator[Traced]:
        """Batches, stored in ``data`` before they are yielded: first those of an interrupted run, then new ones."""
        todo, finished = [], self.finished
        for batch in batches:
            found = finished and finished.take(batch.subset, batch.start, batch.stop)
            if finished is None or not found:
                todo.append(batch)
                continue
            shape = (self.batches.n_layers, batch.stop - batch.start, self.data.shape[2])
            traced = Traced(batch, found[0].reshape(shape), found[1], finished.grid_bytes)
            self._keep(traced)
            yield traced
        for traced in spread(todo) if todo else ():
            if finished is not None:
                batch, profiles = traced.batch, traced.profiles
                finished.put(
                    batch.subset, batch.start, batch.stop, profiles, traced.statistics, traced.grid_bytes
                )
            self._keep(traced)
            yield traced

    def _here(self, batches: Sequence[Batch]) -> Iterator[Traced]:
        return map(self.batches.trace, batches)

    def _keep(self, traced: Traced) -> None:
        """Store a batch in ``data``; the extra pulse beyond a block's end is used for the error at the boundary."""
        batch, pick = traced.batch, self.layers_of(traced.batch.subset)
        stop = batch.stop
        if batch.together:
            index = self.first[batch.start]
            stop = self.blocks[index][1]
            if batch.stop > stop:
                self.boundaries[pick, index] = traced.profiles[:, -1]
        self.data[pick, batch.start : stop] = traced.profiles[:, : stop - batch.start]
        self.tracer.largest_grid = max(self.tracer.largest_grid, traced.grid_bytes)

    def settle(self) -> TraceStatistics:
        """Determine the block length: trace the two blocks in the middle, and shorter ones if these are too long.

        Blocks are too long where their error is above the tolerance and far above that of ray sampling, or, in a run
        with a wanted error, above or near that one.
        """
        if self.interval == 1:
            return TraceStatistics()
        while True:
            middle = self._middle
            stats = self.block(middle)
            decided = self.finished is not None and self.finished.settled
            if len(self.blocks) > 1:
                stats = stats.plus(self.block(middle + 1))
                if self.finished is not None and decided:
                    self.growth = dict(self.finished.growth)
                else:
                    self._measure_growth()
            open_ = self.automatic and len(self.blocks) > 1 and not decided
            shorter = self._shorter() if open_ else self.interval
            if self.finished is not None and not decided:
                self.finished.note(shorter, settled=shorter == self.interval, growth=self.growth)
            if shorter == self.interval:
                return stats
            self.interval = shorter
            self._cut()

    def survey(self, most_rays: int) -> tuple[int, int]:
        """Trace blocks at further block boundaries along the track; returns the numbers of measured and all boundaries.

        Parameters
        ----------
        most_rays : bound on the rays traced for it

        Notes
        -----
        Does nothing where every pulse is traced: there are no blocks.
        """
        if self.interval == 1:
            return 0, 0
        boundaries = range(len(self.blocks) - 1)
        for i in sorted(boundaries, key=lambda i: (GOLDEN * i) % 1.0):
            todo = [k for k in (i, i + 1) if k not in self.done]
            each = sum(grid.n_rays for grids in self.rays.at(self.blocks[i][0]) for grid in grids)
            most_rays -= each * len(todo)
            if most_rays < 0:
                break
            for k in todo:
                self.block(k)
        return sum({i, i + 1} <= self.done for i in boundaries), len(boundaries)

    def sample(self) -> tuple[float, TraceStatistics]:
        """Trace one batch of the first ray subset; returns the share of its pulses, and its statistics."""
        if self.interval == 1:
            first = self._every_pulse()[0]
            share = first.stop / self.data.shape[1]
        else:
            first, share = self._batch(self._middle, 0), 1.0 / len(self.blocks)
        (traced,) = self._trace([first], self._here)
        return share, traced.statistics

    @property
    def _middle(self) -> int:
        """Index of the first of the two blocks in the middle."""
        return max(0, len(self.blocks) // 2 - 1)

    def block(self, index: int) -> TraceStatistics:
        """Trace one block with all ray subsets, up to the first pulse of the next block."""
        total = TraceStatistics()
        subsets = [self._batch(index, subset) for subset in range(self.rays.n_subsets)]
        for traced in self._trace(subsets, self._here):
            total = total.plus(traced.statistics)
        self.done.add(index)
        return total

    def _batch(self, index: int, subset: int) -> Batch:
        start, stop = self.blocks[index]
        return Batch(subset, start, stop + int(index + 1 < len(self.blocks)), together=True)

    def layers_of(self, subset: int) -> slice:
        """Slice of the layers of a ray subset."""
        each = len(self.layers) // self.rays.n_subsets
        return slice(subset * each, (subset + 1) * each)

    def _every_pulse(self) -> list[Batch]:
        sampling = self.tracer.sampling
        batches = []
        for i in range(self.rays.n_subsets):
            for window in sampling.windows:
                first, end = window.pulses
                most = max(g.n_rays for g in self.rays.at(first)[i] if g.serves(first))
                step = min(self.batches.pulses_per_launch(most), end - first)
                starts = range(first, end, step)
                batches += [Batch(i, k, min(end, k + step), together=False) for k in starts]
        return batches

    # ------------------------------------------------------------ error of blocks

    @property
    def error_db(self) -> float:
        """Error energy of blocks against tracing every pulse, relative to the data, dB; worst channel.

        From the boundaries measured so far, with the uncertainty of their number added. -inf where every pulse is
        traced, NaN where there is one block only.
        """
        if self.interval == 1:
            return -np.inf
        boundaries = [i for i in range(len(self.blocks) - 1) if {i, i + 1} <= self.done]
        worst = max(self._errors(boundaries).values(), default=np.nan)
        return float(worst + BOUNDARY_SCATTER_DB / max(len(boundaries), 1) ** 0.5)

    def _errors(self, boundaries: Sequence[int]) -> dict[str, float]:
        """Error of each channel from some of the block boundaries, dB; empty without a boundary.

        Relative to the mean energy of the pulses of the blocks that meet there, as that of single pulses changes with
        the lobes of walls; of few boundaries to the energy of the pulses there if that is less. Channels
        ``EMPTY_DB`` below the strongest hold nothing but rounding and are left out.
        """
        if not len(boundaries):
            return {}
        pulses = [self.blocks[i][1] for i in boundaries]
        data = {
            channel: self._channel(self.data[:, pulses], channel)
            for channel in dict.fromkeys(layer.channel for layer in self.layers)
        }
        meeting = sorted({k for i in boundaries for k in (i, i + 1)})
        energy = {channel: len(pulses) * self._mean_energy(meeting, channel) for channel in data}
        out = {}
        for channel, here in data.items():
            if energy[channel] < power_from_db(EMPTY_DB) * max(energy.values()):
                continue
            change = self._channel(self.boundaries[:, list(boundaries)], channel) - here
            energy_here = energy[channel]
            if len(pulses) < FEW_BOUNDARIES:  # a bound: the weaker of both
                energy_here = min(energy_here, sum_energy(here))
            over_energy = _relative_db(sum_energy(change), energy_here)
            out[channel] = over_energy + _mean_over_change_db(self.growth.get(channel, GROWTH))
        return out

    def _mean_energy(self, blocks: Sequence[int], channel: str) -> float:
        """Mean energy of a pulse of some blocks."""
        spans = [slice(*self.blocks[k]) for k in blocks]
        total = sum(sum_energy(self._channel(self.data[:, span], channel)) for span in spans)
        return total / sum(span.stop - span.start for span in spans)

    def _measure_growth(self) -> None:
        r"""Measure how the change of every channel grows with time, where its error counts.

        The pulse at the boundary in the middle is traced with the first ray subset. From it to the key pulses beside it
        is half the time that is between these, so that with changes :math:`S` the exponent is

        .. math:: \log_2 \frac{S(T)}{S(T / 2)}
        """
        self.growth = {}
        errors = self._errors([self._middle])
        if max(errors.values(), default=-np.inf) <= self.tracer.sampling.scene.settings.tolerance_db:
            return
        pulse = self.blocks[self._middle][1]
        first = self.layers_of(0)
        traced = self._at(None, pulse)
        before, after = self.boundaries[first, self._middle], self.data[first, pulse]
        for channel in errors:
            mine = [layer.channel == channel for layer in self.layers[first]]
            exact, left, right = (planes[mine].sum(axis=0) for planes in (traced, before, after))
            half, whole = (
                0.5 * (sum_energy(left - exact) + sum_energy(right - exact)),
                sum_energy(left - right),
            )
            if half > 0.0 and whole > 0.0:
                self.growth[channel] = float(np.clip(np.log2(whole / half), GROWTH, MOST_GROWTH))

    def witness(self, allowed: float) -> Witness | None:
        """Error of the rays, measured at a few pulses once all is traced; see :mod:`.ray_witness`.

        Half of the pulses are drawn evenly along the track and half by their energy, and weighted by the inverse. They
        have the rays of the first: where something moves, these are laid out for another time.

        Parameters
        ----------
        allowed : most rays to be traced
        """
        channels = tuple(dict.fromkeys(layer.channel for layer in self.layers))
        own = [layer.channel for layer in self.layers[self.layers_of(0)]]
        energy = self.energy_of_pulses()
        if not energy.any():
            return None
        chance = 0.5 / len(energy) + 0.5 * (energy / np.maximum(energy.sum(axis=0), 1e-300)).mean(axis=1)
        chance /= chance.sum()
        n = int(np.clip(allowed / RAYS_A_PULSE, 1, RAY_PULSES))
        middles = (np.arange(n) + 0.5) / n
        pulses = np.minimum(np.searchsorted(np.cumsum(chance), middles), chance.size - 1)
        first = int(pulses[np.argmax(chance[pulses])])
        rays = tuple(grid for grid in self.rays.at(first)[0] if grid.serves(first))
        pulses = np.array([p for p in np.unique(pulses) if all(grid.serves(int(p)) for grid in rays)])
        weights = np.sqrt(1.0 / (len(pulses) * chance.size * chance[pulses])).astype(np.float32)

        def profiles(rays: Sequence[LaunchGrid]) -> C64:
            planes = np.stack(
                [w * self._at(rays, int(p)) for w, p in zip(weights, pulses, strict=True)], axis=1
            )
            return np.stack([planes[[c == channel for c in own]].sum(axis=0) for channel in channels])

        sampling = self.tracer.sampling
        scene, cell = sampling.scene, max(sampling.azimuth_cell, sampling.range_cell)
        seed, wavelength = scene.settings.seed, scene.radar.waveform.wavelength
        each = allowed / len(pulses)
        return witness_rays(
            profiles, rays, energy.mean(axis=0), self._two_sets_db(pulses), wavelength, cell, seed, each
        )

    def _two_sets_db(self, pulses: NDArray[np.intp]) -> float:
        """Error by the difference of two ray sets at some pulses, worst channel, dB; NaN: there is one set."""
        if not has_subsets(self.layers):
            return math.nan
        return max(self._subset_errors(pulses).values())

    def energy_of_pulses(self) -> F64:
        """Energy (n_pulses, n_channels) of the echoes of all ray subsets together."""
        channels = tuple(dict.fromkeys(layer.channel for layer in self.layers))
        out = np.zeros((self.data.shape[1], len(channels)))
        for start, stop in self.blocks:
            for k, channel in enumerate(channels):
                plane = self._channel(self.data[:, start:stop], channel)
                out[start:stop, k] = np.square(np.abs(plane), dtype=np.float64).sum(axis=-1)
        return out

    def _channel(self, planes: C64, channel: str) -> C64:
        """Sum of a channel's layers (n_layers, ...), subsets weighted by their shares."""
        total = np.zeros(planes.shape[1:], dtype=np.complex64)
        for plane, layer in zip(planes, self.layers, strict=True):
            if layer.channel == channel:
                total += plane * np.float32(SUBSET_SHARES[layer.subset])
        return total

    def _shorter(self) -> int:
        """Pulses per block allowed by the error at the middle boundary; the present number if that is small enough."""
        settings = self.tracer.sampling.scene.settings
        error = self._errors([self._middle])
        if max(error.values()) <= settings.tolerance_db + LEEWAY_DB:
            return self.interval
        excess = self._excess(error)
        if excess <= LEEWAY_DB or self.interval <= SHORTEST:
            return self.interval
        growth = max(1.0, min(self.growth.values(), default=1.0))
        length = max(SHORTEST, int(self.interval * power_from_db(-excess / growth)))
        # the change by wide tubes falls faster, and ends where they keep their amplitudes
        sampling = self.tracer.sampling
        steady = sampling.steady_pulses(sampling.spacings.coherent)
        return self._fitting(max(length, int(steady)) if steady < self.interval else length)

    def _fitting(self, length: int) -> int:
        """The longest block length up to ``length`` that the track allows; the present one where none is."""
        fitting = self.tracer.sampling.block_length(length)
        return min(fitting, self.interval) if fitting > 1 else self.interval

    def _excess(self, error: dict[str, float]) -> float:
        """Excess of the worst channel's error over the error allowed for blocks, dB; 0 where it is not exceeded."""
        settings = self.tracer.sampling.scene.settings
        tolerance, target = settings.tolerance_db, settings.target_error_db

        def above(wanted: dict[str, float]) -> float:
            # channels without echoes are in neither
            both = [(value, wanted[channel]) for channel, value in error.items() if channel in wanted]
            return max(0.0, *(value - max(most, tolerance) for value, most in both))

        def above_rays(rays: dict[str, float]) -> float:
            return above({c: min(value + WORTH_DB, max(value, GOOD_DB)) for c, value in rays.items()})

        if target < 0.0:
            return above(dict.fromkeys(error, target - BELOW_TARGET_DB))
        if has_subsets(self.layers):
            middle = slice(self.blocks[self._middle][0], self.blocks[self._middle + 1][1])
            return above_rays(self._subset_errors(middle))
        rays = self.rays.at(self.blocks[self._middle][1])[0]
        frame = self.tracer.sampling.window.frame
        strips = [strip(grid, frame) for grid in rays]
        if sum(grid.n_rays for grid in rays) >= STRIP_FROM and all(grid.n_rays for grid in strips):
            sure = {channel: value - SURE_DB for channel, value in self._shift_errors(strips).items()}
            if above_rays(sure) <= LEEWAY_DB:
                return 0.0
        return above_rays(self._shift_errors(rays))

    def _subset_errors(self, pulses: slice | NDArray[np.intp]) -> dict[str, float]:
        """Error of each channel by ray sampling, from the two ray subsets at some pulses, dB."""
        shares = np.array([SUBSET_SHARES[layer.subset] for layer in self.layers], dtype=np.float32)
        planes = self.data[:, pulses] * shares[:, None, None]
        bars = estimate_error(planes, self.layers, pixels=False)
        return dict(zip(bars.channels, bars.error_db, strict=True))

    def _shift_errors(self, rays: Sequence[LaunchGrid]) -> dict[str, float]:
        """Error of each channel by ray sampling at one pulse, from rays (or a strip) shifted by half a cell, dB."""
        pulse = self.blocks[self._middle][1]
        whole, here = (
            self.data[:, pulse],
            self._at(rays, pulse),
        )  # the block's profile has the block's own error
        all_rays, share = self.rays.at(pulse)[0], 1.0
        if rays is not all_rays:
            share = STRIP_ENERGY * sum(g.n_rays for g in rays) / sum(g.n_rays for g in all_rays)
        other = self._at([_shift_lattice(grid) for grid in rays], pulse)
        out = {}
        for channel in dict.fromkeys(layer.channel for layer in self.layers):
            change = self._channel(other, channel) - self._channel(here, channel)
            out[channel] = _ratio_db(change, self._channel(whole, channel)) - 3.0 - db_from_power(share)
        return out

    def _at(self, rays: Sequence[LaunchGrid] | None, pulse: int) -> C64:
        """Profiles (n_layers, n_samples) of one pulse: surfaces with given rays; None: all, first ray subset."""
        batch = Batch(0, pulse, pulse + 1, together=self.interval > 1)
        return self.batches.trace(batch, rays).profiles[:, 0]


def strip(grid: LaunchGrid, frame: LaunchFrame, share: float = STRIP, place: float = 0.0) -> LaunchGrid:
    """Rays of a strip across the window, over all ranges, with tapers on both sides.

    Parameters
    ----------
    grid : whole lattice
    frame : launch plane of a lattice without one
    share : of the window's width
    place : of the strip's middle, from -1 at one end of the window to 1 at the other
    """
    half = 0.5 * share * (grid.half_x + grid.taper)
    middle = place * max(grid.half_x - 2.0 * half, 0.0)
    keep = np.abs(grid.x - np.float32(middle)) <= 2.0 * half
    counts = np.bincount(grid.level[keep], minlength=len(grid.every_level))
    first = np.cumsum([0, *counts[:-1]])
    levels = tuple(replace(level, first=int(n)) for level, n in zip(grid.levels, first, strict=False))
    # the taper is equally wide on both axes: over range it ends where the window's does
    half_y = max(grid.half_y + grid.taper - half, 0.0)
    frame = grid.frame or frame
    return replace(
        grid,
        x=grid.x[keep] - np.float32(middle),
        y=grid.y[keep],
        half_x=half,
        half_y=half_y,
        taper=half,
        levels=levels,
        frame=replace(frame, center=frame.center + middle * frame.axis_x),
    )


def _shift_lattice(grid: LaunchGrid) -> LaunchGrid:
    """Lattice shifted by half the diagonal of its cell, each level by half its diagonal."""
    spacing = np.array([level.spacing for level in grid.every_level], dtype=np.float32)
    half = np.float32(0.5 * np.sqrt(2.0)) * spacing[grid.level]
    angle = grid.turn + 0.25 * np.pi
    return replace(
        grid, x=grid.x + half * np.float32(np.cos(angle)), y=grid.y + half * np.float32(np.sin(angle))
    )


def _mean_over_change_db(growth: float) -> float:
    """Mean error over a block, up to half its length from the key pulse, over the change between key pulses, dB."""
    return db_from_power(float(0.5**growth / (1.0 + growth)))


def _ratio_db(error: C64, signal: C64) -> float:
    """Ratio of the energies of error and signal, dB; -inf where there is no signal."""
    return _relative_db(sum_energy(error), sum_energy(signal))


def _relative_db(energy: float, reference: float) -> float:
    return db_from_power(energy / reference) if energy > 0.0 and reference > 0.0 else -np.inf
