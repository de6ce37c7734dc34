"""Bytes that focusing takes, from the sizes of data and image alone."""

import numpy as np
import scipy.fft

from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.memory import check_fits
from sarmitsuba.radar.radar import Radar

# pixels of a backprojection tile, and bytes of one: positions in NumPy (three times while they are made) and on the
# device, and its place in the image
TILE_PIXELS, TILE_BYTES = 1 << 20, 112
# bytes of a pixel and layer on its way: what is summed, before and after a batch of pulses
SUMS = 24
# bytes of a range-compressed sample as an upsampled profile, of those of one batch of pulses at most, and their copies
PROFILE, BATCH, COPIES = 32, 12 << 20, 5
# bytes of a pixel and layer in the finished image, and of those that error bars, files and pictures add
PIXEL, FINISHING = 8, 16
# bytes of a pixel: while a look is planned, and of its plan and one layer's field
LOOK_PIXEL, LOOK_FIELD = 60, 44
# cells that the grid of a look keeps free along each axis
LOOK_MARGIN = 96


def focusing_bytes(grid: ImageGrid, n_layers: int, samples: int) -> int:
    """Bytes of the image with all that making and keeping it takes; ``samples`` of all layers' raw data."""
    pixels = int(np.prod(grid.shape))
    tile = min(pixels, TILE_PIXELS)
    making = tile * (TILE_BYTES + SUMS * min(n_layers, 4)) + COPIES * min(PROFILE * samples, BATCH)
    return PIXEL * pixels * n_layers + max(making, FINISHING * pixels * n_layers)


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


def check_image_fits(grid: ImageGrid, n_layers: int, samples: int) -> None:
    """Refuse an image that does not fit into memory beside its raw data.

    Raises
    ------
    ResourceError
        It does not fit.
    """
    rows, columns = grid.shape
    check_fits(
        f"image: {rows} x {columns} pixels in {n_layers} layers",
        focusing_bytes(grid, n_layers, samples),
        "make its extents smaller or its pixel spacings wider",
    )


__all__ = ["check_image_fits", "focusing_bytes", "look_bytes", "look_shape"]
