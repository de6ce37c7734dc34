"""Accumulators of echoes: sums (RCS), range grids (direct), range-rate grids (block), grids of looks (image)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.signal.look_grid import LookGrid
from sarmitsuba.signal.pulse_motion import carrier_range
from sarmitsuba.tracing.kernel.device_arrays import device_array

if TYPE_CHECKING:
    LostCount = tuple[mi.UInt32, mi.Float, mi.Float]
    from sarmitsuba.signal.block import BlockPlan
    from sarmitsuba.signal.direct import DirectPlan
    from sarmitsuba.signal.gridding import GriddingKernel
    from sarmitsuba.tracing.derivatives.echo_derivatives import AdjointGrids
    from sarmitsuba.tracing.kernel.source import Launch
    from sarmitsuba.tracing.kernel.state import Contribution


# float64 numbers in the smallest grid (2 MB), and the size up to which grids grow by four (32 MB); beyond it by two
SMALLEST_GRID = 1 << 18
FOURFOLD_UP_TO = 1 << 22


class GridAccumulator:
    """Complex grid onto which echoes are spread with the gridding kernel of a non-uniform FFT, summed in float64.

    The million equal contributions of a plate at normal incidence, added one by one in float32, are 0.4 % (-48 dB)
    off; in float64 the sum is exact to float32 whatever its order, and costs no more time.

    Cells hold all channels side by side, so that one packet add serves them all. On the CPU every thread adds into
    a copy of its own and the copies are summed at the end of the launch: packet adds without atomics, an order of
    magnitude faster than atomic ones.

    Parameters
    ----------
    n_slots, n_rows, n_columns : shape of the grid: bounce orders (1 when summed), then two coordinates
    n_channels : amplitudes per contribution
    max_order : orders kept apart, 1..max_order; 0 sums all orders
    wavelength : m
    least_bytes : smallest size of the memory; smaller grids of a run then use the kernel compiled for the largest

    Attributes
    ----------
    memory : Dr.Jit float64, flat: slot, row, column, channel (padded to a power of two), re and im
    adjoint : grids of the same cells that echoes read, instead of adding to the memory; None: they are added
    """

    def __init__(
        self,
        n_slots: int,
        n_rows: int,
        n_columns: int,
        n_channels: int,
        max_order: int,
        wavelength: float,
        least_bytes: int = 0,
    ) -> None:
        self.shape = (n_slots, n_rows, n_columns)
        self.n_channels = n_channels
        self.padded = 1 << (n_channels - 1).bit_length()
        self.max_order = max_order
        self.wavelength = wavelength
        self.memory = dr.zeros(mi.Float64, max(grid_numbers(self.shape, n_channels), least_bytes // 8))
        self.on_cpu = dr.backend_v(mi.Float) == dr.JitBackend.LLVM
        self.window: tuple[mi.Float64, float] | None = None
        self.adjoint: AdjointGrids | None = None
        self.packet = (mi.Vector2d, mi.Vector4d, mi.ArrayXd)[min(self.padded.bit_length() - 1, 2)]

    def watch(self, start_range: F64, extent: float) -> None:
        """Count the echoes centred outside the receive window; the part of them that falls inside is kept.

        Parameters
        ----------
        start_range : (n_pulses,) of the launch, m; extent : length of the window, m
        """
        self.window = (device_array(mi.Float64, start_range), extent)

    def outside(self, contribution: Contribution) -> mi.Bool:
        """True for contributions outside the receive window, where one is watched."""
        if self.window is None:
            return mi.Bool(False)
        start, extent = self.window
        first = dr.gather(mi.Float64, start, contribution.pulse, contribution.active)
        r = contribution.slant_range - first
        return (r < 0.0) | (r > dr.opaque(mi.Float64, extent))

    def begin(self) -> LostCount:
        """Initial count of this lane: echoes outside the receive window, their power and the power of all, W."""
        return mi.UInt32(0), mi.Float(0.0), mi.Float(0.0)

    def spread(
        self,
        contribution: Contribution,
        range_offset: mi.Float64,
        cells: tuple[mi.Float64, mi.Float64],
        kernels: tuple[GriddingKernel, GriddingKernel],
        slot: mi.UInt32 | None = None,
    ) -> mi.Bool:
        """Spread echoes over rows and columns (position in cells, kernel); returns the lanes within the grid.

        ``range_offset`` (m) is the slant range less the reference that the phase is taken from; ``slot``: other than
        that of the bounce order.
        """
        (x, y), (_, n_rows, n_columns) = cells, self.shape
        ix, wx, inside_x = grid_cells(x, kernels[0], n_rows)
        iy, wy, inside_y = grid_cells(y, kernels[1], n_columns)
        inside = contribution.active & inside_x & inside_y
        phase = phase_factor(range_offset, self.wavelength)
        values = [amplitude * phase for amplitude in contribution.amplitudes]
        slot = self.slot(contribution.order) if slot is None else slot
        base, columns, inside = self.first_cell(slot, ix, iy, inside)
        for i, wi in enumerate(wx):
            for j, wj in enumerate(wy):
                self.scatter(base + (i * columns + j), values, wi * wj, inside)
        return inside

    def first_cell(
        self, slot: mi.UInt32, ix: mi.UInt32, iy: mi.UInt32, inside: mi.Bool
    ) -> tuple[mi.UInt32, mi.UInt32, mi.Bool]:
        """Place in memory of row ``ix`` and column ``iy``, cells from there to the next row, and lanes in memory."""
        # opaque sizes: the next grid of the same kind then needs no new kernel
        rows, columns = (dr.opaque(mi.UInt32, n) for n in self.shape[1:])
        return (slot * rows + ix) * columns + iy, columns, inside

    def before(self, launch: Launch, n_pulses: int) -> None:
        """Prepare for a launch from a number of pulses; most need nothing."""

    @property
    def written(self) -> Sequence[mi.Float]:
        """Arrays to which a launch writes."""
        return [self.memory if self.adjoint is None else self.adjoint.total.memory]

    def counted(self, state: LostCount, contribution: Contribution, lost: mi.Bool) -> LostCount:
        """The count with one more contribution."""
        power = sum((dr.squared_norm(a) for a in contribution.amplitudes), mi.Float(0.0))
        power = dr.select(contribution.active, power, 0.0)
        return (
            dr.select(lost, state[0] + 1, state[0]),
            state[1] + dr.select(lost, power, 0.0),
            state[2] + power,
        )

    @property
    def n_bytes(self) -> int:
        """Size of the memory, bytes (on the CPU every thread has a copy during the launch)."""
        return 8 * len(self.memory)

    def slot(self, order: mi.UInt32) -> mi.UInt32:
        """Slot of an order (uint32)."""
        if self.max_order == 0:
            return mi.UInt32(0)
        return dr.minimum(order, self.max_order) - 1

    def scatter(
        self, cell: mi.UInt32, values: Sequence[mi.Complex2f], weight: mi.Float, active: mi.Bool
    ) -> None:
        """Add one weighted complex value per channel to one cell, or read the cell of the adjoint grids."""
        if self.adjoint is not None:
            self.adjoint.read(cell, values, weight, active)
            return
        parts = [mi.Float64(part * weight) for v in values for part in (v.real, v.imag)]
        if self.on_cpu:
            parts += [mi.Float64(0.0)] * (2 * self.padded - len(parts))
            dr.scatter_add(self.memory, self.packet(*parts), cell, active, mode=dr.ReduceMode.Expand)
            return
        for i, part in enumerate(parts):
            dr.scatter_add(self.memory, part, cell * (2 * self.padded) + i, active)

    def add(self, state: LostCount, contribution: Contribution) -> LostCount:
        """Add one contribution; see :class:`sarmitsuba.tracing.kernel.kernel.Accumulator`."""
        raise NotImplementedError

    def grid(self) -> C64:
        """(n_slots * n_channels, n_rows, n_columns) complex64 after the launch, channels fastest in the first axis."""
        s, m, n = self.shape
        used = self.memory.numpy()[: 2 * self.padded * s * m * n]
        cells = used.view(np.complex128).reshape(s, m, n, self.padded)[..., : self.n_channels]
        return np.asarray(np.moveaxis(cells, -1, 1).reshape(s * self.n_channels, m, n), dtype=np.complex64)


def grid_numbers(shape: tuple[int, int, int], n_channels: int) -> int:
    """Number of float64 values in the grid of a :class:`GridAccumulator` of this shape (slots, rows, columns)."""
    padded = 1 << (n_channels - 1).bit_length()
    return rounded_size(2 * padded * math.prod(shape))


def rounded_size(n: int) -> int:
    """Number of float64 values to allocate for ``n``; the size is compiled in, so few sizes mean few kernels.

    Powers of four for small grids, then powers of two: a loop over looks, bands and image extents meets all of them
    within a few rounds.
    """
    bits = max((n - 1).bit_length(), SMALLEST_GRID.bit_length() - 1)
    if n <= FOURFOLD_UP_TO:
        bits += bits % 2
    return 1 << bits


class BlockAccumulator(GridAccumulator):
    """Grid over range and range rate onto which each path is added once; it yields all pulses of a block."""

    def __init__(
        self,
        plan: BlockPlan,
        n_slots: int,
        n_channels: int,
        max_order: int,
        wavelength: float,
        least_bytes: int = 0,
    ) -> None:
        super().__init__(*plan.shape(n_slots), n_channels, max_order, wavelength, least_bytes)
        self.plan = plan

    def add(self, state: LostCount, contribution: Contribution) -> LostCount:
        """Spread on the block's grid; see :class:`sarmitsuba.tracing.kernel.kernel.Accumulator`."""
        plan = self.plan
        slant_range = contribution.slant_range
        if plan.in_pulse is not None:  # the shift differs from pulse to pulse: the synthesis applies it
            moving = plan.in_pulse
            numbers = (dr.opaque(mi.Float64, x) for x in (moving.range_per_rate, float(moving.reference[0])))
            slant_range = carrier_range(slant_range, contribution.range_rate, *numbers)
        range0 = slant_range - dr.opaque(mi.Float64, plan.reference_range)
        x = (range0 - dr.opaque(mi.Float64, plan.range0)) * dr.opaque(mi.Float64, 1.0 / plan.range_step)
        y = (
            contribution.range_rate - dr.opaque(mi.Float64, plan.reference_rate + plan.range_rate0)
        ) * dr.opaque(mi.Float64, 1.0 / plan.range_rate_step)
        inside = self.spread(contribution, range0, (x, y), (plan.kernel, plan.range_rate_kernel))
        lost = contribution.active & (~inside | self.outside(contribution))
        return self.counted(state, contribution, lost)


class DirectAccumulator(GridAccumulator):
    """Range grid of every pulse, onto which the paths of that pulse are added."""

    def __init__(
        self,
        plan: DirectPlan,
        n_slots: int,
        n_channels: int,
        max_order: int,
        wavelength: float,
        least_bytes: int = 0,
    ) -> None:
        super().__init__(*plan.shape(n_slots), n_channels, max_order, wavelength, least_bytes)
        self.plan = plan
        self.range0 = device_array(mi.Float64, plan.range0)
        moving = plan.in_pulse
        self.aim_range = None if moving is None else device_array(mi.Float64, moving.reference)

    def add(self, state: LostCount, contribution: Contribution) -> LostCount:
        """Spread on the pulse's range grid; see :class:`sarmitsuba.tracing.kernel.kernel.Accumulator`."""
        plan = self.plan
        slant_range, pulse = contribution.slant_range, contribution.pulse
        range0 = dr.gather(mi.Float64, self.range0, pulse, contribution.active)
        place = slant_range
        if plan.in_pulse is not None and self.aim_range is not None:
            kappa, rate = dr.opaque(mi.Float64, plan.in_pulse.range_per_rate), contribution.range_rate
            aim_range = dr.gather(mi.Float64, self.aim_range, pulse, contribution.active)
            slant_range = carrier_range(slant_range, rate, kappa, aim_range)
            place = slant_range + kappa * rate
        x = (place - range0) * dr.opaque(mi.Float64, 1.0 / plan.range_step)
        ix, wx, inside = grid_cells(x, plan.kernel, plan.n_range)
        inside &= contribution.active
        phase = phase_factor(slant_range, self.wavelength)
        values = [amplitude * phase for amplitude in contribution.amplitudes]
        n_pulses, n_range = dr.opaque(mi.UInt32, plan.n_pulses), dr.opaque(mi.UInt32, plan.n_range)
        base = (self.slot(contribution.order) * n_pulses + pulse) * n_range + ix
        for i, wi in enumerate(wx):
            self.scatter(base + i, values, wi, inside)
        lost = contribution.active & (~inside | self.outside(contribution))
        return self.counted(state, contribution, lost)


class SumAccumulator(GridAccumulator):
    """Coherent sum of the paths of every pulse, for radar cross sections over many looks.

    Parameters
    ----------
    n_pulses : of the launch
    reference_slant_range : m, subtracted from slant ranges before the phase is formed
    n_channels, max_order, wavelength : as for :class:`GridAccumulator`
    """

    def __init__(
        self, n_pulses: int, n_channels: int, max_order: int, wavelength: float, reference_slant_range: float
    ) -> None:
        super().__init__(max(1, max_order), 1, n_pulses, n_channels, max_order, wavelength)
        self.reference = reference_slant_range

    def add(self, state: LostCount, contribution: Contribution) -> LostCount:
        """Add to the pulse's sum; see :class:`sarmitsuba.tracing.kernel.kernel.Accumulator`."""
        offset = contribution.slant_range - dr.opaque(mi.Float64, self.reference)
        phase = phase_factor(offset, self.wavelength)
        values = [amplitude * phase for amplitude in contribution.amplitudes]
        n_pulses = dr.opaque(mi.UInt32, self.shape[2])
        cell = self.slot(contribution.order) * n_pulses + contribution.pulse
        self.scatter(cell, values, mi.Float(1.0), contribution.active)
        return state


def grid_cells(x: mi.Float64, kernel: GriddingKernel, n: int) -> tuple[mi.UInt32, list[mi.Float], mi.Bool]:
    """First cell and weights of the gridding kernel at a position (in cells), and whether they lie within the grid."""
    shifted = x + kernel.shift
    base = dr.floor(shifted)
    first = mi.Int32(base) - kernel.lead
    inside = (x >= kernel.margin) & (x <= dr.opaque(mi.Float64, n - 1 - kernel.margin))
    return mi.UInt32(first), kernel.taps(mi.Float(shifted - base)), inside


def phase_factor(slant_range: mi.Float64, wavelength: float) -> mi.Complex2f:
    """Two-way phase factor ``exp(-j 4 pi x / lambda)`` of a slant range, reduced to one cycle in float64."""
    cycles = slant_range * dr.opaque(mi.Float64, 2.0 / wavelength)
    s, c = dr.sincos(mi.Float(cycles - dr.floor(cycles)) * (2.0 * dr.pi))
    return mi.Complex2f(c, -s)


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
