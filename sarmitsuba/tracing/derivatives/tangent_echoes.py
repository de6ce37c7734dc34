"""Accumulator that records the derivatives of every echo behind its channels."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.derivatives.tangents import NO_MATERIAL, PER_DB

if TYPE_CHECKING:
    from sarmitsuba.tracing.derivatives.tangents import CarriedDisplacements
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
