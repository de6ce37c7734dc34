"""Coloured random errors: series of a given rms and power spectrum."""

import numpy as np

from sarmitsuba.core.arrays import F64


def wandering(time: F64, axes: int, rms: float, corner: float, slope: float, seed: int) -> F64:
    r"""Independent random series of mean zero with the power spectrum :math:`1 / (1 + (f / f_c)^q)`.

    Parameters
    ----------
    time : (n,) s
    axes : number of series
    rms : of each over its n samples
    corner, slope : f_c, Hz, and q; 2 is a Gauss-Markov process
    seed : of the series

    Returns
    -------
    (n, axes) in the unit of ``rms``
    """
    rng = np.random.default_rng(seed)
    n = 2 * time.size  # twice the track length, so that its ends are not correlated
    step = (time[-1] - time[0]) / max(time.size - 1, 1)
    frequency = np.fft.rfftfreq(n, step)
    level = np.sqrt(1.0 / (1.0 + (frequency / corner) ** slope))
    noise = rng.standard_normal((axes, 2, frequency.size)) * level
    series = np.fft.irfft(noise[:, 0] + 1j * noise[:, 1], n, axis=-1)[:, : time.size].T
    series = series - series.mean(axis=0)
    return np.asarray(rms * series / np.maximum(np.sqrt(np.mean(series**2, axis=0)), 1e-300))
