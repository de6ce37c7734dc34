"""Range profiles prepared for interpolation at any slant range: weighting, upsampling, kernel correction."""

from dataclasses import dataclass, replace

import numpy as np
import scipy.fft

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import did_you_mean
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.gridding import GriddingKernel, gridding_kernel

INTERPOLATIONS = {"linear": 2, "kernel": 6, "kernel:4": 4, "kernel:6": 6, "kernel:8": 8}
"""Kernel widths, in samples, of the interpolations by their names."""
# default upsampling of the receiver's rate by kernel width; linear errs by -47 to -50 dB then, and more would make it
# slower than the better kernel of four taps
_DEFAULT_OVERSAMPLING = {2: 6, 4: 2, 6: 2, 8: 2}
# receiver samples of zeros between the end of a profile and its periodic repetition
_GUARD = 64
MOST_BEYOND = _GUARD // 2
"""Largest continuation of a profile beyond either end, receiver samples."""


def parse_interpolation(text: str) -> int:
    """Return the kernel width, in samples, of an interpolation's name.

    ``linear`` (width 2), ``kernel`` (width 6) or ``kernel:4``, ``kernel:6``, ``kernel:8``.
    """
    if text not in INTERPOLATIONS:
        guess = did_you_mean(text, INTERPOLATIONS)
        raise DataError(f"interpolation {text!r}: unknown{guess}; choose one of {', '.join(INTERPOLATIONS)}")
    return INTERPOLATIONS[text]


def band_weights(n_fft: int, sampling_rate: float, bandwidth: float, window: Window) -> F64:
    r"""Weights of the FFT's bins: the window over the band, zero outside, scaled so that a point keeps its peak.

    A bin that the band's edge cuts counts by the part inside. Scaled to
    :math:`\sum_k w_k \Delta f = B`.

    Parameters
    ----------
    n_fft : length of the transform
    sampling_rate, bandwidth : Hz
    window : over the band

    Returns
    -------
    (n_fft,) float64 in FFT order
    """
    bins = scipy.fft.fftfreq(n_fft, 1.0 / n_fft)
    half = 0.5 * bandwidth * n_fft / sampling_rate  # half band in bins
    inside = np.clip(half - np.abs(bins) + 0.5, 0.0, 1.0)
    if 2.0 * half >= n_fft:  # critically sampled: the bin at the Nyquist frequency represents both edges
        inside = np.ones(n_fft)
    weight = inside * window(np.clip(bins / (2.0 * half), -0.5, 0.5))
    return np.asarray(weight * (min(2.0 * half, n_fft) / weight.sum()))


@dataclass(frozen=True, eq=False)
class ProfilePlan:
    """Conversion of a pulse's range-compressed samples into a profile for interpolation.

    Parameters
    ----------
    n_samples : samples of a pulse
    sample_spacing : m, one-way slant range
    width : taps of the interpolation kernel, even (1 where the plan serves spectra only)
    oversampling : whole factor on the sampling rate
    gains : (n_fft,) float64 spectrum gains in FFT order: window over the band, kernel transform divided out

    Notes
    -----
    The profile is the band-limited periodic function through the samples, which are followed by a guard of zeros.
    Echoes cut by the receive window's ends keep the resulting ripple.
    """

    n_samples: int
    sample_spacing: float
    width: int
    oversampling: int
    gains: F64

    @property
    def kernel(self) -> GriddingKernel:
        """The interpolation kernel."""
        return gridding_kernel(self.width)

    @property
    def n_fft(self) -> int:
        """Length of the forward transform."""
        return self.gains.size

    @property
    def kernel_error(self) -> float:
        """Amplitude of the interpolation's strongest image, that of the band's edge, relative to the signal."""
        edge = float(np.abs(scipy.fft.fftfreq(self.n_fft)[self.gains > 0.0]).max()) / self.oversampling
        inside, image = np.abs(self.kernel.transform([edge, 1.0 - edge]))
        return float(image / inside)

    @property
    def step(self) -> float:
        """Spacing of the profile's samples, m of slant range."""
        return self.sample_spacing / self.oversampling

    @property
    def last(self) -> int:
        """Largest valid position, in profile samples from the first receiver sample; the smallest is 0."""
        return (self.n_samples - 1) * self.oversampling

    @property
    def n_stored(self) -> int:
        """Profile samples stored per pulse: the valid ones and the kernel's margin."""
        return self.last + self.width

    def spectrum(self, data: C64, workers: int = -1) -> C64:
        """Weighted spectrum (..., n_fft), FFT order, of samples (..., n_samples); time origin at the first sample."""
        out = scipy.fft.fft(data, n=self.n_fft, axis=-1, workers=workers)
        return np.asarray(out * self.gains.astype(np.float32), dtype=np.complex64)

    def adjoint_spectrum(self, spectrum: C64) -> C64:
        """Adjoint of :meth:`spectrum`: samples (..., n_samples) from spectra (..., n_fft)."""
        weighted = spectrum * self.gains.astype(np.float32)
        line = scipy.fft.ifft(weighted, axis=-1, workers=-1, overwrite_x=True, norm="forward")
        return np.asarray(line[..., : self.n_samples], dtype=np.complex64)

    def profiles(self, data: C64, beyond: int = 0) -> C64:
        """Upsampled profiles (..., n_stored) complex64; entry ``kernel.lead`` is the first receiver sample.

        With ``beyond``, at most ``MOST_BEYOND``, the profile is continued by that many receiver samples on either side:
        it is longer by twice as many times ``oversampling``, and the first receiver sample is shifted by half of that.
        """
        spectrum = self.spectrum(data)
        spectrum *= np.float32(1.0 / self.n_fft)
        n, n_up = self.n_fft, self.n_fft * self.oversampling
        padded = np.zeros((*data.shape[:-1], n_up), dtype=np.complex64)
        half = n // 2
        padded[..., : n - half] = spectrum[..., : n - half]
        padded[..., n_up - half :] = spectrum[..., n - half :]
        fine = scipy.fft.ifft(padded, axis=-1, workers=-1, overwrite_x=True, norm="forward")
        lead = self.kernel.lead + beyond * self.oversampling
        body = fine[..., : self.n_stored + 2 * beyond * self.oversampling - lead]
        return (
            np.concatenate([fine[..., n_up - lead :], body], axis=-1) if lead else np.ascontiguousarray(body)
        )

    def adjoint_profiles(self, profiles: C64, beyond: int = 0) -> C64:
        """Adjoint of :meth:`profiles`: samples (..., n_samples) complex64 from profiles (..., n_stored)."""
        n, n_up = self.n_fft, self.n_fft * self.oversampling
        lead = self.kernel.lead + beyond * self.oversampling
        fine = np.zeros((*profiles.shape[:-1], n_up), dtype=np.complex64)
        fine[..., : profiles.shape[-1] - lead] = profiles[..., lead:]
        if lead:
            fine[..., n_up - lead :] += profiles[..., :lead]
        padded = scipy.fft.fft(fine, axis=-1, workers=-1, overwrite_x=True)
        half = n // 2
        spectrum = np.concatenate([padded[..., : n - half], padded[..., n_up - half :]], axis=-1)
        spectrum *= np.float32(1.0 / n)
        return self.adjoint_spectrum(spectrum)


def plan_profiles(
    radar: Radar, window: Window, *, interpolation: str = "kernel", oversampling: int = 0
) -> ProfilePlan:
    """Plan the interpolable profiles of a radar's range-compressed data.

    Parameters
    ----------
    radar : gives receive window, bandwidth and sampling rate
    window : over the band
    interpolation : see :func:`parse_interpolation`
    oversampling : whole factor on the sampling rate, 0 = 6 for ``linear`` and 2 for the others
    """
    width = parse_interpolation(interpolation)
    factor = oversampling or _DEFAULT_OVERSAMPLING[width]
    if factor < 1 or factor != int(factor):
        raise DataError(f"oversampling = {oversampling} must be a whole number from 1 (or 0 for the default)")
    plan = plan_spectrum(radar, window)
    used = plan.gains > 0.0
    cycles = scipy.fft.fftfreq(plan.n_fft)[used] / factor  # cycles per profile sample
    gains = plan.gains.copy()
    gains[used] /= gridding_kernel(width).transform(cycles)
    return replace(plan, gains=gains, width=width, oversampling=factor)


def plan_spectrum(radar: Radar, window: Window, *, extra: int = 0) -> ProfilePlan:
    """Plan the weighted range spectrum only, without any interpolation kernel.

    Parameters
    ----------
    radar : gives receive window, bandwidth and sampling rate
    window : over the band
    extra : samples by which ranges may leave the receive window; zeros follow the data at least that far
    """
    receive = radar.window
    n_fft = int(scipy.fft.next_fast_len(receive.n_samples + max(_GUARD, 16 + extra)))
    gains = band_weights(n_fft, receive.sampling_rate, radar.waveform.bandwidth, window)
    # the window's finite length blurs the band's edge: rescale so that a point in the middle keeps its peak
    middle = receive.n_samples // 2
    samples = np.arange(receive.n_samples) - middle
    centred = scipy.fft.fft(np.sinc(samples * receive.sample_spacing / radar.waveform.range_cell), n=n_fft)
    centred = centred * np.exp(2j * np.pi * scipy.fft.fftfreq(n_fft) * middle)
    gains *= n_fft / float(centred.real @ gains)
    return ProfilePlan(receive.n_samples, receive.sample_spacing, 1, 1, gains)
