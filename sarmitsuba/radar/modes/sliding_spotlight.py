"""Sliding spotlight: the beam rotates about a point beyond the scene, so that its footprint moves slowly."""

from collections.abc import Mapping

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.core.parameters import Param, Value
from sarmitsuba.radar.mode import MODES, AimGeometry, RadarMode, TrackAxes
from sarmitsuba.radar.track import Track


class SlidingSpotlight(RadarMode):
    r"""Beam steered to a rotation point beyond the aim point, on its line of sight from mid-aperture.

    .. math:: R_{rot} = R / (1 - A)

    is that point's slant range from mid-aperture. At the aim point's range R the footprint then moves at A times the
    antenna's speed, A the sliding factor: 0 is spotlight, 1 stripmap. A pixel at another closest range r slides at
    :math:`A(r) = (R_{rot} - r) / R_{rot}`, and stays in a beam of half-power width :math:`\Theta` over a track of
    :math:`r \Theta / A(r)`: an antenna of length D resolves :math:`A(r) D / 2` in azimuth.

    References
    ----------
    D. P. Belcher and C. J. Baker, "High resolution processing of hybrid strip-map/spotlight mode SAR", IEE Proc.
    Radar, Sonar Navig. 143 (6), 1996. P. Prats et al., "Processing of sliding spotlight and TOPS SAR data using
    baseband azimuth scaling", IEEE Trans. Geosci. Remote Sens. 48 (2), 2010.
    """

    name = "sliding_spotlight"
    doc = "beam rotated about a point beyond the aim point"
    parameters = (
        Param(
            "sliding_factor",
            "float",
            0.3,
            "speed of the footprint along the track over the antenna's, at the aim point: 0 would be spotlight, 1 is "
            "stripmap",
            "",
            0.001,
            1.0,
        ),
    )
    instantaneous_doppler = True
    own_apertures = True

    def boresight(
        self, track: Track, axes: TrackAxes, geometry: AimGeometry, values: Mapping[str, Value]
    ) -> F64:
        """Return the unit vectors from every position to the rotation point."""
        factor = float(values["sliding_factor"])
        # times 1 - A: stripmap's fixed direction is the limit of a point at infinity
        line = (1.0 - factor) * (geometry.center - track.position)
        line += geometry.slant_range * geometry.line_of_sight
        return unit_rows(line)


MODES.register(SlidingSpotlight())
