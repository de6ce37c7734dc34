"""Weight of a ray by its direction and by where it starts: the antenna pattern and the launch window's fade-out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.backend import device_numbers, dr, mi
from sarmitsuba.trace.arrays import vector_rows

if TYPE_CHECKING:
    from sarmitsuba.radar.antenna import Antenna
    from sarmitsuba.trace.launch import PulseBatch


def fade(x: mi.Float, half: float, taper: float) -> mi.Float:
    """1 within ``half``, raised-cosine fall to 0 over ``taper`` beyond it; 1 everywhere where ``taper`` is 0."""
    # one kernel for both: a window with a fade-out and one without
    width = dr.opaque(mi.Float, taper if taper > 0.0 else np.inf)
    t = dr.clip((dr.abs(x) - dr.opaque(mi.Float, half)) / width, 0.0, 1.0)
    return 0.5 + 0.5 * dr.cos(t * np.pi)


class BeamPattern:
    """One-way amplitude pattern of the pulse that a lane belongs to.

    Without azimuth axes only the elevation pattern counts: a block of pulses has each pulse's own azimuth pattern from
    its synthesis (:func:`sarmitsuba.echo.block.synthesise`).
    """

    def __init__(self, antenna: Antenna, pulses: PulseBatch, pulse: mi.UInt32) -> None:
        assert pulses.elevation_axis is not None and pulses.boresight is not None
        self.antenna = antenna
        self.azimuth = None
        if pulses.azimuth_axis is not None:
            self.azimuth = mi.Vector3f(dr.gather(mi.Vector3d, vector_rows(pulses.azimuth_axis), pulse))
        self.elevation = mi.Vector3f(dr.gather(mi.Vector3d, vector_rows(pulses.elevation_axis), pulse))
        self.boresight = mi.Vector3f(dr.gather(mi.Vector3d, vector_rows(pulses.boresight), pulse))

    def one_way(self, u: mi.Vector3f) -> mi.Float:
        """Relative one-way amplitude towards the unit vector ``u`` (antenna to scene); zero behind the aperture."""
        azimuth = mi.Float(0.0) if self.azimuth is None else dr.dot(u, self.azimuth)
        numbers = device_numbers(mi.Float, self.antenna.numbers)
        two_way = self.antenna.normalised(azimuth, dr.dot(u, self.elevation), numbers, dr)
        return dr.select(dr.dot(u, self.boresight) > 0.0, dr.sqrt(dr.maximum(two_way, 0.0)), 0.0)


__all__ = ["BeamPattern", "fade"]
