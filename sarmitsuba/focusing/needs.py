"""Bytes that focusing takes, from the image's size alone."""

import numpy as np
import scipy.fft

from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.memory import check_fits

# pixels of a backprojection tile, and bytes of one: positions in NumPy (three times while they are made) and on the
# device, and its place in the image
TILE_PIXELS, TILE_BYTES = 1 << 20, 112
# bytes of a pixel and layer on its way: what is summed, before and after a batch of pulses
SUMS = 24
# bytes of profiles of a batch of pulses, with their copies
BATCH = 60_000_000
# bytes of a pixel and layer in the finished image, and of those that error bars, files and pictures add
PIXEL, FINISHING = 8, 16
# bytes of a pixel: of a look's plan, and of the intermediate fields of every layer
LOOK_PIXEL, LOOK_FIELD = 90, 40


def focusing_bytes(grid: ImageGrid, n_layers: int) -> int:
    """Bytes of the image with all that making and keeping it takes."""
    pixels = int(np.prod(grid.shape))
    tile = min(pixels, TILE_PIXELS)
    making = tile * (TILE_BYTES + SUMS * min(n_layers, 4)) + BATCH
    return PIXEL * pixels * n_layers + max(making, FINISHING * pixels * n_layers)


def look_shape(grid: ImageGrid) -> tuple[int, int]:
    """About as many cells of range and range rate as the grid of a look has."""
    n_azimuth, n_range = grid.shape
    return int(scipy.fft.next_fast_len(n_range + 64)), int(scipy.fft.next_fast_len(n_azimuth + 64))


def look_bytes(grid: ImageGrid, n_layers: int) -> int:
    """Bytes of an image made from one look, its plan included."""
    pixels = int(np.prod(grid.shape))
    return pixels * (LOOK_PIXEL + LOOK_FIELD + (PIXEL + FINISHING) * n_layers)


def check_image_fits(grid: ImageGrid, n_layers: int) -> None:
    """Refuse an image that does not fit into memory.

    Raises
    ------
    ResourceError
        It does not fit.
    """
    rows, columns = grid.shape
    check_fits(
        f"image: {rows} x {columns} pixels in {n_layers} layers",
        focusing_bytes(grid, n_layers),
        "make its extents smaller or its pixel spacings wider",
    )


__all__ = ["check_image_fits", "focusing_bytes", "look_bytes", "look_shape"]
