"""Stripmap: the beam is fixed to the track and sweeps over the ground with it."""

from collections.abc import Mapping

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.parameters import Value
from sarmitsuba.radar.mode import MODES, AimGeometry, RadarMode, TrackAxes
from sarmitsuba.radar.track import Track


class Stripmap(RadarMode):
    """Beam of fixed direction in the antenna's axes, through the aim point at mid-aperture."""

    name = "stripmap"
    doc = "beam fixed to the track"
    own_apertures = True

    def boresight(
        self, track: Track, axes: TrackAxes, geometry: AimGeometry, values: Mapping[str, Value]
    ) -> F64:
        """Return the line of sight at mid-aperture, rotated with the antenna."""
        middle = track.center_index
        parts = [
            float(geometry.line_of_sight @ axis[middle]) for axis in (axes.forward, axes.right, axes.over)
        ]
        return np.asarray(parts[0] * axes.forward + parts[1] * axes.right + parts[2] * axes.over)


MODES.register(Stripmap())
