"""Baseline of an interferometric pair: components about the line of sight, critical value and height of ambiguity.

A second pass with a baseline suitable for the scene is planned here too. Components are those at a pixel, from the
phase centres of both images: antenna position and slant range of every point.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.collection import Flight
from sarmitsuba.radar.mode import right_of
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.image import SarImage

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
        return FixedAntennas(transmitter, receiver, unit_rows(velocity))

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
        units = [unit_rows(line) for line in lines]
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


# distance of the transmitters, relative to that of the receivers, below which they count as one
_SAME = 1e-3


@dataclass(frozen=True)
class Baseline:
    r"""Interferometric baseline from the first image's antenna to the second's, for one point.

    In a single pass (p = 1) the transmitter is common and the baseline is that of the receivers; in two passes (p = 2)
    it is that of the phase centres.

    .. math:: h_a = \frac{\lambda R \sin\theta}{p B_\perp}, \qquad B_{crit} = \frac{\lambda R \tan\theta}{p \delta_r}

    Parameters
    ----------
    perpendicular : m; across the line of sight and the flight, positive upwards
    parallel : m; along the line of sight, positive towards the scene
    along : m; along the flight, across the line of sight
    passes : p
    slant_range : R, m
    incidence : theta, rad, at a level surface, in the plane across the flight
    range_cell : m of slant range, c / 2 bandwidth
    wavelength : m

    Notes
    -----
    Ignores the slope of the terrain. The critical baseline holds for range alone: along-track baselines also shift the
    Doppler bands.
    """

    perpendicular: float
    parallel: float
    along: float
    passes: int
    slant_range: float
    incidence: float
    range_cell: float
    wavelength: float

    @staticmethod
    def of(
        views: tuple[Viewpoint, Viewpoint], point: F64, wavelength: float, range_cell: float
    ) -> "Baseline":
        """Baseline for a point (3,), m, frame of the user's file."""
        first, second = (view.look(point) for view in views)
        passes, moved = 2, second.center - first.center
        receivers = second.receiver - first.receiver
        apart = float(np.linalg.norm(second.transmitter - first.transmitter))
        if apart < _SAME * float(np.linalg.norm(receivers)):
            passes, moved = 1, receivers
        line = point - first.center
        distance = float(np.linalg.norm(line))
        sight = line / distance
        forward = first.forward
        normal = np.cross(sight, forward)
        normal *= np.copysign(1.0, normal[2]) / np.linalg.norm(normal)
        flight = np.cross(normal, sight)
        flight *= np.copysign(1.0, float(flight @ forward))
        across = sight - float(sight @ forward) * forward
        return Baseline(
            float(moved @ normal),
            float(moved @ sight),
            float(moved @ flight),
            passes,
            distance,
            float(np.arccos(-across[2] / np.linalg.norm(across))),
            range_cell,
            wavelength,
        )

    @property
    def critical(self) -> float:
        """Critical perpendicular baseline, at which the range spectra of level ground do not overlap, m."""
        return float(
            self.wavelength * self.slant_range * np.tan(self.incidence) / (self.passes * self.range_cell)
        )

    @property
    def height_of_ambiguity(self) -> float:
        """Height of ambiguity: change of height for a phase of 2 pi, m; infinite without perpendicular baseline."""
        if self.perpendicular == 0.0:
            return float(np.inf)
        turn = self.wavelength * self.slant_range * np.sin(self.incidence)
        return float(turn / (self.passes * abs(self.perpendicular)))

    def as_dict(self) -> dict[str, object]:
        """Values for JSON, units in the names."""
        return {
            "perpendicular_m": self.perpendicular,
            "parallel_m": self.parallel,
            "along_m": self.along,
            "passes": self.passes,
            "slant_range_m": self.slant_range,
            "incidence_deg": float(np.degrees(self.incidence)),
            "critical_m": self.critical,
            "share_of_critical": abs(self.perpendicular) / self.critical,
            "height_of_ambiguity_m": self.height_of_ambiguity if self.perpendicular else None,
        }


# automatic baseline: relief of the scene over the height of ambiguity, and share of the critical baseline
RELIEF_SHARE, LEAST_COHERENCE = 0.6, 0.8


@dataclass(frozen=True)
class PassOffset:
    """Offset of a parallel pass, or of a second receiver.

    Parameters
    ----------
    across, up : m, to the right of the track and upwards
    passes : 2, or 1 for two receivers and one transmission
    """

    across: float
    up: float
    passes: Literal[1, 2] = 2

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters of ``sar_antenna``, by their names in scene files and ``RadarDescription``."""
        what = "pass_offset" if self.passes == 2 else "receiver_offset"
        return {f"{what}_across": self.across, f"{what}_up": self.up}


def second_pass(
    radar: Radar, relief: float, baseline: float | None = None, passes: Literal[1, 2] = 2
) -> PassOffset:
    r"""Offset of the second pass, normal to line of sight and flight at the aim point.

    .. math:: B_\perp = \min\left(\frac{0.6\, \lambda R \sin\theta}{p\, \Delta z}, 0.2\, B_{crit}\right)

    Parameters
    ----------
    radar : of the first pass
    relief : Delta z, m, height range of the scene; 0 for level ground
    baseline : perpendicular, m, positive upwards, in place of the automatic one
    passes : p: 2, or 1 with one transmission and two receivers
    """
    along = radar.track.along
    sight = radar.aim_point - radar.track.center_position
    distance = float(np.linalg.norm(sight))
    normal = np.cross(sight, along)
    normal *= np.sign(normal[2]) / np.linalg.norm(normal)
    if baseline is None:
        drop = sight - (sight @ along) * along
        incidence = float(np.arccos(-drop[2] / np.linalg.norm(drop)))
        turn = radar.waveform.wavelength * distance / passes
        baseline = (1.0 - LEAST_COHERENCE) * turn * np.tan(incidence) / radar.waveform.range_cell
        if relief > 0.0:
            baseline = min(baseline, RELIEF_SHARE * turn * np.sin(incidence) / relief)
    return PassOffset(float(baseline * (normal @ right_of(along))), float(baseline * normal[2]), passes)
