"""Mean power of an image of one look from the mean powers of independent echoes."""

from dataclasses import replace

import numpy as np
import scipy.fft

from sarmitsuba.core.arrays import C64, F32
from sarmitsuba.signal.focusing.look import Look, resample
from sarmitsuba.signal.raw.look_grid import LookGrid


def power_grid(grid: LookGrid) -> LookGrid:
    """Grid of half the cells, for the squared response has twice the band."""
    return replace(
        grid,
        range_step=0.5 * grid.range_step,
        azimuth_step=0.5 * grid.azimuth_step,
        n_range=2 * grid.n_range,
        n_azimuth=2 * grid.n_azimuth,
    )


class PowerResponse:
    r"""Squared impulse response of looks.

    Independent echoes of mean power p at places c have in a pixel x the mean power

    .. math:: \sum p\, |h(x - c)|^2

    Parameters
    ----------
    look : of the image

    Notes
    -----
    Rounding of the sums may give negative values far below the largest; they are set to zero.
    """

    def __init__(self, look: Look) -> None:
        coarse = look.grid
        self.grid = power_grid(coarse)
        self.look = replace(look, grid=self.grid, x=2.0 * look.x, y=2.0 * look.y)
        spectrum = np.zeros((self.grid.n_range, self.grid.n_azimuth), dtype=np.complex64)
        rows, columns = (
            np.round(scipy.fft.fftfreq(n, 1.0 / n)).astype(int) for n in (coarse.n_range, coarse.n_azimuth)
        )
        spectrum[np.ix_(rows, columns)] = look.response * _transform(coarse) ** 2
        response = scipy.fft.ifft2(spectrum, workers=-1, overwrite_x=True)
        squared = np.square(4.0 * np.abs(response)).astype(np.float32)
        self.spectrum: C64 = scipy.fft.rfft2(squared, workers=-1)
        self.spectrum /= (_transform(self.grid)[:, : self.spectrum.shape[1]] ** 2).astype(np.float32)

    def image(self, powers: F32) -> F32:
        """Mean power (n, n_azimuth, n_range), m^2, of the pixels from that of the echoes, (n, n_range, n_azimuth)."""
        out = np.empty((len(powers), *self.look.image.shape), dtype=np.float32)
        size = (self.grid.n_range, self.grid.n_azimuth)
        for i, plane in enumerate(powers):
            field = scipy.fft.irfft2(scipy.fft.rfft2(plane, workers=-1) * self.spectrum, size, workers=-1)
            power = resample(field.astype(np.complex64), self.look).real
            out[i] = np.maximum(power, 0.0) * np.square(self.look.gain)
        return out


def _transform(grid: LookGrid) -> F32:
    """Transform (n_range, n_azimuth) of the gridding kernel on the grid's frequencies."""
    kernel = grid.kernel
    return np.outer(
        kernel.transform(scipy.fft.fftfreq(grid.n_range)), kernel.transform(scipy.fft.fftfreq(grid.n_azimuth))
    ).astype(np.float32)
