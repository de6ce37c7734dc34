"""Spotlight: the beam is steered to stay on the aim point."""

from collections.abc import Mapping

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.parameters import Value
from sarmitsuba.radar.mode import MODES, AimGeometry, RadarMode, TrackAxes, point_towards
from sarmitsuba.radar.track import Track


class Spotlight(RadarMode):
    """Beam steered to the aim point, which illuminates one patch of ground during the whole aperture."""

    name = "spotlight"
    doc = "beam steered to the aim point"
    instantaneous_doppler = True

    def boresight(
        self, track: Track, axes: TrackAxes, geometry: AimGeometry, values: Mapping[str, Value]
    ) -> F64:
        """Return the unit vectors from every position to the aim point."""
        return point_towards(geometry.aim, track)


MODES.register(Spotlight())
