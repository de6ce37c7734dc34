"""Pictures of samples for detectors: 8 bits of the logarithm of intensity."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64
from sarmitsuba.core.units import db_from_power
from sarmitsuba.machine.atomic import atomic_path

# share of the pixels that are as bright as the brightest
_BRIGHTEST = 1e-3


def grey_levels(image: C64, range_db: float) -> NDArray[np.uint8]:
    """Grey levels (rows, columns) of the channels' mean intensity (channels, rows, columns).

    255 is the intensity that a thousandth of the pixels exceeds, 0 is ``range_db`` below it.
    """
    power = (image.real.astype(np.float64) ** 2 + image.imag.astype(np.float64) ** 2).mean(axis=0)
    top = float(np.quantile(power, 1.0 - _BRIGHTEST)) or float(power.max()) or 1.0
    level = db_from_power(np.maximum(power / top, 1e-30))
    return np.asarray(np.clip(np.round(255.0 * (1.0 + level / range_db)), 0, 255).astype(np.uint8))


def write_picture(path: Path, levels: NDArray[np.uint8]) -> None:
    """Write a PNG."""
    from PIL import Image

    with atomic_path(path) as temporary:
        Image.fromarray(levels).save(temporary, format="PNG")
