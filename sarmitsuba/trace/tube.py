"""Ray tubes: the footprint of a ray on a facet and the phase integral over it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

Vector = Any


def footprint(edge: Vector, d: Vector, n: Vector, cos_theta: Any, dr: Any) -> Vector:
    """Project a tube's edge vector along the ray ``d`` onto the tangent plane of normal ``n``.

    ``cos_theta = -d . n > 0``.
    """
    return edge + d * (dr.dot(edge, n) / cos_theta)


def sinc(x: Any, dr: Any) -> Any:
    """``sin x / x`` with a series near zero, where the quotient loses digits."""
    small = dr.abs(x) < 1e-2
    safe = dr.select(small, 1.0, x)
    x2 = x * x
    return dr.select(small, 1.0 - x2 * (1.0 / 6.0) * (1.0 - x2 * 0.05), dr.sin(safe) / safe)


@dataclass(frozen=True)
class Extent:
    """How far a tube may reach from its ray, in tube units (the edges u, v of its footprint), before a facet ends.

    ``right, left`` along +u, -u at v = 0; ``top, bottom`` along +v, -v at u = 0; each with the slope of the limiting
    edge (change of the reach per unit along the other axis). ``NOWHERE`` where nothing limits it. The coordinates
    are those of the launch plane, so an extent stays valid through mirrors, and the extents of all facets of a
    chain intersect.
    """

    right: Any
    right_slope: Any
    left: Any
    left_slope: Any
    top: Any
    top_slope: Any
    bottom: Any
    bottom_slope: Any

    def fields(self) -> tuple[Any, ...]:
        """As a tuple, for the state of a loop."""
        return (
            *(self.right, self.right_slope, self.left, self.left_slope),
            *(self.top, self.top_slope, self.bottom, self.bottom_slope),
        )


NOWHERE = 1e3


def unlimited(f32: Any) -> Extent:
    """Extent of a tube that has met no facet yet."""
    return Extent(*(f32(x) for x in (NOWHERE, 0.0) * 4))


def limited(extent: Extent, sides: Sequence[Any], place: Vector, u: Vector, v: Vector, dr: Any) -> Extent:
    """Intersect an extent with the sharp sides of the facet that was hit.

    Each side limits the axis that crosses it more steeply, so slopes stay within one.

    Parameters
    ----------
    sides : 4-vectors of :func:`sarmitsuba.trace.sides.facet_sides`
    place : hit point from the triangle's vertex 0, m
    u, v : edges of the tube's footprint, m
    """
    out = list(extent.fields())
    for side in sides:
        m = type(place)(side[0], side[1], side[2])
        height = dr.maximum(dr.dot(m, place) - side[3], 0.0)
        gu, gv = dr.dot(m, u), dr.dot(m, v)  # the height changes by so much per unit of u and of v
        row = dr.abs(gu) >= dr.abs(gv)
        for k, (mine, steep, other) in enumerate(
            ((row, gu, gv), (row, gu, gv), (~row, gv, gu), (~row, gv, gu))
        ):
            ends = mine & ((steep < 0.0) if k % 2 == 0 else (steep > 0.0))
            safe = dr.select(ends, dr.abs(steep), 1.0)
            reach = height / safe
            nearer = ends & (reach < out[2 * k])
            out[2 * k] = dr.select(nearer, reach, out[2 * k])
            out[2 * k + 1] = dr.select(nearer, other / safe, out[2 * k + 1])
    return Extent(*out)


@dataclass(frozen=True)
class Patch:
    """The part of a facet that one ray stands for: reaches and slopes as in :class:`Extent`, and a weight.

    A tube ends half way to its neighbour, or at the facet's edge where the neighbour is beyond it. Tubes so
    tile the facet up to its very edges, whatever the lattice, except near its corners. A facet narrower than the
    lattice is found by some rays only, and those count for the rest: ``weight`` is one over the chance.
    """

    extent: Extent
    weight: Any

    def box(self, u: Vector, v: Vector) -> tuple[Vector, Vector, Vector]:
        """Middle of the patch from the hit point, and its edges, for a tube of edges ``u, v``; slopes left out."""
        e = self.extent
        middle = u * (0.5 * (e.right - e.left)) + v * (0.5 * (e.top - e.bottom))
        return middle, u * (e.right + e.left), v * (e.top + e.bottom)

    def rim(self, u: Vector, v: Vector, dr: Any) -> Vector:
        """From the hit point to the facet's edge where the patch ends at one: between two edges, 0 where there is none.

        Neighbouring patches cancel where they touch, at the carrier by their phases and off it on the average over
        many rows; what is left of a facet comes from its edges and stands at their range and rate.
        """
        e = self.extent

        def along(plus: Any, minus: Any) -> Any:
            ends = dr.select(plus == 0.5, 0.0, 1.0), dr.select(minus == 0.5, 0.0, 1.0)
            return (ends[0] * plus - ends[1] * minus) / dr.maximum(ends[0] + ends[1], 1.0)

        return u * along(e.right, e.left) + v * along(e.top, e.bottom)

    def area(self) -> Any:
        """Area of the patch over that of a whole tube, times the weight."""
        e = self.extent
        return (e.left + e.right) * (e.bottom + e.top) * self.weight


def patch(extent: Extent, dr: Any) -> Patch:
    """End a tube half way to its neighbours or at the facet's edge before them."""
    f = extent.fields()
    out = []
    for k in range(4):
        cut = f[2 * k] < 1.0
        out += [dr.select(cut, f[2 * k], 0.5), dr.select(cut, f[2 * k + 1], 0.0)]
    chance = dr.clip(f[0] + f[2], 1e-3, 1.0) * dr.clip(f[4] + f[6], 1e-3, 1.0)
    return Patch(Extent(*out), dr.rcp(chance))


def phase_integral(q: Vector, u: Vector, v: Vector, piece: Patch, dr: Any, complex_t: Any) -> Any:
    r"""Integral of ``exp(j q . r)`` over a patch in tube units, times its weight (1 for a whole tube and q = 0).

    .. math:: \int_{-C}^{D} \int_{-A - a\beta}^{B + b\beta} e^{j (Q_u \alpha + Q_v \beta)} d\alpha\, d\beta

    in closed form, with the sloped ends on the axis that is cut; where both are, the slopes of v are left out.
    """
    e = piece.extent
    qu, qv = dr.dot(q, u), dr.dot(q, v)
    swap = (e.right_slope == 0.0) & (e.left_slope == 0.0)

    def pick(row: Any, column: Any) -> Any:
        return dr.select(swap, column, row)

    qa, qb = pick(qu, qv), pick(qv, qu)
    right, left = pick(e.right, e.top), pick(e.left, e.bottom)
    slope_r, slope_l = pick(e.right_slope, e.top_slope), pick(e.left_slope, e.bottom_slope)
    low, high = pick(e.bottom, e.left), pick(e.top, e.right)
    middle, width = 0.5 * (high - low), high + low

    def line(k: Any, turn: Any) -> Any:
        """exp(j turn) times the integral of exp(j k beta) over the line."""
        s, c = dr.sincos(turn + k * middle)
        return complex_t(c, s) * (width * sinc(0.5 * k * width, dr))

    small = dr.abs(qa) < 1e-2
    safe = dr.select(small, 1.0, qa)
    ends = line(qb + safe * slope_r, safe * right) - line(qb - safe * slope_l, -safe * left)
    exact = complex_t(ends.imag, -ends.real) / safe  # over j
    # first terms of the series in qa, where the two ends cancel
    x = 0.5 * qb * width
    s, c = dr.sincos(qb * middle)
    turn = complex_t(c, s)
    mean = sinc(x, dr)
    near = dr.abs(x) < 1e-2
    odd = dr.select(near, x * (1.0 / 3.0), (mean - dr.cos(x)) / dr.select(near, 1.0, x))
    zeroth = turn * (width * mean)
    first = turn * complex_t(middle * width * mean, 0.5 * width * width * odd)
    across = zeroth * complex_t(right + left, 0.5 * qa * (right * right - left * left))
    series = across + first * (slope_r + slope_l)
    return dr.select(small, series, exact) * piece.weight
