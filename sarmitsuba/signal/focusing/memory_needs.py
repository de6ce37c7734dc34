"""Memory needs of focusing, from the sizes of data and image."""

import numpy as np

from sarmitsuba.machine.memory import check_fits
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.image.sar_image import ImageGrid

# pixels of a backprojection tile; bytes per pixel for its place in the image; per line for the position in NumPy (three
# times while it is made) and on the device
TILE_PIXELS, TILE_BYTES, LINE_BYTES = 1 << 20, 24, 88
# bytes per pixel and layer of the sums, before and after a batch of pulses
SUMS = 24
# bytes of a range-compressed sample as an upsampled profile, of those of one batch of pulses at most, and their copies
PROFILE, BATCH, COPIES = 32, 5 << 20, 5
# bytes per pixel and layer of the finished image, and of error bars, files and pictures
PIXEL, FINISHING = 8, 16
# bytes per pixel: while a look is planned, and of its plan and one layer's field
LOOK_PIXEL, LOOK_FIELD = 60, 44
# bytes per cell of the grid of several looks, while its impulse response is made
LOOK_CELL = 40


def backprojection_bytes(radar: Radar, grid: ImageGrid, n_layers: int, per_line: int = 1) -> int:
    """Peak memory in bytes of backprojection with ``per_line`` pixels in a line, pixels included.

    Raw data are not included.
    """
    pixels, samples = int(np.prod(grid.shape)), n_layers * radar.track.n_pulses * radar.window.n_samples
    tile = min(pixels, TILE_PIXELS) * (TILE_BYTES + LINE_BYTES // per_line + SUMS * min(n_layers, 4))
    return PIXEL * pixels * n_layers + tile + COPIES * min(PROFILE * samples, BATCH)


def focusing_bytes(grid: ImageGrid, n_layers: int, making: int) -> int:
    """Peak memory in bytes of making and storing an image; ``making``: while its pixels are made."""
    return max(making, (PIXEL + FINISHING) * int(np.prod(grid.shape)) * n_layers)


def look_bytes(grid: ImageGrid, n_layers: int, n_cells: int) -> int:
    """Bytes of an image made from looks, its plan and their grid's cells included."""
    each = max(LOOK_PIXEL, LOOK_FIELD + PIXEL * n_layers, (PIXEL + FINISHING) * n_layers)
    return max(int(np.prod(grid.shape)) * each, LOOK_CELL * n_cells)


def check_image_fits(grid: ImageGrid, n_layers: int, making: int) -> None:
    """Raise a ResourceError for an image that does not fit into memory; ``making`` as in :func:`focusing_bytes`.

    Raises
    ------
    ResourceError
        It does not fit.
    """
    rows, columns = grid.shape
    check_fits(
        f"image: {rows} x {columns} pixels in {n_layers} layers",
        focusing_bytes(grid, n_layers, making),
        "make its extents smaller or its pixel spacings wider",
    )
