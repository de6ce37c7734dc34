"""Direct adder: every path is spread onto every pulse's own range grid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.echo.gridding import SpreadingKernel, spreading_kernel

F64 = NDArray[np.float64]
C64 = NDArray[np.complex64]


@dataclass(frozen=True, eq=False)
class DirectPlan:
    r"""Range grids of the pulses ``start:stop``, one a pulse.

    A path of half length h(t) and amplitude a is added at pulse t (k counts from ``start``) as::

        x = (h(t) - range0[k]) / range_step
        grid[layer, k, i] += a exp(-j 4 pi fc h(t) / c) phi(x - i)

    Parameters
    ----------
    start, stop : first pulse and one past the last
    range0 : (stop - start,) float64, half length of cell 0 at each pulse, m
    range_step : cell, m; half a range cell or slightly less
    n_range : cells a pulse
    width : of the spreading kernel
    n_fine, n_out : lengths of the two FFTs, ``n_fine * range_step = n_out * sample_spacing``
    """

    start: int
    stop: int
    range0: F64
    range_step: float
    n_range: int
    width: int
    n_fine: int
    n_out: int

    @property
    def n_pulses(self) -> int:
        """Pulses of this plan."""
        return self.stop - self.start

    @property
    def kernel(self) -> SpreadingKernel:
        """The spreading kernel."""
        return spreading_kernel(self.width)

    def shape(self, n_layers: int) -> tuple[int, int, int]:
        """Shape of the complex64 grid, (n_layers, n_pulses, n_range)."""
        return (n_layers, self.n_pulses, self.n_range)
