"""The antenna's trajectory: one position and velocity per pulse, float64, scene frame.

The effective velocity is that of the rotation of the line of sight, on a straight track or from an orbit.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.machine.regular_files import read_text
from sarmitsuba.radar.utc import DEFAULT_EPOCH, epoch_of_stamp, is_time, seconds_of, utc_after, utc_of

_FARTHEST = 1e12  # m, bound of positions in a file


def numbers_of(pulses: slice | ArrayLike, n: int) -> NDArray[np.intp]:
    """Pulse numbers that a slice, numbers or a mask select from ``n``; RadarError where the selection is invalid."""
    try:
        return np.arange(n)[pulses if isinstance(pulses, slice) else np.asarray(pulses)]
    except IndexError as error:
        raise RadarError(
            f"pulses: {error}; give a slice, numbers from 0 to {n - 1}, or a mask of {n}"
        ) from None


@dataclass(frozen=True, eq=False)
class Track:
    """Antenna phase-centre positions at the pulse times (stop-and-go: at rest during one pulse).

    Parameters
    ----------
    time : (n_pulses,) float64, s, strictly increasing
    position : (n_pulses, 3) float64, m, scene frame (east, north, up)
    velocity : (n_pulses, 3) float64, m/s, scene frame
    epoch : UTC of time zero, datetime64[ns]; an ISO 8601 text or a ``datetime`` with a time zone is converted

    Notes
    -----
    Ignores the antenna's motion within one pulse and between transmission and reception.
    """

    time: F64
    position: F64
    velocity: F64
    epoch: np.datetime64 = DEFAULT_EPOCH

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "epoch", utc_of(self.epoch))
        except ValueError as error:
            raise RadarError(f"track: epoch: {error}") from None
        n = self.time.size
        if n < 1 or self.time.ndim != 1 or self.position.shape != (n, 3) or self.velocity.shape != (n, 3):
            raise RadarError(
                f"track: time {self.time.shape}, position {self.position.shape} and velocity "
                f"{self.velocity.shape} must be (n,), (n, 3), (n, 3) with n >= 1"
            )
        if not (np.isfinite(self.time).all() and np.isfinite(self.position).all()):
            raise RadarError("track: time and position must be finite")
        if n > 1 and not (np.diff(self.time) > 0).all():
            raise RadarError("track: pulse times must increase strictly; sort the pulses by time")

    @property
    def utc(self) -> NDArray[np.datetime64]:
        """(n_pulses,) datetime64[ns], UTC of the pulses."""
        return np.array([utc_after(self.epoch, float(time)) for time in self.time], dtype="datetime64[ns]")

    @property
    def n_pulses(self) -> int:
        """Number of pulses."""
        return int(self.time.shape[0])

    @property
    def center_index(self) -> int:
        """Index of the pulse at the middle of the aperture."""
        return self.n_pulses // 2

    @property
    def center_position(self) -> F64:
        """Mid-aperture position, the mean of the two middle pulses when their number is even."""
        n = self.n_pulses
        return np.asarray(0.5 * (self.position[(n - 1) // 2] + self.position[n // 2]))

    @property
    def prf(self) -> float:
        """Pulse repetition frequency, Hz, from the median interval of two or more pulses."""
        return 1.0 / float(np.median(np.diff(self.time)))

    @property
    def along(self) -> F64:
        """Horizontal unit vector of flight at mid-aperture, from the velocity."""
        v = self.velocity[self.center_index] * np.array([1.0, 1.0, 0.0])
        norm = float(np.linalg.norm(v))
        if norm == 0.0:
            return np.array([0.0, 1.0, 0.0])
        return np.asarray(v / norm)

    def __repr__(self) -> str:
        span = f"{float(self.time[-1] - self.time[0]):.4g} s"
        return f"Track({self.n_pulses} pulses in {span}, {'straight' if self.is_straight else 'curved'})"

    @property
    def is_straight(self) -> bool:
        """True when every pulse lies on one uniformly sampled line, to a micrometre."""
        n = self.n_pulses
        if n < 3:
            return True
        line = np.linspace(0.0, 1.0, n)[:, None]
        fit = self.position[0] + line * (self.position[-1] - self.position[0])
        return bool(np.abs(fit - self.position).max() < 1e-6)

    def moved(self, shift: ArrayLike) -> "Track":
        """Parallel track, every position shifted by ``shift`` (3,), m."""
        return replace(self, position=self.position + np.asarray(shift, dtype=np.float64))

    def of_pulses(self, pulses: slice | ArrayLike) -> "Track":
        """Track of selected pulses: a slice, pulse numbers or a mask.

        Raises
        ------
        RadarError : no pulse is left, or the pulses do not follow each other in time
        """
        pick = numbers_of(pulses, self.n_pulses)
        return Track(self.time[pick], self.position[pick], self.velocity[pick], self.epoch)

    @staticmethod
    def straight(center: ArrayLike, velocity: ArrayLike, prf: float, n_pulses: int) -> "Track":
        """Uniform straight track; time zero and ``center`` are at mid-aperture.

        Parameters
        ----------
        center, velocity : (3,) float, m and m/s, scene frame
        prf : pulse repetition frequency, Hz
        n_pulses : number of pulses
        """
        t = np.asarray((np.arange(n_pulses) - 0.5 * (n_pulses - 1)) / prf, dtype=np.float64)
        v = np.asarray(velocity, dtype=np.float64)
        p = np.asarray(np.asarray(center, dtype=np.float64) + t[:, None] * v, dtype=np.float64)
        return Track(t, p, np.broadcast_to(v, p.shape).copy())

    @staticmethod
    def from_csv(path: Path | str) -> "Track":
        """Read one pulse per line: ``time_s, x_m, y_m, z_m``, comma separated, ``#`` comments, one optional header.

        Times are seconds, or UTC in ISO 8601, which count from the first pulse. Velocities come from a cubic spline
        through the positions.
        """
        path = Path(path)
        try:
            lines = [ln for ln in read_text(path).splitlines() if ln.strip() and ln.lstrip()[0] != "#"]
        except OSError as error:
            raise RadarError(f"{path}: cannot read the track: {error.strerror}") from error
        if lines and not is_time(lines[0].split(",")[0]):
            lines = lines[1:]
        try:
            first = lines[0].split(",")[0] if lines else "0"
            epoch = epoch_of_stamp(first)
            cells = [ln.split(",") for ln in lines]
            rows = np.array(
                [[seconds_of(c[0], first), *(float(each) for each in c[1:])] for c in cells], dtype=np.float64
            )
        except ValueError as error:
            raise RadarError(f"{path}: {one_line(error)}; every line needs time_s, x_m, y_m, z_m") from error
        if rows.ndim != 2 or rows.shape[1] != 4:
            raise RadarError(f"{path}: every line needs four numbers: time_s, x_m, y_m, z_m")
        if np.abs(rows[:, 1:]).max() > _FARTHEST:
            raise RadarError(
                f"{path}: a position lies beyond {_FARTHEST:g} m; give metres in the scene's frame"
            )
        try:
            with np.errstate(over="ignore"):
                return Track.from_samples(rows[:, 0], rows[:, 1:], epoch)
        except ValueError as error:  # times so close to each other that velocities overflow
            raise RadarError(f"{path}: {one_line(error)}; give times in s") from error

    @staticmethod
    def from_samples(time: ArrayLike, position: ArrayLike, epoch: np.datetime64 = DEFAULT_EPOCH) -> "Track":
        """Track through given pulse times and positions; velocities from a cubic spline (zero for one pulse)."""
        t = np.asarray(time, dtype=np.float64)
        p = np.asarray(position, dtype=np.float64)
        if t.size > 1 and (np.diff(t) > 0).all() and np.isfinite(p).all():
            v = (
                np.asarray(scipy.interpolate.CubicSpline(t, p, axis=0)(t, 1))
                if t.size > 2
                else np.gradient(p, t, axis=0)
            )
        else:
            v = np.zeros_like(p)
        return Track(t, p, v, epoch)


def range_acceleration(track: Track, line: F64) -> F64:
    r"""Squared effective velocity of points at rest, half the second derivative of R^2, (n_pulses,) m^2/s^2.

    .. math:: \frac{1}{2} \frac{d^2 R^2}{dt^2} = |v|^2 - L \cdot \dot v

    Parameters
    ----------
    track : its velocities give the accelerations, by differences
    line : (n_pulses, 3) float64, m, from the antenna to the point
    """
    acceleration = np.zeros_like(track.velocity)
    if track.n_pulses > 1:
        acceleration = np.gradient(track.velocity, track.time, axis=0)
    return np.asarray(np.sum(track.velocity**2, axis=1) - np.einsum("ij,ij->i", line, acceleration))


# Newton's steps to a time of zero Doppler; each leaves a hundredth of the error of the one before
_STEPS = 4


def zero_doppler_delay(track: Track, points: F64) -> F64:
    r"""Time from the middle of a track until points lie square to the velocity, (n,) float64, s.

    .. math:: (p - x(t)) \cdot v(t) = 0, \quad x(t) = x + v t + a t^2 / 2

    Parameters
    ----------
    track : gives the state in its middle, and the mean acceleration a
    points : (n, 3) float64, m, scene frame

    Notes
    -----
    Ignores the change of the acceleration: in orbit 2 mm of the position 2 s away.
    """
    first, last = track.position[[0, -1]]
    v0, v1 = track.velocity[[0, -1]]
    span = float(track.time[-1] - track.time[0])
    a = (v1 - v0) / span if span > 0.0 else np.zeros(3)
    x, v = 0.5 * (first + last) - a * span**2 / 8.0, 0.5 * (v0 + v1)
    slope = float(v @ v) - (points - x) @ a
    time = np.zeros(len(points))
    for _ in range(_STEPS):
        here, motion = x + np.outer(time, v) + 0.5 * np.outer(time**2, a), v + np.outer(time, a)
        time = time + np.einsum("ni,ni->n", points - here, motion) / slope
    return np.asarray(time)


def effective_velocity_ratio(track: Track, point: F64, pulse: int) -> float:
    r"""Squared ratio of the effective velocity to the antenna's speed.

    .. math:: V_{eff}^2 / V^2

    It is the rate of the sine of a point's direction along the flight over that from a straight track of the same
    speed: 1 on a straight track, and from an orbit about the footprint's speed over the satellite's.

    Parameters
    ----------
    track : in the scene frame
    point : (3,) float64, m, scene frame
    pulse : index

    Notes
    -----
    Exact at zero Doppler; ignores the change of speed elsewhere.
    """
    near = track.of_pulses(slice(max(pulse - 1, 0), pulse + 2))
    here = pulse - max(pulse - 1, 0)
    line = np.asarray(point - near.position)
    half = float(range_acceleration(near, line)[here])
    return half / float(np.sum(near.velocity[here] ** 2))
