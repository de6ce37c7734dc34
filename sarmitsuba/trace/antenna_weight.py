"""Weight of a ray by its direction and by where it starts: the antenna pattern and the launch window's fade-out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.backend import device_numbers, dr, mi
from sarmitsuba.trace.device_arrays import vector_rows

if TYPE_CHECKING:
    from sarmitsuba.radar.antenna import Antenna
    from sarmitsuba.trace.launch import PulseBatch


# sines of two legs that differ by less are one direction in float32; gain of a block's azimuth pattern that is none
_APART, _DARK = 1e-6, 1e-3


def fade(x: mi.Float, half: float, taper: float) -> mi.Float:
    """1 within ``half``, raised-cosine fall to 0 over ``taper`` beyond it; 1 everywhere where ``taper`` is 0."""
    # one kernel for both: a window with a fade-out and one without
    width = dr.opaque(mi.Float, taper if taper > 0.0 else np.inf)
    t = dr.clip((dr.abs(x) - dr.opaque(mi.Float, half)) / width, 0.0, 1.0)
    return 0.5 + 0.5 * dr.cos(t * np.pi)


class BeamPattern:
    """One-way amplitude pattern of the pulse that a lane belongs to.

    In a block of pulses only the elevation pattern counts: each pulse's own azimuth pattern comes from the synthesis
    (:func:`sarmitsuba.echo.block.synthesise`), at the mean of the path's first and last leg. What two legs apart have
    over that mean is :meth:`received`'s.

    Parameters
    ----------
    first_leg : (lanes,) directions in which the rays start, where they may come back from another; else None
    """

    def __init__(
        self, antenna: Antenna, pulses: PulseBatch, pulse: mi.UInt32, first_leg: mi.Vector3f | None
    ) -> None:
        assert pulses.elevation_axis is not None and pulses.boresight is not None
        self.antenna = antenna
        self.azimuth = self.first_sine = None
        if not pulses.azimuth_later or first_leg is not None:
            assert pulses.azimuth_axis is not None
            self.azimuth = mi.Vector3f(dr.gather(mi.Vector3d, vector_rows(pulses.azimuth_axis), pulse))
        self.elevation = mi.Vector3f(dr.gather(mi.Vector3d, vector_rows(pulses.elevation_axis), pulse))
        self.boresight = mi.Vector3f(dr.gather(mi.Vector3d, vector_rows(pulses.boresight), pulse))
        if pulses.azimuth_later and first_leg is not None:
            self.first_sine = dr.dot(first_leg, self.azimuth)
        self.later = pulses.azimuth_later

    def one_way(self, u: mi.Vector3f) -> mi.Float:
        """Relative one-way amplitude towards the unit vector ``u`` (antenna to scene); zero behind the aperture."""
        azimuth = mi.Float(0.0) if self.later else dr.dot(u, self.azimuth)
        two_way = self._two_way(azimuth, dr.dot(u, self.elevation))
        return dr.select(dr.dot(u, self.boresight) > 0.0, dr.sqrt(dr.maximum(two_way, 0.0)), 0.0)

    def received(self, u: mi.Vector3f) -> mi.Float:
        r"""As :meth:`one_way`, for the last leg of a path.

        Where the azimuth pattern g comes later, at the mean of both legs, this carries what the legs' own have over it,

        .. math:: \sqrt{g(s_1) g(s_2)} / g((s_1 + s_2) / 2)

        which for a Gaussian is the same for all pulses of the block. It is held at 1 where g is below -60 dB there, and
        bounded by 2: next to a null it is not.
        """
        gain = self.one_way(u)
        if self.first_sine is None:
            return gain
        last_sine = dr.dot(u, self.azimuth)
        zero = mi.Float(0.0)
        mean = self._two_way(0.5 * (self.first_sine + last_sine), zero)
        own = dr.sqrt(dr.maximum(self._two_way(self.first_sine, zero) * self._two_way(last_sine, zero), 0.0))
        apart = (dr.abs(last_sine - self.first_sine) > _APART) & (mean > _DARK)
        return gain * dr.select(apart, dr.minimum(own / dr.maximum(mean, _DARK), 2.0), 1.0)

    def _two_way(self, sin_azimuth: mi.Float, sin_elevation: mi.Float) -> mi.Float:
        """Relative two-way amplitude."""
        numbers = device_numbers(mi.Float, self.antenna.numbers)
        return self.antenna.normalised(sin_azimuth, sin_elevation, numbers, dr)


__all__ = ["BeamPattern", "fade"]
