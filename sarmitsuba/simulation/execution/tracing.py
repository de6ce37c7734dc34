"""Tracing of one scene: key pulse by key pulse, and the synthesis of the pulses around each."""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.timing import StageTimer
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.raw.sub_bands import RangeFilter, SubBands
from sarmitsuba.simulation.execution.blame import blame_stages, check_traced, find_blame
from sarmitsuba.simulation.execution.pulses import AntennaStates
from sarmitsuba.simulation.execution.recording import Recording
from sarmitsuba.simulation.execution.statistics import TraceStatistics
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.planning.site import RunSite
from sarmitsuba.tracing.derivatives.path_derivatives import differentiate, record_beside
from sarmitsuba.tracing.derivatives.tangents import TangentPlan
from sarmitsuba.tracing.kernel.accumulators import BlockAccumulator, DirectAccumulator, GridAccumulator
from sarmitsuba.tracing.kernel.kernel import Accumulator, KernelSettings
from sarmitsuba.tracing.kernel.launch import LaunchFrame, LaunchGrid, PulseBatch
from sarmitsuba.tracing.kernel.scene_tables import TraceScene
from sarmitsuba.tracing.kernel.source import Launch, Source, launches
from sarmitsuba.tracing.kernel.state import Kernel
from sarmitsuba.tracing.kernel.surfaces import Surfaces
from sarmitsuba.tracing.kernel.tubes.polygon import INNER_UP_TO
from sarmitsuba.tracing.scatterers.sources import sources_of

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
