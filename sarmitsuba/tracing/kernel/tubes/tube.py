"""Ray tubes: the footprint of a ray on a facet, and its divergence or convergence behind a curved mirror."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sarmitsuba.machine.backend import dr, mi


def footprint(edge: mi.Vector3f, d: mi.Vector3f, n: mi.Vector3f, cos_theta: mi.Float) -> mi.Vector3f:
    """Footprint of a tube's edge vector: its projection along the ray ``d`` onto the tangent plane of normal ``n``.

    ``cos_theta = -d . n > 0``.
    """
    return edge + d * (dr.dot(edge, n) / cos_theta)


@dataclass  # not frozen: part of the loop's state, which Dr.Jit writes to
class TubeExtent:
    """Extent of a tube about its ray up to the edges of facets, in tube units (the edges u, v of its footprint).

    ``right, left`` along +u, -u at v = 0; ``top, bottom`` along +v, -v at u = 0; each with the slope of the limiting
    edge (change of the distance per unit along the other axis). ``NOWHERE`` where nothing limits it. The coordinates
    are those of the launch plane, so an extent stays valid through mirrors, and the extents of all facets of a
    chain intersect.
    """

    right: mi.Float
    right_slope: mi.Float
    left: mi.Float
    left_slope: mi.Float
    top: mi.Float
    top_slope: mi.Float
    bottom: mi.Float
    bottom_slope: mi.Float

    def fields(self) -> tuple[mi.Float, ...]:
        """Distance and slope of the four ends in turn, as a tuple."""
        return (
            *(self.right, self.right_slope, self.left, self.left_slope),
            *(self.top, self.top_slope, self.bottom, self.bottom_slope),
        )


NOWHERE = 1e3


def make_unlimited() -> TubeExtent:
    """Extent of a tube before the first hit."""
    return TubeExtent(*(mi.Float(x) for x in (NOWHERE, 0.0) * 4))


def limit_extent(
    extent: TubeExtent, edges: Sequence[mi.Vector4f], point: mi.Vector3f, u: mi.Vector3f, v: mi.Vector3f
) -> TubeExtent:
    """Extent of a tube, intersected with the boundary edges of the facet that was hit.

    Each edge limits the axis that crosses it more steeply, so slopes stay within one.

    Parameters
    ----------
    edges : 4-vectors of :func:`sarmitsuba.scene.mesh.boundary_edges.facets`
    point : hit point from the triangle's vertex 0, m
    u, v : edges of the tube's footprint, m
    """
    out = list(extent.fields())
    for edge in edges:
        m = type(point)(edge[0], edge[1], edge[2])
        height = dr.maximum(dr.dot(m, point) - edge[3], 0.0)
        gu, gv = dr.dot(m, u), dr.dot(m, v)  # change of the height per unit of u and of v
        row = dr.abs(gu) >= dr.abs(gv)
        for k, (mine, steep, other) in enumerate(
            ((row, gu, gv), (row, gu, gv), (~row, gv, gu), (~row, gv, gu))
        ):
            ends = mine & ((steep < 0.0) if k % 2 == 0 else (steep > 0.0))
            safe = dr.select(ends, dr.abs(steep), 1.0)
            limit = height / safe
            nearer = ends & (limit < out[2 * k])
            out[2 * k] = dr.select(nearer, limit, out[2 * k])
            out[2 * k + 1] = dr.select(nearer, other / safe, out[2 * k + 1])
    return TubeExtent(*out)


@dataclass(frozen=True)
class Patch:
    """Patch of a facet that one ray represents for diffuse returns: a quadrilateral in tube units, and a weight.

    A tube ends half way to its neighbour, or at the facet's edge where the neighbour is beyond it. Tubes thus tile
    the facet up to its edges for any lattice, except at corners sharper than 25 degrees (area within 6 %).
    A facet narrower than the lattice is hit by some rays only: ``weight`` is one over the chance.

    Parameters
    ----------
    extent : distances and slopes; 0.5 and 0 where the neighbour ends the tube
    corners : (alpha, beta) of right top, left top, left bottom, right bottom, where the four ends meet
    rim : (alpha, beta) of the facet's edge or corner at which the patch ends; the middle between two, 0 without any
    weight : of its area
    """

    extent: TubeExtent
    corners: tuple[tuple[mi.Float, mi.Float], ...]
    rim: tuple[mi.Float, mi.Float]
    weight: mi.Float

    def box(self, u: mi.Vector3f, v: mi.Vector3f) -> tuple[mi.Vector3f, mi.Vector3f, mi.Vector3f]:
        """Middle of the patch from the hit point, and its edges, for a tube of edges ``u, v``; slopes ignored."""
        e = self.extent
        middle = u * (0.5 * (e.right - e.left)) + v * (0.5 * (e.top - e.bottom))
        return middle, u * (e.right + e.left), v * (e.top + e.bottom)

    def area(self) -> mi.Float:
        """Area of the patch relative to a whole tube, times the weight."""
        (ax, ay), (bx, by), (cx, cy), (dx, dy) = self.corners
        return 0.5 * ((ax - cx) * (by - dy) - (bx - dx) * (ay - cy)) * self.weight


def patch(extent: TubeExtent) -> Patch:
    """Patch of a tube: ended half way to its neighbours, or at the facet's edge if that is nearer."""
    f = extent.fields()
    ends, slopes, cuts = [], [], []
    for k in range(4):
        cut = f[2 * k] < 1.0
        ends.append(dr.select(cut, f[2 * k], 0.5))
        slopes.append(dr.select(cut, f[2 * k + 1], 0.0))
        cuts.append(dr.select(cut, 1.0, 0.0))

    def corner(sign_u: float, column: int, sign_v: float, row: int) -> tuple[mi.Float, mi.Float]:
        """Corner of the patch: intersection of ``alpha = su (e + s beta)`` and ``beta = sv (e + s alpha)``."""
        x, xs = sign_u * ends[column], sign_u * slopes[column]
        y, ys = sign_v * ends[row], sign_v * slopes[row]
        determinant = 1.0 - xs * ys
        # an acute corner along the lattice's diagonal belongs to the rays further out: the patch ends in a right angle
        goes_on = (ends[column] + sign_v * slopes[column] > 1.0) & (ends[row] + sign_u * slopes[row] > 1.0)
        meet = (determinant > 0.25) & ~goes_on
        xs, ys = dr.select(meet, xs, 0.0), dr.select(meet, ys, 0.0)
        scale = dr.rcp(dr.select(meet, determinant, 1.0))
        return (x + xs * y) * scale, (y + ys * x) * scale

    right_top, left_top = corner(1.0, 0, 1.0, 2), corner(-1.0, 1, 1.0, 2)
    left_bottom, right_bottom = corner(-1.0, 1, -1.0, 3), corner(1.0, 0, -1.0, 3)

    def middle(plus: int, minus: int) -> tuple[mi.Float, mi.Float]:
        """Edge of the facet at which the patch ends along one axis, and whether there is one."""
        n = cuts[plus] + cuts[minus]
        return (cuts[plus] * ends[plus] - cuts[minus] * ends[minus]) / dr.maximum(n, 1.0), n

    (rim_u, by_u), (rim_v, by_v) = middle(0, 1), middle(2, 3)
    # in a corner of the facet the two edges intersect elsewhere than on the axes
    single = (by_u == 1.0) & (by_v == 1.0)
    top, right = cuts[2] > 0.0, cuts[0] > 0.0

    def meeting_point(axis: int, otherwise: mi.Float) -> mi.Float:
        upper = dr.select(right, right_top[axis], left_top[axis])
        lower = dr.select(right, right_bottom[axis], left_bottom[axis])
        return dr.select(single, dr.select(top, upper, lower), otherwise)

    rim = (meeting_point(0, rim_u), meeting_point(1, rim_v))
    chance = dr.clip(f[0] + f[2], 1e-3, 1.0) * dr.clip(f[4] + f[6], 1e-3, 1.0)
    extent = TubeExtent(*(x for pair in zip(ends, slopes, strict=True) for x in pair))
    return Patch(extent, (right_top, left_top, left_bottom, right_bottom), rim, dr.rcp(chance))


# largest cross-section of a tube behind curved mirrors relative to flat ones; the ray ends beyond it: its field is
# 120 dB down, and further mirrors would leave the range of float32
WIDEST_SPREAD = 1e12


def normal_change(
    table: mi.Float, face: mi.UInt32, active: mi.Bool, sign: mi.Float
) -> Callable[[mi.Vector3f], mi.Vector3f]:
    """Change of the normal for a step on the facet: a function of float32 vectors; ``sign`` -1 reverses the normal."""
    a = dr.gather(mi.Vector4f, table, face * 2, active)
    b = dr.gather(mi.Vector4f, table, face * 2 + 1, active)

    def apply(step: mi.Vector3f) -> mi.Vector3f:
        return (
            mi.Vector3f(
                a.x * step.x + a.w * step.y + b.x * step.z,
                a.w * step.x + a.y * step.y + b.y * step.z,
                b.x * step.x + b.y * step.y + a.z * step.z,
            )
            * sign
        )

    return apply
