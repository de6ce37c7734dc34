"""Range compression of chirped echoes into range profiles."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import scipy.fft

from sarmitsuba.core.arrays import C64, C128, F64, LinearMap
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import did_you_mean
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.chirp import chirp_spectrum, n_fast_chirped
from sarmitsuba.signal.focusing.profiles import band_weights
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.raw_data import RawData

Compression = Literal["flat", "matched", "mismatched"]
COMPRESSIONS: tuple[str, ...] = ("flat", "matched", "mismatched")
# of the mean spectrum, added to that by which a mismatched filter divides: the larger, the nearer to the matched filter
_REGULAR = 0.01

_BATCH = 1 << 22  # complex samples transformed at once, 32 MB


def compression_filter(radar: Radar, n_fft: int, method: str = "matched") -> C128:
    r"""Frequency response of the compression filter, (n_fft,) complex128 in FFT order, zero outside the bandwidth.

    With P the spectrum of the sampled pulse and the sums over the band's bins:

    .. math:: H_{matched} = \frac{P^* N}{\sum |P|^2}, \qquad H_{flat} = \frac{f_s}{B} \frac{1}{P}

    Both give a point of echo amplitude A the peak A. ``matched`` is best against noise and leaves the pulse's Fresnel
    ripple and the -6 dB at its band edges, squared, in the profile's spectrum; ``flat`` divides them out,
    which is the exact inverse of :func:`sarmitsuba.signal.chirp.to_chirped`: a flat band, a pure sinc. ``mismatched``
    divides the matched one by the spectrum D of the code without the shape of its chips, of which the response is left:
    :math:`P^* / (|D|^2 + 0.01 \langle |D|^2 \rangle)` (Ackroyd and Ghani, IEEE Trans. AES 9 (2) 1973, for long
    filters); D = P for frequency modulation.

    Notes
    -----
    ``flat`` raises the noise at the band's edges: by 6 dB at the edge itself, about ``1 / sqrt(B T_p)`` on the whole.
    """
    if method not in COMPRESSIONS:
        guess = did_you_mean(method, COMPRESSIONS)
        raise DataError(
            f"range compression {method!r}: unknown{guess}; choose one of {', '.join(COMPRESSIONS)}"
        )
    wave, rate = radar.waveform, radar.window.sampling_rate
    pulse = chirp_spectrum(radar, n_fft)
    band = band_weights(n_fft, rate, wave.bandwidth, parse_window("rectangular"))
    if method == "mismatched":
        power = _code_power(radar, n_fft, pulse)
        rough = band * pulse.conj() / (power + _REGULAR * float(np.sum(band * power) / np.sum(band)))
        return np.asarray(rough * (n_fft / float(np.sum(rough * pulse).real)))
    if method == "matched":
        return np.asarray(band * pulse.conj() * (n_fft / float(np.sum(band * np.abs(pulse) ** 2))))
    inverse = np.divide(band, pulse, out=np.zeros_like(pulse), where=band > 0.0)
    return np.asarray(inverse * (rate / wave.bandwidth))


def _code_power(radar: Radar, n_fft: int, pulse: C128) -> F64:
    """Spectrum (n_fft,) of a phase code as one number per chip; of other pulses, their own ``pulse``."""
    chips = radar.waveform.chips
    if chips is None:
        return np.asarray(np.abs(pulse) ** 2)
    step = radar.waveform.pulse_width * radar.window.sampling_rate / chips.size
    turn = np.exp(-2j * np.pi * np.outer(scipy.fft.fftfreq(n_fft), step * np.arange(chips.size)))
    return np.asarray(np.abs(turn @ np.exp(1j * chips)) ** 2)


@dataclass(frozen=True, eq=False)
class RangeCompression(LinearMap):
    """Range compression of chirped echoes, pulse by pulse.

    Parameters
    ----------
    radar : that recorded them
    method : ``matched`` or ``flat``, see :func:`compression_filter`
    """

    radar: Radar
    method: str

    @property
    def n_fast(self) -> int:
        """Samples of a chirped pulse."""
        return n_fast_chirped(self.radar)

    @cached_property
    def response(self) -> C64:
        """Frequency response (n_fft,) of the filter."""
        n_fft = int(scipy.fft.next_fast_len(self.n_fast + 1))
        return compression_filter(self.radar, n_fft, self.method).astype(np.complex64)

    def forward(self, values: C64) -> C64:
        """Compressed echoes (n_layers, n_pulses, n_samples) of chirped ones (n_layers, n_pulses, n_fast)."""
        n_layers, n_pulses, _ = values.shape
        response, n_samples = self.response, self.radar.window.n_samples
        out = np.empty((n_layers, n_pulses, n_samples), dtype=np.complex64)
        step = max(1, _BATCH // response.size)
        for layer in range(n_layers):
            for start in range(0, n_pulses, step):
                pick = slice(start, start + step)
                work = scipy.fft.fft(values[layer, pick], n=response.size, axis=-1, workers=-1)
                line = scipy.fft.ifft(work * response, axis=-1, workers=-1)
                out[layer, pick] = line[:, :n_samples]
        return out

    def adjoint(self, values: C64) -> C64:
        """Chirped echoes from compressed ones by the conjugate filter."""
        n_layers, n_pulses, _ = values.shape
        response, n_fast = self.response.conj(), self.n_fast
        out = np.empty((n_layers, n_pulses, n_fast), dtype=np.complex64)
        step = max(1, _BATCH // response.size)
        for layer in range(n_layers):
            for start in range(0, n_pulses, step):
                pick = slice(start, start + step)
                work = scipy.fft.fft(
                    values[layer, pick], n=response.size, axis=-1, workers=-1, norm="forward"
                )
                line = scipy.fft.ifft(work * response, axis=-1, workers=-1, norm="forward")
                out[layer, pick] = line[:, :n_fast]
        return out


def range_compress(raw: RawData, *, method: str = "matched") -> RawData:
    """Range compression of every echo; compressed data are returned unchanged.

    Parameters
    ----------
    raw : domain ``chirped``
    method : ``matched`` or ``flat``, see :func:`compression_filter`

    Returns
    -------
    RawData, domain ``compressed``, on the radar's receive window; range weighting is applied by the focuser

    Notes
    -----
    Ignores the pulse's motion-induced Doppler shift. Truncated echoes are compressed as far as they were recorded.
    """
    if raw.domain == "compressed":
        return raw
    radar = raw.radar
    compression = RangeCompression(radar, method)
    n_fast = compression.n_fast
    if raw.data.shape[2] != n_fast:
        raise DataError(
            f"raw data: {raw.data.shape[2]} samples per pulse, but the window of {radar.window.n_samples} and the "
            "pulse "
            f"width of {radar.waveform.pulse_width:g} s need {n_fast}"
        )
    out = compression.forward(raw.data)
    return replace(raw, data=out, domain="compressed", metadata={**raw.metadata, "range_compression": method})
