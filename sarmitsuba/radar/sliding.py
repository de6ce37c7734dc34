"""Motion of a steered beam over the scene: footprint speed, and the track that illuminates an image."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.parameters import Value
from sarmitsuba.radar.effective_velocity import effective_velocity_ratio
from sarmitsuba.radar.mode import AimGeometry, RadarMode
from sarmitsuba.radar.path import FlightPath
from sarmitsuba.radar.track import Track

# slant ranges on either side of mid-aperture within which the track is searched
_LONGEST = 50.0
# bisection steps, after which an interval is known to float64
_HALVINGS = 60


@dataclass(frozen=True, eq=False)
class BeamOverPath:
    """Beam steered by a mode along a path.

    Parameters
    ----------
    law : the mode
    path : flight path of the antenna
    geometry : about the aim point
    values : of the mode's parameters
    """

    law: RadarMode
    path: FlightPath
    geometry: AimGeometry
    values: Mapping[str, Value]

    def sines(self, time: F64, points: F64) -> tuple[F64, F64]:
        """Sines along the flight at (n,) times, s: of points (m, 3), giving (n, m), and of the boresight, (n,)."""
        track = Track(time, *self.path.states(time))
        forward = track.velocity / np.linalg.norm(track.velocity, axis=1, keepdims=True)
        line = points[None] - track.position[:, None]
        sine = np.einsum("npc,nc->np", line, forward) / np.linalg.norm(line, axis=2)
        boresight = self.law.pointing(track, self.geometry, self.values).boresight
        return sine, np.einsum("nc,nc->n", boresight, forward)

    @cached_property
    def footprint_speed(self) -> float:
        r"""Speed of the footprint at the aim point over the antenna's: 1 for a beam fixed to the track, 0 in spotlight.

        .. math:: A = \left(1 - \frac{d s_{boresight}}{d s_{aim}}\right) \frac{V_{eff}^2}{V^2}

        over the sines s along the flight, and the effective velocity, V on a straight path; see
        `sarmitsuba.radar.radar.Radar.footprint_speed`.
        """
        step = 1e-3 * self.geometry.slant_range / self.path.speed
        time = np.array([-step, 0.0, step])
        aim, boresight = self.sines(time, self.geometry.aim[None])
        held = 1.0 - float(boresight[2] - boresight[0]) / float(aim[2, 0] - aim[0, 0])
        return held * effective_velocity_ratio(Track(time, *self.path.states(time)), self.geometry.aim, 1)

    def track_length(self, points: F64, half_aperture: float, where: str) -> float:
        """Length of track, centred on mid-aperture, whose beam passes over all points, m.

        Parameters
        ----------
        points : (n, 3) float64, m, scene frame
        half_aperture : largest sine off the boresight of pulses that are processed for a point
        where : start of an error

        Raises
        ------
        RadarError
            The beam never leaves a point on the expected side.
        """

        def passes(half: float) -> bool:
            time = np.array([-half, 0.0, half]) / self.path.speed
            sine, boresight = self.sines(time, points)
            offset = sine - boresight[:, None]
            return bool((offset[0] >= half_aperture).all() and (offset[2] <= -half_aperture).all())

        reach = self.geometry.slant_range
        high = 1e-4 * reach
        while not passes(high):
            high *= 1.25
            if high > _LONGEST * reach:
                raise RadarError(
                    f"{where}: the footprint moves at {self.footprint_speed:.3g} of the antenna's speed and never "
                    "passes over the whole image; let it move faster (sliding_factor), shrink the image or coarsen "
                    "azimuth_resolution"
                )
        low = high / 1.25
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if passes(middle) else (middle, high)
        return 2.0 * high
