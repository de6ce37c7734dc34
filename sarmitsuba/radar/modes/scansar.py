"""ScanSAR: bursts of one sub-swath after the other, the beam stepped in elevation and at rest in azimuth."""

from collections.abc import Mapping

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.parameters import Value
from sarmitsuba.radar.bursts import PARAMETERS, steer_beam
from sarmitsuba.radar.mode import MODES, AimGeometry, RadarMode, TrackAxes
from sarmitsuba.radar.track import Track


class ScanSar(RadarMode):
    r"""Beam fixed to the antenna during a burst, at the elevation of its sub-swath.

    All pulses of a burst of the length :math:`T_B` serve every pixel: the azimuth cell is that of their track,
    :math:`\lambda R / (2 v T_B)`. Places are seen in different parts of the beam (scalloping); the focusers divide by
    the gain that they were seen with, which leaves a noise level that changes over the burst.

    References
    ----------
    R. Bamler, "Optimum look weighting for burst-mode and ScanSAR processing", IEEE Trans. Geosci. Remote Sens. 33 (3),
    1995.
    """

    name = "scansar"
    doc = "bursts of each sub-swath in turn, beam stepped in elevation"
    parameters = PARAMETERS
    own_apertures = True
    squints = False
    bursts = True

    def boresight(
        self, track: Track, axes: TrackAxes, geometry: AimGeometry, values: Mapping[str, Value]
    ) -> F64:
        """Return the direction square to the flight at the elevation of the sub-swath."""
        return steer_beam(track, axes, geometry, values, 0.0)


MODES.register(ScanSar())
