"""Block synthesis: paths are added once to a (range, range rate) grid and become K pulses together."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.echo.gridding import SpreadingKernel, spreading_kernel

F64 = NDArray[np.float64]
C64 = NDArray[np.complex64]


@dataclass(frozen=True, eq=False)
class BlockPlan:
    r"""Grid and geometry of one block of pulses ``start:stop`` about the key pulse ``key``.

    A path of half length h and amplitude a (constant within the block) is added once. With the antenna at
    ``position`` (of the key pulse) and the velocity ``velocity``::

        R0   = h - |reference - position|                          (float64)
        rate = dh/dt - d|reference - antenna|/dt                    (both with ``velocity``)
        x    = (R0 - range0) / range_step,  y = (rate - rate0) / rate_step
        grid[layer, i, j] += a exp(-j 4 pi fc R0 / c) phi(x - i) phi(y - j)

    with ``phi`` the taps of ``kernel`` along range and of ``rate_kernel`` along the rate. Contributions must
    satisfy ``margin <= x <= n_range - 1 - margin`` and alike for y, with the kernels' ``margin``; the box given
    to ``plan_block`` guarantees it for all paths that stay inside, anything else must be masked.

    Parameters
    ----------
    key, start, stop : pulse indices; ``start <= key < stop``
    position, velocity : (3,) float64, m and m/s, scene frame; the antenna's at the key time. The velocity is
        the slope of the best line through the block's positions: use it, not the track's own, for ``rate``
    reference : (3,) float64, m, scene frame; P_ref
    reference_range : |reference - position|, m
    tau : (K,) float64, s, pulse times less the key pulse's
    range0, range_step, n_range : half length of cell 0, cell (m) and number of cells along range
    rate0, rate_step, n_rate : the same along the rate, m/s
    width, rate_width : of the spreading kernels
    n_inner : length of the FFT over the grid's range axis
    n_fine, n_out : lengths of the last two FFTs, ``n_fine * range_step = n_out * sample_spacing``
    range_center, range_scale, rate_center, rate_scale : normalisation of the curvature polynomials
    range_curvature : (4, K) float64, m: polynomial in (R0 - range_center) / range_scale of the half length that
        ``R0 + rate tau`` leaves out; see ``plan_block``
    rate_curvature : (4, K) float64, m: the same in (rate - rate_center) / rate_scale
    geometry_error_db : worst over the box's sample points of the rms phase error over the block, dB
    kernel_error_db : rms error of the two spreading kernels, dB
    """

    key: int
    start: int
    stop: int
    position: F64
    velocity: F64
    reference: F64
    reference_range: float
    tau: F64
    range0: float
    range_step: float
    n_range: int
    rate0: float
    rate_step: float
    n_rate: int
    width: int
    rate_width: int
    n_inner: int
    n_fine: int
    n_out: int
    range_center: float
    range_scale: float
    rate_center: float
    rate_scale: float
    range_curvature: F64
    rate_curvature: F64
    geometry_error_db: float
    kernel_error_db: float

    @property
    def n_pulses(self) -> int:
        """Pulses of this block, K."""
        return self.stop - self.start

    @property
    def predicted_error_db(self) -> float:
        """Relative error to expect, geometry and kernel together, dB."""
        return float(10.0 * np.log10(10.0 ** (self.geometry_error_db / 10) + 10.0 ** (self.kernel_error_db / 10)))

    @property
    def kernel(self) -> SpreadingKernel:
        """Spreading kernel along range."""
        return spreading_kernel(self.width)

    @property
    def rate_kernel(self) -> SpreadingKernel:
        """Spreading kernel along the rate."""
        return spreading_kernel(self.rate_width)

    def shape(self, n_layers: int) -> tuple[int, int, int]:
        """Shape of the complex64 grid, (n_layers, n_range, n_rate)."""
        return (n_layers, self.n_range, self.n_rate)
