"""What an effect changes and takes in one scene: blocks of pulses traced with the effect and without it.

The energy of the echoes' change over that of the echoes is that of the image's change over that of the image, summed
over the aperture: focusing keeps energies. Bright lines and glints count with all they have, which patches of a pilot
rarely meet; blocks hold the pulses around a key pulse, so that a glint counts as long as it lasts.
"""

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.effects.effect import Decision, Effect, effects
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.errors import SarmitsubaError
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.batches import Batch, Bench
from sarmitsuba.simulation.blocks import partition
from sarmitsuba.simulation.run import Run
from sarmitsuba.timing import Clock

# blocks spread over the aperture that are traced both ways, and most pulses of one
PLACES, LONGEST = 5, 256
# rays of what is traced both ways, all effects together, up to which effects are tried
MOST_RAYS = 100_000_000
# rounds of the timing of the block in the middle, with an effect and without it, in turn; the least of each counts
ROUNDS = 2


class _Echoes:
    """Some blocks of pulses of a run, traced by one set of its rays.

    Parameters
    ----------
    run : made ready
    blocks : first pulse of each, and the one after its last
    clock : of ``seconds`` and ``setup``

    Attributes
    ----------
    profiles : (n_channels, n_pulses, n_samples) complex64, all bounce orders summed
    setup : of what the run does once before it traces: lattices, draws of sources, s
    seconds : of the block in the middle, least of the rounds, s
    rays : of one block
    """

    def __init__(self, run: Run, blocks: Sequence[tuple[int, int]], clock: Clock) -> None:
        assert run.sampling is not None
        self.blocks, self.clock, self.seconds = tuple(blocks), clock, np.inf
        start = clock()
        rays = run.rays(run.sampling, 0)
        tracer = run.tracer(run.sampling)
        self.setup = clock() - start
        self.rays = sum(grid.n_rays for grid in rays.at(self.blocks[0][0])[0])
        self._bench = Bench(tracer, rays, run.layers.per_subset, run.layers.max_order)
        channels = run.layers.channels
        profiles = np.concatenate([self._one(block) for block in self.blocks], axis=1)  # also compiles
        self.profiles = profiles.reshape(-1, len(channels), *profiles.shape[1:]).sum(axis=0)

    def again(self) -> None:
        """Another round of the timing."""
        start = self.clock()
        self._one(self.blocks[len(self.blocks) // 2])
        self.seconds = min(self.seconds, self.clock() - start)

    def _one(self, block: tuple[int, int]) -> NDArray[np.complex64]:
        return self._bench.trace(Batch(0, *block, together=True)).profiles


def measured_both_ways(
    run: Run, loaded: Scene, keys: int, *, clock: Clock = time.process_time
) -> EffectsPlan:
    """The plan with what effects change and take, as far as blocks of pulses traced both ways can tell.

    Parameters
    ----------
    run : made ready, its plan decided by itself
    loaded : its scene, as loaded
    keys : key pulses of the whole run; what the cost is a share of
    clock : what the cost is counted in; processor seconds of all threads, which other programs disturb least

    Notes
    -----
    Ignores what only pulses between the blocks see, and what changes within a block. What is proven to change
    nothing is not tried, nor what other than the tracing shows (:attr:`Effect.at_key_pulses`).
    """
    plan = run.plan
    if run.context is None or run.sampling is None or loaded.settings.method == "raster":
        return plan
    blocks = _blocks(run.scene.radar.track.n_pulses, keys, run.sampling.block_length(LONGEST))
    keys *= len(run.layers.subsets)
    base = _Echoes(run, blocks, clock)
    left = MOST_RAYS
    for effect in effects():
        decision = plan.decision(effect.name)
        if decision is None or not _worth_trying(effect, decision) or left < 0:
            continue
        try:
            other = run.otherwise(switched(loaded, decision))
            if other.sampling is None or other.layers.channels != run.layers.channels:
                continue
            way = _Echoes(other, blocks, clock)
        except SarmitsubaError:  # nothing would be left that returns
            continue
        for _ in range(ROUNDS):
            base.again()
            way.again()
        left -= (len(blocks) + ROUNDS) * way.rays + ROUNDS * base.rays
        plan = plan.with_measured(
            effect.name, _change_db(way.profiles, base.profiles), _share(decision, base, way, keys)
        )
    return plan


def _blocks(n_pulses: int, keys: int, fitting: int) -> list[tuple[int, int]]:
    """First pulses and ends of blocks spread over the aperture: those of the run, or no longer than fits the track."""
    length = max(1, min(-(-n_pulses // keys), fitting) if keys < n_pulses else min(fitting, LONGEST))
    blocks = partition(n_pulses, length)
    number = min(PLACES, len(blocks))
    return [blocks[int((i + 0.5) * len(blocks) / number)] for i in range(number)]


def _worth_trying(effect: Effect, decision: Decision) -> bool:
    """Whether blocks traced both ways can tell anything of an effect."""
    if not effect.at_key_pulses or decision.error_db == -np.inf:
        return False
    return bool(effect.documentation) or effect.name == "max_depth"


def switched(loaded: Scene, decision: Decision) -> Scene:
    """The scene with an effect the other way; bounces: without the last, or with the second."""
    settings = loaded.settings
    if decision.name == "max_depth":
        depth = decision.value or 1
        return replace(loaded, settings=replace(settings, max_depth=depth - 1 if depth > 1 else 2))
    switch: Literal["on", "off"] = "off" if decision.on else "on"
    switches = {**settings.effects, decision.name: switch}
    return replace(loaded, settings=replace(settings, effects=switches))


def _change_db(other: NDArray[np.complex64], base: NDArray[np.complex64]) -> float:
    """Energy of the change over that of the echoes, worst channel, dB."""
    change, energy = (np.square(np.abs(x)).sum(axis=(1, 2), dtype=np.float64) for x in (other - base, base))
    if not change.any():
        return -np.inf
    return float(10.0 * np.log10(np.max(change / np.maximum(energy, 1e-300))))


def _share(decision: Decision, base: _Echoes, way: _Echoes, keys: int) -> float:
    """Share of the simulation that an effect takes, or would take."""
    here, there = (x.setup + x.seconds * keys for x in (base, way))
    with_it, without = (here, there) if decision.on else (there, here)
    return max(0.0, 1.0 - without / with_it)


__all__ = ["measured_both_ways", "switched"]
