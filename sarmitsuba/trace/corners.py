"""Which of the two facets of a corner limits a double bounce: there it is closed, for both directions of its path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sarmitsuba.backend import dr, mi
from sarmitsuba.mesh.boundary_edges import N_EDGES
from sarmitsuba.trace.geometry import INNER_BIT

if TYPE_CHECKING:
    from sarmitsuba.trace.state import Hit, Kernel

# power of the ratio of reaches with which a facet's share falls
POWER = 4
# reach, over the distance from the fold, of a facet that nothing ends; and the least sine of a corner's angle
UNLIMITED, LEAST_SINE = 1e3, 0.1


@dataclass  # not frozen: part of the loop's state, which Dr.Jit writes to
class Mirror:
    """The facet that a ray was mirrored in last.

    Parameters
    ----------
    face : row of the scene's tables
    bits : of its own material, with the edges that only cut it into parts
    point : m, of reflection, from the triangle's vertex 0
    normal : facing the ray
    length : float64, m, unfolded, to there
    """

    face: mi.UInt32
    bits: mi.UInt32
    point: mi.Vector3f
    normal: mi.Vector3f
    length: mi.Float64

    @staticmethod
    def none() -> Mirror:
        """Before the first."""
        zero = dr.zeros(mi.Vector3f)
        return Mirror(mi.UInt32(0), mi.UInt32(0), zero, zero, mi.Float64(0.0))

    @staticmethod
    def at(hit: Hit) -> Mirror:
        """The facet of a hit."""
        return Mirror(hit.face, hit.own_material, mi.Vector3f(hit.p - hit.vertex0), hit.normal, hit.length)


def corner_share(kernel: Kernel, mirror: Mirror, hit: Hit) -> mi.Float:
    r"""Weight of a double bounce by which of its two facets ends first, seen from the line in which their planes meet.

    A path over A that closes at B, and the reversed one, over B to A, are two estimates of one field, each of half of
    it. Currents are those of physical optics where the facet itself ends, as an edge of metal wants them; where the
    light that A sends to B ends within B, because A ends, B has no edge and the estimate errs. With reaches
    :math:`\kappa`, of the facets' ends over those of the two hits,

    .. math:: w_B = \frac{2 \kappa_A^4}{\kappa_A^4 + \kappa_B^4}, \quad w_A + w_B = 2

    Parameters
    ----------
    kernel : its scene has the facets' edges
    mirror, hit : where the ray comes from, and where it closes

    Returns
    -------
    w of the facet that was hit; 1 at other hits than the second and between facets that are nearly parallel

    Notes
    -----
    Ignores ends of the facets along the fold, and other objects that end their light.
    """
    cosine = dr.dot(mirror.normal, hit.normal)
    sine2 = 1.0 - dr.square(cosine)
    inverse = dr.rsqrt(dr.maximum(sine2, LEAST_SINE**2))
    leg = mi.Float(hit.length - mirror.length) * inverse
    edges = _reach(
        kernel,
        mirror.face,
        mirror.bits,
        mirror.point,
        (hit.normal - mirror.normal * cosine) * inverse,
        leg * hit.cos_incidence,
        hit.active,
    )
    here = _reach(
        kernel,
        hit.face,
        hit.own_material,
        mi.Vector3f(hit.p - hit.vertex0),
        (mirror.normal - hit.normal * cosine) * inverse,
        leg * dr.dot(hit.direction, mirror.normal),
        hit.active,
    )
    ratio = dr.power(here / edges, POWER)
    corner = (hit.order == 2) & (sine2 > LEAST_SINE**2)
    return dr.select(corner, 2.0 / (1.0 + ratio), 1.0)


def _reach(
    kernel: Kernel,
    face: mi.UInt32,
    bits: mi.UInt32,
    point: mi.Vector3f,
    away: mi.Vector3f,
    distance: mi.Float,
    active: mi.Bool,
) -> mi.Float:
    """How far a facet goes on from the fold, over the distance of a point; ``away``: unit vector from the fold."""
    beyond = mi.Float(UNLIMITED) * distance
    for i in range(N_EDGES):
        edge = dr.gather(mi.Vector4f, kernel.scene.edge_table, face * N_EDGES + i, active)
        m = mi.Vector3f(edge[0], edge[1], edge[2])
        towards = -dr.dot(m, away)
        height = dr.maximum(dr.dot(m, point) - edge[3], 0.0)
        ends = (towards > 1e-3) & (((bits >> (INNER_BIT + i)) & 1) == 0)
        beyond = dr.select(ends, dr.minimum(beyond, height / dr.select(ends, towards, 1.0)), beyond)
    return 1.0 + beyond / dr.maximum(distance, 1e-12)


__all__ = ["Mirror", "corner_share"]
