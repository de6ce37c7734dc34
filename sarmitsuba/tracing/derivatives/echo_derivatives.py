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

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.derivatives.tangent_slots import NO_SHAPE, CarriedSlots
from sarmitsuba.tracing.derivatives.tangents import NO_MATERIAL, PER_DB, CarriedDisplacements

if TYPE_CHECKING:
    from sarmitsuba.tracing.derivatives.adjoint_grids import AdjointGrids
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
