"""Places at which a focused image shows scatterers, and the antenna that sees them at the middle of their aperture."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.motion import STILL, Motion
from sarmitsuba.signal.focusing.aperture_weights import flight
from sarmitsuba.signal.image import ImageGrid

# Newton steps; misfit of range and of range over the aperture, m, at which they end, and largest of a solution
_STEPS, _CLOSE, _ENOUGH = 8, 1e-7, 1e-4


@dataclass(frozen=True, eq=False)
class ImagePlacement:
    r"""Places of scatterers in an image: where its plane has the same history of range.

    A place Q of the image plane has the ranges of a point P in two pulses, a quarter of the aperture before and after
    its middle, :math:`R_i(Q) = R_i(P)`; solved by Newton's method. The aperture is that of the point itself where
    pixels have their own, else the whole track. Bistatic ranges are half the way there and back. The ranges of P are
    those of the track that is flown, those of Q of the recorded one, which the focuser uses.

    Parameters
    ----------
    grid : the image's, in the frame of ``radar``
    radar : of the image

    Notes
    -----
    Exact for straight tracks. On a curved one a point off the plane has no such place for all pulses: it is blurred,
    and this is the middle of it. Ignores range shifts by the Doppler frequency within a pulse, and the antenna's
    pattern: a side of the track that it does not look to is shown where the other side is.
    """

    grid: ImageGrid
    radar: Radar

    @cached_property
    def _flown(self) -> Radar:
        return self.radar.start_stop()

    @cached_property
    def _told(self) -> Radar:
        return self.radar.as_recorded().start_stop()

    def aperture(self, points: F64) -> tuple[I64, I64]:
        """First and last pulse (n,) of the apertures of points (n, 3), m; equal where a point has no pulse or one."""
        radar = self._told
        count = radar.track.n_pulses
        if not np.isfinite(radar.half_aperture):
            return np.zeros(len(points), dtype=np.int64), np.full(len(points), count - 1)
        first = self._first_behind(points, radar.half_aperture)
        last = np.maximum(self._first_behind(points, -radar.half_aperture) - 1, first)
        return np.minimum(first, count - 1), np.minimum(last, count - 1)

    def _first_behind(self, points: F64, sine: float) -> I64:
        """First pulse (n,) at which points lie behind a direction, given by its sine from the boresight; by halving."""
        forward, boresight, _ = flight(self._told)
        position = self._told.track.position
        low, high = np.zeros(len(points), dtype=np.int64), np.full(len(points), len(position))
        while (low < high).any():
            middle = np.minimum((low + high) // 2, len(position) - 1)
            line = points - position[middle]
            ahead = np.einsum("ij,ij->i", line, forward[middle]) / np.linalg.norm(line, axis=1)
            behind = ahead - boresight[middle] <= sine
            high = np.where(behind & (low < high), middle, high)
            low = np.where(~behind & (low < high), middle + 1, low)
        return low

    def antenna(self, points: F64) -> F64:
        """Position (n, 3), m, of the transmitter as flown, at the middle of the apertures of points (n, 3), m."""
        first, last = self.aperture(points)
        middle = 0.5 * (first + last)
        position = self._flown.track.position
        low = np.floor(middle).astype(np.int64)
        high = np.minimum(low + 1, len(position) - 1)
        return np.asarray(position[low] + (middle - low)[:, None] * (position[high] - position[low]))

    def locate(self, points: F64, motion: Motion = STILL) -> tuple[F64, F64]:
        """Azimuth and range (n,), m of the grid, at which the image shows points (n, 3), m, given at time zero.

        NaN where no place has that history (below the track).
        """
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        grid, track = self.grid, self._told.track
        first, last = self.aperture(points)
        middle, apart = (first + last + 1) // 2, np.maximum(1, (last - first + 1) // 4)
        ends = (0, track.n_pulses - 1)
        pulses = np.stack([np.clip(middle - apart, *ends), np.clip(middle + apart, *ends)], axis=1)
        moved = points[:, None, :]
        if not motion.still:
            moved = moved + motion.displacement(self._flown.track.time[pulses])
        wanted = _history(_ranges(self._flown, moved, pulses)[0])
        # a straight level track: the same azimuth and the same range of closest approach
        base, along, across = track.center_position, track.along, self._told.across
        beside = (points - base) @ across
        square = beside**2 + (base[2] - points[:, 2]) ** 2 - (base[2] - grid.height) ** 2
        flat = np.array([base[0], base[1], grid.height])
        place = flat + ((points - base) @ along)[:, None] * along
        place += np.sqrt(np.maximum(square, 1.0))[:, None] * across
        axes = np.stack([along, across], axis=1)
        miss = np.empty_like(wanted)
        left = np.arange(len(points))
        for step in range(_STEPS + 1):
            ranges, gradient = _ranges(self._told, place[left][:, None, :], pulses[left])
            miss[left] = _history(ranges) - wanted[left]
            far = ~(np.abs(miss[left]).max(axis=1) <= _CLOSE)
            left, gradient = left[far], gradient[far]
            if step == _STEPS or not left.size:
                break
            slope = _history(gradient @ axes)
            steep = np.abs(np.linalg.det(slope)) > 1e-12
            slope[~steep] = np.eye(2)
            place[left] -= np.linalg.solve(slope, miss[left][..., None])[..., 0] @ axes.T
        place[~(np.abs(miss).max(axis=1, initial=0.0) <= _ENOUGH)] = np.nan
        offset = place - grid.origin
        offset[:, 2] = grid.height - grid.origin[2]
        azimuth, ground = offset @ grid.along, offset @ grid.across
        return azimuth, ground if grid.kind == "ground" else np.hypot(ground, offset[:, 2])


def _ranges(radar: Radar, points: F64, pulses: I64) -> tuple[F64, F64]:
    """Slant range (n, 2) of points (n, 1 or 2, 3) in two pulses (n, 2), m, and its gradient (n, 2, 3)."""
    ranges, gradient = 0.0, 0.0
    for track in radar.tracks:
        line = points - track.position[pulses]
        distance = np.linalg.norm(line, axis=-1)
        ranges = ranges + distance
        gradient = gradient + line / distance[..., None]
    share = 1.0 / len(radar.tracks)
    return np.asarray(share * ranges), np.asarray(share * gradient)


def _history(ranges: F64) -> F64:
    """Mean and difference over the two pulses (second axis) of ranges, in that order on the second axis."""
    return np.stack([ranges.mean(axis=1), ranges[:, 1] - ranges[:, 0]], axis=1)
