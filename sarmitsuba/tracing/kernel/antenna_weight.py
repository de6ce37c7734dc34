"""Antenna pattern along a ray, and the taper at the edge of the launch window."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.machine.backend import device_numbers, dr, mi
from sarmitsuba.tracing.kernel.device_arrays import vector_rows

if TYPE_CHECKING:
    from sarmitsuba.radar.antenna import Antenna
    from sarmitsuba.tracing.kernel.launch import PulseBatch


# step of the derivative of a pattern, over its half-power half-width; two-way amplitude that counts as zero in it
_STEP, _BLACK = 0.01, 1e-12
# sines of the directions of two legs closer than this count as equal (float32); azimuth gain that counts as zero
_APART, _DARK = 1e-6, 1e-3


def fade(x: mi.Float, half: float, taper: float) -> mi.Float:
    """Raised-cosine taper: 1 within ``half``, falling to 0 over ``taper`` beyond it; 1 everywhere if ``taper`` is 0."""
    # one kernel for both: a window with a fade-out and one without
    width = dr.opaque(mi.Float, taper if taper > 0.0 else np.inf)
    t = dr.clip((dr.abs(x) - dr.opaque(mi.Float, half)) / width, 0.0, 1.0)
    return 0.5 + 0.5 * dr.cos(t * np.pi)


class BeamPattern:
    """One-way amplitude pattern of the pulse that a lane belongs to.

    In a block of pulses only the elevation pattern counts: each pulse's azimuth pattern comes from the synthesis
    (:func:`.raw.block.synthesise`), at the mean direction of the path's first and last leg. The error of
    that mean for legs in different directions is corrected in :meth:`received`.

    Parameters
    ----------
    first_leg : (lanes,) launch directions of the rays; None where every echo returns along its launch direction
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
        r"""Relative one-way amplitude of the last leg of a path; as :meth:`one_way`.

        Where the azimuth pattern g is applied later, at the mean direction of both legs, this holds the correction

        .. math:: \sqrt{g(s_1) g(s_2)} / g((s_1 + s_2) / 2)

        which for a Gaussian pattern is the same for all pulses of the block. It is 1 where g at the mean is below
        -60 dB, and at most 2: the correction diverges next to a null.
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

    def rates(self, u: mi.Vector3f) -> tuple[mi.Float, mi.Float]:
        r"""Relative derivatives of :meth:`one_way` by the boresight's angles in azimuth and elevation, 1/rad.

        A turn of the boresight :math:`\mathbf b` changes the sine along its axis by :math:`-\mathbf u \cdot \mathbf b`.
        That in azimuth is zero where the azimuth pattern is applied later.
        """
        azimuth = mi.Float(0.0) if self.later else dr.dot(u, self.azimuth)
        elevation, turn = dr.dot(u, self.elevation), -0.5 * dr.dot(u, self.boresight)
        along = mi.Float(0.0) if self.later else self._slope(azimuth, elevation, 0) * turn
        return along, self._slope(azimuth, elevation, 1) * turn

    def received_rates(self, u: mi.Vector3f) -> tuple[mi.Float, mi.Float]:
        """The same of :meth:`received`."""
        azimuth, elevation = self.rates(u)
        if self.first_sine is None:
            return azimuth, elevation
        zero, last = mi.Float(0.0), dr.dot(u, self.azimuth)
        apart = dr.abs(last - self.first_sine) > _APART
        ends = 0.5 * (self._slope(self.first_sine, zero, 0) + self._slope(last, zero, 0))
        change = self._slope(0.5 * (self.first_sine + last), zero, 0) - ends
        return azimuth + dr.select(apart, change * dr.dot(u, self.boresight), 0.0), elevation

    def _slope(self, sin_azimuth: mi.Float, sin_elevation: mi.Float, axis: int) -> mi.Float:
        """Derivative of the logarithm of the two-way amplitude by the sine along an axis; zero where it is dark."""
        step = dr.opaque(mi.Float, _STEP / self.antenna.per_width[axis])
        aside = (step, mi.Float(0.0)) if axis == 0 else (mi.Float(0.0), step)
        below = self._two_way(sin_azimuth - aside[0], sin_elevation - aside[1])
        above = self._two_way(sin_azimuth + aside[0], sin_elevation + aside[1])
        own = self._two_way(sin_azimuth, sin_elevation)
        slope = (above - below) * 0.5 / (step * dr.maximum(own, _BLACK))
        return dr.select(own > _BLACK, slope, 0.0)

    def _two_way(self, sin_azimuth: mi.Float, sin_elevation: mi.Float) -> mi.Float:
        """Relative two-way amplitude."""
        numbers = device_numbers(mi.Float, self.antenna.numbers)
        return self.antenna.normalise(sin_azimuth, sin_elevation, numbers, dr)
