"""Derivatives of the phase integral over a part of a facet that is stretched or turned, by Dr.Jit's forward mode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.kernel.tubes.polygon import Polygon, part_integral

# derivatives of q, u and v of `part_integral`
Rate: TypeAlias = "tuple[mi.Vector3f, mi.Vector3f, mi.Vector3f]"


def integral_with_rates(
    rates: Sequence[Rate],
    q: mi.Vector3f,
    u: mi.Vector3f,
    v: mi.Vector3f,
    piece: Polygon,
    longest: mi.Float,
    kept_up_to: mi.Float | None = None,
) -> tuple[mi.Complex2f, ...]:
    r"""Phase integral I of :func:`.polygon.part_integral`, its phase centre, derivatives of I.

    The part keeps its corners in tube units while ``q``, ``u`` and ``v`` change. The phase centre moves with the facet:
    the derivatives are those of :math:`I e^{-j Q \cdot x_0}` at its fixed place :math:`x_0` in tube units.

    Notes
    -----
    One traversal of the graph for each rate: everything lies within one pass of the kernel's loop, from which nothing
    of the graph leaves.
    """
    inputs = (mi.Vector3f(q), mi.Vector3f(u), mi.Vector3f(v))
    dr.enable_grad(*inputs)
    integral, place_u, place_v = part_integral(inputs[0], inputs[1], inputs[2], piece, longest, kept_up_to)
    # seen from a centre that does not move, though `part_integral` chooses it by q
    qu, qv = dr.dot(inputs[0], inputs[1]), dr.dot(inputs[0], inputs[2])
    moved_u, moved_v = place_u - dr.detach(place_u), place_v - dr.detach(place_v)
    sine, cosine = dr.sincos(qu * moved_u + qv * moved_v)
    held = integral * mi.Complex2f(cosine, sine)
    found = []
    for rate in rates:
        for x, change in zip(inputs, rate, strict=True):
            dr.set_grad(x, change)
        dr.enqueue(dr.ADMode.Forward, *inputs)
        dr.traverse(dr.ADMode.Forward, flags=dr.ADFlag.ClearInterior)
        found.append(mi.Complex2f(dr.grad(held)))
        dr.clear_grad(held)
    return (dr.detach(integral), dr.detach(place_u), dr.detach(place_v), *found)
