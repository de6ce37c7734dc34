"""Weights of a double bounce and of its reversed path, by which facet of the corner limits the lit area."""

from __future__ import annotations

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.scene.mesh.boundary_edges import N_EDGES
from sarmitsuba.tracing.kernel.scene_tables import INNER_BIT
from sarmitsuba.tracing.kernel.state import Hit, Kernel, Lane, Mirror, RayState
from sarmitsuba.tracing.kernel.table_rows import FaceRow

# exponent of the ratio of reaches in the weight
POWER = 8
# relative reach of a facet without an edge in this direction; least sine of the angle of a corner
UNLIMITED, LEAST_SINE = 1e3, 0.1
# width of a tube that a curved surface has spread, over that of the first Fresnel zone where it closes, up to which
# its return is as good as that of the reversed path, and from which it is left to that one
NARROW, WIDE = 0.8, 2.2
# rad, bistatic angles up to which both chains count as estimates of each path, and from which each counts alone
NEAR, FAR = 0.03, 0.1


def mirror_at(kernel: Kernel, hit: Hit) -> Mirror:
    """Facet of a hit, recorded as the mirror of the ray's next leg."""
    point = mi.Vector3f(hit.p - hit.vertex0)
    return Mirror(
        hit.face,
        hit.own_material,
        point,
        hit.normal,
        hit.length,
        dr.select(_flat(kernel, hit), mi.UInt32(1), 0),
    )


def _flat(kernel: Kernel, hit: Hit) -> mi.Bool:
    """Whether a facet is flat, not part of a curved surface."""
    if kernel.scene.curvature_table is None:
        return mi.Bool(True)
    return _squared_curvature(kernel, hit.face, hit.active) == 0.0


def corner_share(kernel: Kernel, mirror: Mirror, hit: Hit) -> tuple[mi.Float, mi.Bool]:
    r"""Weight of a double bounce relative to its reversed path, by which of its two facets limits the lit area.

    A path over A that closes at B, and the reversed one, over B to A, estimate the same return (transposed); both are
    summed. Physical optics integrates the currents on B up to an edge of B. Where the area lit by A ends within B,
    because A ends, there is no edge of B: then the reversed path, which ends at the edge of A, is the better estimate.
    With r the reach of B over that of A (distance of a facet's end from the fold over that of the hit on it) on the
    path, and r' on the reversed one, to which B mirrors the antenna,

    .. math::
        w_{AB} = \frac{2 f}{f + g}, \quad f = \frac1{1 + r^8}, \quad g = \frac{r'^8}{1 + r'^8}, \quad
        w_{AB} + w_{BA} = 2

    A curved and a flat surface: the path that closes on the curved one is right with rays as that needs.
    The reversed path is spread by the curved mirror, and closes on the flat one by tubes of the width

    .. math:: b = d \, (1 + 2 s / \rho \cos\theta)

    after the distance s from the radius of curvature :math:`\rho`, with rays of spacing d. The phase over them is not
    known where b exceeds the Fresnel zone :math:`\sqrt{\lambda s}`: there its weight falls to zero.

    In a square corner r' is r. In wide corners, near the direction where both facets are equally long, both paths end
    at an edge and both have weight one.

    Parameters
    ----------
    kernel : its scene has the facets' edges
    mirror, hit : facet of the first bounce, and hit where the path closes

    Returns
    -------
    w of the path, and lanes of corners of flat facets; 1 for other hits than the second, between two curved surfaces or
        nearly parallel facets, and where the reversed path does not exist

    Notes
    -----
    Ignores the ends of the facets along the fold, and shadows of other objects on them. For a separate receiving
    antenna see :func:`both_chains`.
    """
    d, s, n_a, n_b = hit.direction, hit.to_antenna, mirror.normal, hit.normal
    cosine = dr.dot(n_a, n_b)
    sine2 = 1.0 - dr.square(cosine)
    inverse = dr.rsqrt(dr.maximum(sine2, LEAST_SINE**2))
    leg = mi.Float(hit.length - mirror.length) * inverse
    from_a, to_b = dr.maximum(dr.dot(d, n_a), 1e-7), hit.cos_incidence
    point = mi.Vector3f(hit.p - hit.vertex0)
    reach_a = _reach(
        kernel, mirror.face, mirror.bits, mirror.point, (n_b - n_a * cosine) * inverse, leg * to_b, hit
    )
    reach_b = _reach(
        kernel, hit.face, hit.own_material, point, (n_a - n_b * cosine) * inverse, leg * from_a, hit
    )
    ratio = reach_b / reach_a
    # the reversed path leaves A towards the antenna's image in B
    from_b, to_a = dr.dot(s, n_b), dr.dot(s, n_a) - 2.0 * dr.dot(s, n_b) * cosine
    reversed_ratio = ratio * (from_b * from_a) / (dr.maximum(to_a, 1e-7) * to_b)
    own, other = (dr.power(dr.clip(x, 1.0 / UNLIMITED, UNLIMITED), POWER) for x in (ratio, reversed_ratio))
    weight = 2.0 * (1.0 + other) / (1.0 + other * (2.0 + own))
    flat = _flat(kernel, hit)
    corner = (hit.order == 2) & (sine2 > LEAST_SINE**2) & (mirror.flat == 1) & flat
    corner &= to_a > 0.0
    share = dr.select(corner, weight, 1.0)
    if kernel.scene.curvature_table is not None:
        round_one = (hit.order == 2) & (flat != (mirror.flat == 1)) & (to_a > 0.0)
        face = dr.select(flat, mirror.face, hit.face)
        away = _spread(kernel, hit, face, mi.Float(hit.length - mirror.length), dr.select(flat, from_a, to_b))
        share = dr.select(round_one, dr.select(flat, 1.0 - away, 1.0 + away), share)
    return share, corner


def _spread(kernel: Kernel, hit: Hit, face: mi.UInt32, leg: mi.Float, cosine: mi.Float) -> mi.Float:
    """Share, 0 to 1, of the path that closes on a flat surface that is left to the one that closes on a curved one."""
    leg = dr.maximum(leg, 1e-6)
    radius = dr.rsqrt(dr.maximum(_squared_curvature(kernel, face, hit.active), 1e-12))
    need, _ = FaceRow.of(kernel.scene.face_info, face, hit.active).needed_spacings
    width = need * (1.0 + 2.0 * leg / (radius * dr.maximum(cosine, LEAST_SINE)))
    zone = dr.sqrt(leg * (2.0 * dr.pi) / kernel.constants.wavenumber)
    x = dr.clip((width / zone - NARROW) / (WIDE - NARROW), 0.0, 1.0)
    return dr.square(x) * (3.0 - 2.0 * x)


def _squared_curvature(kernel: Kernel, face: mi.UInt32, active: mi.Bool) -> mi.Float:
    """Sum of the squares of both principal curvatures of a facet's surface, 1/m^2."""
    a, b = (dr.gather(mi.Vector4f, kernel.scene.curvature_table, face * 2 + i, active) for i in range(2))
    return (
        dr.square(a.x)
        + dr.square(a.y)
        + dr.square(a.z)
        + 2.0 * (dr.square(a.w) + dr.square(b.x) + dr.square(b.y))
    )


def both_chains(
    kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, share: mi.Float, corner: mi.Bool
) -> mi.Complex2f:
    r"""Factor on a double bounce received by a separate antenna, for both directions of the path.

    The chain over A and B is an estimate of two paths, transmitter, A, B, receiver, and the other way round, receiver,
    A, B, transmitter; so is the chain over B and A. With the slant ranges :math:`h, h'` of the two

    .. math:: c = (1 - t) + t \, \tfrac{w}{2} \left(1 + e^{2 j k (h - h')}\right)

    where t falls from 1 to 0 for bistatic angles from ``NEAR`` to ``FAR``: for large angles each path closes at its own
    last hit.

    Parameters
    ----------
    share, corner : w and its lanes, from :func:`corner_share`

    Returns
    -------
    c; 1 for other lanes

    Notes
    -----
    Ignores the difference of the two ranges within a range cell, and the distance between the hits of both paths (the
    bistatic angle times the size of the corner).
    """
    assert ray.virtual_receiver is not None
    other = dr.norm(hit.p - ray.virtual_receiver) + dr.norm(lane.transmitter - hit.p)
    further = mi.Float(hit.length + hit.length_back - other)
    phase = kernel.constants.wavenumber * further  # 2 k (h - h'), of half the lengths
    apart = dr.norm(mi.Vector3f(dr.normalize(lane.transmitter - hit.p) - hit.to_antenna64))
    x = dr.clip((apart - NEAR) / (FAR - NEAR), 0.0, 1.0)
    near = dr.select(corner, 1.0 - dr.square(x) * (3.0 - 2.0 * x), 0.0)
    sine, cosine = dr.sincos(phase)
    half = 0.5 * share * near
    return mi.Complex2f(1.0 - near + half * (1.0 + cosine), half * sine)


def _reach(
    kernel: Kernel,
    face: mi.UInt32,
    bits: mi.UInt32,
    point: mi.Vector3f,
    away: mi.Vector3f,
    distance: mi.Float,
    hit: Hit,
) -> mi.Float:
    """Extent of a facet from the fold, relative to the distance of a point; ``away``: unit vector from the fold."""
    beyond = mi.Float(UNLIMITED) * distance
    for i in range(N_EDGES):
        edge = dr.gather(mi.Vector4f, kernel.scene.edge_table, face * N_EDGES + i, hit.active)
        m = mi.Vector3f(edge[0], edge[1], edge[2])
        towards = -dr.dot(m, away)
        height = dr.maximum(dr.dot(m, point) - edge[3], 0.0)
        ends = (towards > 1e-3) & (((bits >> (INNER_BIT + i)) & 1) == 0)
        beyond = dr.select(ends, dr.minimum(beyond, height / dr.select(ends, towards, 1.0)), beyond)
    return 1.0 + beyond / dr.maximum(distance, 1e-12)
