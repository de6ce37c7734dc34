"""Phase centres of an image: antenna positions and slant range of every point."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.flight import Flight
from sarmitsuba.signal.image.sar_image import SarImage

# iterations for the time at which a point is at the beam's squint: in orbit each leaves a tenth of the error
_ROUNDS = 8


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """Phase centres of the apertures of an image, in the frame of the user's file.

    Parameters
    ----------
    transmitter : its flight
    receiver : flight of a separate receiver; None: monostatic
    squint_sine : sine of the squint if every point has its own aperture; None: one aperture for all points
    """

    transmitter: Flight
    receiver: Flight | None
    squint_sine: float | None

    @staticmethod
    def of(image: SarImage) -> "Viewpoint":
        """Viewpoint of an image.

        Raises
        ------
        DataError
            The image has no recorded track.
        """
        facts = image.metadata.get("focus", {})
        if "flight" not in facts:
            raise DataError("interferogram: the image has no recorded track; focus its raw data again")
        receiver = facts.get("receiver_flight")
        sine = facts.get("squint_sine")
        return Viewpoint(
            Flight.from_dict(facts["flight"]),
            None if receiver is None else Flight.from_dict(receiver),
            None if sine is None else float(sine),
        )

    def time(self, points: F64) -> F64:
        """Time of the aperture centre of points (..., 3), (...,) s."""
        path = self.transmitter
        time = np.full(points.shape[:-1], path.span[1])
        if self.squint_sine is None:
            return time
        tangent = self.squint_sine / np.sqrt(1.0 - self.squint_sine**2)
        for _ in range(_ROUNDS):
            line, velocity = points - path.position(time), path.velocity_at(time)
            speed = np.linalg.norm(velocity, axis=-1)
            x = np.sum(line * velocity, axis=-1) / speed
            closest = np.sqrt(np.sum(line**2, axis=-1) - x**2)
            time = time + (x - closest * tangent) / speed
        return time

    def antennas(self, time: F64) -> tuple[F64, F64]:
        """Positions of transmitter and receiver at times (...,), two (..., 3), m."""
        if self.squint_sine is None:  # mid-aperture exactly
            places = [
                np.broadcast_to(path.center, (*time.shape, 3))
                for path in (self.transmitter, self.receiver or self.transmitter)
            ]
            return places[0], places[1]
        first = self.transmitter.position(time)
        return first, first if self.receiver is None else self.receiver.position(time)

    def look(self, points: F64) -> "FixedAntennas":
        """Antennas at the aperture centres of points (..., 3), m."""
        time = self.time(points)
        transmitter, receiver = self.antennas(time)
        velocity = (
            self.transmitter.velocity if self.squint_sine is None else self.transmitter.velocity_at(time)
        )
        return FixedAntennas(
            transmitter, receiver, velocity / np.linalg.norm(velocity, axis=-1, keepdims=True)
        )

    def distance(self, points: F64) -> F64:
        """Slant range of points (..., 3), half the two-way path, (...,) m."""
        return self.look(points).distance(points)


@dataclass(frozen=True, eq=False)
class FixedAntennas:
    """Antennas at fixed positions.

    Parameters
    ----------
    transmitter, receiver : (..., 3) float64, m
    forward : (3,) or (..., 3) float64, unit vector of flight
    """

    transmitter: F64
    receiver: F64
    forward: F64

    @property
    def center(self) -> F64:
        """Phase centre: midpoint of both antennas, (..., 3), m."""
        return np.asarray(0.5 * (self.transmitter + self.receiver))

    def distance(self, points: F64) -> F64:
        """Slant range, (...,) m."""
        legs = [np.linalg.norm(points - place, axis=-1) for place in (self.transmitter, self.receiver)]
        return np.asarray(0.5 * (legs[0] + legs[1]))

    def gradient(self, points: F64) -> F64:
        """Gradient of the slant range, (..., 3): the line of sight, or the mean of both."""
        lines = [points - place for place in (self.transmitter, self.receiver)]
        units = [line / np.linalg.norm(line, axis=-1, keepdims=True) for line in lines]
        return np.asarray(0.5 * (units[0] + units[1]))

    def sine(self, points: F64) -> F64:
        """Sine of the angle to points along the flight, from the phase centre, (...,); constant at one Doppler."""
        line = points - self.center
        return np.asarray(np.sum(line * self.forward, axis=-1) / np.linalg.norm(line, axis=-1))

    def sine_gradient(self, points: F64) -> F64:
        """Gradient of `sine`, (..., 3), 1/m."""
        line = points - self.center
        distance = np.linalg.norm(line, axis=-1, keepdims=True)
        unit = line / distance
        sine = np.sum(unit * self.forward, axis=-1, keepdims=True)
        return np.asarray((self.forward - sine * unit) / distance)
