r"""Derivatives of slant ranges along a path: at mirrors, of the coherent return of a tube, of diffuse scatterers.

A shape that is stretched or turned changes amplitudes too: the area of its facets, and the phase over tubes. With the
relative change :math:`\partial a / a` the complex range :math:`\partial R + j \, \partial a / 2 k a` holds both, as
:math:`-2 j k` times it is the relative derivative of the echo.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.derivatives.edge_tangents import arrive_beside_edge
from sarmitsuba.tracing.derivatives.tangents import EchoDerivative, RayDerivative

if TYPE_CHECKING:
    from sarmitsuba.tracing.derivatives.tangents import Carried
    from sarmitsuba.tracing.kernel.state import Closing, Hit, Kernel, Lane, RayState, TubeFootprint
    from sarmitsuba.tracing.kernel.tubes.integral_rates import Rate


def normal_rate(
    carried: Carried, k: int, face: mi.UInt32, active: mi.Bool, n: mi.Vector3d
) -> mi.Vector3d | None:
    r"""Derivative of a facet's unit normal, :math:`-A^T n + n (n \cdot A n)`; None where it is zero."""
    rows = carried.gradient[k]
    if rows is None:
        return None
    pulled = rows[0] * n.x + rows[1] * n.y + rows[2] * n.z
    rate = n * dr.dot(n, pulled) - pulled
    return dr.select(carried.moves(k, face, active), rate, mi.Vector3d(0.0))


def turned_hit(carried: Carried, k: int, ray: RayState, hit: Hit, step: mi.Float) -> Hit:
    r"""A hit whose facet is turned as by a step of displacement k, and the wave as the mirrors before it turn.

    The direction from an image of the antenna that moves at :math:`\dot A'` changes by
    :math:`-(\dot A' - d \, (d \cdot \dot A')) / L`.

    Notes
    -----
    Ignores the change of the direction to the antenna, a displacement over the slant range.
    """
    assert ray.derivative is not None
    d, virtual, along = hit.direction64, ray.derivative.virtual[k], mi.Float64(step)
    d = dr.normalize(d - (virtual - d * dr.dot(virtual, d)) * (along / hit.length))
    n, turn = hit.normal64, normal_rate(carried, k, hit.face, hit.active, hit.normal64)
    if turn is not None:
        n = dr.normalize(n + turn * along)
    direction, normal = mi.Vector3f(d), mi.Vector3f(n)
    return replace(
        hit,
        direction64=d,
        direction=direction,
        normal64=n,
        normal=normal,
        cos_incidence=dr.maximum(-dr.dot(direction, normal), 1e-7),
    )


def _stretch_tube(
    carried: Carried, k: int, ray: RayState, hit: Hit, tube_here: TubeFootprint
) -> tuple[mi.Vector3f, mi.Vector3f] | None:
    """Change of a tube's two edges on a facet with the lit area, m per unit; None for a translation.

    The edges change with the facet, or with a smaller lit piece before it, whose tubes are projected onto the facet.
    """
    assert ray.derivative is not None
    boundary, before = ray.derivative.boundary[k], ray.derivative.stretch[k]
    if boundary is None or before is None:
        return None
    own = hit.largest_cell <= boundary.size
    moves = carried.moves(k, hit.face, hit.active)
    found = []
    for edge, change in zip((tube_here.u, tube_here.v), before, strict=True):
        turned = mi.Vector3f(carried.turned(k, mi.Vector3d(edge)))
        projected = change + hit.direction * (dr.dot(change, hit.normal) / hit.cos_incidence)
        found.append(dr.select(own, dr.select(moves, turned, mi.Vector3f(0.0)), projected))
    return found[0], found[1]


def mirrored_tangents(
    carried: Carried, lane: Lane, ray: RayState, hit: Hit, tube_here: TubeFootprint, n: mi.Vector3d
) -> RayDerivative:
    r"""State of the ray reflected at a hit.

    The image :math:`A' = A - 2 n \, (A - p) \cdot n` of the antenna in a facet that moves and turns has the
    velocity :math:`\dot A - 2 n \, (\dot A - \dot p) \cdot n - 2 \dot n \, (A - p) \cdot n
    - 2 n \, (A - p) \cdot \dot n`.
    """
    assert ray.derivative is not None
    from_hit = ray.virtual_antenna - hit.p
    virtual, boundaries, stretches, velocities, turns = [], [], [], [], []
    n32 = mi.Vector3f(n)
    for k, (velocity, boundary) in enumerate(
        zip(ray.derivative.virtual, ray.derivative.boundary, strict=True)
    ):
        movement = carried.movement(k, hit.face, hit.p, hit.active)
        towards = velocity if movement is None else velocity - movement.velocity
        image = velocity - n * (2.0 * dr.dot(towards, n))
        turn = normal_rate(carried, k, hit.face, hit.active, n)
        turns.append(turn)
        if turn is not None:
            image -= 2.0 * (turn * dr.dot(from_hit, n) + n * dr.dot(from_hit, turn))
        virtual.append(image)
        change = ray.derivative.velocity[k]
        if change is not None and turn is not None:
            own = ray.virtual_velocity
            change = change - 2.0 * (turn * dr.dot(own, n) + n * (dr.dot(own, turn) + dr.dot(change, n)))
        velocities.append(change)
        stretch = _stretch_tube(carried, k, ray, hit, tube_here)
        if stretch is not None:
            u, v = (x - n32 * (2.0 * dr.dot(x, n32)) for x in stretch)
            stretch = (u, v)
        stretches.append(stretch)
        if boundary is not None and movement is not None:
            boundary = boundary.at(movement, hit.largest_cell).mirrored(movement, n)
        boundaries.append(boundary)
    edge = ray.derivative.edge
    if edge is not None:
        edge = arrive_beside_edge(edge, carried, lane, ray, hit).mirrored(n, turns)
    return RayDerivative(
        tuple(virtual),
        tuple(boundaries),
        tuple(stretches),
        tuple(velocities),
        carried.slots,
        edge,
        ray.derivative.fields,
    )


def _patch(
    carried: Carried, k: int, ray: RayState, hit: Hit, point: mi.Vector3d
) -> tuple[mi.Vector3d, mi.Vector3d]:
    """Velocities of the antenna and of its image relative to the lit patch at a point of the facet, m per unit."""
    assert ray.derivative is not None
    antenna, virtual, boundary = carried.antenna[k], ray.derivative.virtual[k], ray.derivative.boundary[k]
    movement = carried.movement(k, hit.face, point, hit.active)
    if movement is not None and boundary is not None:
        # tubes tile the lit area: their common sides move with its boundary
        patch = boundary.at(movement, hit.largest_cell).on(movement, hit.direction64, hit.normal64)
        antenna, virtual = antenna - patch, virtual - patch
    return antenna, virtual


@dataclass(frozen=True, eq=False)
class _Seen:
    """Both ends of a path as seen from its scatterer: directions, float64, from the image and to the antenna."""

    out: mi.Vector3d
    back: mi.Vector3d
    across_out: mi.Vector3d  # 1/s, velocity of the image across the leg over its length
    across_back: mi.Vector3d

    @staticmethod
    def of(ray: RayState, lane: Lane, point: mi.Vector3d) -> _Seen:
        """Directions and their changes at a point."""
        leg, leg_back = point - ray.virtual_antenna, lane.antenna - point
        length, length_back = dr.norm(leg), dr.norm(leg_back)
        out, back = leg / length, leg_back / length_back
        moving, home = ray.virtual_velocity, lane.velocity
        return _Seen(
            out,
            back,
            (moving - out * dr.dot(out, moving)) / length,
            (home - back * dr.dot(back, home)) / length_back,
        )

    def rates(
        self, antenna: mi.Vector3d, virtual: mi.Vector3d, velocity: mi.Vector3d | None
    ) -> tuple[mi.Float, mi.Float]:
        r"""Derivatives of the range rate straight to the antenna, and back through the mirrors, m/s per unit.

        With the velocities per unit :math:`\dot{\mathbf a}, \dot{\mathbf a}'` of the antenna and of its image relative
        to the scatterer, and the change :math:`\dot{\mathbf v}'` of the image's velocity,

        .. math:: \partial \dot R = \tfrac12 \left(\dot{\mathbf a} \cdot \mathbf v_\perp / L_b
                  + \dot{\mathbf a}' \cdot \mathbf v'_\perp / L - \mathbf d \cdot \dot{\mathbf v}' \right).
        """
        leg = dr.dot(virtual, self.across_out)
        if velocity is not None:
            leg = leg - dr.dot(self.out, velocity)
        return mi.Float(0.5 * (leg + dr.dot(antenna, self.across_back))), mi.Float(leg)


def differentiate_tube(
    carried: Carried,
    kernel: Kernel,
    lane: Lane,
    ray: RayState,
    hit: Hit,
    tube_here: TubeFootprint,
    closing: Closing,
) -> EchoDerivative:
    """Derivatives of the slant range of a tube's coherent return by every displacement, and of its range rate."""
    assert ray.derivative is not None
    changes = list(closing.changes)
    seen = _Seen.of(ray, lane, closing.point) if carried.rates else None
    swings: list[mi.Float] = []
    rim = closing.point - hit.p  # phase centre of the return from the hit, in the facet's plane
    d, s = hit.direction64, hit.to_antenna64
    across_out, across_back = rim - d * dr.dot(rim, d), rim - s * dr.dot(rim, s)
    found: list[mi.Float64 | mi.Complex2f] = []
    for k, gradient in enumerate(carried.gradient):
        antenna, virtual = _patch(carried, k, ray, hit, closing.point)
        if seen is not None:
            swings.append(seen.rates(antenna, virtual, ray.derivative.velocity[k])[0])
        rate = dr.dot(s, antenna) - dr.dot(d, virtual)
        rate -= dr.dot(across_out, virtual) / hit.length + dr.dot(across_back, antenna) / hit.length_back
        if gradient is None:
            found.append(0.5 * rate)
            continue
        stretch = _stretch_tube(carried, k, ray, hit, tube_here)
        assert stretch is not None
        growth = mi.Complex2f(_area_rate(tube_here, stretch))
        if closing.integral is not None and changes:
            whole, change = closing.integral, changes.pop(0)
            there = dr.squared_norm(whole) > 1e-24
            growth += dr.select(there, change / dr.select(there, whole, 1.0), 0.0)
        found.append(add_amplitude(kernel, 0.5 * rate, growth))
    return EchoDerivative(tuple(found), None if seen is None else tuple(swings))


def add_amplitude(kernel: Kernel, rate: mi.Float64, growth: mi.Complex2f) -> mi.Complex2f:
    """Complex derivative of a slant range, from its own and the relative one of the amplitude."""
    per = growth * (0.5 / kernel.constants.wavenumber)
    return mi.Complex2f(mi.Float(rate) - per.imag, per.real)


def _area_rate(tube_here: TubeFootprint, stretch: tuple[mi.Vector3f, mi.Vector3f]) -> mi.Float:
    """Relative change of the area of a tube's footprint."""
    normal = dr.cross(tube_here.u, tube_here.v)
    change = dr.cross(stretch[0], tube_here.v) + dr.cross(tube_here.u, stretch[1])
    return dr.dot(change, normal) * dr.rcp(dr.maximum(dr.squared_norm(normal), 1e-30))


def _surface_rate(carried: Carried, k: int, hit: Hit) -> mi.Float:
    r"""Relative change of the area of a facet, :math:`\mathrm{tr} A - n \cdot A n`."""
    rows = carried.gradient[k]
    assert rows is not None
    n = hit.normal64
    rate = rows[0].x + rows[1].y + rows[2].z - dr.dot(n, carried.turned(k, n))
    return dr.select(carried.moves(k, hit.face, hit.active), mi.Float(rate), 0.0)


def deformation_rates(
    carried: Carried, kernel: Kernel, ray: RayState, hit: Hit, tube: TubeFootprint
) -> list[Rate]:
    """Derivatives of q, u and v of a tube's phase integral by every displacement that stretches or turns a shape."""
    if carried.beside_edges:
        return []
    found = []
    d, s = hit.direction64, hit.to_antenna64
    for k, rows in enumerate(carried.gradient):
        if rows is None:
            continue
        antenna, virtual = _patch(carried, k, ray, hit, hit.p)
        out = -(virtual - d * dr.dot(virtual, d)) / hit.length
        back = (antenna - s * dr.dot(antenna, s)) / hit.length_back
        q = mi.Vector3f(back - out) * kernel.constants.wavenumber
        stretch = _stretch_tube(carried, k, ray, hit, tube)
        assert stretch is not None
        u, v = stretch
        found.append((q, u, v))
    return found


def differentiate_scatterer(
    carried: Carried, kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, centre: mi.Vector3d
) -> tuple[EchoDerivative, EchoDerivative]:
    """Derivatives of a diffuse scatterer's slant range and range rate: straight, and back through the mirrors."""
    assert ray.derivative is not None
    seen = _Seen.of(ray, lane, centre)
    swings: list[tuple[mi.Float, mi.Float]] = []
    straight: list[mi.Float64 | mi.Complex2f] = []
    reciprocal: list[mi.Float64 | mi.Complex2f] = []
    for k, virtual in enumerate(ray.derivative.virtual):
        antenna = carried.antenna[k]
        movement = carried.movement(k, hit.face, centre, hit.active)
        if movement is not None:
            antenna, virtual = antenna - movement.velocity, virtual - movement.velocity
        leg = -dr.dot(seen.out, virtual)
        rates: list[mi.Float64 | mi.Complex2f] = [0.5 * (leg + dr.dot(seen.back, antenna)), leg]
        if carried.rates:
            swings.append(seen.rates(antenna, virtual, ray.derivative.velocity[k]))
        if carried.gradient[k] is not None:
            # the power of a cell grows with its area
            growth = mi.Complex2f(0.5 * _surface_rate(carried, k, hit))
            rates = [add_amplitude(kernel, rate, growth) for rate in rates]
        straight.append(rates[0])
        reciprocal.append(rates[1])
    if not carried.rates:
        return EchoDerivative(tuple(straight)), EchoDerivative(tuple(reciprocal))
    return (
        EchoDerivative(tuple(straight), tuple(rate for rate, _ in swings)),
        EchoDerivative(tuple(reciprocal), tuple(rate for _, rate in swings)),
    )
