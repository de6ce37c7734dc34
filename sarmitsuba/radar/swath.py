"""Swath of the radar: the image's box, its slant ranges and Doppler bandwidth, the receive window."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.radar import ReceiveWindow

# range cells of margin on both sides of the window, for side lobes and interpolation
_MARGIN_CELLS = 16


@dataclass(frozen=True, eq=False)
class Box:
    """Box with vertical sides aligned with the flight direction.

    Parameters
    ----------
    origin : (3,) float64, m, scene frame; the aim point
    axes : (3, 3) float64; rows are the unit vectors along, across (to the look side) and up
    low, high : (3,) float64, m, corners in these axes from ``origin``
    """

    origin: F64
    axes: F64
    low: F64
    high: F64

    def local(self, points: F64) -> F64:
        """Scene-frame points (n, 3) in the box's axes."""
        return np.asarray((points - self.origin) @ self.axes.T)

    def samples(self) -> F64:
        """Corners and midpoints of the edges, (18, 3), in the box's axes, m."""
        mid = 0.5 * (self.low + self.high)
        grid = np.meshgrid(
            *(np.array([self.low[i], mid[i], self.high[i]]) for i in range(2)),
            np.array([self.low[2], self.high[2]]),
            indexing="ij",
        )
        return np.stack([g.ravel() for g in grid], axis=1)

    def slant_ranges(self, position: F64) -> tuple[F64, F64]:
        """Shortest and longest distance of the box from (n, 3) scene-frame positions, (n,) float64, m."""
        q = self.local(position)
        nearest = np.clip(q, self.low, self.high)
        farthest = np.where(np.abs(q - self.low) > np.abs(q - self.high), self.low, self.high)
        return np.linalg.norm(q - nearest, axis=1), np.linalg.norm(q - farthest, axis=1)

    def overlap(self, other_low: F64, other_high: F64) -> tuple[F64, F64] | None:
        """Corners of the intersection with another box in the same axes; None when they do not overlap."""
        low, high = np.maximum(self.low, other_low), np.minimum(self.high, other_high)
        return None if (low > high).any() else (low, high)


def doppler_bandwidth(
    position: F64, velocity: F64, box: Box, wavelength: float, *, instantaneous: bool = False
) -> float:
    r"""Doppler bandwidth of a box seen from several positions, Hz.

    .. math:: f_D = 2 v \cdot u / \lambda

    Parameters
    ----------
    position, velocity : (n, 3) float64, m and m/s, scene frame
    box : of the scene
    wavelength : m
    instantaneous : largest spread at one position in place of the spread over all positions
    """
    points = box.samples() @ box.axes + box.origin
    line = points[None, :, :] - position[:, None, :]
    line /= np.maximum(np.linalg.norm(line, axis=2, keepdims=True), 1e-30)
    frequency = 2.0 / wavelength * np.einsum("npc,nc->np", line, velocity)
    if instantaneous:
        return float(np.ptp(frequency, axis=1).max())
    return float(np.ptp(frequency))


def beam_bandwidth(antenna: Antenna, speed: float, wavelength: float, half_aperture: float = np.inf) -> float:
    r"""Pulse rate (Hz) above which the beam, to its first nulls, is not aliased into the processed band.

    .. math:: f = \frac{2 v}{\lambda} (s_0 + \min(s_0, s_a))

    s_0 the sine to the first null and s_a ``half_aperture``; infinite when isotropic. Without ``half_aperture`` it is
    the Doppler spread of the whole beam at one instant.
    """
    if not antenna.directive:
        return np.inf
    null = antenna.nulls[0]
    return 2.0 * speed / wavelength * (null + min(null, half_aperture))


def receive_window(
    positions: Sequence[F64],
    center: F64,
    box: Box,
    range_cell: float,
    sample_spacing: float,
    near_range: float = 0.0,
    far_range: float = 0.0,
) -> ReceiveWindow:
    """Receive window that contains the echoes of a box from every pulse.

    The start is the same for all pulses unless the range of the aim point migrates by more than a quarter of
    the swath; then it follows that range in whole samples.

    Parameters
    ----------
    positions : (n_pulses, 3) float64, m, scene frame, of every antenna: of one, or of transmitter and receiver
    center : (3,) mid-aperture position
    box : to be covered; its height is added at both ends for multiple bounces
    range_cell, sample_spacing : m
    near_range, far_range : given limits at mid-aperture, m; 0 = automatic
    """
    ranges = [(*box.slant_ranges(p), np.linalg.norm(p - box.origin, axis=1)) for p in positions]
    near, far, to_aim = ranges[0] if len(ranges) == 1 else np.mean(ranges, axis=0)
    follow = np.zeros_like(to_aim)
    if np.ptp(to_aim) > 0.25 * float((far - near).max()):
        mid = float(np.linalg.norm(center - box.origin))
        follow = np.round((to_aim - mid) / sample_spacing) * sample_spacing
    margin = max(_MARGIN_CELLS * range_cell, float(box.high[2] - box.low[2]))
    start = near_range or float((near - follow).min()) - margin
    stop = far_range or float((far - follow).max()) + margin
    start = max(start, sample_spacing - float(follow.min()))
    n = int(np.ceil((stop - start) / sample_spacing)) + 1
    if not far_range:
        n = fast_length(max(n, 2))
    return ReceiveWindow(start + follow, sample_spacing, n)


def fast_length(n: int) -> int:
    """Smallest whole number from ``n`` on without prime factors above 11, for which SciPy's transforms are fast.

    That of ``scipy.fft.next_fast_len``, whose import takes longer than the loading of a small scene.
    """
    while True:
        rest = n
        for prime in (2, 3, 5, 7, 11):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return n
        n += 1
