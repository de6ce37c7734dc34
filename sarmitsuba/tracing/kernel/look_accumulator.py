"""Accumulator of the image-domain method: the grid onto which the echoes of looks are spread."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.signal.raw.look_grid import LookGrid
from sarmitsuba.tracing.kernel.accumulators import GridAccumulator
from sarmitsuba.tracing.kernel.device_arrays import device_array

if TYPE_CHECKING:
    from sarmitsuba.tracing.kernel.accumulators import LostCount
    from sarmitsuba.tracing.kernel.state import Contribution


class ImageAccumulator(GridAccumulator):
    """Grid of the looks, onto which each path is added once.

    Parameters
    ----------
    grid : of the looks
    n_slots, n_channels, max_order, wavelength : as for :class:`sarmitsuba.tracing.kernel.accumulators.GridAccumulator`
    """

    def __init__(
        self, grid: LookGrid, n_slots: int, n_channels: int, max_order: int, wavelength: float
    ) -> None:
        super().__init__(n_slots, grid.n_range, grid.n_azimuth, n_channels, max_order, wavelength)
        self.look = grid
        self.antenna = device_array(mi.Float64, grid.antenna)

    def serve(self, first: int, last: int) -> None:
        """Assign the pulses of the next launch to the looks ``first`` to ``last`` (not included)."""
        self.antenna = device_array(mi.Float64, self.look.antenna[first:last])

    def add(self, state: LostCount, contribution: Contribution) -> LostCount:
        """Spread on the looks' grid; see :class:`sarmitsuba.tracing.kernel.kernel.Accumulator`."""
        contribution, offset, cells = self.placed(contribution)
        inside = self.spread(contribution, offset, cells, (self.look.kernel, self.look.kernel))
        return self.counted(state, contribution, contribution.active & ~inside)

    def look_weight(self, share: mi.Float) -> mi.Float:
        """Factor on the amplitude of an echo that has a share of a look; those of two neighbours add up to one."""
        return share

    def placed(
        self, contribution: Contribution
    ) -> tuple[Contribution, mi.Float64, tuple[mi.Float64, mi.Float64]]:
        """Echo with the look's weight on its amplitude, its range coordinate (m), and its place on the grid (cells)."""
        look, f64 = self.look, mi.Float64
        r, s = contribution.slant_range, contribution.range_rate
        if look.fan is not None:
            antenna = dr.gather(f64, self.antenna, contribution.pulse, contribution.active)
            numbers = tuple(dr.opaque(f64, value) for value in look.fan.numbers)
            r, s, distance = look.fan.place(r, s, antenna, numbers, dr)
            # as a point at rest of the same cross section, at the time when the beam passes over it
            part = mi.Float(dr.square(contribution.slant_range / distance))
            active = contribution.active
            if look.n_looks > 1:
                ends = (dr.opaque(f64, float(look.antenna[i])) for i in (0, -1))
                off = dr.abs(dr.clip(s, *ends) - antenna) * dr.opaque(f64, 1.0 / look.spacing)
                share = mi.Float(1.0 - off)
                active &= share > 0.0
                part *= self.look_weight(share)
            amplitudes = tuple(amplitude * part for amplitude in contribution.amplitudes)
            contribution = replace(contribution, amplitudes=amplitudes, active=active)
        offset = r - dr.opaque(f64, look.reference_range)
        x = (offset - dr.opaque(f64, look.range0)) * dr.opaque(f64, 1.0 / look.range_step)
        y = (s - dr.opaque(f64, look.azimuth0)) * dr.opaque(f64, 1.0 / look.azimuth_step)
        return contribution, offset, (x, y)
