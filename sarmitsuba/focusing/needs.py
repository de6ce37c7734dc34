"""Bytes that focusing takes, from the sizes of data and image alone."""

import numpy as np
import scipy.fft

from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.memory import check_fits
from sarmitsuba.radar.radar import Radar

# pixels of a backprojection tile; bytes of one, its place in the image; of a line of them, the position in NumPy (three
# times while it is made) and on the device
TILE_PIXELS, TILE_BYTES, LINE_BYTES = 1 << 20, 24, 88
# bytes of a pixel and layer on its way: what is summed, before and after a batch of pulses
SUMS = 24
# bytes of a range-compressed sample as an upsampled profile, of those of one batch of pulses at most, and their copies
PROFILE, BATCH, COPIES = 32, 5 << 20, 5
# bytes of a pixel and layer in the finished image, and of those that error bars, files and pictures add
PIXEL, FINISHING = 8, 16
# bytes of a pixel: while a look is planned, and of its plan and one layer's field
LOOK_PIXEL, LOOK_FIELD = 60, 44
# cells that the grid of a look keeps free along each axis
LOOK_MARGIN = 96


def backprojection_bytes(radar: Radar, grid: ImageGrid, n_layers: int, per_line: int = 1) -> int:
    """Most bytes at a time while backprojection makes the pixels, ``per_line`` in a line, those included.

    The raw data are held already.
    """
    pixels, samples = int(np.prod(grid.shape)), n_layers * radar.track.n_pulses * radar.window.n_samples
    tile = min(pixels, TILE_PIXELS) * (TILE_BYTES + LINE_BYTES // per_line + SUMS * min(n_layers, 4))
    return PIXEL * pixels * n_layers + tile + COPIES * min(PROFILE * samples, BATCH)


def focusing_bytes(grid: ImageGrid, n_layers: int, making: int) -> int:
    """Bytes of the image with all that making and keeping it takes; ``making`` of them while its pixels are made."""
    return max(making, (PIXEL + FINISHING) * int(np.prod(grid.shape)) * n_layers)


def look_shape(radar: Radar, grid: ImageGrid, azimuth_cell: float) -> tuple[int, int]:
    """About as many cells of range and range rate as the grid of a look has: two per resolution cell."""
    lines = [grid.positions_on_line(i) for i in (0, grid.shape[0] // 2, grid.shape[0] - 1)]
    distance = np.linalg.norm(np.array(lines) - radar.track.center_position, axis=-1)
    n_range = 2.0 * float(np.ptp(distance)) / radar.waveform.range_cell
    n_azimuth = 2.0 * float(np.ptp(grid.azimuth)) / azimuth_cell
    first, second = (int(scipy.fft.next_fast_len(int(n) + LOOK_MARGIN)) for n in (n_range, n_azimuth))
    return first, second


def look_bytes(grid: ImageGrid, n_layers: int) -> int:
    """Bytes of an image made from one look, its plan included."""
    each = max(LOOK_PIXEL, LOOK_FIELD + PIXEL * n_layers, (PIXEL + FINISHING) * n_layers)
    return int(np.prod(grid.shape)) * each


def check_image_fits(grid: ImageGrid, n_layers: int, making: int) -> None:
    """Refuse an image that does not fit into memory beside its raw data; ``making`` as in :func:`focusing_bytes`.

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


__all__ = ["backprojection_bytes", "check_image_fits", "focusing_bytes", "look_bytes", "look_shape"]
