"""Side lobes of the impulse response, by which a page tells a weak pixel from its bright neighbour's spill."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64
from sarmitsuba.signal.focusing.windows import Window, parse_window
from sarmitsuba.signal.image.sar_image import SarImage

# cells along each axis over which side lobes are followed, and most pixels
_REACH, _MOST = 24.0, 160
# samples of a window, and of its transform in a cell
_SAMPLES, _FINE = 512, 32


def side_lobes(image: SarImage, range_window: str, azimuth_window: str) -> dict[str, NDArray[np.generic]]:
    """Greatest amplitudes of the impulse response so many pixels from its peak or further, relative to the peak.

    Parameters
    ----------
    image : of which the cells and the pixels count
    range_window, azimuth_window : with which it was focused

    Returns
    -------
    ``azimuth`` and ``range``, (n,) float32 from 0 pixels on, falling

    Notes
    -----
    The response is the product of the windows' transforms along the image's axes. Ignores squint, which turns the
    side lobes of range, and the shape of the band of wide apertures.
    """
    grid = image.grid
    range_cell = image.range_resolution_cell
    if grid.kind == "ground":
        range_cell /= float(np.sin(np.median(image.incidence_angle)))
    cells = {
        "azimuth": (image.azimuth_resolution_cell, grid.azimuth_spacing, azimuth_window),
        "range": (range_cell, grid.range_spacing, range_window),
    }
    return {
        name: _envelope(parse_window(text), cell, spacing).astype(np.float32)
        for name, (cell, spacing, text) in cells.items()
    }


def _envelope(window: Window, cell: float, spacing: float) -> F64:
    """Envelope at every pixel; ``cell`` is the noise-equivalent width."""
    own = cell / window.broadening  # the width without a window
    count = int(np.clip(np.ceil(_REACH * own / spacing), 1, _MOST))
    pixels = np.arange(count + 1)
    away = np.arange(0.0, (count + 1) * spacing / own + 2.0, 1.0 / _FINE)
    places = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    weights = window(places)
    response = np.abs(np.cos(2.0 * np.pi * np.outer(away, places)) @ weights) / weights.sum()
    falling = np.maximum.accumulate(response[::-1])[::-1]
    # the peak may be half a pixel nearer
    return np.asarray(np.interp(np.maximum(pixels - 0.5, 0.0) * spacing / own, away, falling))
