"""Which of the two facets of a corner limits a double bounce: there it is closed, for both directions of its path."""

from __future__ import annotations

from sarmitsuba.backend import dr, mi
from sarmitsuba.mesh.boundary_edges import N_EDGES
from sarmitsuba.trace.scene_tables import INNER_BIT
from sarmitsuba.trace.state import Hit, Kernel, Lane, Mirror, RayState

# power of the ratio of reaches with which a path's share falls
POWER = 8
# reach, over the distance from the fold, of a facet that nothing ends; and the least sine of a corner's angle
UNLIMITED, LEAST_SINE = 1e3, 0.1
# rad, angle between transmitter and receiver up to which, and from which on no more, both chains estimate each path
NEAR, FAR = 0.03, 0.1


def mirror_at(kernel: Kernel, hit: Hit) -> Mirror:
    """The facet of a hit as the mirror that the ray comes from afterwards."""
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
    """Whether a facet is no part of a curved surface."""
    table = kernel.scene.curvature_table
    if table is None:
        return mi.Bool(True)
    rows = [dr.gather(mi.Vector4f, table, hit.face * 2 + i, hit.active) for i in range(2)]
    return dr.squared_norm(rows[0]) + dr.squared_norm(rows[1]) == 0.0


def corner_share(kernel: Kernel, mirror: Mirror, hit: Hit) -> tuple[mi.Float, mi.Bool]:
    r"""Weight of a double bounce, by which of its two facets ends first on its way and on that of the reversed path.

    A path over A that closes at B, and the reversed one, over B to A, are estimates of one field each by the other's
    transpose; together they count twice. The currents at B end at an edge where B does, as physical optics wants it.
    Where the light that A sends ends within B, because A ends, there is no edge: then the reversed path, which ends at
    the edge of A, is the better one. With r the reach of B over that of A (distances of the facets' ends from the fold
    over those of the two hits) on the path, and r' on the reversed one, to which B mirrors the antenna,

    .. math::
        w_{AB} = \frac{2 f}{f + g}, \quad f = \frac1{1 + r^8}, \quad g = \frac{r'^8}{1 + r'^8}, \quad
        w_{AB} + w_{BA} = 2

    In a square corner r' is r. Both end at their own edges, and both count once, for wide corners near the direction
    where the facets are equally long.

    Parameters
    ----------
    kernel : its scene has the facets' edges
    mirror, hit : where the ray comes from, and where it closes

    Returns
    -------
    w of the path, and lanes that have one; 1 for other hits than the second, for curved surfaces, between facets that
        are nearly parallel, and where no path goes the other way round

    Notes
    -----
    Ignores ends of the facets along the fold, and other objects that end their light. For an antenna apart that
    receives see :func:`both_chains`.
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
    corner = (hit.order == 2) & (sine2 > LEAST_SINE**2) & (mirror.flat == 1) & _flat(kernel, hit)
    corner &= to_a > 0.0
    return dr.select(corner, weight, 1.0), corner


def both_chains(
    kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, share: mi.Float, corner: mi.Bool
) -> mi.Complex2f:
    r"""Factor of a double bounce where another antenna receives, from the path's slant range.

    The chain over A and B is an estimate of two paths, transmitter, A, B, receiver, and the other way round, receiver,
    A, B, transmitter; so is the chain over B and A. With the slant ranges :math:`h, h'` of the two

    .. math:: c = (1 - t) + t \, \tfrac{w}{2} \left(1 + e^{2 j k (h - h')}\right)

    where t falls from 1 to 0 between ``NEAR`` and ``FAR`` of angle between both antennas: far apart each path closes
    where it hits last.

    Parameters
    ----------
    share, corner : w and its lanes, from :func:`corner_share`

    Returns
    -------
    c; 1 for other lanes

    Notes
    -----
    Ignores that the two ranges differ within a range cell, and that the other path meets both facets elsewhere by the
    angle between the antennas times the size of the corner.
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
    """How far a facet goes on from the fold, over the distance of a point; ``away``: unit vector from the fold."""
    beyond = mi.Float(UNLIMITED) * distance
    for i in range(N_EDGES):
        edge = dr.gather(mi.Vector4f, kernel.scene.edge_table, face * N_EDGES + i, hit.active)
        m = mi.Vector3f(edge[0], edge[1], edge[2])
        towards = -dr.dot(m, away)
        height = dr.maximum(dr.dot(m, point) - edge[3], 0.0)
        ends = (towards > 1e-3) & (((bits >> (INNER_BIT + i)) & 1) == 0)
        beyond = dr.select(ends, dr.minimum(beyond, height / dr.select(ends, towards, 1.0)), beyond)
    return 1.0 + beyond / dr.maximum(distance, 1e-12)


__all__ = ["both_chains", "corner_share", "mirror_at"]
