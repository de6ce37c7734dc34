"""Parameters of the radar: gain, clock, positions of the antenna, pointing of its beam."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from sarmitsuba.apps.fit.parameter import AXES, Derivatives, Parameter
from sarmitsuba.core.arrays import C64, F64, I64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import RadarError, SceneError
from sarmitsuba.core.units import power_from_db
from sarmitsuba.radar.track_errors import turn_axes
from sarmitsuba.tracing.derivatives.tangents import PER_DB, Displacement

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from sarmitsuba.scene.scene import Scene


# largest change of the gain, dB: above, float32 amplitudes overflow
MOST_GAIN = 300.0


@dataclass(frozen=True)
class Gain(Parameter):
    """Gain of the whole radar, dB of power, relative to the scene's."""

    of_radar: ClassVar[tuple[str, ...]] = ("transmit_power",)
    label: str = "gain"

    def names(self, scene: Scene) -> tuple[str, ...]:
        """See the base class."""
        return ("gain [dB]",)

    def values(self, scene: Scene) -> F64:
        """See the base class."""
        return np.zeros(1)

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class."""
        radar = scene.radar
        if not abs(float(values[0])) <= MOST_GAIN:
            raise SceneError(
                f"parameter gain = {float(values[0]):g} dB must be within {MOST_GAIN:g} dB of the scene's"
            )
        power = radar.transmit_power * power_from_db(float(values[0]))
        return replace(scene, radar=replace(radar, transmit_power=power))

    def derivative(self, found: Derivatives) -> Sequence[C64]:
        """See the base class."""
        return (found.data * np.float32(PER_DB),)


@dataclass(frozen=True)
class ClockOffset(Parameter):
    """Delay of the echoes against the clock that starts the receive window, s; the carrier's phase does not change."""

    of_radar: ClassVar[tuple[str, ...]] = ("window",)
    label: str = "clock_offset"

    def names(self, scene: Scene) -> tuple[str, ...]:
        """See the base class."""
        return ("clock_offset [s]",)

    def values(self, scene: Scene) -> F64:
        """See the base class."""
        return np.zeros(1)

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class."""
        window = scene.radar.window
        start = window.start_range - 0.5 * SPEED_OF_LIGHT * float(values[0])
        return replace(scene, radar=replace(scene.radar, window=replace(window, start_range=start)))

    def derivative(self, found: Derivatives) -> Sequence[C64]:
        """See the base class."""
        carrier = 4j * np.pi * found.center_frequency / SPEED_OF_LIGHT
        envelope = found.farther + np.complex64(carrier) * found.data
        return (np.asarray(envelope * np.float32(0.5 * SPEED_OF_LIGHT), dtype=np.complex64),)


@dataclass(frozen=True)
class AntennaTrack(Parameter):
    """Displacement of the antenna's positions, m, linear between knots that divide the time of the track equally.

    An antenna that moves on until reception is displaced there as at that time.

    Parameters
    ----------
    knots : number of them; 1: the same displacement at all pulses
    axes : of the scene frame, some of ``xyz``
    """

    pointing: ClassVar[bool] = True
    of_radar: ClassVar[tuple[str, ...]] = ("track", "receiver", "recorded", "delay")
    knots: int = 1
    axes: str = AXES

    @property
    def label(self) -> str:  # type: ignore[override]
        """See the base class."""
        return f"track:{self.knots}:{self.axes}"

    def names(self, scene: Scene) -> tuple[str, ...]:
        """See the base class."""
        check_knots(self, scene)
        return tuple(f"track {axis} at knot {k} [m]" for axis in self.axes for k in range(self.knots))

    def values(self, scene: Scene) -> F64:
        """See the base class."""
        return np.zeros(self.knots * len(self.axes))

    def offsets(self, time: F64, values: F64, at: F64 | None = None) -> F64:
        """(n_pulses, 3) displacement at the pulse times, m; or at other times ``at``, of knots over the pulse times."""
        offsets = np.zeros((len(time), 3))
        weights = knot_weights(time, self.knots, at)
        for axis, knots in zip(self.axes, values.reshape(len(self.axes), self.knots), strict=True):
            offsets[:, AXES.index(axis)] = weights @ knots
        return offsets

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class."""
        radar = scene.radar
        offsets = (self.offsets(radar.track.time, values, at) for at in radar.times)
        return replace(scene, radar=radar.displaced(*offsets))

    def displacements(self, scene: Scene, face_mesh: I64) -> Sequence[Displacement]:
        """See the base class."""
        return [Displacement(np.eye(3)[AXES.index(axis)]) for axis in self.axes]

    def derivative(self, found: Derivatives) -> Iterator[C64]:
        """See the base class."""
        planes = []
        for axis, plane in zip(self.axes, found.displaced, strict=True):
            total = plane
            for angle, turned_beam in zip(found.aside[..., AXES.index(axis)], found.pointed, strict=False):
                total = total + angle.astype(np.float32)[:, None] * turned_beam
            planes.append(total)
        return spread_to_knots(planes, found.times, self.knots)


@dataclass(frozen=True)
class BeamPointing(Parameter):
    """Angles of the beam in azimuth (forward) and elevation (upward), rad, as :class:`AntennaTrack` between knots.

    Parameters
    ----------
    knots : number of them, which divide the time of the track equally; 1: the same angles at all pulses
    """

    pointing: ClassVar[bool] = True
    of_radar: ClassVar[tuple[str, ...]] = ("pointing", "receiver_pointing", "recorded_pointing")
    knots: int = 1

    @property
    def label(self) -> str:  # type: ignore[override]
        """See the base class."""
        return f"pointing:{self.knots}"

    def names(self, scene: Scene) -> tuple[str, ...]:
        """See the base class."""
        check_knots(self, scene)
        angles = ("azimuth", "elevation")
        return tuple(f"pointing {angle} at knot {k} [rad]" for angle in angles for k in range(self.knots))

    def values(self, scene: Scene) -> F64:
        """See the base class."""
        if not scene.radar.antenna.directive:
            raise RadarError(
                "parameter pointing: the antenna is isotropic and has no beam to turn; give it a pattern"
            )
        return np.zeros(2 * self.knots)

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class."""
        radar = scene.radar
        angles = knot_weights(radar.track.time, self.knots) @ values.reshape(2, self.knots).T
        pointing = turn_axes(radar.pointing, angles)
        return replace(scene, radar=replace(radar, pointing=pointing))

    def derivative(self, found: Derivatives) -> Iterator[C64]:
        """See the base class."""
        # both legs have the beam of the transmission
        return spread_to_knots(found.pointed, found.times[:1], self.knots)


def check_knots(parameter: AntennaTrack | BeamPointing, scene: Scene) -> None:
    """Refuse more knots than pulses, whose values no data tell.

    Raises
    ------
    RadarError : one line: the parameter and the largest number
    """
    n_pulses = scene.radar.track.n_pulses
    if parameter.knots > n_pulses:
        raise RadarError(
            f"parameter {parameter.label}: {parameter.knots} knots on a track of {n_pulses} pulses; take at most "
            f"{n_pulses}"
        )


def knot_weights(time: F64, knots: int, at: F64 | None = None) -> F64:
    """(n_pulses, knots) weight of each knot, equally spaced over the track.

    Parameters
    ----------
    time : (n_pulses,) s, of the pulses
    knots : number of them
    at : (n_pulses,) s, at which; None: at the pulses. Before the first knot and after the last one these hold.
    """
    if knots == 1 or len(time) == 1:
        weights = np.zeros((len(time), knots))
        weights[:, 0] = 1.0
        return weights
    places = np.linspace(time[0], time[-1], knots)
    return np.stack([np.interp(time if at is None else at, places, one) for one in np.eye(knots)], axis=1)


def spread_to_knots(planes: Sequence[C64], times: Sequence[F64], knots: int) -> Iterator[C64]:
    """Derivatives by values at knots, from those by a value common to all pulses; plane by plane.

    ``times``: of transmission, and where the antenna moves on, of reception. Each leg is half of the derivative.
    """
    weights = np.mean([knot_weights(times[0], knots, at) for at in times], axis=0).astype(np.float32)
    return (plane * one[:, None] for plane in planes for one in weights.T)
