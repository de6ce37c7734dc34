"""Pulses of one batch: antenna states at the traced pulses, grid of their echoes, and range profiles from the grid."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track_errors import turn_axes
from sarmitsuba.signal.raw.block import BlockPlan, plan_block
from sarmitsuba.signal.raw.block_synthesis import synthesise, synthesise_adjoint
from sarmitsuba.signal.raw.direct import DirectPlan, finish, finish_adjoint, plan_direct
from sarmitsuba.signal.raw.sub_bands import RangeFilter
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.tracing.kernel.accumulators import BlockAccumulator, DirectAccumulator, GridAccumulator

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
