"""Parts of an image of one look, each over the pixels about its echoes, and mean powers of independent echoes."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.fft

from sarmitsuba.core.arrays import C64, F32
from sarmitsuba.signal.focusing.look import Look, resample
from sarmitsuba.signal.look_grid import LookGrid

# cells about the echoes of a part beyond which its side lobes are left out: 64 resolution cells
REACH = 128
# sizes of parts are multiples of this, cells: few sizes mean few responses
_STEP = 64
# share of the grid from which on the whole of it is taken
_WHOLE = 0.7


@dataclass(frozen=True)
class GridPart:
    """Part of the looks' grid: first row and column, number of rows and columns, cells."""

    row: int
    column: int
    rows: int
    columns: int

    def of(self, grid: LookGrid) -> LookGrid:
        """The part as a grid."""
        return replace(
            grid,
            range0=grid.range0 + self.row * grid.range_step,
            azimuth0=grid.azimuth0 + self.column * grid.azimuth_step,
            n_range=self.rows,
            n_azimuth=self.columns,
        )


class PartImages:
    """Images of parts of the echoes of a look.

    Parameters
    ----------
    look : of the image

    Notes
    -----
    Side lobes of a part more than ``REACH`` cells from its echoes are left out, unless it takes most of the image.
    """

    def __init__(self, look: Look) -> None:
        self.look = look
        self._responses: dict[tuple[int, int], C64 | F32] = {}

    def part(self, row: int, stop_row: int, column: int, stop_column: int) -> GridPart:
        """Part of the grid for echoes in these rows and columns, the last ones not included; with ``REACH`` about."""
        grid = self.look.grid
        rows, columns = (
            min(n, -(-(stop - start + 2 * REACH) // _STEP) * _STEP)
            for start, stop, n in ((row, stop_row, grid.n_range), (column, stop_column, grid.n_azimuth))
        )
        if rows * columns > _WHOLE * grid.n_range * grid.n_azimuth:
            return GridPart(0, 0, grid.n_range, grid.n_azimuth)
        return GridPart(
            min(max(row - REACH, 0), grid.n_range - rows),
            min(max(column - REACH, 0), grid.n_azimuth - columns),
            rows,
            columns,
        )

    def power(self, cells: C64, part: GridPart) -> tuple[tuple[slice, slice], F32]:
        """Pixels of a part (rows and columns of the image) and their power, m^2, summed over channels.

        Parameters
        ----------
        cells : (n_channels, rows, columns) complex64, of the part
        """
        look = self.look
        kernel = look.grid.kernel
        x, y = look.x - np.float32(part.row), look.y - np.float32(part.column)
        inside = (x >= kernel.margin) & (x <= part.rows - 1 - kernel.margin)
        inside &= (y >= kernel.margin) & (y <= part.columns - 1 - kernel.margin)
        where = []
        for axis in (1, 0):
            some = np.flatnonzero(inside.any(axis=axis))
            where.append(slice(int(some[0]), int(some[-1]) + 1) if some.size else slice(0, 0))
        here = (where[0], where[1])
        mask = inside[here]
        some_look = replace(look, grid=part.of(look.grid), x=x[here][mask], y=y[here][mask])
        found = np.zeros(some_look.x.shape, dtype=np.float32)
        response = self._response(part.rows, part.columns)
        for plane in cells:
            spectrum = scipy.fft.fft2(plane, workers=-1) * response
            smooth = scipy.fft.ifft2(spectrum, workers=-1, overwrite_x=True)
            value = resample(smooth.astype(np.complex64), some_look)
            found += np.square(value.real) + np.square(value.imag)
        power = np.zeros(mask.shape, dtype=np.float32)
        power[mask] = found * np.square(look.gain[here][mask])
        return here, power

    @cached_property
    def _field(self) -> C64:
        """Impulse response on the whole grid, with the gridding kernels divided out."""
        return np.asarray(scipy.fft.ifft2(self.look.response, workers=-1), dtype=np.complex64)

    def _response(self, rows: int, columns: int) -> C64 | F32:
        """Spectrum of the response on a grid of a part's size, cut off at ``REACH``."""
        grid = self.look.grid
        if (rows, columns) == (grid.n_range, grid.n_azimuth):
            return self.look.response
        if (rows, columns) not in self._responses:
            field = np.zeros((rows, columns), dtype=np.complex64)
            # of an axis that is whole, all
            lines, posts = (
                np.arange(-(n // 2), n - n // 2) if n == whole else np.arange(-REACH, REACH + 1)
                for n, whole in ((rows, grid.n_range), (columns, grid.n_azimuth))
            )
            field[np.ix_(lines % rows, posts % columns)] = self._field[
                np.ix_(lines % grid.n_range, posts % grid.n_azimuth)
            ]
            self._responses[rows, columns] = scipy.fft.fft2(field, workers=-1, overwrite_x=True)
        return self._responses[rows, columns]


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
