"""Weight of a ray by direction and place: the antenna pattern and the launch window's fade-out."""

from typing import Any

import numpy as np

from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.trace.launch import PulseBatch, vector64


def fade(x: Any, half: float, taper: float, dr: Any, f32: Any) -> Any:
    """1 within ``half``, raised-cosine fall to 0 over ``taper`` beyond it."""
    t = dr.clip((dr.abs(x) - dr.opaque(f32, half)) / dr.opaque(f32, max(taper, 1e-6)), 0.0, 1.0)
    return 0.5 + 0.5 * dr.cos(t * np.pi)


class BeamPattern:
    """One-way amplitude pattern of the pulse that a lane belongs to."""

    def __init__(self, antenna: Antenna, pulses: PulseBatch, pulse: Any, mi: Any, dr: Any) -> None:
        assert pulses.azimuth_axis is not None and pulses.elevation_axis is not None
        assert pulses.boresight is not None
        self.antenna, self.dr = antenna, dr
        self.azimuth = mi.Vector3f(dr.gather(mi.Vector3d, vector64(mi, pulses.azimuth_axis), pulse))
        self.elevation = mi.Vector3f(dr.gather(mi.Vector3d, vector64(mi, pulses.elevation_axis), pulse))
        self.boresight = mi.Vector3f(dr.gather(mi.Vector3d, vector64(mi, pulses.boresight), pulse))

    def one_way(self, u: Any) -> Any:
        """Relative one-way amplitude towards the unit vector ``u`` (antenna to scene); zero behind the aperture."""
        dr = self.dr
        two_way = self.antenna.two_way_amplitude(dr.dot(u, self.azimuth), dr.dot(u, self.elevation), dr)
        return dr.select(dr.dot(u, self.boresight) > 0.0, dr.sqrt(dr.maximum(two_way, 0.0)), 0.0)


__all__ = ["BeamPattern", "fade"]
