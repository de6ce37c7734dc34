"""Kaiser window: nearly the largest energy in a main lobe of given width."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.signal.focusing.windows.window import WINDOWS, WindowFamily, WindowParameter


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
