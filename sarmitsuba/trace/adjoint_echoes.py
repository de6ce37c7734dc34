r"""Derivatives of one real number by many parameters: echoes read from the adjoint grid instead of adding to the grid.

Raw data are linear in the echoes. The derivative of a loss by the data, taken backwards through the synthesis, is an
adjoint grid G over the same cells; with the gridding weights w of an echo's cells and its phase factor,

.. math:: dL = \Re \sum_c g_c^* \, da_c, \quad g_c = \sum_i w_i G_{ic} \, e^{+j 4 \pi f_c R / c}

for a change of its amplitudes in the channels c. A second grid, with the factor of a slant range on its spectrum, does
the same for :math:`a_c \, \partial R`. Each echo adds the product with each of its own derivatives to one number of
the gradient, whatever the number of parameters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.arrays import C64, F64
from sarmitsuba.backend import dr, mi
from sarmitsuba.trace.device_arrays import device_array
from sarmitsuba.trace.tangent_echoes import WithTangents
from sarmitsuba.trace.tangent_slots import NO_SHAPE, CarriedSlots
from sarmitsuba.trace.tangents import NO_MATERIAL, PER_DB, CarriedDisplacements

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sarmitsuba.trace.accumulators import GridAccumulator
    from sarmitsuba.trace.kernel import Accumulator, LaneArrays
    from sarmitsuba.trace.state import Contribution
    from sarmitsuba.trace.tangents import Carried


# bits of the smallest number of values of a gradient
SMALLEST = 10


class GradientSum:
    """Sum of the derivatives of all launches, float64; ``n``: numbers."""

    def __init__(self, n: int) -> None:
        self.n = n
        # the size is compiled in: few sizes mean few kernels
        self.memory = dr.zeros(mi.Float64, 1 << max((n - 1).bit_length(), SMALLEST))

    def add(self, number: mi.UInt32, value: mi.Float, active: mi.Bool) -> None:
        """Add one value per lane; every thread has a copy of the memory during the launch."""
        on_cpu = dr.backend_v(mi.Float) == dr.JitBackend.LLVM
        mode = dr.ReduceMode.Expand if on_cpu else dr.ReduceMode.Auto
        dr.scatter_add(self.memory, mi.Float64(value), number, active, mode=mode)

    def numbers(self) -> F64:
        """(n,) float64 after the launches."""
        return np.array(self.memory.numpy()[: self.n], dtype=np.float64)


class AdjointGrids:
    """Adjoint grids of one launch.

    Parameters
    ----------
    grids : one or two of (n_channels, n_rows, n_columns) complex64: for changes of amplitudes, and of slant ranges in m
    total : to which echoes add
    """

    def __init__(self, grids: Sequence[C64], total: GradientSum) -> None:
        self.n_channels, self.n_grids, self.total = len(grids[0]), len(grids), total
        both = np.concatenate(grids)
        self.memory = device_array(mi.Float, np.moveaxis(both, 0, -1).copy().view(np.float32))
        self.packet = mi.Vector2f if self.n_grids == 1 else mi.Vector4f
        self.start()

    @property
    def n_bytes(self) -> int:
        """Size of the grids."""
        return 4 * len(self.memory)

    def start(self) -> None:
        """Begin with an echo."""
        self._sums = [mi.Float(0.0)] * (2 * self.n_grids * self.n_channels)
        self._values: Sequence[mi.Complex2f] = ()

    def read(
        self, cell: mi.UInt32, values: Sequence[mi.Complex2f], weight: mi.Float, active: mi.Bool
    ) -> None:
        """Read one cell of an echo; see :meth:`sarmitsuba.trace.accumulators.GridAccumulator.scatter`."""
        n, size = self.n_channels, 2 * self.n_grids
        for i in range(n):
            numbers = dr.gather(self.packet, self.memory, cell * n + i, active)
            for k in range(size):
                self._sums[size * i + k] = dr.fma(weight, numbers[k], self._sums[size * i + k])
        self._values = values

    def products(self) -> tuple[mi.Float, mi.Complex2f]:
        """Derivatives by a relative change of the echo's amplitudes, and by its complex slant range, per m."""
        n, sums = self.n_channels, self._sums
        read = [mi.Complex2f(sums[2 * i], -sums[2 * i + 1]) for i in range(self.n_grids * n)]
        level, farther = mi.Float(0.0), mi.Complex2f(0.0)
        for grid, value in zip(read[:n], self._values, strict=True):
            level += (grid * value).real
        for grid, value in zip(read[n:], self._values, strict=False):
            farther += grid * value
        return level, farther


class AdjointEchoes:
    """Accumulator that adds the derivatives of every echo to a gradient.

    See :class:`sarmitsuba.trace.kernel.Accumulator`.

    Parameters
    ----------
    carried : of the kernel
    accumulator : whose cells are read
    grids : adjoint grids
    """

    def __init__(self, carried: CarriedSlots, accumulator: GridAccumulator, grids: AdjointGrids) -> None:
        self.plan, self.accumulator, self.grids = carried.plan, accumulator, grids

    def begin(self) -> LaneArrays:
        """See the protocol."""
        return self.accumulator.begin()

    def add(self, state: LaneArrays, contribution: Contribution) -> LaneArrays:
        """See the protocol."""
        plan, total, echo = self.plan, self.grids.total, contribution
        self.grids.start()
        state = self.accumulator.add(state, echo)
        level, farther = self.grids.products()
        rates = echo.range_tangents or ()
        for k, rate in enumerate(rates):
            shape, way = echo.slots[k // plan.ways], k % plan.ways
            value = (
                farther.real * mi.Float(rate) if not isinstance(rate, mi.Complex2f) else (farther * rate).real
            )
            total.add(shape * plan.ways + way, value, echo.active & (shape != NO_SHAPE))
        if echo.material is None or not (plan.n_materials or plan.n_texels):
            return state
        known = echo.active & (echo.material != NO_MATERIAL)
        level = level * PER_DB
        if plan.n_materials:
            total.add(echo.material + dr.opaque(mi.UInt32, plan.first_material), level, known)
        for texel, share in echo.texels:
            total.add(texel + dr.opaque(mi.UInt32, plan.first_texel), level * share, known)
        return state


def recording(carried: Carried, accumulator: GridAccumulator) -> Accumulator:
    """Accumulator that records the derivatives of echoes: beside them, or added to a gradient."""
    if isinstance(carried, CarriedSlots):
        assert accumulator.adjoint is not None
        return AdjointEchoes(carried, accumulator, accumulator.adjoint)
    assert isinstance(carried, CarriedDisplacements)
    return WithTangents(carried, accumulator)
