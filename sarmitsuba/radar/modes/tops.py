"""TOPS: bursts of one sub-swath after the other, in each of which the beam turns forward."""

from collections.abc import Mapping

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.parameters import Param, Value
from sarmitsuba.radar.bursts import PARAMETERS, STEERING, steer_beam
from sarmitsuba.radar.mode import MODES, AimGeometry, RadarMode, TrackAxes
from sarmitsuba.radar.track import Track


class Tops(RadarMode):
    r"""Terrain observation by progressive scans: the beam turns forward at a steady rate during a burst.

    Its footprint moves :math:`1 + k_s / |k_a|` times as fast as in stripmap, so that every place is seen by the whole
    beam, for a time shorter by that factor; an antenna of length D resolves that times D / 2 in azimuth.

    References
    ----------
    F. De Zan and A. Monti Guarnieri, "TOPSAR: Terrain Observation by Progressive Scans", IEEE Trans. Geosci. Remote
    Sens. 44 (9), 2006.
    """

    name = "tops"
    doc = "bursts of each sub-swath in turn, beam turned forward in each"
    parameters = (
        *PARAMETERS,
        Param(
            STEERING,
            "float",
            0.0,
            "rate at which the beam turns forward during a burst, for a sub-swath without one of its own",
            "deg/s",
            0.0,
            1e3,
        ),
        Param(
            "steering_limit_deg",
            "float",
            0.0,
            "largest angle of the beam off broadside that the antenna steers to without a grating lobe; 0: any",
            "deg",
            0.0,
            60.0,
        ),
    )
    instantaneous_doppler = True
    own_apertures = True
    squints = False
    bursts = True

    def boresight(
        self, track: Track, axes: TrackAxes, geometry: AimGeometry, values: Mapping[str, Value]
    ) -> F64:
        """Return the direction that turns about the middle of the track."""
        return steer_beam(track, axes, geometry, values, float(np.radians(float(values[STEERING]))))


MODES.register(Tops())
