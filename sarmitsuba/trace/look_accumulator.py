"""Contributions of one look binned straight into image coordinates: slant range and range rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.backend import dr, mi
from sarmitsuba.echo.gridding import SpreadingKernel, spreading_kernel
from sarmitsuba.trace.accumulators import GridAccumulator, grid_cells, phase_factor

if TYPE_CHECKING:
    from sarmitsuba.trace.state import Contribution

F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LookGrid:
    r"""Where the contributions of one look go: a grid over range and range rate, about the look's position.

    A path of slant range h and rate h' goes to the cell of its range and rate (``zero_doppler`` off; every pixel is
    seen by the same pulses), or of its closest approach (on; the beam passes over every pixel in turn):

    .. math:: r_c = h \sqrt{1 - (h' / v)^2}, \quad s = h h' / r_c

    Both are exact for straight paths on a straight track; the rate of a path is the sine of its angle off the
    zero-Doppler plane times the speed, so s is its azimuth times ``-v^2 / r_c``.

    Parameters
    ----------
    position, velocity : (3,) float64, m and m/s, scene frame; of the antenna at the look's time
    zero_doppler : coordinates of closest approach instead of the look's own
    reference_range : m; range of the origin, subtracted before the phase is formed
    range0, range_step, n_range : range of cell 0 less ``reference_range`` (m), cell (m), number of cells
    rate0, rate_step, n_rate : the same along the rate, m/s
    width : of the spreading kernel, both axes
    """

    position: F64
    velocity: F64
    zero_doppler: bool
    reference_range: float
    range0: float
    range_step: float
    n_range: int
    rate0: float
    rate_step: float
    n_rate: int
    width: int

    @property
    def kernel(self) -> SpreadingKernel:
        """Spreading kernel of both axes."""
        return spreading_kernel(self.width)

    @property
    def speed(self) -> float:
        """Antenna's speed, m/s."""
        return float(np.linalg.norm(self.velocity))

    def coordinates(self, slant_range: Any, range_rate: Any, xp: Any = np) -> tuple[Any, Any]:
        """Range and rate coordinate of paths, m and m/s, arrays of NumPy or Dr.Jit float64."""
        if not self.zero_doppler:
            return slant_range, range_rate
        sine = range_rate * (1.0 / self.speed)
        cosine = xp.sqrt(xp.maximum(1.0 - sine * sine, 1e-6))
        return slant_range * cosine, range_rate / cosine

    def cells(self, slant_range: Any, range_rate: Any, xp: Any = np) -> tuple[Any, Any, Any]:
        """Range less the reference (m), and the position of paths on the two axes in cells."""
        r, s = self.coordinates(slant_range, range_rate, xp)
        offset = r - self.reference_range
        x = (offset - self.range0) * (1.0 / self.range_step)
        y = (s - self.rate0) * (1.0 / self.rate_step)
        return offset, x, y


class ImageAccumulator(GridAccumulator):
    """Adds each path once to the grid of a look."""

    def __init__(
        self, grid: LookGrid, n_slots: int, n_channels: int, max_order: int, wavelength: float
    ) -> None:
        super().__init__(n_slots, grid.n_range, grid.n_rate, n_channels, max_order, wavelength)
        self.look = grid

    def add(self, state: tuple[mi.UInt32], contribution: Contribution) -> tuple[mi.UInt32]:
        """Spread on the look's grid; see :class:`sarmitsuba.trace.kernel.Accumulator`."""
        look, f64 = self.look, mi.Float64
        r, s = contribution.slant_range, contribution.range_rate
        if look.zero_doppler:
            sine = s * dr.opaque(f64, 1.0 / look.speed)
            cosine = dr.sqrt(dr.maximum(1.0 - sine * sine, 1e-6))
            r, s = r * cosine, s / cosine
        offset = r - dr.opaque(f64, look.reference_range)
        x = (offset - dr.opaque(f64, look.range0)) * dr.opaque(f64, 1.0 / look.range_step)
        y = (s - dr.opaque(f64, look.rate0)) * dr.opaque(f64, 1.0 / look.rate_step)
        ix, wx, inside_x = grid_cells(x, look.kernel, look.n_range)
        iy, wy, inside_y = grid_cells(y, look.kernel, look.n_rate)
        inside = contribution.active & inside_x & inside_y
        phase = phase_factor(offset, self.wavelength)
        values = [amplitude * phase for amplitude in contribution.amplitudes]
        # opaque: another grid of the same kind then needs no new kernel
        n_range, n_rate = dr.opaque(mi.UInt32, look.n_range), dr.opaque(mi.UInt32, look.n_rate)
        base = (self.slot(contribution.order) * n_range + ix) * n_rate + iy
        for i, wi in enumerate(wx):
            for j, wj in enumerate(wy):
                self.scatter(base + (i * n_rate + j), values, wi * wj, inside)
        return (dr.select(contribution.active & ~inside, state[0] + 1, state[0]),)


__all__ = ["ImageAccumulator", "LookGrid"]
