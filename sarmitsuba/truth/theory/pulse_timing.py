"""Response of an aperture with non-uniform pulse times."""

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64


def jittered_response(turns: ArrayLike, jitter: float, n_pulses: int) -> F64:
    r"""Mean power of the sum of n pulses with random intervals, relative to its peak.

    Independent Gaussian intervals of mean T and rms :math:`\sigma T`, whose characteristic function at the Doppler
    offset f from the point is :math:`\chi = e^{-j 2 \pi f T - (2 \pi f T \sigma)^2 / 2}`:

    .. math:: \frac{1}{n^2} E \left| \sum_i e^{-j 2 \pi f t_i} \right|^2 =
              \frac{1}{n} + \frac{2}{n^2} \mathrm{Re} \sum_{m=1}^{n-1} (n - m) \chi^m

    For many pulses it is the spectrum of a renewal process, :math:`(1 - |\chi|^2) / n |1 - \chi|^2`.

    Parameters
    ----------
    turns : (...) f T, Doppler offset over the mean pulse repetition frequency
    jitter : sigma
    n_pulses : n, of equal weight

    References
    ----------
    F. Beutler, O. Leneman, The spectral analysis of impulse processes, Information and Control 12 (1968), 236.
    """
    angle = 2.0 * np.pi * np.asarray(turns, dtype=np.float64)
    m = np.arange(1, n_pulses)
    exponent = np.multiply.outer(-0.5 * (angle * jitter) ** 2 - 1j * angle, m)
    return np.asarray(1.0 / n_pulses + 2.0 / n_pulses**2 * (np.exp(exponent).real @ (n_pulses - m)))


def jitter_noise(turns: ArrayLike, jitter: float, n_pulses: int) -> F64:
    r"""Noise-like part of :func:`jittered_response` far from peak and ghosts: the renewal spectrum over n.

    .. math:: \frac{1 - |\chi|^2}{n |1 - \chi|^2}, \quad
              \text{for small } \sigma: \frac{(\pi f T \sigma)^2}{n \sin^2 \pi f T}

    Parameters and reference as there.
    """
    angle = 2.0 * np.pi * np.asarray(turns, dtype=np.float64)
    chi = np.exp(-1j * angle - 0.5 * (angle * jitter) ** 2)
    return np.asarray((1.0 - np.abs(chi) ** 2) / (n_pulses * np.abs(1.0 - chi) ** 2))


def staggered_lines(intervals: ArrayLike) -> F64:
    r"""Power of the ghosts of a staggered sequence of pulse intervals, relative to the point, (M,) float64.

    Entry k is the ghost at a Doppler offset of k / M pulse repetition frequencies (entry 0 the point itself):

    .. math:: \left| \frac{1}{M} \sum_{m=0}^{M-1} e^{-j 2 \pi k t_m / t_M} \right|^2

    with :math:`t_m` the sum of the first m intervals.

    Parameters
    ----------
    intervals : (M,) in any unit

    References
    ----------
    Y.-C. Jenq, Digital spectra of nonuniformly sampled signals, IEEE Trans. Instrum. Meas. 37 (1988), 245.
    """
    steps = np.asarray(intervals, dtype=np.float64)
    return staggered_line(intervals, np.arange(steps.size))


def staggered_line(intervals: ArrayLike, order: ArrayLike) -> F64:
    """As :func:`staggered_lines`, for any whole orders k; (...) float64."""
    steps = np.asarray(intervals, dtype=np.float64)
    start = np.concatenate([[0.0], np.cumsum(steps)[:-1]]) / steps.sum()
    phase = 2.0 * np.pi * np.multiply.outer(np.asarray(order, dtype=np.float64), start)
    return np.asarray(np.abs(np.exp(-1j * phase).mean(axis=-1)) ** 2)
