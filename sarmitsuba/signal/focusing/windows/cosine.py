"""Windows that are a constant and a cosine: rectangular, Hamming, Hann."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.signal.focusing.windows.window import WINDOWS, WindowFamily, WindowParameter


def rectangular(u: F64) -> F64:
    """``w = 1``."""
    return np.ones_like(u)


def hamming(u: F64, pedestal: float) -> F64:
    r""":math:`w = a + (1 - a) \cos 2 \pi u`."""
    return np.asarray(pedestal + (1.0 - pedestal) * np.cos(2.0 * np.pi * u))


def hann(u: F64) -> F64:
    r""":math:`w = \cos^2 \pi u`."""
    return np.asarray(0.5 + 0.5 * np.cos(2.0 * np.pi * u))


WINDOWS.register(
    WindowFamily("rectangular", "no weighting: sharpest, first side lobe at -13.3 dB", rectangular)
)
WINDOWS.register(
    WindowFamily(
        "hamming",
        "cosine on a pedestal, side lobes below -42.7 dB at 0.54",
        hamming,
        (WindowParameter("pedestal", 0.54, 0.5, 1.0, "weight at the edge is 2 pedestal - 1"),),
    )
)
WINDOWS.register(WindowFamily("hann", "raised cosine, side lobes fall off fast", hann))
