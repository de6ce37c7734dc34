"""Adds the contributions of one look to a grid over slant range and range rate."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sarmitsuba.backend import dr, mi
from sarmitsuba.echo.look_grid import LookGrid
from sarmitsuba.trace.accumulators import GridAccumulator

if TYPE_CHECKING:
    from sarmitsuba.trace.accumulators import LostCount
    from sarmitsuba.trace.state import Contribution


class ImageAccumulator(GridAccumulator):
    """Adds each path once to the grid of a look."""

    def __init__(
        self, grid: LookGrid, n_slots: int, n_channels: int, max_order: int, wavelength: float
    ) -> None:
        super().__init__(n_slots, grid.n_range, grid.n_range_rate, n_channels, max_order, wavelength)
        self.look = grid

    def add(self, state: LostCount, contribution: Contribution) -> LostCount:
        """Spread on the look's grid; see :class:`sarmitsuba.trace.kernel.Accumulator`."""
        look, f64 = self.look, mi.Float64
        r, s = contribution.slant_range, contribution.range_rate
        if look.zero_doppler:
            sine = s * dr.opaque(f64, 1.0 / look.speed)
            cosine = dr.sqrt(dr.maximum(1.0 - sine * sine, 1e-6))
            r, s = r * cosine, s / cosine
        offset = r - dr.opaque(f64, look.reference_range)
        x = (offset - dr.opaque(f64, look.range0)) * dr.opaque(f64, 1.0 / look.range_step)
        y = (s - dr.opaque(f64, look.range_rate0)) * dr.opaque(f64, 1.0 / look.range_rate_step)
        inside = self.spread(contribution, offset, (x, y), (look.kernel, look.kernel))
        return self.counted(state, contribution, contribution.active & ~inside)


__all__ = ["ImageAccumulator"]
