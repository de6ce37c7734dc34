"""Derivatives of the echo of a scatterer at a known position, straight or over the ground, by every displacement.

One place for all sources other than surfaces: wires, edges, volumes, pairs and extensions' kinds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.derivatives.range_tangents import add_amplitude, normal_rate
from sarmitsuba.tracing.derivatives.tangents import NO_MATERIAL, EchoDerivative
from sarmitsuba.tracing.kernel.leg import Leg, beam_patterns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sarmitsuba.radar.antenna import Antenna
    from sarmitsuba.tracing.derivatives.tangents import Carried
    from sarmitsuba.tracing.kernel.state import Kernel

    # velocity of a scatterer, m per unit, and relative growth of its amplitude, per unit
    Shift = tuple[mi.Vector3d, mi.Float]


def leg_rate(carried: Carried, k: int, leg: Leg, point: mi.Vector3d | None) -> tuple[mi.Float64, mi.Float64]:
    r"""Derivatives of a leg's length and of its rate by displacement k, m and m/s per unit.

    With the velocity :math:`\dot{\mathbf a}` of the antenna, or of its image in the leg's mirror, relative to the
    scatterer: :math:`\hat{\mathbf s} \cdot \dot{\mathbf a}` and :math:`\dot{\mathbf a} \cdot \mathbf v_\perp / L`.

    Parameters
    ----------
    point : velocity of the scatterer, m per unit; None: at rest
    """
    velocity, change = carried.antenna[k], mi.Float64(0.0)
    if leg.mirror is not None:
        there = leg.mirror
        n, movement = there.normal, carried.movement(k, there.face, there.point, mi.Bool(True))
        towards = velocity if movement is None else velocity - movement.velocity
        velocity = velocity - n * (2.0 * dr.dot(towards, n))
        turn = normal_rate(carried, k, there.face, mi.Bool(True), n)
        if turn is not None:
            velocity -= 2.0 * (turn * dr.dot(there.antenna, n) + n * dr.dot(there.antenna, turn))
            moving = there.velocity
            change = -2.0 * dr.dot(leg.to_antenna64, turn * dr.dot(moving, n) + n * dr.dot(moving, turn))
    if point is not None:
        velocity = velocity - point
    return dr.dot(leg.to_antenna64, velocity), dr.dot(velocity, leg.across) + change


def differentiate_legs(
    carried: Carried,
    kernel: Kernel,
    antenna: Antenna,
    pulse: mi.UInt32,
    legs: tuple[Leg, Leg],
    shifts: Sequence[Shift | None],
    materials: tuple[mi.UInt32, mi.UInt32] | None,
) -> EchoDerivative:
    """Derivatives of the echo of a scatterer, without those of its amplitudes by properties of materials.

    Parameters
    ----------
    carried : derivatives that the kernel records
    legs : of the incident and of the scattered wave
    shifts : of the scatterer, by displacement; None: at rest
    materials : of both scatterers of a pair of diffuse ones; None: neither is diffuse

    Notes
    -----
    Ignores changes by properties of materials: callers refuse sources that depend on them.
    """
    ranges: list[mi.Float64 | mi.Complex2f] = []
    rates = []
    for k, gradient in enumerate(carried.gradient):
        shift = shifts[k] if shifts else None
        found = [leg_rate(carried, k, leg, None if shift is None else shift[0]) for leg in legs]
        rate = 0.5 * (found[0][0] + found[1][0])
        rates.append(mi.Float(0.5 * (found[0][1] + found[1][1])))
        if gradient is None:
            ranges.append(rate)
        else:
            growth = mi.Complex2f(0.0 if shift is None else shift[1])
            ranges.append(add_amplitude(kernel, rate, growth))
    beam = None
    if carried.pointing:
        beams = beam_patterns(kernel, antenna, pulse, legs[0].leaving)
        assert beams is not None
        ends = beams[0].rates(legs[0].leaving), beams[1].received_rates(legs[1].leaving)
        beam = tuple(x + y for x, y in zip(*ends, strict=True))
    return EchoDerivative(
        ranges=tuple(ranges),
        rates=tuple(rates) if carried.rates else None,
        gains=beam,
        material=mi.UInt32(NO_MATERIAL) if materials is None else materials[0],
        partner=None if materials is None else materials[1],
    )
