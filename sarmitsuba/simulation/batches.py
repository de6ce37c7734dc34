"""What tracing of a run is cut into: batches of pulses that need nothing of each other, wherever they are traced."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.echo.block import plan_block
from sarmitsuba.scene.lines import line_ends
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.layers import LayerPlan
from sarmitsuba.simulation.sampling.plan import SamplingPlan
from sarmitsuba.simulation.sampling.rays import Rays
from sarmitsuba.simulation.sources.kind import passages_of
from sarmitsuba.simulation.statistics import TraceStatistics
from sarmitsuba.simulation.tracing import Tracer
from sarmitsuba.timing import StageTimer
from sarmitsuba.trace.geometry import TraceScene, build_trace_scene
from sarmitsuba.trace.launch import LaunchGrid

C64 = NDArray[np.complex64]


@dataclass(frozen=True)
class Batch:
    """Pulses that are traced in one go.

    Parameters
    ----------
    subset : index of the ray subset
    start, stop : pulses
    together : as a block, from its key pulse; else every pulse is traced
    """

    subset: int
    start: int
    stop: int
    together: bool


@dataclass(frozen=True, eq=False)
class Traced:
    """What a batch came to.

    Parameters
    ----------
    batch : which
    profiles : (layers of a subset, n_pulses, n_samples) complex64, not weighted by the subset's share yet
    statistics : what was done
    grid_bytes : of the largest accumulator grid so far where it was traced
    """

    batch: Batch
    profiles: C64
    statistics: TraceStatistics
    grid_bytes: int


class Bench:
    """Where batches of a run are traced.

    Parameters
    ----------
    tracer : of the run
    rays : lattices of every ray subset
    n_layers : layers of one subset
    max_order : highest bounce order that is kept apart; 0 where all are summed
    """

    def __init__(self, tracer: Tracer, rays: Rays, n_layers: int, max_order: int) -> None:
        self.tracer, self.rays, self.n_layers, self.max_order = tracer, rays, n_layers, max_order

    def trace(self, batch: Batch) -> Traced:
        """Trace one batch."""
        start, stop = batch.start, batch.stop
        if batch.together:
            lattices = self.rays.at(start + (stop - start) // 2)[batch.subset]
            profiles, stats = self.block(lattices, start, stop)
        else:
            lattices = self.rays.at(start)[batch.subset]
            profiles, stats = self.tracer.direct(lattices, start, stop, self.n_layers, self.max_order)
        if batch.subset:  # the pulses of the first subset again
            stats = replace(stats, key_pulses=0)
        return Traced(batch, profiles, stats, self.tracer.largest_grid)

    def block(self, rays: Sequence[LaunchGrid], start: int, stop: int) -> tuple[C64, TraceStatistics]:
        """Trace the pulses ``start:stop`` from their key pulse, with any rays."""
        sampling = self.tracer.sampling
        plan = plan_block(
            sampling.scene.radar,
            start,
            stop,
            sampling.window.center,
            sampling.phase_box,
            sampling.scene.settings.gridding_width,
            extra_slant_range=sampling.extra_slant_range,
            extra_range_rate=sampling.extra_range_rate,
        )
        return self.tracer.block(rays, plan, self.n_layers, self.max_order)


@dataclass(frozen=True, eq=False)
class TraceJob:
    """All that another process needs to trace batches of a run as the run's own would; it can be pickled.

    Every decision is the run's: effects, sampling, blocks. So the bits do not depend on who traces.

    Parameters
    ----------
    scene : whose geometry is traced
    sampling : plan of the run
    layers : what is kept apart
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

    def bench(self) -> Bench:
        """Build the geometry on this process's device; the back end must be there."""
        trace_scene = built(self.scene)
        flags, timer = self.sampling.flags, StageTimer()
        tracer = Tracer(self.sampling, flags, trace_scene, self.max_depth, timer, self.sub_bands)
        rays = Rays(self.sampling, trace_scene, self.layers.subsets, self.pass_index)
        return Bench(tracer, rays, self.layers.per_subset, self.layers.max_order)


class Crew(Protocol):
    """Workers that trace batches in processes of their own."""

    @property
    def n_workers(self) -> int:
        """How many there are now."""
        ...

    def trace(self, job: TraceJob, batches: Sequence[Batch]) -> Iterator[Traced]:
        """Trace batches in any order; each comes back exactly once, whatever happens to a worker."""
        ...


def built(scene: Scene) -> TraceScene:
    """Geometry of a scene on the device."""
    wavelength, antenna = scene.radar.waveform.wavelength, scene.radar.track.center_position
    geometry, materials, seed = scene.geometry, scene.materials, scene.settings.seed
    places = np.concatenate([line_ends(scene.lines), *(volume.vertices for volume in scene.volumes)])
    made = build_trace_scene(geometry, materials, wavelength, antenna, places, seed)
    return replace(made, passages=passages_of(scene))


__all__ = ["Batch", "Bench", "Crew", "TraceJob", "Traced", "built"]
