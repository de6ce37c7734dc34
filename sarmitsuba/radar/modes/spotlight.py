"""Spotlight: the beam is steered to stay on the aim point."""

from collections.abc import Mapping

import numpy as np

from sarmitsuba.parameters import Value
from sarmitsuba.radar.mode import F64, MODES, AimGeometry, RadarMode, TrackAxes
from sarmitsuba.radar.track import Track


class Spotlight(RadarMode):
    """Beam held on the aim point, which lights one patch of ground during the whole aperture."""

    name = "spotlight"
    doc = "beam held on the aim point"
    instantaneous_doppler = True

    def boresight(
        self, track: Track, axes: TrackAxes, geometry: AimGeometry, values: Mapping[str, Value]
    ) -> F64:
        """Return the unit vectors from every position to the aim point."""
        line = geometry.aim - track.position
        return np.asarray(line / np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-300))


MODES.register(Spotlight())

__all__ = ["Spotlight"]
