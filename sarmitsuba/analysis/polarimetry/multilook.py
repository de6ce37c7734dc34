"""Multilook averages over blocks of pixels, or over a sliding window."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C128
from sarmitsuba.core.errors import DataError
from sarmitsuba.signal.image.averaging import block_means, sliding_means


def averaged(values: NDArray[np.complexfloating], looks: tuple[int, int], sliding: bool) -> C128:
    """Means of (n_azimuth, n_range) complex values over ``looks`` pixels (azimuth, range).

    Parameters
    ----------
    values : (n_azimuth, n_range) complex
    looks : pixels of a block or of the window
    sliding : whether to use a window centred on every pixel (boxcar, mirrored at the edges) instead of blocks;
        incomplete blocks at the far ends are dropped

    Raises
    ------
    DataError
        ``looks`` are below 1 or above the image's size.
    """
    check_looks(values.shape, looks)
    parts = []
    for part in (values.real, values.imag):
        wide = np.asarray(part, dtype=np.float64)
        parts.append(sliding_means(wide, looks, "reflect") if sliding else block_means(wide, looks))
    return np.asarray(parts[0] + 1j * parts[1])


def check_looks(shape: tuple[int, ...], looks: tuple[int, int]) -> None:
    """Raise a DataError where blocks of ``looks`` do not fit an image of ``shape``."""
    if not all(1 <= n <= size for n, size in zip(looks, shape, strict=True)):
        raise DataError(
            f"polarimetry: looks of {looks[0]} x {looks[1]} pixels of an image of {shape[0]} x {shape[1]}; give 1 or "
            "more, up to its size"
        )
