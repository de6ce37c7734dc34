"""Chirped echoes, as recorded by a receiver, from range-compressed profiles."""

import math
from dataclasses import replace

import numpy as np
import scipy.fft

from sarmitsuba.core.arrays import C128
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.waveform import Waveform
from sarmitsuba.signal.raw_data import RawData

_BATCH = 2**22  # complex samples transformed at once, 32 MB


def pulse_samples(waveform: Waveform, sampling_rate: float) -> C128:
    r"""Transmitted pulse at the receiver's sampling rate.

    .. math:: g_n = e^{j \phi(t_n)}, \quad t_n = n / f_s - T_p / 2, \quad 0 \le n \le T_p f_s

    Parameters
    ----------
    waveform : pulse of width T_p and phase phi, :math:`\pi \gamma t^2` for linear modulation
    sampling_rate : complex samples per second f_s, Hz

    Returns
    -------
    (floor(T_p f_s) + 1,) complex128
    """
    n = math.floor(waveform.pulse_width * sampling_rate * (1.0 + 1e-12)) + 1
    t = np.arange(n) / sampling_rate - 0.5 * waveform.pulse_width
    if not waveform.code:
        return np.asarray(np.exp(1j * np.pi * waveform.chirp_rate * t**2))
    pulse = np.asarray(np.exp(1j * waveform.phase(t)))
    if waveform.chips is not None:  # a chip ends where the next begins, so that all have as many samples
        pulse[t >= waveform.pulse_width * (0.5 - 1e-9)] = 0.0
    return pulse


def n_fast_chirped(radar: Radar) -> int:
    """Number of samples of a chirped echo: those of the profile and of one pulse."""
    return radar.window.n_samples + math.ceil(radar.waveform.pulse_width * radar.window.sampling_rate)


def chirp_spectrum(radar: Radar, n_fft: int) -> C128:
    """DFT of :func:`pulse_samples`, zero padded to ``n_fft``; its first sample is the origin of time.

    A chirped record is the profile convolved with the pulse, ``chirped[i] = sum_j profile[j] g[i - j]`` times
    B / f_s, so sample 0 of the record is half a pulse before sample 0 of the profile and no further shift
    is needed in either direction.
    """
    return np.asarray(scipy.fft.fft(pulse_samples(radar.waveform, radar.window.sampling_rate), n=n_fft))


def to_chirped(raw: RawData) -> RawData:
    r"""LFM echoes at baseband from range-compressed data.

    .. math:: s_i = \frac{B}{f_s} \sum_j p_j \, g_{i - j}

    A point of peak A becomes ``A exp(j pi gamma (t - 2 R / c)^2)``, of magnitude A all through the pulse, on
    the fast times stated in :class:`sarmitsuba.signal.raw_data.RawData`.

    Parameters
    ----------
    raw : domain ``compressed``

    Returns
    -------
    RawData, domain ``chirped``; layers, radar and metadata as before

    Notes
    -----
    Ignores the pulse's spectrum outside the band B: the receiver's filter is ideal.
    Echoes from outside the window whose pulses reach into it are not in the profile and so not in the record.
    """
    if raw.domain != "compressed":
        raise DataError(f"to_chirped needs range-compressed raw data, but these are {raw.domain}")
    radar = raw.radar
    n_fast = n_fast_chirped(radar)
    n_fft = int(scipy.fft.next_fast_len(n_fast + 1))
    scale = radar.waveform.bandwidth / radar.window.sampling_rate
    spectrum = (chirp_spectrum(radar, n_fft) * scale).astype(np.complex64)
    n_layers, n_pulses, _ = raw.data.shape
    out = np.empty((n_layers, n_pulses, n_fast), dtype=np.complex64)
    step = max(1, _BATCH // n_fft)
    for layer in range(n_layers):
        for start in range(0, n_pulses, step):
            pick = slice(start, start + step)
            work = scipy.fft.fft(raw.data[layer, pick], n=n_fft, axis=-1, workers=-1)
            work *= spectrum
            out[layer, pick] = scipy.fft.ifft(work, axis=-1, workers=-1, overwrite_x=True)[:, :n_fast]
    return replace(raw, data=out, domain="chirped")
