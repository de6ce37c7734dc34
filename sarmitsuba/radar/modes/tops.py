"""TOPS: bursts of one sub-swath after the other, in each of which the beam turns forward."""

from sarmitsuba.core.parameters import Param
from sarmitsuba.radar.bursts import PARAMETERS, STEERING, BurstMode
from sarmitsuba.radar.mode import MODES


class Tops(BurstMode):
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
            "rate at which the beam turns forward during a burst",
            "deg/s",
            0.0,
            1e3,
        ),
        Param(
            "steering_limit_deg",
            "float",
            0.0,
            "angle of the beam at which grating lobes begin; 0: none",
            "deg",
            0.0,
            60.0,
        ),
    )
    instantaneous_doppler = True


MODES.register(Tops())
