"""Curvature of slant ranges within a block of pulses, fitted to the track's geometry."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.raw.threads import one_blas_thread

_RANGE_DEGREE, _RATE_DEGREE = 4, 3
_HELD = (
    1.25  # beyond this multiple of the fitted span the polynomials are constant: only kernel tails lie there
)


@dataclass(frozen=True, eq=False)
class Curvature:
    r"""Curvature: slant range beyond ``R0 + range_rate tau``, per pulse, as a function of range plus one of range rate.

    .. math:: c(R_0, \dot R, t_k) = \sum_n a_{nk} x^n + \sum_{n \ge 1} b_{nk} y^n, \quad
              x = (R_0 - R_c) / R_s, \; y = (\dot R - \dot R_c) / \dot R_s

    Parameters
    ----------
    range_center, range_scale : m
    range_rate_center, range_rate_scale : m/s
    by_range : (n_degree + 1, K) float64, m, constant first
    by_range_rate : (n_degree, K) float64, m, without a constant
    """

    range_center: float
    range_scale: float
    range_rate_center: float
    range_rate_scale: float
    by_range: F64
    by_range_rate: F64

    def of_range(self, range_offset: NDArray[np.floating]) -> F64:
        """Part by range at the offsets R0 (n,), m: (K, n)."""
        x = np.clip((range_offset - self.range_center) / self.range_scale, -_HELD, _HELD)
        return np.asarray(np.polynomial.polynomial.polyval(x, self.by_range))

    def of_range_rate(self, range_rate: NDArray[np.floating]) -> F64:
        """Part by range rate at (n,) m/s: (K, n)."""
        y = np.clip((range_rate - self.range_rate_center) / self.range_rate_scale, -_HELD, _HELD)
        return np.asarray(y * np.polynomial.polynomial.polyval(y, self.by_range_rate))

    @property
    def slope(self) -> F64:
        """Derivative of the part by range at the centre, (K,)."""
        return np.asarray(self.by_range[1] / self.range_scale)


@dataclass(frozen=True, eq=False)
class KeyState:
    """State of the antennas at a block's key pulse: one antenna, or transmitter and receiver.

    Parameters
    ----------
    key : number of the pulse
    position, velocity : (n_antennas, 3) float64, m and m/s, scene frame; the velocity is that of the best line through
        the block's positions
    tau : (K,) float64, s, effective time of every pulse on that line, from the key pulse
    """

    key: int
    position: F64
    velocity: F64
    tau: F64

    def slant_range(self, point: F64) -> float:
        """Slant range of a point (3,), m: mean of the distances to both antennas."""
        return float(np.linalg.norm(point - self.position, axis=-1).mean())

    def rate(self, point: F64) -> float:
        """Range rate of a point (3,), m/s."""
        legs = self.position - point
        return float((np.einsum("ai,ai->a", legs, self.velocity) / np.linalg.norm(legs, axis=-1)).mean())


def key_state(radar: Radar, start: int, stop: int) -> KeyState:
    """State at a block's key pulse, from the best line through its pulses.

    The times are those of the projections of the pulse positions onto the line, which also covers antennas at rest or
    with varying speed. The residual is then small, as the grid over range rates requires.
    """
    key, tracks = start + (stop - start) // 2, radar.tracks
    positions = np.concatenate([track.position[start:stop] for track in tracks], axis=1)
    position, time = positions[key - start], radar.track.time
    tau = time[start:stop] - time[key]
    if stop - start < 2:
        velocity = np.concatenate([track.velocity[key] for track in tracks])
    else:
        centered = tau - tau.mean()
        velocity = centered @ (positions - position) / (centered @ centered)
        square = float(velocity @ velocity)
        if square > 0.0:
            tau = (positions - position) @ velocity / square
    return KeyState(key, position.reshape(-1, 3), np.asarray(velocity).reshape(-1, 3), tau)


def sample_paths(box: F64, antenna: F64, extra: float) -> tuple[F64, F64]:
    """Sample paths of the box as pairs of points, slant range = mean of the distances to both.

    Direct returns and corner reflectors have identical points. A mirror chain shifts its image point along the line
    of sight, behind the first hit, by at most ``2 * extra`` when only one of the two legs is mirrored, ``extra``
    when both are.
    """
    axes = [np.linspace(box[0, i], box[1, i], n) for i, n in enumerate((7, 7, 3))]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    if extra <= 0.0:
        return points, points
    sight = points - antenna
    sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
    rng = np.random.default_rng(0)
    partner = np.clip(points + rng.uniform(-2.0 * extra, 2.0 * extra, points.shape), box[0], box[1])
    images = [points, points + 0.5 * extra * sight, points + extra * sight, points + 2.0 * extra * sight]
    others = [points, points + 0.5 * extra * sight, points + extra * sight, partner]
    # longer paths than allowed are excluded
    a, b = np.concatenate(images), np.concatenate(others)
    half = 0.5 * (np.linalg.norm(a - antenna, axis=-1) + np.linalg.norm(b - antenna, axis=-1))
    keep = half <= np.linalg.norm(points - antenna, axis=-1).max() + extra
    return a[keep], b[keep]


@dataclass(frozen=True, eq=False)
class CurvatureFit:
    """Result of :func:`fit_curvature`.

    Parameters
    ----------
    curvature : the fitted polynomials
    range_rate : (n_samples,) float64, m/s, of the sample paths
    error : (n_samples,) float64, rad^2, mean square phase error over the block's pulses
    """

    curvature: Curvature
    range_rate: F64
    error: F64


def fit_curvature(radar: Radar, start: int, stop: int, reference: F64, a: F64, b: F64) -> CurvatureFit:
    """Curvature fitted to the exact slant ranges of sample paths; a, b (n_samples, 3)."""
    state = key_state(radar, start, stop)
    tau = state.tau
    # with two antennas the incident leg is the transmitter's, the scattered leg the receiver's
    out, back = 0, len(radar.tracks) - 1

    def distance(p: F64, antenna: int) -> F64:
        track = radar.tracks[antenna].position[start:stop]
        leg = [
            p[:, None, i] - track[:, i] for i in range(3)
        ]  # summed over three axes, norm() takes four times as long
        return np.asarray(np.sqrt(leg[0] * leg[0] + leg[1] * leg[1] + leg[2] * leg[2]))

    def slope(p: F64, antenna: int) -> F64:
        d = state.position[antenna] - p
        return np.asarray(d @ state.velocity[antenna] / np.linalg.norm(d, axis=-1))

    there = reference[None]
    offset = 0.5 * (distance(a, out) + distance(b, back))
    offset -= 0.5 * (distance(there, out) + distance(there, back))
    range0 = offset[:, state.key - start]
    range_rate = 0.5 * (slope(a, out) + slope(b, back)) - 0.5 * (slope(there, out) + slope(there, back))
    residual = offset - range0[:, None] - range_rate[:, None] * tau

    def center_scale(v: F64, least: float) -> tuple[float, float]:
        return 0.5 * float(v.max() + v.min()), max(0.5 * float(np.ptp(v)), least)

    rc, rs = center_scale(range0, radar.waveform.range_cell)
    vc, vs = center_scale(range_rate, radar.waveform.wavelength / max(4.0 * float(np.abs(tau).max()), 1e-9))
    x, y = (range0 - rc) / rs, (range_rate - vc) / vs
    basis = np.concatenate(
        [x[None] ** np.arange(_RANGE_DEGREE + 1)[:, None], y[None] ** np.arange(1, _RATE_DEGREE + 1)[:, None]]
    )
    with one_blas_thread():  # small products: threads would only wait for each other
        # normal equations of a few scaled monomials: ten times quicker than an SVD of all samples, and the pseudo-
        # inverse drops what a flat box cannot tell apart
        normal = np.linalg.pinv(basis @ basis.T, rcond=1e-13, hermitian=True)
        coefficients = normal @ (basis @ residual)
        model = basis.T @ coefficients
    # the correction is exact at the carrier and to first order across the band: mean of (k_f a)^4 / 4
    wavenumber = 4.0 * np.pi / SPEED_OF_LIGHT
    at_carrier = wavenumber * radar.waveform.center_frequency * (residual - model)
    over_band = 0.5 * (0.5 * wavenumber * radar.waveform.bandwidth * model) ** 2 / np.sqrt(5.0)
    n = _RANGE_DEGREE + 1
    return CurvatureFit(
        Curvature(rc, rs, vc, vs, coefficients[:n], coefficients[n:]),
        range_rate,
        np.asarray(np.mean(at_carrier**2 + over_band**2, axis=1)),
    )
