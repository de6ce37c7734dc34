r"""Derivatives of one real number by many parameters: echoes read from the adjoint grid instead of adding to the grid.

Raw data are linear in the echoes. The derivative of a loss by the data, taken backwards through the synthesis, is an
adjoint grid G over the same cells; with the gridding weights w of an echo's cells and its phase factor,

.. math:: dL = \Re \sum_c g_c^* \, da_c, \quad g_c = \sum_i w_i G_{ic} \, e^{+j 4 \pi f_c R / c}

for a change of its amplitudes in the channels c. A second grid, with the factor of a slant range on its spectrum, does
the same for :math:`a_c \, \partial R`. Each echo adds the product with each of its own derivatives to one number of
the gradient, whatever the number of parameters.
"""

from __future__ import annotations

from dataclasses import replace
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
    """Adjoint grids of one launch, each (n_channels, n_rows, n_columns) complex64; None: not needed.

    Parameters
    ----------
    plain : for changes of amplitudes
    farther : for changes of slant ranges, m
    turning : for changes of range rates, m/s
    total : to which echoes add
    """

    def __init__(
        self, plain: C64 | None, farther: C64 | None, turning: C64 | None, total: GradientSum
    ) -> None:
        self.total = total
        grids = [plain, farther, turning]
        self.kept = [k for k, grid in enumerate(grids) if grid is not None]
        both = np.concatenate([grid for grid in grids if grid is not None])
        self.n_channels, self.n_planes = len(both) // len(self.kept), len(both)
        self.memory = device_array(mi.Float, np.moveaxis(both, 0, -1).copy().view(np.float32))
        self.packet, self.size = (mi.Vector4f, 4) if self.n_planes % 2 == 0 else (mi.Vector2f, 2)
        self.start()

    @property
    def n_bytes(self) -> int:
        """Size of the grids."""
        return 4 * len(self.memory)

    def start(self) -> None:
        """Begin with an echo."""
        self._sums = [mi.Float(0.0)] * (2 * self.n_planes)
        self._values: Sequence[mi.Complex2f] = ()

    def read(
        self, cell: mi.UInt32, values: Sequence[mi.Complex2f], weight: mi.Float, active: mi.Bool
    ) -> None:
        """Read one cell of an echo; see :meth:`sarmitsuba.trace.accumulators.GridAccumulator.scatter`."""
        packets = 2 * self.n_planes // self.size
        for i in range(packets):
            numbers = dr.gather(self.packet, self.memory, cell * packets + i, active)
            for j in range(self.size):
                k = self.size * i + j
                self._sums[k] = dr.fma(weight, numbers[j], self._sums[k])
        self._values = values

    def product(self, kind: int, first: int = 0) -> mi.Complex2f:
        """Derivative by a factor of values, by one of the grids: 0 plain, 1 farther, 2 turning; zero without the grid.

        The values are the echo's in all channels, from the number ``first`` on.
        """
        found = mi.Complex2f(0.0)
        if kind in self.kept:
            place = self.kept.index(kind) * self.n_channels
            for k in range(self.n_channels):
                re, im = self._sums[2 * (place + k) : 2 * (place + k) + 2]
                found += mi.Complex2f(re, -im) * self._values[first + k]
        return found


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
        self.plan, self.turning = carried.plan, carried.turning
        # beside edges the derivatives are factors of the echoes themselves
        self.kind = 0 if carried.beside_edges else 1
        self.accumulator, self.grids = accumulator, grids

    def begin(self) -> LaneArrays:
        """See the protocol."""
        return self.accumulator.begin()

    def add(self, state: LaneArrays, contribution: Contribution) -> LaneArrays:
        """See the protocol."""
        plan, grids, echo = self.plan, self.grids, contribution
        total, c = grids.total, len(echo.amplitudes)
        grids.start()
        # changes of amplitudes by turns of faces have the phase of the echo too
        changes = echo.amplitude_tangents or ()
        state = self.accumulator.add(state, replace(echo, amplitudes=(*echo.amplitudes, *changes)))
        farther, turning = grids.product(self.kind), grids.product(2)
        for k, rate in enumerate(echo.range_tangents or ()):
            shape, way = echo.slots[k // plan.ways], k % plan.ways
            complex_rate = rate if isinstance(rate, mi.Complex2f) else mi.Complex2f(mi.Float(rate))
            value = (farther * complex_rate).real
            if echo.rate_tangents is not None:
                value += turning.real * echo.rate_tangents[k]
            if k in self.turning:
                value += grids.product(1, c * (1 + self.turning.index(k))).real
            total.add(shape * plan.ways + way, value, echo.active & (shape != NO_SHAPE))
        if echo.material is None or not (plan.n_materials or plan.n_texels):
            return state
        known = echo.active & (echo.material != NO_MATERIAL)
        level = grids.product(0).real * PER_DB
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
