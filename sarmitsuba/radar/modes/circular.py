"""Circular mode: the antenna flies a level circle about the aim point and looks at it from all sides."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.parameters import Param, Value
from sarmitsuba.radar.mode import MODES, AimGeometry, FlightPath, RadarMode, TrackAxes, point_towards
from sarmitsuba.radar.track import Track


@dataclass(frozen=True, eq=False)
class CirclePath(FlightPath):
    """Level circle at constant speed.

    Parameters
    ----------
    axis : (3,) float64, m, scene frame; any point of the circle's vertical axis
    center : (3,) float64, m, scene frame; mid-aperture, at time zero
    flight : (3,) float64, m/s, horizontal, across the line to the axis; velocity at time zero
    """

    axis: F64
    center: F64
    flight: F64

    def states(self, time: F64) -> tuple[F64, F64]:
        """See the class."""
        out = (self.center - self.axis) * np.array([1.0, 1.0, 0.0])
        radius, speed = float(np.linalg.norm(out)), float(np.linalg.norm(self.flight))
        angle = speed / radius * time[:, None]
        ahead = self.flight * (radius / speed)  # a quarter of the circle later
        middle = np.array([self.axis[0], self.axis[1], self.center[2]])
        position = middle + np.cos(angle) * out + np.sin(angle) * ahead
        velocity = speed / radius * (np.cos(angle) * ahead - np.sin(angle) * out)
        return np.asarray(position), np.asarray(velocity)


class Circular(RadarMode):
    r"""Circular SAR: beam steered to the aim point from a level circle about it, or an arc of it.

    An arc of :math:`\varphi` samples the spectrum of the ground over an annulus of that angle, of the radius
    :math:`(4 \pi / \lambda) \sin\theta`, theta the look angle. Its noise-equivalent azimuth cell is
    :math:`\lambda / (2 \varphi \sin\theta)`, which is the law of every straight track, :math:`\lambda R / 2 L`, with
    the arc's length for L. Of a whole circle it is :math:`\lambda / (4 \pi \sin\theta)`, and a point's response in
    the plane of focus is :math:`J_0(4 \pi r \sin\theta / \lambda)` for a narrow band.

    References
    ----------
    M. Soumekh, Synthetic Aperture Radar Signal Processing with MATLAB Algorithms, Wiley, 1999, chapter 7.
    """

    name = "circular"
    doc = "beam steered to the aim point from a circle about it"
    parameters = (Param("arc_deg", "float", 360.0, "angle of the circle that is flown", "deg", 0.01, 360.0),)
    instantaneous_doppler = True
    squints = False
    all_round = True
    path_parameters = ("arc_deg",)

    def boresight(
        self, track: Track, axes: TrackAxes, geometry: AimGeometry, values: Mapping[str, Value]
    ) -> F64:
        """Return the unit vectors from every position to the aim point."""
        return point_towards(geometry.aim, track)

    def path(self, geometry: AimGeometry, speed: float) -> FlightPath:
        """Circle through mid-aperture about the vertical through the aim point."""
        return CirclePath(geometry.aim, geometry.center, speed * geometry.along)

    def path_length(self, geometry: AimGeometry, values: Mapping[str, Value]) -> float:
        """Length of the arc, m."""
        radius = float(np.linalg.norm((geometry.center - geometry.aim)[:2]))
        return float(np.radians(float(values["arc_deg"])) * radius)


MODES.register(Circular())
