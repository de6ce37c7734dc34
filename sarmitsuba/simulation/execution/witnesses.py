"""Witnesses of a run: errors of blocks of pulses, of bounces and of effects left out, measured on drawn pulses.

Each of them traces a few pulses again, the slow way, and compares their echoes: every pulse in place of its block, two
bounces more, the effects on that are off. They take a small share of the rays of the run. Where a whole pulse is more,
blocks are compared in strips of the launch window, and bounces and effects by fewer rays of the whole window.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.special import stdtrit

from sarmitsuba.core.arrays import C64, F64, sum_energies
from sarmitsuba.core.constants import EMPTY_DB, SUBSET_SHARES
from sarmitsuba.core.errors import SarmitsubaError, SarmitsubaWarning
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.core.witness import CONFIDENCE, Witness
from sarmitsuba.effects.effect import EFFECTS
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.signal.raw_data import sum_layers
from sarmitsuba.simulation.execution.blocks import BOUNDARY_SCATTER_DB, STRIP_ENERGY, Blocks, partition, strip
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.statistics import TraceStatistics
from sarmitsuba.simulation.execution.tracing import Batch, BatchTracer, Tracer
from sarmitsuba.simulation.planning.pilot import plan_in
from sarmitsuba.simulation.planning.prediction.counting import WITNESS_SHARE
from sarmitsuba.simulation.planning.sampling.rays import Rays

# rays that take as long as what a launch takes whatever its rays: recording, grid, synthesis
LAUNCH = 5e4
# rays of a run from which one sample is taken whatever it costs: then at most a few per cent
SHORT = 4e6
# pulses or blocks traced again, at most; pulses against which blocks are held at least: one alone tells little
MOST, FEWEST = 8, 3
# least and largest share of the window in a strip, and rays of a pulse up to which no strip is taken: in one a few rays
# wide its edges are most of the error
LEAST_STRIP, WIDEST_STRIP, WHOLE = 0.1, 0.3, 3e5
# pulses before and after a key pulse at which bounces and effects are compared: echoes of several interfere
AROUND = 8
# rays that may have been missed where none was met, with 95 %: upper limit of a Poisson count of none
UNMET = 3.0
# bounces beyond the last
DEEPER = 2
# factor by which rays are farther apart at most: on flat facets the tubes of four times the spacing still tile the
# surface (share of later bounces in a street block -4.7 dB, with all rays -4.3; at six times the spacing -3.1)
SPARSEST = 4.0
# rays and contributions of a run from which effects left out are traced: their kernels have to be compiled
LONG = 2e8
# error from which on a contradicted law is worth a warning, dB: below it no picture shows it
SHOWS_DB = -20.0
# standard normal quantile of the confidence of a witness
_QUANTILE = 1.645

Switch = Literal["on", "off"]


@dataclass(frozen=True)
class Allowance:
    """Rays that one witness of a run may take; contributions count as rays.

    Parameters
    ----------
    pulse : of a key pulse in the run, all ray subsets
    subsets : number of ray subsets
    allowed : of one witness
    least : number of samples taken in any case: one where error bars are wanted, and in runs that are not short
    """

    pulse: float
    subsets: int
    allowed: float
    least: int

    @staticmethod
    def of(statistics: TraceStatistics, subsets: int) -> Allowance:
        """Allowance of a traced run with so many ray subsets."""
        total = float(statistics.rays + statistics.contributions)
        each = max(total / max(statistics.key_pulses, 1), 1.0)
        wanted = subsets > 1
        return Allowance(each, subsets, WITNESS_SHARE * total, int(wanted or total >= SHORT))

    def samples(self, each: float) -> int:
        """Number of samples that may be taken at a price of ``each`` rays."""
        return int(np.clip(self.allowed / each, self.least, MOST))


def block_witness(run: Run, blocks: Blocks, allowance: Allowance) -> Witness | None:
    """Error of blocks of pulses against tracing every pulse, at drawn pulses; None where every pulse is traced.

    Parameters
    ----------
    run : traced
    blocks : traced, not yet weighted by the shares of the ray subsets

    Notes
    -----
    Pulses are drawn half evenly along the track and half by their energy, and weighted by the inverse. Strips
    are tapered, and leave out echoes of scatterers at known positions. Unlike the change where blocks meet, errors
    alike on both sides are seen, too. The error is relative to the echoes of the whole track; that in a strip, to its
    share of the window or of the echoes, whichever is larger: a strip where nothing lies tells little.
    """
    if blocks.interval == 1:
        return None
    rng = np.random.default_rng([run.scene.settings.seed & 0x7FFFFFFF, 0xB10C])
    launches = LAUNCH * allowance.subsets
    whole, part = allowance.pulse + launches, 2.0 * (LEAST_STRIP * allowance.pulse + launches)
    share, n = 1.0, max(allowance.samples(whole), FEWEST * allowance.least)
    if allowance.allowed < whole and allowance.pulse > WHOLE:
        n = max(allowance.samples(part), FEWEST * allowance.least)
        affordable = 0.5 * allowance.allowed / max(n, 1) - launches
        share = float(np.clip(affordable / allowance.pulse, LEAST_STRIP, WIDEST_STRIP))
    energy = blocks.energy_of_pulses()
    mean = energy.mean(axis=0)
    chance = _chance_of_pulses(blocks, energy)
    errors, energies = [], []
    for pulse in _drawn_pulses(chance, n, rng):
        start, stop = next(block for block in blocks.blocks if pulse < block[1])
        place = float(rng.uniform(-1.0, 1.0))
        sets = [
            _trace_subset(blocks, subset, (start, stop), pulse, share, place)
            for subset in range(allowance.subsets)
        ]
        shared, exact = (np.sum(planes, axis=0) for planes in zip(*sets, strict=True))
        weight = 1.0 / (chance.size * chance[pulse])
        errors.append(weight * sum_energies(shared[:, pulse - start] - exact))
        if share < 1.0:
            of_strip = weight * sum_energies(shared) / (stop - start)
            energies.append(np.maximum(of_strip, mean * (STRIP_ENERGY * share / (1.0 - share))))
        else:
            energies.append(mean)
    if not errors:
        return None
    strips = f" in strips of {100.0 * share:.0f} % of the window" if share < 1.0 else ""
    reference = f"every pulse traced, at {len(errors)} drawn pulses{strips}"
    every = np.array(errors), np.array(energies)
    found = _worst(*every, blocks.error_db, reference)
    if found is None:
        return None
    boundaries = max(len(blocks.blocks) - 1, 0)
    if share == 1.0:
        return _combine_boundaries(found, boundaries, float(found.samples), _certain(found))
    counted = mean > power_from_db(EMPTY_DB) * mean.max()
    of_channels = every[0][:, counted], every[1][:, counted]
    covered = float(np.minimum(of_channels[1] / mean[counted], 1.0).sum(axis=0).min())
    return _combine_boundaries(found, boundaries, covered, replace(found, error_db=_least_db(*of_channels)))


def _least_db(errors: F64, energies: F64) -> float:
    """Level that the error exceeds with 95 %, worst channel, dB, by the scatter from strip to strip (n, n_channels)."""
    n, whole = len(errors), np.maximum(energies.mean(axis=0), 1e-300)
    if n < 2:
        return -math.inf
    apart = (errors - errors.mean(axis=0) / whole * energies).std(axis=0, ddof=1) / math.sqrt(n)
    least = (errors.mean(axis=0) - stdtrit(n - 1, CONFIDENCE) * apart) / whole
    return db_from_power(max(float(least.max()), 1e-300))


def _combine_boundaries(found: Witness, boundaries: int, covered: float, certain: Witness) -> Witness:
    """Mean of the errors at drawn pulses and where blocks meet; at drawn pulses alone where these contradict it.

    Where blocks meet, errors that are alike on both sides do not show; but there are more of these places.

    Parameters
    ----------
    found : at drawn pulses
    boundaries : number of places where blocks meet
    covered : number of pulses that the drawn ones count as: a strip counts as its share
    certain : at the level that the error of the drawn ones exceeds with 95 %
    """
    if not boundaries or certain.contradicts:
        return found
    n = covered + boundaries
    # the figure of the boundaries bears their scatter already
    meeting_db = found.law_db - BOUNDARY_SCATTER_DB / math.sqrt(boundaries)
    drawn, meeting = (power_from_db(level) for level in (found.error_db, meeting_db))
    error_db = db_from_power((covered * drawn + boundaries * meeting) / n + 1e-30)
    upper_db = error_db + _QUANTILE * BOUNDARY_SCATTER_DB / math.sqrt(n)
    reference = f"{found.reference}, and where blocks meet"
    samples = found.samples + boundaries
    return replace(found, error_db=error_db, upper_db=upper_db, samples=samples, reference=reference)


def _certain(found: Witness) -> Witness:
    """The witness at the level that its error exceeds with 95 %, by the scatter from place to place."""
    return replace(
        found, error_db=found.error_db - _QUANTILE * BOUNDARY_SCATTER_DB / math.sqrt(found.samples)
    )


def _trace_subset(
    blocks: Blocks, subset: int, block: tuple[int, int], pulse: int, share: float, place: float
) -> tuple[C64, C64]:
    """Echoes (n_channels, ...) of a block, and of one of its pulses traced by itself, of one weighted ray subset.

    Parameters
    ----------
    share, place : of the strip, see :func:`sarmitsuba.simulation.execution.blocks.strip`; a share of 1: all rays
    """
    start, stop = block
    pick = blocks.layers_of(subset)
    layers = blocks.layers[pick]
    shared, rays = blocks.data[pick, start:stop], None
    if share < 1.0:
        frame = blocks.tracer.sampling.window.frame
        lattices = blocks.rays.at(start + (stop - start) // 2)[subset]
        rays = [grid for grid in (strip(each, frame, share, place) for each in lattices) if grid.n_rays]
        shared = blocks.batches.trace(Batch(subset, start, stop, together=True), rays).profiles
    exact = blocks.batches.trace(Batch(subset, pulse, pulse + 1, together=True), rays).profiles[:, 0]
    weight = np.float32(SUBSET_SHARES[layers[0].subset])
    return sum_layers(shared, layers) * weight, sum_layers(exact, layers) * weight


def _chance_of_pulses(blocks: Blocks, energy: F64) -> F64:
    """Chance (n_pulses,) of each pulse: half evenly, half by energy; none of key pulses, which do not err."""
    share = energy / np.maximum(energy.sum(axis=0), 1e-300)
    chance = 0.5 / len(energy) + 0.5 * share.mean(axis=1)
    chance[[start + (stop - start) // 2 for start, stop in blocks.blocks if stop - start > 1]] = 0.0
    return np.asarray(chance / chance.sum())


def _drawn_pulses(chance: F64, n: int, rng: np.random.Generator) -> list[int]:
    """Pulses drawn with these chances (n_pulses,), spread along the track."""
    places = (np.arange(n) + rng.random(n)) / n
    found = np.searchsorted(np.cumsum(chance), places, side="right")
    return [int(pulse) for pulse in np.minimum(found, chance.size - 1) if chance[pulse] > 0.0]


def bounce_witness(run: Run, tracer: Tracer, data: C64, allowance: Allowance) -> Witness | None:
    """Energy of bounces beyond the last that is followed, from ``DEEPER`` more at drawn pulses.

    None where one bounce is proven to be all, or where the kernel of several would have to be compiled for it.

    Parameters
    ----------
    run, tracer : of the traced run
    data : (n_layers, n_pulses, n_samples) complex64, its echoes; ray subsets are weighted

    Notes
    -----
    Bounces beyond these are left out, and in long runs the mirrored echoes of scatterers at known positions.
    """
    decision = run.plan.decision("max_depth")
    if run.context is None or (decision is not None and decision.error_db == -np.inf):
        return None
    depth, flags = run.plan.max_depth + DEEPER, tracer.flags
    if not flags.multi_bounce:
        if decision is not None and decision.source != "user":
            return None
        scene = run.context.scene
        deeper = replace(scene, settings=replace(scene.settings, max_depth=depth))
        plan = plan_in(replace(run.context, scene=deeper), warn=False)
        flags = replace(
            flags, multi_bounce=True, diffuse_double=flags.diffuse_double or plan.flags.diffuse_double
        )
    law = (run.plan.pilot.get("energy_from_order_upper_db") or [])[run.plan.max_depth :]
    law_db = math.nan if not law or law[0] is None else float(law[0])
    only_rays = allowance.pulse > WHOLE
    found = _compare(run, data, (tracer, _deeper(tracer, flags, depth)), allowance, only_rays=only_rays)
    if found is None:
        return None
    return replace(
        found,
        upper_db=min(found.upper_db, max(found.error_db, 0.0)),  # what is left out is at most all
        law_db=law_db,
        reference=f"{DEEPER} more bounces, {found.reference}",
    )


def _deeper(tracer: Tracer, flags: KernelFlags, depth: int) -> Tracer:
    """Tracer of the same sources with more bounces."""
    other = copy(tracer)
    other.flags = flags
    other.kernel = replace(tracer.kernel, max_depth=depth)
    own = {id(t): _deeper(t, flags, depth) for t in tracer.by_frequency if t is not tracer}
    other.by_frequency = tuple(own.get(id(t), other) for t in tracer.by_frequency)
    return other


def effect_witness(run: Run, tracer: Tracer, data: C64, allowance: Allowance) -> Witness | None:
    """Energy of the change by all effects that are off, on at drawn pulses; None in short runs, and where none is off.

    Notes
    -----
    Effects on focusing, channels or the receiver do not show in the echoes of single pulses, and are not tried; nor are
    effects that the user has switched off.
    """
    if run.context is None or run.statistics.rays + run.statistics.contributions < LONG:
        return None
    tried = [
        d
        for d in run.plan.decisions
        if not d.on and not d.error_db == -np.inf and d.source != "user" and EFFECTS[d.name].at_key_pulses
    ]
    tried = [d for d in tried if d.name != "max_depth" and EFFECTS[d.name].documentation]
    if not tried:
        return None
    scene = run.context.scene
    on: dict[str, Switch] = {d.name: "on" for d in tried}
    switched = replace(scene, settings=replace(scene.settings, effects={**scene.settings.effects, **on}))
    try:
        other = run.otherwise(switched)
        if other.sampling is None or other.layers.channels != run.layers.channels:
            return None
        found = _compare(run, data, (tracer, other.tracer(other.sampling)), allowance, only_rays=False)
    except SarmitsubaError:  # somewhere it cannot be on
        return None
    names = ", ".join(d.name for d in tried)
    law_db = db_from_power(np.nansum([power_from_db(d.error_db) for d in tried]))
    return found and replace(found, law_db=law_db, reference=f"{names} on, {found.reference}")


def _compare(
    run: Run, data: C64, ways: tuple[Tracer, Tracer], allowance: Allowance, *, only_rays: bool
) -> Witness | None:
    """Change of the echoes from one tracer to another in drawn blocks of pulses, relative to the changed data.

    Parameters
    ----------
    only_rays : without the echoes of scatterers at known positions

    Notes
    -----
    Rays are those of a plain lattice, without the finer ones over small parts, and farther apart where the allowance
    asks for it.
    """
    assert run.sampling is not None and run.trace_scene is not None
    rng = np.random.default_rng([run.scene.settings.seed & 0x7FFFFFFF, 0x0DE9])
    n = allowance.samples(2.0 * (allowance.pulse / SPARSEST**2 + LAUNCH))
    total = run.scene.radar.track.n_pulses
    blocks = partition(total, max(run.sampling.key_pulse_interval, 1))
    n = min(n, len(blocks))
    if n < 1:
        return None
    affordable = max(0.5 * allowance.allowed / n - LAUNCH, 1.0)
    factor = float(np.clip(math.sqrt(allowance.pulse / affordable), 1.0, SPARSEST))
    sampling = run.at(factor).sampling
    assert sampling is not None
    rays = Rays(sampling, run.trace_scene, (0,), 0, run.plan.max_depth)
    layers = run.layers.layers[: run.layers.per_subset]
    errors, energies, traced = [], [], 0
    for i in range(n):
        start, stop = blocks[int((i + rng.random()) * len(blocks) / n)]
        key = start + (stop - start) // 2
        start, stop = max(start, key - AROUND), min(stop, key + AROUND)
        lattices = [grid for grid in rays.plain[0] if grid.serves(key) and grid.n_rays]
        if not lattices:
            continue
        batch = Batch(0, start, stop, together=True)
        less, more = (
            sum_layers(
                BatchTracer(tracer, rays, run.layers.per_subset, run.layers.max_order)
                .trace(batch, lattices, only_rays=only_rays)
                .profiles,
                layers,
            )
            for tracer in ways
        )
        errors.append(sum_energies(more - less))
        energies.append(sum_energies(sum_layers(data[:, start:stop], run.layers.layers) + more - less))
        traced += sum(grid.n_rays for grid in lattices)
    if not errors:
        return None
    thinner = f", by rays {factor:.1f} times as far apart" if factor > 1.0 else ""
    reference = f"over {len(errors)} drawn block{'s' * (len(errors) > 1)} of pulses{thinner}"
    found = _worst(np.array(errors), np.array(energies), math.nan, reference)
    unseen = db_from_power(
        UNMET / max(traced, 1)
    )  # echoes of rays as bright as the mean that none of these met
    return found and replace(found, upper_db=max(found.upper_db, unseen))


def _worst(errors: F64, energies: F64, law_db: float, reference: str) -> Witness | None:
    """Witness of the channel with the largest error.

    Parameters
    ----------
    errors : (n, n_channels) at each drawn pulse
    energies : (n, n_channels) mean over the pulses around

    Notes
    -----
    The upper level is at least that of a scatter by ``BOUNDARY_SCATTER_DB`` from place to place.
    """
    n = len(errors)
    whole = energies.sum(axis=0)
    if not whole.any():
        return None
    found = []
    for k in np.flatnonzero(whole > power_from_db(EMPTY_DB) * whole.max()):
        each = Witness.from_weighted(errors[:, k], whole[k : k + 1], 0, law_db=law_db, reference=reference)
        upper = each.error_db + _QUANTILE * BOUNDARY_SCATTER_DB / math.sqrt(n)
        found.append(replace(each, upper_db=max(each.upper_db, upper)))
    return max(found, key=lambda each: each.error_db)


_REMEDIES = {
    "blocks": ("blocks of pulses", "set a shorter key_pulse_interval, or method raw"),
    "bounces": ("bounces left out", "set a larger max_depth, or auto"),
    "effects": ("effects left out", "switch them on; `explain` measures each of them"),
}


def contradictions(name: str, witnesses: Mapping[str, Witness], tolerance_db: float) -> list[str]:
    """Texts on the witnesses that contradict a law; each is issued as a warning.

    Errors below the tolerance or ``SHOWS_DB``, and those that few samples may show by chance, are left out: the
    account of the image marks them.
    """
    texts = []
    least = max(tolerance_db, SHOWS_DB)
    for stage, witness in witnesses.items():
        if stage in _REMEDIES and _certain(witness).contradicts and witness.error_db > least:
            cause, remedy = _REMEDIES[stage]
            texts.append(
                f"{name}: the error by {cause} is {witness.error_db:.1f} dB, measured in this run "
                f"({witness.samples}); a formula expected {witness.law_db:.1f} dB. The image states the measured one; "
                f"to lower it, {remedy}"
            )
    for text in texts:
        warnings.warn(text, SarmitsubaWarning, stacklevel=3)
    return texts
