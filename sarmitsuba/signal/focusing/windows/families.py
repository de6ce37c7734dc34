"""Families of windows: a constant and a cosine (rectangular, Hamming, Hann), Kaiser, Taylor.

Kaiser's has nearly the largest energy in a main lobe of given width, Taylor's nearly equal side lobes of a given level
next to the main lobe.
"""

from functools import lru_cache

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import amplitude_from_db
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


def kaiser(u: F64, beta: float) -> F64:
    r""":math:`w(u) = I_0(\beta \sqrt{1 - 4 u^2}) / I_0(\beta)`."""
    return np.asarray(np.i0(beta * np.sqrt(np.clip(1.0 - 4.0 * u**2, 0.0, None))) / np.i0(beta))


WINDOWS.register(
    WindowFamily(
        "kaiser",
        "most energy in the main lobe; a greater beta lowers the side lobes and widens it",
        kaiser,
        (WindowParameter("beta", 2.5, 0.0, 40.0, "0 is rectangular, 8.6 gives side lobes below -60 dB"),),
    )
)


def taylor(u: F64, n_bar: float, level_db: float) -> F64:
    r""":math:`w(u) = 1 + 2 \sum_{m=1}^{\bar n - 1} F_m \cos 2 \pi m u`."""
    out = np.ones_like(u)
    for m, f in enumerate(taylor_coefficients(int(n_bar), level_db), start=1):
        out += 2.0 * f * np.cos(2.0 * np.pi * m * u)
    return out


@lru_cache(maxsize=64)
def taylor_coefficients(n_bar: int, level_db: float) -> tuple[float, ...]:
    """Coefficients F_m, m = 1 ... n_bar - 1.

    References
    ----------
    Carrara, Goodman, Majewski, *Spotlight SAR*, appendix D.2 (sidelobe level ``level_db`` < 0).
    """
    a = np.arccosh(amplitude_from_db(-level_db)) / np.pi
    s2 = n_bar**2 / (a**2 + (n_bar - 0.5) ** 2)
    m = np.arange(1, n_bar)
    out = np.empty(n_bar - 1)
    for i, mi in enumerate(m):
        top = np.prod(1.0 - mi**2 / s2 / (a**2 + (m - 0.5) ** 2))
        bottom = np.prod(1.0 - mi**2 / m[m != mi] ** 2)
        out[i] = 0.5 * (-1.0) ** (mi + 1) * top / bottom
    return tuple(float(f) for f in out)


WINDOWS.register(
    WindowFamily(
        "taylor",
        "n_bar nearly equal side lobes of a chosen level, narrow main lobe",
        taylor,
        (
            WindowParameter("n_bar", 4.0, 2.0, 64.0, "number of nearly equal side lobes", whole=True),
            WindowParameter("level_db", -35.0, -100.0, -14.0, "highest side lobe over the peak, dB"),
        ),
    )
)
