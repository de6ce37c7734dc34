"""Derivatives of slant ranges along a path: at mirrors, of the coherent return of a tube, of diffuse scatterers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sarmitsuba.backend import dr, mi
from sarmitsuba.trace.tangents import RayTangents

if TYPE_CHECKING:
    from sarmitsuba.trace.state import Hit, Lane, RayState
    from sarmitsuba.trace.tangents import Carried


def _normal_rate(carried: Carried, k: int, hit: Hit, n: mi.Vector3d) -> mi.Vector3d | None:
    r"""Derivative of a facet's unit normal, :math:`-A^T n + n (n \cdot A n)`; None where it is zero."""
    rows = carried.gradient[k]
    if rows is None:
        return None
    pulled = rows[0] * n.x + rows[1] * n.y + rows[2] * n.z
    rate = n * dr.dot(n, pulled) - pulled
    return dr.select(carried.moves(k, hit.face, hit.active), rate, mi.Vector3d(0.0))


def mirrored_tangents(carried: Carried, ray: RayState, hit: Hit, n: mi.Vector3d) -> RayTangents:
    r"""State of the ray reflected at a hit.

    The image :math:`A' = A - 2 n \, (A - p) \cdot n` of the antenna in a facet that moves and turns has the
    velocity :math:`\dot A - 2 n \, (\dot A - \dot p) \cdot n - 2 \dot n \, (A - p) \cdot n
    - 2 n \, (A - p) \cdot \dot n`.
    """
    assert ray.tangents is not None
    from_hit = ray.virtual_antenna - hit.p
    virtual, boundaries = [], []
    for k, (velocity, boundary) in enumerate(zip(ray.tangents.virtual, ray.tangents.boundary, strict=True)):
        movement = carried.movement(k, hit.face, hit.p, hit.active)
        towards = velocity if movement is None else velocity - movement.velocity
        image = velocity - n * (2.0 * dr.dot(towards, n))
        turn = _normal_rate(carried, k, hit, n)
        if turn is not None:
            image -= 2.0 * (turn * dr.dot(from_hit, n) + n * dr.dot(from_hit, turn))
        virtual.append(image)
        if boundary is not None and movement is not None:
            boundary = boundary.at(movement, hit.largest_cell).mirrored(movement, n)
        boundaries.append(boundary)
    return RayTangents(tuple(virtual), tuple(boundaries))


def of_tube(carried: Carried, ray: RayState, hit: Hit, rim: mi.Vector3d) -> tuple[mi.Float64, ...]:
    """Derivatives of the slant range of a tube's coherent return, m per unit.

    ``rim`` : m, phase centre of the return from the hit, in the facet's plane
    """
    assert ray.tangents is not None
    found = []
    d, s = hit.direction64, hit.to_antenna64
    across_out, across_back = rim - d * dr.dot(rim, d), rim - s * dr.dot(rim, s)
    for k, (virtual, boundary) in enumerate(zip(ray.tangents.virtual, ray.tangents.boundary, strict=True)):
        antenna = carried.antenna[k]
        movement = carried.movement(k, hit.face, hit.p + rim, hit.active)
        if movement is not None and boundary is not None:
            # tubes tile the lit area: their common sides move with its boundary
            patch = boundary.at(movement, hit.largest_cell).on(movement, d, hit.normal64)
            antenna, virtual = antenna - patch, virtual - patch
        rate = dr.dot(s, antenna) - dr.dot(d, virtual)
        rate -= dr.dot(across_out, virtual) / hit.length + dr.dot(across_back, antenna) / hit.length_back
        found.append(0.5 * rate)
    return tuple(found)


def of_scatterer(
    carried: Carried, ray: RayState, hit: Hit, lane: Lane, centre: mi.Vector3d
) -> tuple[tuple[mi.Float64, ...], tuple[mi.Float64, ...]]:
    """Derivatives of a diffuse scatterer's slant range: straight to the antenna, and back through the mirrors."""
    assert ray.tangents is not None
    out, back = dr.normalize(centre - ray.virtual_antenna), dr.normalize(lane.antenna - centre)
    straight, reciprocal = [], []
    for k, virtual in enumerate(ray.tangents.virtual):
        antenna = carried.antenna[k]
        movement = carried.movement(k, hit.face, centre, hit.active)
        if movement is not None:
            antenna, virtual = antenna - movement.velocity, virtual - movement.velocity
        leg = -dr.dot(out, virtual)
        reciprocal.append(leg)
        straight.append(0.5 * (leg + dr.dot(back, antenna)))
    return tuple(straight), tuple(reciprocal)
