"""Radar modes: beam steering over the track, and the aperture, resolution and Doppler bandwidth that follow.

The flight path is a function of time; automatic tracks are samples of it at the pulse times.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.core.errors import ExtensionError
from sarmitsuba.core.parameters import Param, Value
from sarmitsuba.core.registry import Registry
from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.track import Track


class FlightPath(ABC):
    """Position and velocity at any time; time zero is mid-aperture."""

    @abstractmethod
    def states(self, time: F64) -> tuple[F64, F64]:
        """Position (m) and velocity (m/s), two (n, 3) float64 in the scene frame, at (n,) times in s."""

    @property
    def speed(self) -> float:
        """Speed at mid-aperture, m/s."""
        return float(np.linalg.norm(self.states(np.zeros(1))[1]))

    def track(self, prf: float, n_pulses: int) -> Track:
        """Uniformly timed pulses with mid-aperture in their middle.

        Parameters
        ----------
        prf : pulse repetition frequency, Hz
        n_pulses : number of pulses
        """
        time = np.asarray((np.arange(n_pulses) - 0.5 * (n_pulses - 1)) / prf, dtype=np.float64)
        return Track(time, *self.states(time))


@dataclass(frozen=True, eq=False)
class StraightPath(FlightPath):
    """Straight path at constant speed.

    Parameters
    ----------
    center : (3,) float64, m, scene frame; mid-aperture
    flight : (3,) float64, m/s, velocity
    """

    center: F64
    flight: F64

    def states(self, time: F64) -> tuple[F64, F64]:
        """See the class."""
        position = np.asarray(self.center + time[:, None] * self.flight)
        return position, np.broadcast_to(self.flight, position.shape).copy()


UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class AimGeometry:
    """Geometry of the radar at mid-aperture about its aim point.

    Parameters
    ----------
    aim : (3,) float64, m, scene frame; aim point
    center : (3,) float64, m, scene frame; mid-aperture position
    along, across : (3,) float64, horizontal unit vectors of flight and to the look side
    """

    aim: F64
    center: F64
    along: F64
    across: F64

    @property
    def slant_range(self) -> float:
        """Distance from mid-aperture to the aim point, m."""
        return float(np.linalg.norm(self.center - self.aim))

    @property
    def line_of_sight(self) -> F64:
        """(3,) unit vector from mid-aperture to the aim point."""
        return np.asarray((self.aim - self.center) / self.slant_range)

    @property
    def cos_squint(self) -> float:
        """Cosine of the squint angle, at least 1e-6."""
        sine = float((self.aim - self.center) @ self.along) / self.slant_range
        return float(np.sqrt(max(1.0 - sine * sine, 1e-12)))

    @property
    def axes(self) -> F64:
        """(3, 3) rows along, across and up."""
        return np.stack([self.along, self.across, UP])


@dataclass(frozen=True, eq=False)
class TrackAxes:
    """The antenna's axes at every pulse, orthonormal, scene frame.

    Parameters
    ----------
    forward, right, over : (n_pulses, 3) float64; along the velocity, horizontal to its right, and across both
    """

    forward: F64
    right: F64
    over: F64

    @staticmethod
    def of(track: Track, along: F64) -> "TrackAxes":
        """Axes of a track; ``along`` (3,) stands for the velocity where the antenna is still or climbs vertically."""
        speed = np.linalg.norm(track.velocity, axis=1, keepdims=True)
        forward = np.where(speed > 0.0, track.velocity / np.maximum(speed, 1e-300), along)
        right = np.cross(forward, UP)
        size = np.linalg.norm(right, axis=1, keepdims=True)
        right = np.where(size > 1e-9, right / np.maximum(size, 1e-9), right_of(along))
        return TrackAxes(forward, right, np.cross(right, forward))


class RadarMode(ABC):
    """Radar mode: beam steering, and the aperture, resolution and Doppler bandwidth that follow.

    A mode is one module with one registered instance; it may be a user's extension module.

    Attributes
    ----------
    name : in scene files
    doc : beam steering in one phrase
    parameters : of the sensor that only this mode has
    instantaneous_doppler : the Doppler bandwidth is that of the image at one instant, because beam and focuser follow
        the aim point; False counts the spread over the whole aperture
    own_apertures : the beam passes over the pixels one after the other, so that each has its own aperture about its
        closest approach, and the automatic track contains the apertures of the whole image; False where all pixels are
        illuminated by the same pulses
    squints : the beam may look ahead or back at mid-aperture
    all_round : the line of sight turns so far that no slant-range axis serves all pulses: images have a ground grid
    path_parameters : names of those ``parameters`` that shape the automatic track; a given track has no use for them
    bursts : pulses come in bursts (:mod:`sarmitsuba.radar.bursts`), which set their rate, number and times
    """

    name: str
    doc: str
    parameters: tuple[Param, ...] = ()
    instantaneous_doppler: bool = False
    own_apertures: bool = False
    squints: bool = True
    all_round: bool = False
    path_parameters: tuple[str, ...] = ()
    bursts: bool = False

    @abstractmethod
    def boresight(
        self, track: Track, axes: TrackAxes, geometry: AimGeometry, values: Mapping[str, Value]
    ) -> F64:
        """Direction of the beam at every pulse.

        Parameters
        ----------
        track, axes : the antenna's positions and its axes
        geometry : aim point and mid-aperture
        values : of ``parameters``

        Returns
        -------
        (n_pulses, 3) float64 unit vectors, scene frame
        """

    def path(self, geometry: AimGeometry, speed: float) -> FlightPath:
        """Flight path where no track is given: straight through mid-aperture, at ``speed`` (m/s)."""
        return StraightPath(geometry.center, speed * geometry.along)

    def path_length(self, geometry: AimGeometry, values: Mapping[str, Value]) -> float:
        """Length of track given by the mode's ``values``, m; 0 where it follows from the azimuth resolution."""
        return 0.0

    def aperture_length(self, geometry: AimGeometry, wavelength: float, azimuth_cell: float) -> float:
        r"""Length of track that gives an azimuth cell, m.

        .. math:: L = \lambda R / (2 \delta_a \cos\psi)

        Parameters
        ----------
        geometry : gives slant range R and squint psi
        wavelength, azimuth_cell : m
        """
        return wavelength * geometry.slant_range / (2.0 * azimuth_cell * geometry.cos_squint)

    def azimuth_cell(self, geometry: AimGeometry, wavelength: float, length: float) -> float:
        """Azimuth cell of a track of given length, m: the inverse of `aperture_length`."""
        return wavelength * geometry.slant_range / (2.0 * length * geometry.cos_squint)

    def pointing(
        self, track: Track, geometry: AimGeometry, values: Mapping[str, Value] | None = None
    ) -> Pointing:
        """Boresight and aperture axes of every pulse.

        Parameters
        ----------
        track : in the scene frame
        geometry : aim point and mid-aperture
        values : of ``parameters``; None takes their defaults
        """
        axes = TrackAxes.of(track, geometry.along)
        boresight = self.boresight(track, axes, geometry, self.filled(values))
        azimuth = axes.forward - np.einsum("ij,ij->i", axes.forward, boresight)[:, None] * boresight
        size = np.linalg.norm(azimuth, axis=1, keepdims=True)
        azimuth = np.where(size > 1e-9, azimuth / np.maximum(size, 1e-9), np.cross(boresight, axes.right))
        elevation = np.cross(azimuth, boresight)
        elevation *= np.where(elevation[:, 2:] < 0.0, -1.0, 1.0)
        return Pointing(boresight, azimuth, elevation)

    def filled(self, values: Mapping[str, Value] | None) -> dict[str, Value]:
        """Values of ``parameters``, missing ones at their defaults."""
        return {p.name: p.default for p in self.parameters if p.default is not None} | dict(values or {})


def point_towards(point: F64, track: Track) -> F64:
    """Unit vectors (n_pulses, 3) from every position of a track to a point (3,), or to one per pulse."""
    line = point - track.position
    return unit_rows(line)


MODES: Registry[RadarMode] = Registry("radar mode", RadarMode, "sarmitsuba.radar.modes")


def mode_parameters() -> tuple[Param, ...]:
    """Parameters that only some modes have, each once.

    Raises
    ------
    ExtensionError
        Two modes give one name different meanings.
    """
    found: dict[str, Param] = {}
    for mode in MODES:
        for param in mode.parameters:
            if found.setdefault(param.name, param) != param:
                raise ExtensionError(
                    f'radar mode {mode.name}: parameter "{param.name}" has another meaning in another mode; rename it'
                )
    return tuple(found.values())


def right_of(along: F64) -> F64:
    """Horizontal vector (3,) to the right of a horizontal direction."""
    return np.array([along[1], -along[0], 0.0])
