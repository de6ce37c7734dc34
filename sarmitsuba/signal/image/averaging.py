"""Means of neighbouring pixels: over adjacent blocks, or over a window centred on every pixel."""

from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64


def block_means(values: NDArray[np.floating], block: tuple[int, int]) -> F64:
    """Means over blocks of rows and columns; incomplete blocks at the far ends are dropped.

    Their centres are those of :func:`block_middles`.
    """
    rows, columns = values.shape[0] // block[0], values.shape[1] // block[1]
    kept = np.asarray(values, dtype=np.float64)[: rows * block[0], : columns * block[1]]
    return np.asarray(kept.reshape(rows, block[0], columns, block[1]).mean(axis=(1, 3)))


def block_middles(axis: F64, n: int) -> F64:
    """Centres of blocks of n pixels, (size // n,), from the centres of the pixels, (size,)."""
    blocks = axis.size // n
    return np.asarray(axis[: blocks * n].reshape(blocks, n).mean(axis=1))


def sliding_means(
    values: NDArray[np.floating], widths: tuple[float, float], rim: Literal["nearest", "reflect"]
) -> F64:
    r"""Means over a window of ``widths`` pixels (rows, columns) centred on every pixel.

    .. math:: \bar x_i = \frac{1}{w} \sum_j x_j \, |[i - w/2, i + w/2] \cap [j - 1/2, j + 1/2]|

    A pixel at the window's end is weighted by its part inside, so that windows of an even or fractional number of
    pixels cause no shift.

    Parameters
    ----------
    values : (n_azimuth, n_range) real
    widths : pixels, at least 1
    rim : continuation beyond the edges: the last value repeated, or mirrored about the edge
    """
    means = np.asarray(values, dtype=np.float64)
    for axis, width in enumerate(widths):
        reach = int(np.ceil(0.5 * (width - 1.0)))
        if reach < 1:
            continue
        weights = np.ones(2 * reach + 1)
        weights[[0, -1]] = 0.5 * (width - (2 * reach - 1))
        means = scipy.ndimage.correlate1d(means, weights / width, axis=axis, mode=rim)
    return means
