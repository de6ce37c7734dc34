r"""Moving boundaries of the visible surface: rays on both sides of the edges of shapes, weighted by their motion.

The sum over the tubes of a lattice of spacing s is, in the mean over the lattice's place, an integral over the launch
plane of the return F of the tube at x. Derivatives of the returns of single tubes are taken with the tubes moving along
with the lit surface (:mod:`sarmitsuba.tracing.derivatives.range_tangents`). Where F jumps at the projection of an edge,
that leaves

.. math:: \frac{1}{s^2} \oint \left( (v - u_i) F_i - (v - u_o) F_o \right) dl

with the velocity v of the edge along its normal in the launch plane, and those u of the tubes on the inner and the
outer side. An edge hidden behind others has the same returns on both sides, and adds nothing.

References
----------
Reynolds' transport theorem; Li et al., "Differentiable Monte Carlo ray tracing through edge sampling", ACM TOG 37
(2018), for the sampling of edges.

Notes
-----
Edges are those on the first leg of a path, on the second behind a flat mirror, and on the last of a double bounce,
where a ray is sent to the edge's shadow on the surface that closes the path. Those on the last legs of three bounces
count as those of the reversed path. Several legs may be beside one edge, in one plane with the antenna: the first
counts alone. Ignores edges in which two bodies touch (as one moves they part, or one hides the other's edge: two
derivatives), those on the middle legs of four bounces or more, and such planes among the legs of three bounces.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.derivatives.edge_state import SHADOWED, EdgeState
from sarmitsuba.tracing.derivatives.tangents import EchoDerivative
from sarmitsuba.tracing.kernel.device_arrays import device_array

if TYPE_CHECKING:
    from sarmitsuba.tracing.derivatives.edge_state import EdgeLane
    from sarmitsuba.tracing.derivatives.tangents import Carried, RayDerivative
    from sarmitsuba.tracing.kernel.launch import EdgeSamples
    from sarmitsuba.tracing.kernel.state import Hit, Lane, RayState


def begin_edge(
    tangents: RayDerivative,
    samples: EdgeSamples,
    row: mi.UInt32,
    d: mi.Vector3d,
    axes: tuple[mi.Vector3d, mi.Vector3d],
) -> RayDerivative:
    """State of a ray launched along ``d``; ``row``: of each lane in the samples; ``axes``: of the launch plane."""
    x, y = (dr.gather(mi.Float64, device_array(mi.Float64, n), row) for n in samples.normal.T)
    normal = axes[0] * x + axes[1] * y
    plane = dr.cross(*axes)
    across = normal - plane * (dr.dot(normal, d) / dr.dot(plane, d))
    n = len(tangents.virtual)
    turns, frames = tuple(mi.Vector3d(0.0) for _ in range(n)), tuple(mi.Float64(0.0) for _ in range(n))
    state = EdgeState(across, turns, frames, mi.UInt32(0))
    slots = tangents.slots
    if samples.shapes is not None:
        own = (dr.gather(mi.UInt32, device_array(mi.UInt32, n), row) for n in samples.shapes.T)
        slots = (*own, *slots[samples.shapes.shape[1] :])
    return replace(tangents, slots=slots, edge=state)


def arrive_beside_edge(state: EdgeState, carried: Carried, lane: Lane, ray: RayState, hit: Hit) -> EdgeState:
    """State at a hit: the lit area moves with the smallest piece of surface on the path."""
    assert ray.derivative is not None
    frames = []
    for k, (boundary, before) in enumerate(zip(ray.derivative.boundary, state.frames, strict=True)):
        if boundary is None:
            frames.append(before)
            continue
        own = hit.largest_cell <= boundary.size
        frames.append(dr.select(own, _frame(state, carried, k, ray, hit, hit.p), before))
    edge = _edge_of(lane)
    of_edge = (hit.face == edge.faces[0]) | (hit.face == edge.faces[1])
    outline = dr.select(hit.order == edge.leg, dr.select(of_edge, mi.UInt32(1), 0), state.outline)
    mirror = (edge.leg == SHADOWED) & hit.first & (hit.face == edge.faces[0])
    return EdgeState(state.across, state.turns, tuple(frames), dr.select(mirror, mi.UInt32(1), outline))


def find_shadowed(lane: Lane, ray: RayState, hit: Hit) -> Hit:
    """A hit that the antenna sees but for an edge, if the ray was sent there.

    Rays whose last leg is beside an edge are sent to its shadow. Where the edge is beside another leg too, they do not
    come there: that leg has rays of its own.
    """
    edge, before = _edge_of(lane), None if ray.derivative is None else ray.derivative.edge
    assert before is not None
    here = hit.active & (hit.order == 2) & (before.outline == 1) & (hit.face == edge.faces[1])
    return replace(hit, sees=dr.select(edge.leg == SHADOWED, here, hit.sees))


def _frame(
    state: EdgeState, carried: Carried, k: int, ray: RayState, hit: Hit, point: mi.Vector3d
) -> mi.Float64:
    """Velocity of a point of the facet that was hit, as an angle about the antenna's image."""
    assert ray.derivative is not None
    movement = carried.movement(k, hit.face, point, hit.active)
    towards = (
        -ray.derivative.virtual[k] if movement is None else movement.velocity - ray.derivative.virtual[k]
    )
    # mirrors that turn swing the antenna's image about them, and with it the axes that the angle is measured in
    return dr.dot(state.across, towards) / hit.length + dr.dot(state.turns[k], hit.direction64)


def weigh_tube(carried: Carried, lane: Lane, ray: RayState, hit: Hit) -> EchoDerivative:
    """Weights of a coherent return by every displacement, 1 per unit.

    A path and the reversed one have the same return, and each is traced. Of three bounces or more they count twice for
    what happens on legs of the reversed path that no ray is sampled for: a facet hidden from the antenna on the way
    back, and outlines beyond the second.
    """
    edge, before = _edge_of(lane), None if ray.derivative is None else ray.derivative.edge
    assert before is not None
    state = arrive_beside_edge(before, carried, lane, ray, hit)
    legs = edge.leg + dr.select(state.outline == 1, mi.UInt32(1), 0)
    weight = mi.Float64(edge.weight * dr.select(hit.order > dr.maximum(legs, 2), 2.0, 1.0))
    return EchoDerivative(tuple(edge.relative(weight, k, frame) for k, frame in enumerate(state.frames)))


def weigh_scatterer(
    carried: Carried, lane: Lane, ray: RayState, hit: Hit, centre: mi.Vector3d
) -> tuple[EchoDerivative, EchoDerivative]:
    """Weights of the returns of a diffuse scatterer by every displacement: straight, and back through the mirrors."""
    assert ray.derivative is not None and ray.derivative.edge is not None
    edge, state = _edge_of(lane), ray.derivative.edge
    weight, found = mi.Float64(edge.weight), []
    for k, boundary in enumerate(ray.derivative.boundary):
        if boundary is None:  # the parallax of an antenna is a displacement over the slant range
            found.append(mi.Float64(0.0))
        else:
            found.append(edge.relative(weight, k, _frame(state, carried, k, ray, hit, centre)))
    straight = edge.leg == SHADOWED
    back = tuple(dr.select(straight, 0.0, rate) for rate in found)
    return EchoDerivative(tuple(found)), EchoDerivative(back)


def _edge_of(lane: Lane) -> EdgeLane:
    """The edge that a ray passes."""
    assert lane.derivative is not None and lane.derivative.edge is not None
    return lane.derivative.edge
