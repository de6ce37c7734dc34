r"""Accumulators of the derivatives of echoes: recorded behind their channels, or read from adjoint grids.

Raw data are linear in the echoes. The derivative of a loss by the data, taken backwards through the synthesis, is an
adjoint grid G over the same cells; with the gridding weights w of an echo's cells and its phase factor,

.. math:: dL = \Re \sum_c g_c^* \, da_c, \quad g_c = \sum_i w_i G_{ic} \, e^{+j 4 \pi f_c R / c}

for a change of its amplitudes in the channels c. A second grid, with the factor of a slant range on its spectrum, does
the same for :math:`a_c \, \partial R`. Each echo adds the product with each of its derivatives to one number of
the gradient, whatever the number of parameters.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.derivatives.tangent_slots import NO_SHAPE, CarriedSlots
from sarmitsuba.tracing.derivatives.tangents import NO_MATERIAL, PER_DB, CarriedDisplacements
from sarmitsuba.tracing.kernel.device_arrays import device_array

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sarmitsuba.tracing.derivatives.tangents import Carried
    from sarmitsuba.tracing.kernel.kernel import Accumulator, LaneArrays
    from sarmitsuba.tracing.kernel.state import Contribution


class WithTangents:
    """Accumulator with tangents; see :class:`sarmitsuba.tracing.kernel.kernel.Accumulator`."""

    def __init__(self, carried: CarriedDisplacements, accumulator: Accumulator) -> None:
        self.carried, self.accumulator = carried, accumulator

    def begin(self) -> LaneArrays:
        """See the protocol."""
        return self.accumulator.begin()

    def add(self, state: LaneArrays, contribution: Contribution) -> LaneArrays:
        """See the protocol."""
        return self.accumulator.add(
            state, replace(contribution, amplitudes=list_with_derivatives(self.carried, contribution))
        )


def list_with_derivatives(carried: CarriedDisplacements, echo: Contribution) -> tuple[mi.Complex2f, ...]:
    """Channels of an echo and their derivatives."""
    derivative = echo.derivative
    assert derivative is not None and derivative.material is not None
    c, plan, changes = len(echo.amplitudes), carried.plan, derivative.amplitudes or ()
    out = list(echo.amplitudes)
    for rate in derivative.ranges:
        factor = rate if isinstance(rate, mi.Complex2f) else mi.Float(rate)
        out += [a * factor for a in echo.amplitudes]
    by_property, by_turn = changes[: c * len(plan.properties)], changes[c * len(plan.properties) :]
    for i, k in enumerate(carried.turning):
        for j in range(c):
            out[c * (1 + k) + j] += by_turn[c * i + j]
    if carried.plan.levels:
        bits = []
        for material in (derivative.material, derivative.partner):
            if material is None:
                continue
            known = material != NO_MATERIAL
            found = dr.gather(mi.UInt32, carried.plan.levelled, material, echo.active & known)
            bits.append(dr.select(known, found, 0))
        for k in range(len(carried.plan.levels)):
            per_db = sum((mi.Float((own >> k) & 1) for own in bits), mi.Float(0.0)) * PER_DB
            out += [a * per_db for a in echo.amplitudes]
    out += by_property
    for number in carried.texels:
        share = sum(
            (dr.select(texel == number, part, 0.0) for texel, part in derivative.texels), mi.Float(0.0)
        )
        per_db = dr.select(derivative.material != NO_MATERIAL, share * PER_DB, 0.0)
        out += [a * per_db for a in echo.amplitudes]
    by_angle = (a * rate for rate in derivative.gains or () for a in echo.amplitudes)
    swings = (a * rate for rate in derivative.rates or () for a in echo.amplitudes)
    return (*out, *by_angle, *swings)


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
        """Read one cell of an echo; see :meth:`sarmitsuba.tracing.kernel.accumulators.GridAccumulator.scatter`."""
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

    See :class:`sarmitsuba.tracing.kernel.kernel.Accumulator`.

    Parameters
    ----------
    carried : of the kernel
    accumulator : whose cells are read
    grids : adjoint grids
    """

    def __init__(self, carried: CarriedSlots, accumulator: Accumulator, grids: AdjointGrids) -> None:
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
        derivative = echo.derivative
        assert derivative is not None and derivative.material is not None
        total, c = grids.total, len(echo.amplitudes)
        grids.start()
        # changes of amplitudes by turns of faces have the phase of the echo too
        state = self.accumulator.add(state, replace(echo, amplitudes=echo.values))
        farther, turning = grids.product(self.kind), grids.product(2)
        for k, rate in enumerate(derivative.ranges):
            shape, way = derivative.slots[k // plan.ways], k % plan.ways
            complex_rate = rate if isinstance(rate, mi.Complex2f) else mi.Complex2f(mi.Float(rate))
            value = (farther * complex_rate).real
            if derivative.rates is not None:
                value += turning.real * derivative.rates[k]
            if k in self.turning:
                value += grids.product(1, c * (1 + self.turning.index(k))).real
            total.add(shape * plan.ways + way, value, echo.active & (shape != NO_SHAPE))
        if not (plan.n_materials or plan.n_texels):
            return state
        level = grids.product(0).real * PER_DB
        if plan.n_materials:
            first = dr.opaque(mi.UInt32, plan.first_material)
            for material in (derivative.material, derivative.partner):
                if material is not None:
                    total.add(material + first, level, echo.active & (material != NO_MATERIAL))
        known = echo.active & (derivative.material != NO_MATERIAL)
        for texel, share in derivative.texels:
            total.add(texel + dr.opaque(mi.UInt32, plan.first_texel), level * share, known)
        return state


def recording(carried: Carried, accumulator: Accumulator, grids: AdjointGrids | None) -> Accumulator:
    """Accumulator that records the derivatives of echoes: beside them, or added to a gradient by adjoint grids."""
    if isinstance(carried, CarriedSlots):
        assert grids is not None
        return AdjointEchoes(carried, accumulator, grids)
    assert isinstance(carried, CarriedDisplacements)
    return WithTangents(carried, accumulator)
