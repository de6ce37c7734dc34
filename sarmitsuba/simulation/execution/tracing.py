"""Tracing of one scene: key pulse by key pulse, and the synthesis of the pulses around each.

Pulses are traced in batches, independently of each other and in any process. A batch has the antenna states at its
traced pulses, the grid of their echoes, and the range profiles computed from the grid.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.timing import StageTimer
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track_errors import turn_axes
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.block import BlockPlan, plan_block
from sarmitsuba.signal.block_synthesis import synthesise, synthesise_adjoint
from sarmitsuba.signal.direct import DirectPlan, finish, finish_adjoint, plan_direct
from sarmitsuba.signal.sub_bands import RangeFilter, SubBands
from sarmitsuba.simulation.execution.blame import blame_stages, check_traced, find_blame
from sarmitsuba.simulation.execution.layers import LayerPlan
from sarmitsuba.simulation.execution.recording import Recording
from sarmitsuba.simulation.execution.statistics import TraceStatistics
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.planning.sampling.rays import Rays
from sarmitsuba.simulation.planning.site import RunSite
from sarmitsuba.tracing.derivatives.path_derivatives import differentiate, record_beside
from sarmitsuba.tracing.derivatives.tangents import TangentPlan
from sarmitsuba.tracing.kernel.accumulators import BlockAccumulator, DirectAccumulator, GridAccumulator
from sarmitsuba.tracing.kernel.kernel import Accumulator, KernelSettings
from sarmitsuba.tracing.kernel.launch import LaunchFrame, LaunchGrid, PulseBatch
from sarmitsuba.tracing.kernel.scene_tables import TraceScene, build_trace_scene
from sarmitsuba.tracing.kernel.source import Launch, Part, Source, launches
from sarmitsuba.tracing.kernel.state import Kernel
from sarmitsuba.tracing.kernel.surfaces import Surfaces
from sarmitsuba.tracing.kernel.tubes.polygon import INNER_UP_TO
from sarmitsuba.tracing.scatterers.sources import passages_of, sources_of

# step of the derivative by the azimuth angle of the beam, over the half-power half-width
AZIMUTH_STEP = 0.01


@dataclass(frozen=True, eq=False)
class AntennaStates:
    """Positions and velocities of the antennas at the pulses of a launch.

    Parameters
    ----------
    position, velocity : (n, 3) float64, m and m/s, scene frame, of the transmitting antenna
    pick : pulses whose pointing applies
    receiver : position and velocity of a separate receiving antenna; None: one antenna transmits and receives
    """

    position: F64
    velocity: F64
    pick: slice
    receiver: tuple[F64, F64] | None = None

    @classmethod
    def on_tracks(cls, radar: Radar, pick: slice) -> "AntennaStates":
        """States on the flown tracks at some pulses."""
        apart = radar.receiver
        receiver = None if apart is None else (apart.position[pick], apart.velocity[pick])
        return cls(radar.track.position[pick], radar.track.velocity[pick], pick, receiver)

    @property
    def n_pulses(self) -> int:
        """Number of pulses of the launch."""
        return len(self.position)


class Pulses(ABC):
    """Pulses of one batch.

    Attributes
    ----------
    states : of the antennas, at the traced pulses
    each : number of pulses to which a traced path contributes
    plan : of the grid of their echoes
    """

    states: AntennaStates
    each: int
    plan: BlockPlan | DirectPlan

    @abstractmethod
    def accumulator(
        self, n_orders: int, n_channels: int, max_order: int, wavelength: float, least_bytes: int
    ) -> GridAccumulator:
        """Empty grid for the echoes; see :class:`GridAccumulator`."""

    @abstractmethod
    def profiles(self, grid: NDArray[np.complexfloating], share: RangeFilter | None) -> C64:
        """Range-compressed profiles (n_layers, n_pulses, n_samples) of a filled grid; ``share``: of the band."""

    @abstractmethod
    def adjoint(self, profiles: C64, share: RangeFilter | None) -> C64:
        """Adjoint of :meth:`profiles`: a grid from profiles."""


class KeyPulse(Pulses):
    """A block of pulses that share the tracing of one of them.

    Parameters
    ----------
    sampling : of the run
    start, stop : pulses of the block
    """

    def __init__(self, sampling: SamplingPlan, start: int, stop: int) -> None:
        scene = sampling.scene
        self.radar = scene.radar
        self.plan: BlockPlan = plan_block(
            self.radar,
            start,
            stop,
            sampling.window.center,
            sampling.phase_box,
            scene.settings.gridding_width,
            extra_slant_range=sampling.extra_slant_range,
            extra_range_rate=sampling.extra_range_rate,
        )
        position, velocity = self.plan.state.position, self.plan.state.velocity
        receiver = (position[1:], velocity[1:]) if len(position) > 1 else None
        pick = slice(self.plan.key, self.plan.key + 1)
        self.states = AntennaStates(position[:1], velocity[:1], pick, receiver)
        self.each = self.plan.n_pulses
        # the synthesis applies each pulse's azimuth pattern: the rays of the block carry the elevation pattern only
        self.beam = sampling.flags.antenna_pattern and sampling.azimuth_later

    def accumulator(
        self, n_orders: int, n_channels: int, max_order: int, wavelength: float, least_bytes: int
    ) -> BlockAccumulator:
        """See :class:`Pulses`."""
        return BlockAccumulator(self.plan, n_orders, n_channels, max_order, wavelength, least_bytes)

    def profiles(self, grid: NDArray[np.complexfloating], share: RangeFilter | None) -> C64:
        """See :class:`Pulses`."""
        return synthesise(grid, self.plan, self.radar, beam=self.beam, share=share)

    def adjoint(self, profiles: C64, share: RangeFilter | None) -> C64:
        """See :class:`Pulses`."""
        return synthesise_adjoint(profiles, self.plan, self.radar, beam=self.beam, share=share)

    def by_azimuth(self, grid: NDArray[np.complexfloating], share: RangeFilter | None) -> C64:
        """Derivative of :meth:`profiles` by the azimuth angle of the beam, per rad, where the synthesis applies it."""
        step = AZIMUTH_STEP / self.radar.antenna.per_width[0]
        ends = []
        for angle in (-step, step):
            angles = np.tile([angle, 0.0], (self.radar.track.n_pulses, 1))
            radar = replace(self.radar, pointing=turn_axes(self.radar.pointing, angles))
            ends.append(synthesise(grid, self.plan, radar, beam=True, share=share))
        return np.asarray((ends[1] - ends[0]) * np.float32(0.5 / step))


class EveryPulse(Pulses):
    """Pulses of one sector of the track, each of them traced, in one launch.

    Parameters
    ----------
    sampling : of the run
    start, stop : pulses, as many as memory allows
    """

    def __init__(self, sampling: SamplingPlan, start: int, stop: int) -> None:
        self.radar = sampling.scene.radar
        width = sampling.scene.settings.gridding_width
        self.plan: DirectPlan = plan_direct(
            self.radar, start, stop, sampling.phase_box, width, sampling.extra_slant_range
        )
        self.states = AntennaStates.on_tracks(self.radar, slice(start, stop))
        self.each = 1

    def accumulator(
        self, n_orders: int, n_channels: int, max_order: int, wavelength: float, least_bytes: int
    ) -> DirectAccumulator:
        """See :class:`Pulses`."""
        return DirectAccumulator(self.plan, n_orders, n_channels, max_order, wavelength, least_bytes)

    def profiles(self, grid: NDArray[np.complexfloating], share: RangeFilter | None) -> C64:
        """See :class:`Pulses`."""
        return finish(grid, self.plan, self.radar, share=share)

    def adjoint(self, profiles: C64, share: RangeFilter | None) -> C64:
        """See :class:`Pulses`."""
        return finish_adjoint(profiles, self.plan, self.radar, share=share)


# lanes of one launch; bounds the memory of a batch whatever the number of pulses
MAX_LANES = 8_000_000
# phase difference of neighbouring rays at the carrier up to which terms of common sides of tubes are kept, rad, where
# the band is traced at several frequencies at every pulse: the returns of edges and corners are right over the band,
# while these terms cancel exactly only at the traced frequencies. In a block of pulses edges and corners keep the
# amplitude of its key pulse: there the limit is that at the carrier
EVERY_PULSE_UP_TO = 0.5
# bytes of one accumulator grid; bounds the pulses of a direct batch
MAX_GRID_BYTES = 256_000_000


class Tracer:
    """Tracer of a scene: geometry, sources and settings common to all batches.

    Parameters
    ----------
    sampling : plan of the run
    flags : switches of the kernel
    trace_scene : geometry and materials on the device
    max_depth : most bounces
    timer : stages ``trace`` and ``synthesise`` are added to it
    sub_bands : number of frequencies that the band is traced at; 1: the carrier alone

    Attributes
    ----------
    largest_grid : bytes of the largest accumulator grid so far
    times : (n,) s, of the pulses of the next launch; None: as at time zero
    tangents : derivatives that are recorded behind the channels; None: none
    """

    def __init__(
        self,
        sampling: SamplingPlan,
        flags: KernelFlags,
        trace_scene: TraceScene,
        max_depth: int,
        timer: StageTimer,
        sub_bands: int = 1,
    ) -> None:
        self.sampling, self.flags, self.trace_scene, self.timer = sampling, flags, trace_scene, timer
        self.largest_grid = 0
        self.times: F64 | None = None
        self.tangents: TangentPlan | None = None
        # surfaces first, then scatterers at known positions
        self.sources: tuple[Source, ...] = (
            Surfaces(),
            *sources_of(RunSite(sampling, flags, trace_scene)),
        )
        timer.lap("launch grid")
        radar, center = sampling.scene.radar, sampling.window.center
        antenna = radar.track.center_position
        self.kernel = KernelSettings(
            wavelength=radar.waveform.wavelength,
            max_depth=max_depth,
            cell=sampling.scatterer_cell,
            seed=sampling.scene.settings.seed,
            amplitude=radar.amplitude_constant,
            reference_range=_reference_range(radar, center),
            up=polarisation_up(radar, center, antenna),
            days=sampling.scene.settings.pass_days,
        )
        wave = radar.waveform
        self.bands = SubBands(wave.center_frequency, wave.bandwidth, sub_bands)
        self.by_frequency = (self,) if sub_bands == 1 else tuple(self._at(f) for f in self.bands.frequencies)

    def _at(self, frequency: float) -> "Tracer":
        """Tracer with the same rays, positions and random numbers at another frequency, Hz."""
        other, wavelength = copy(self), SPEED_OF_LIGHT / frequency
        materials = tuple(m.at_frequency(frequency) for m in self.sampling.scene.materials)
        other.trace_scene = self.trace_scene.at_frequency(materials, wavelength)
        # the same sides of tubes are left out at all frequencies, so that terms which cancel do so also in between
        kept = INNER_UP_TO * frequency / self.bands.center_frequency
        other.kernel = replace(self.kernel, wavelength=wavelength, kept_up_to=kept)
        other.sources = tuple(source.at(wavelength) for source in self.sources)
        other.by_frequency = (other,)
        return other

    def use_timer(self, timer: StageTimer) -> None:
        """Use another timer for the stages, at every frequency."""
        for tracer in {self, *self.by_frequency}:
            tracer.timer = timer

    def of_term(self, term: int) -> "Tracer":
        """Tracer with one of the random numbers of every diffuse scatterer; see :class:`KernelSettings`."""
        other = copy(self)
        other.kernel = replace(self.kernel, term=term)
        own = {id(tracer): tracer.of_term(term) for tracer in self.by_frequency if tracer is not self}
        other.by_frequency = tuple(own.get(id(tracer), other) for tracer in self.by_frequency)
        return other

    @property
    def most_pulses(self) -> int | None:
        """Pulses that one launch may trace; None for any number."""
        return 1 if self.flags.motion else None

    def pose(self, time: F64) -> None:
        """Move all objects to their positions at the times of the next pulses, (n,) s; meshes to those at the first."""
        for tracer in {self, *self.by_frequency}:
            tracer.times = time
            if self.flags.motion:
                tracer.trace_scene = tracer.trace_scene.at(float(time[0]))

    def over_band(self) -> Iterator[tuple["Tracer", RangeFilter | None]]:
        """Tracer at every traced frequency of the band, with its share of the spectrum."""
        for i, tracer in enumerate(self.by_frequency):
            yield tracer, self.bands.range_filter(i)

    def launches(self, rays: Sequence[LaunchGrid], n_pulses: int) -> list[Launch]:
        """All launches of a batch of pulses with these lattices: surfaces, then scatterers at known positions."""
        return launches(self.sources, rays, n_pulses)

    def kernel_of(self, grid: LaunchGrid, states: AntennaStates, accumulator: Accumulator) -> Kernel:
        """Kernel of a launch; parameters as for :meth:`launch`."""
        flags, settings = self.flags, self.kernel
        frame = grid.frame or self.sampling.window.frame
        batch = pulse_batch(self.sampling.scene.radar, states, frame, patterned=flags.antenna_pattern)
        if flags.water_motion:
            batch = replace(batch, time=self.times)
        if isinstance(accumulator, BlockAccumulator) and self.sampling.azimuth_later:
            # the range rate of a moving object does not give its position in the beam: the rays carry the full pattern
            batch = batch.with_azimuth_later
        if settings.kept_up_to is not None and isinstance(accumulator, DirectAccumulator):
            settings = replace(settings, kept_up_to=settings.kept_up_to * (EVERY_PULSE_UP_TO / INNER_UP_TO))
        return differentiate(Kernel.of(self.trace_scene, grid, batch, flags, settings), self.tangents)

    def launch(
        self, launch: Launch, states: AntennaStates, accumulator: GridAccumulator, each: int = 1
    ) -> TraceStatistics:
        """Record and run one kernel.

        Parameters
        ----------
        launch : source and part
        states : of the antennas, at its pulses
        accumulator : to which echoes are added
        each : number of pulses to which a path contributes
        """
        antenna = self.sampling.scene.radar.antenna
        kernel = self.kernel_of(launch.part.grid, states, accumulator)
        accumulator.before(launch, kernel.pulses.n_pulses)
        counts, state = launch.record(kernel, antenna, record_beside(kernel, accumulator))
        dr.eval(counts.hits, counts.contributions, state, accumulator.written)
        totals = [int(dr.sum(mi.UInt64(c))[0]) for c in (counts.hits, counts.contributions, state[0])]
        # in NumPy: sums by Dr.Jit differ in the last bits with the number of threads
        lost_power, power = (float(np.sum(np.asarray(p), dtype=np.float64)) for p in state[1:3])
        self.timer.lap("trace")
        if not np.isfinite(power):
            self._stop(launch, kernel, states.pick)
        n_pulses = kernel.pulses.n_pulses
        return TraceStatistics(
            rays=launch.part.rays * n_pulses,
            hits=totals[0],
            contributions=totals[1],
            outside=totals[2],
            key_pulses=n_pulses,
            path_pulses=totals[1] * each,
            power=power * each,
            power_outside=lost_power * each,
        )

    def _stop(self, launch: Launch, kernel: Kernel, pick: slice) -> None:
        """Raise the error about a launch with echoes that are not finite; see :func:`check_traced`."""
        scene = self.sampling.scene

        def culprit(flags: KernelFlags = kernel.flags) -> str:
            lanes = max(1, launch.part.rays * kernel.pulses.n_pulses)
            n_channels, depth = len(scene.radar.channels), self.kernel.max_depth
            bodies = self.trace_scene, scene.geometry, scene.materials
            look = scene.settings.method == "image"

            def again(recording: Recording) -> None:
                _, state = launch.record(replace(kernel, flags=flags), scene.radar.antenna, recording)
                dr.eval(state, recording.memory)

            def label(pulse: int) -> str:
                return f"look {pulse}" if look else f"pulse {pick.start + pulse}"

            return find_blame(again, lanes, depth, n_channels, *bodies, label)

        blame_stages(kernel.flags, scene.name, lambda flags: not culprit(flags))
        check_traced(np.zeros(0, np.complex64), np.nan, scene.name, culprit)


def _reference_range(radar: Radar, center: F64) -> float:
    """Reference length of both legs at a point (3,), m: for two antennas the geometric mean."""
    legs = [float(np.linalg.norm(center - track.center_position)) for track in radar.tracks]
    return legs[0] if len(legs) == 1 else float(np.sqrt(legs[0] * legs[1]))


def pulse_batch(radar: Radar, states: AntennaStates, frame: LaunchFrame, *, patterned: bool) -> PulseBatch:
    """Antenna states of a launch; ``patterned``: with the pointing of the beams."""
    pick = states.pick

    def of(position: F64, velocity: F64, pointing: Pointing) -> PulseBatch:
        return PulseBatch(
            position=position,
            velocity=velocity,
            frame=frame,
            boresight=pointing.boresight[pick] if patterned else None,
            azimuth_axis=pointing.azimuth_axis[pick] if patterned else None,
            elevation_axis=pointing.elevation_axis[pick] if patterned else None,
        )

    batch = of(states.position, states.velocity, radar.pointing)
    if states.receiver is None:
        return batch
    return replace(batch, receiver=of(*states.receiver, radar.pointings[-1]))


def polarisation_up(radar: Radar, center: F64, antenna: F64) -> tuple[float, float, float]:
    """Vertical reference of the polarisation basis: the scene's vertical, or across track when looking down."""
    look = center - antenna
    look = look / np.linalg.norm(look)
    up = np.array([0.0, 0.0, 1.0])
    if abs(look[2]) > np.cos(np.radians(1.0)):  # within a degree of nadir H and V are undefined
        up = radar.across
    return (float(up[0]), float(up[1]), float(up[2]))


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
