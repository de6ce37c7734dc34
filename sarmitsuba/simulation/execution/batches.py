"""Batches of pulses of a run, which can be traced independently of each other in any process."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from sarmitsuba.core.arrays import C64
from sarmitsuba.core.timing import StageTimer
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.raw.sub_bands import RangeFilter
from sarmitsuba.simulation.execution.layers import LayerPlan
from sarmitsuba.simulation.execution.pulses import EveryPulse, KeyPulse, Pulses
from sarmitsuba.simulation.execution.statistics import TraceStatistics
from sarmitsuba.simulation.execution.tracing import MAX_GRID_BYTES, MAX_LANES, Tracer
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.planning.sampling.rays import Rays
from sarmitsuba.tracing.kernel.accumulators import GridAccumulator
from sarmitsuba.tracing.kernel.launch import LaunchGrid
from sarmitsuba.tracing.kernel.scene_tables import TraceScene, build_trace_scene
from sarmitsuba.tracing.kernel.source import Part
from sarmitsuba.tracing.scatterers.sources import passages_of

# positions of each antenna along the aperture, or a few more, from which corners of metal facets may be seen
APERTURE = 32


@dataclass(frozen=True)
class Batch:
    """Pulses that are traced together.

    Parameters
    ----------
    subset : index of the ray subset
    start, stop : pulses
    together : whether they share one tracing, of their key pulse; else every pulse is traced
    """

    subset: int
    start: int
    stop: int
    together: bool


@dataclass(frozen=True, eq=False)
class Traced:
    """Result of one batch.

    Parameters
    ----------
    batch : pulses and ray subset
    profiles : (layers of a subset, n_pulses, n_samples) complex64, not yet weighted by the subset's share
    statistics : of the tracing
    grid_bytes : of the largest accumulator grid so far in the process that traced it
    """

    batch: Batch
    profiles: C64
    statistics: TraceStatistics
    grid_bytes: int


class BatchTracer:
    """Tracing of batches of a run.

    Parameters
    ----------
    tracer : of the run
    rays : lattices of every ray subset
    n_layers : layers of one subset
    max_order : highest bounce order kept separately; 0 where all are summed
    """

    def __init__(self, tracer: Tracer, rays: Rays, n_layers: int, max_order: int) -> None:
        self.tracer, self.rays, self.n_layers, self.max_order = tracer, rays, n_layers, max_order

    def trace(
        self, batch: Batch, lattices: Sequence[LaunchGrid] | None = None, *, only_rays: bool = True
    ) -> Traced:
        """Trace one batch.

        Parameters
        ----------
        batch : pulses and ray subset
        lattices : other rays than those of the subset
        only_rays : with other rays: without the echoes of scatterers at known positions, which do not depend on them
        """
        only_rays = only_rays and lattices is not None
        if lattices is None:
            middle = batch.start + (batch.stop - batch.start) // 2
            lattices = self.rays.at(middle if batch.together else batch.start)[batch.subset]
        n_pulses = 1 if batch.together else batch.stop - batch.start

        def wanted(part: Part, *, every_pulse: bool) -> bool:
            return part.every_pulse == every_pulse and (part.rays > 0 or not only_rays)

        if batch.together:
            block = KeyPulse(self.tracer.sampling, batch.start, batch.stop)
            profiles, statistics = self._profiles(block, lattices, partial(wanted, every_pulse=False))
            if any(wanted(launch.part, every_pulse=True) for launch in self.tracer.launches(lattices, 1)):
                step = self.pulses_per_launch(0)
                for start in range(batch.start, batch.stop, step):
                    stop = min(start + step, batch.stop)
                    pulses = EveryPulse(self.tracer.sampling, start, stop)
                    apart, more = self._profiles(pulses, lattices, partial(wanted, every_pulse=True))
                    profiles[:, start - batch.start : stop - batch.start] += apart
                    statistics = statistics.plus(more)
        else:
            pulses = EveryPulse(self.tracer.sampling, batch.start, batch.stop)
            profiles, statistics = self._profiles(
                pulses, lattices, lambda part: part.rays > 0 or not only_rays
            )
        # the subsets after the first have the same pulses
        statistics = replace(statistics, key_pulses=0 if batch.subset else n_pulses)
        return Traced(batch, profiles, statistics, self.tracer.largest_grid)

    def pulses_per_launch(self, n_rays: int) -> int:
        """Pulses of one launch that traces every pulse, as many as memory allows."""
        row = self.n_layers * 2 * self.tracer.sampling.scene.radar.window.n_samples * 2 * 16
        return self.tracer.most_pulses or int(max(1, min(MAX_LANES // max(n_rays, 1), MAX_GRID_BYTES // row)))

    @property
    def amplitudes(self) -> int:
        """Complex numbers of an echo: its channels."""
        return len(self.tracer.sampling.scene.radar.channels)

    def of_grid(self, pulses: Pulses, grid: C64, share: RangeFilter | None) -> C64:
        """Profiles of a filled grid at one frequency, with its share of the band."""
        return pulses.profiles(grid, share)

    def accumulator(self, pulses: Pulses, share: RangeFilter | None) -> GridAccumulator:
        """Empty grid for the echoes of pulses at one frequency, with its share of the band."""
        tracer, wavelength = self.tracer, self.tracer.sampling.scene.radar.waveform.wavelength
        found = pulses.accumulator(
            max(1, self.max_order), self.amplitudes, self.max_order, wavelength, tracer.largest_grid
        )
        tracer.largest_grid = max(tracer.largest_grid, found.n_bytes)
        return found

    def finished(self, pulses: Pulses, accumulator: GridAccumulator, share: RangeFilter | None) -> C64:
        """Profiles of a filled accumulator at one frequency."""
        return self.of_grid(pulses, accumulator.grid(), share)

    def _profiles(
        self, pulses: Pulses, lattices: Sequence[LaunchGrid], wanted: Callable[[Part], bool]
    ) -> tuple[C64, TraceStatistics]:
        """Profiles of the wanted launches, over the band."""
        tracer, radar, states = self.tracer, self.tracer.sampling.scene.radar, pulses.states
        serving = [grid for grid in lattices if grid.serves(states.pick.start)]
        tracer.pose(radar.track.time[states.pick])
        profiles: C64 | None = None
        statistics = TraceStatistics()
        for at_frequency, share in tracer.over_band():
            accumulator = self.accumulator(pulses, share)
            accumulator.watch(radar.window.start_range[states.pick], radar.window.extent)
            # no lattice: no edge moves before anything that these pulses light
            for launch in at_frequency.launches(serving, states.n_pulses) if serving else ():
                if wanted(launch.part):
                    done = at_frequency.launch(launch, states, accumulator, pulses.each)
                    statistics = statistics.plus(replace(done, key_pulses=0))
            part = self.finished(pulses, accumulator, share)
            profiles = part if profiles is None else profiles + part
            tracer.timer.lap("synthesise")
        assert profiles is not None
        return profiles, statistics


@dataclass(frozen=True, eq=False)
class TraceJob:
    """Input for another process to trace batches of a run; can be pickled.

    All decisions (effects, sampling, blocks) are those of the run, so that the result does not depend on the process.

    Parameters
    ----------
    scene : whose geometry is traced
    sampling : plan of the run
    layers : channels, orders and subsets that are kept separately
    max_depth : most bounces
    pass_index : of the run's rays
    sub_bands : number of frequencies that the band is traced at
    """

    scene: Scene
    sampling: SamplingPlan
    layers: LayerPlan
    max_depth: int
    pass_index: int
    sub_bands: int = 1

    def tracer(self) -> BatchTracer:
        """Tracer with the geometry built on this process's device; the back end must be started."""
        trace_scene = build_geometry(self.scene)
        flags, timer = self.sampling.flags, StageTimer()
        tracer = Tracer(self.sampling, flags, trace_scene, self.max_depth, timer, self.sub_bands)
        rays = Rays(self.sampling, trace_scene, self.layers.subsets, self.pass_index, self.max_depth)
        return BatchTracer(tracer, rays, self.layers.per_subset, self.layers.max_order)


class Workers(Protocol):
    """Workers: processes that trace batches."""

    @property
    def n_workers(self) -> int:
        """Current number of workers."""
        ...

    def trace(self, job: TraceJob, batches: Sequence[Batch]) -> Iterator[Traced]:
        """Trace batches in any order; each is returned exactly once, even if a worker fails."""
        ...


def build_geometry(scene: Scene) -> TraceScene:
    """Geometry of a scene on the device."""
    wavelength, antenna = scene.radar.waveform.wavelength, scene.radar.track.center_position
    geometry, materials, seed = scene.geometry, scene.materials, scene.settings.seed
    tracks = scene.radar.tracks
    aperture = np.concatenate([t.position[:: max(1, t.n_pulses // APERTURE)] for t in tracks])
    made = build_trace_scene(geometry, materials, wavelength, antenna, scene.source_places, seed, aperture)
    return replace(made, passages=passages_of(scene))
