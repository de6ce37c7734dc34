r"""Doppler centroid of recorded echoes, estimated from the correlation of neighbouring pulses.

With the spectrum :math:`S_t(f)` of pulse t over its baseband frequency f, carrier :math:`f_0`, pulse rate :math:`f_p`,

.. math:: C(f) = \sum_t S_{t+1}(f) S_t^*(f), \qquad \arg C(f) = 2 \pi \frac{f_{DC}}{f_p} \left(1 + \frac{f}{f_0}\right)

The phase at f = 0 gives the centroid up to a multiple of the pulse rate (average cross-correlation coefficient), its
slope over f the multiple (wavelength diversity: the range walk from pulse to pulse).

References: S. N. Madsen, IEEE Trans. Aerosp. Electron. Syst. 25 (1989), 134; R. Bamler and H. Runge, IEEE Trans.
Geosci. Remote Sens. 29 (1991), 995.
"""

from dataclasses import dataclass

import numpy as np
import scipy.fft

from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.core.errors import DataError

# parts of the pulses, each left out once for the standard deviation (jackknife)
_PARTS = 16
# standard deviations that must lie between the estimate and half the pulse rate from the multiple that is taken: the
# next multiple is 5 of them away at least
_SURE = 2.5
# largest standard deviation of the centroid within the pulse rate, over the pulse rate
_COARSE = 0.05
_BATCH = 1 << 22  # complex samples transformed at once


@dataclass(frozen=True)
class DopplerEstimate:
    """Doppler centroid of echoes.

    Parameters
    ----------
    frequency : Hz, absolute: with the multiple of the pulse rate
    deviation : standard deviation of ``frequency`` if the multiple is right, Hz
    multiple : of the pulse rate that was added to the centroid within plus and minus half of it
    walk : Hz, the independent estimate from the slope, which chose the multiple
    walk_deviation : its standard deviation, Hz
    """

    frequency: float
    deviation: float
    multiple: int
    walk: float
    walk_deviation: float


def estimate_doppler(
    echoes: C64, prf: float, carrier: float, sampling_rate: float, band: float
) -> DopplerEstimate:
    """Doppler centroid of echoes at uniform pulse times, averaged over the swath.

    Parameters
    ----------
    echoes : (n_pulses, n_fast) complex64, at baseband; chirped or range compressed
    prf, carrier, sampling_rate : Hz
    band : Hz, bandwidth that the echoes fill

    Raises
    ------
    DataError
        The echoes do not tell the centroid, or not its multiple of the pulse rate; one line with the two estimates.

    Notes
    -----
    One centroid for the whole swath: ignores its change over range, and a pattern of the antenna that depends on the
    frequency within the band, which biases the slope. Strong targets that only a part of their aperture shows bias both
    estimates; the standard deviations, from parts of the pulses left out in turn, show that.
    """
    n_pulses = echoes.shape[0]
    if n_pulses < 2 * _PARTS:
        raise DataError(
            f"Doppler centroid: {n_pulses} pulses are too few to estimate it; at least {2 * _PARTS} are needed"
        )
    frequency, parts = _correlations(echoes, sampling_rate, band)
    whole = parts.sum(axis=0)
    if not np.abs(whole).sum() > 0.0:
        raise DataError("Doppler centroid: the echoes are zero, or neighbouring pulses do not correlate")
    base, walk = _fit(whole, frequency, prf, carrier)
    left_out = np.array([_fit(whole - part, frequency, prf, carrier, base) for part in parts])
    spread = np.sqrt((_PARTS - 1) * np.mean((left_out - left_out.mean(axis=0)) ** 2, axis=0))
    if spread[0] > _COARSE * prf:
        raise DataError(
            f"Doppler centroid: the echoes show {base:.0f} Hz within the pulse rate of {prf:g} Hz with a standard "
            f"deviation of {spread[0]:.0f} Hz, too coarse; give doppler_centroid_hz"
        )
    multiple = round((walk - base) / prf)
    found = base + multiple * prf
    if abs(walk - found) + _SURE * float(spread[1]) > 0.5 * prf:
        raise DataError(
            f"Doppler centroid: {base:.1f} Hz plus a multiple of the pulse rate {prf:g} Hz; the range walk shows "
            f"{walk:.0f} Hz with a standard deviation of {spread[1]:.0f} Hz, which does not tell the multiple; give "
            "doppler_centroid_hz"
        )
    return DopplerEstimate(found, float(spread[0]), multiple, walk, float(spread[1]))


def _correlations(echoes: C64, sampling_rate: float, band: float) -> tuple[F64, C128]:
    """Frequencies (n,) Hz in the band, and C(f) of consecutive parts of the pulses, (_PARTS, n)."""
    n_fft = int(scipy.fft.next_fast_len(echoes.shape[1]))
    frequency = scipy.fft.fftfreq(n_fft, 1.0 / sampling_rate)
    inside = np.abs(frequency) <= 0.5 * band
    parts = np.zeros((_PARTS, int(inside.sum())), dtype=np.complex128)
    edges = np.linspace(0, echoes.shape[0] - 1, _PARTS + 1).astype(int)
    rows = max(2, _BATCH // n_fft)
    for part, first, last in zip(parts, edges[:-1], edges[1:], strict=True):
        for start in range(first, last, rows):
            stop = min(start + rows, last)
            spectrum = scipy.fft.fft(echoes[start : stop + 1], n=n_fft, axis=1, workers=-1)[:, inside]
            part += np.einsum("tk,tk->k", spectrum[1:], spectrum[:-1].conj(), dtype=np.complex128)
    return frequency[inside], parts


def _fit(
    correlation: C128, frequency: F64, prf: float, carrier: float, about: float | None = None
) -> tuple[float, float]:
    """Centroid within the pulse rate (nearest to ``about``) and absolute one from the slope, Hz."""
    phase = float(np.angle(correlation.sum()))
    slope = 0.0
    for _ in range(3):  # Newton's steps for the greatest coherent sum
        turned = correlation * np.exp(-1j * (phase + slope * frequency))
        weight, miss = turned.real, turned.imag
        middle = float(weight @ frequency) / float(weight.sum())
        off = frequency - middle
        step = float(off @ miss) / float(weight @ off**2)
        phase += float(miss.sum()) / float(weight.sum()) - step * middle
        slope += step
    scale = prf / (2.0 * np.pi)
    base = float(np.mod(phase + np.pi, 2.0 * np.pi) - np.pi) * scale
    if about is not None:
        base += prf * round((about - base) / prf)
    return base, slope * carrier * scale
