"""The part of a flat facet that one ray stands for, exact up to the facet's corners, and the phase integral over it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

from sarmitsuba.backend import dr, mi
from sarmitsuba.tubes.tube import NOWHERE, Extent

# rows of the lattice to each side that are looked at for other rays on the facet
ROWS = 4
# tubes that a part reaches at most across its row, where no ray is nearer
REACH = ROWS + 0.5
# the same along the row, below an edge that crosses rows at an angle of one over twice that
REACH_ALONG = 30.0
# the same up to the rim of a curved surface
REACH_RIM = 1.5
# phase over a tube (rad) beyond which sides between the parts of a facet are left out
INNER_UP_TO = 5.0
# of a ray to meet a narrow facet; bounds the weight
LEAST_CHANCE = 1e-3


@dataclass(frozen=True)
class Line:
    """Half-plane ``h + gu alpha + gv beta >= 0`` of tube units, the larger of ``|gu|, |gv|`` one."""

    h: mi.Float
    gu: mi.Float
    gv: mi.Float


@dataclass(frozen=True)
class Polygon:
    """Part of a convex facet in tube units: its sides counter-clockwise, and a weight.

    Parameters
    ----------
    sides : (alpha, beta) of start and end of each; those that are not there have no length
    rim : point that phases refer to, see :class:`sarmitsuba.tubes.tube.Patch`
    weight : of its area
    tiles : its first four sides are those of other rays' parts too, all around the facet
    """

    sides: tuple[tuple[mi.Float, mi.Float, mi.Float, mi.Float], ...]
    rim: tuple[mi.Float, mi.Float]
    weight: mi.Float
    tiles: mi.Bool

    def area(self) -> mi.Float:
        """Area over that of a whole tube, times the weight."""
        twice = sum((ax * by - bx * ay for ax, ay, bx, by in self.sides[1:]), self._first())
        return 0.5 * twice * self.weight

    def _first(self) -> mi.Float:
        ax, ay, bx, by = self.sides[0]
        return ax * by - bx * ay


def facet_lines(
    edges: Sequence[mi.Vector4f], point: mi.Vector3f, u: mi.Vector3f, v: mi.Vector3f
) -> list[Line]:
    """Boundary edges of the facet in units of the tube that hit it; see :func:`sarmitsuba.tubes.tube.limited`."""
    lines = []
    for edge in edges:
        m = type(point)(edge[0], edge[1], edge[2])
        lines.append(_line(dr.maximum(dr.dot(m, point) - edge[3], 0.0), dr.dot(m, u), dr.dot(m, v)))
    return lines


def extent_lines(extent: Extent) -> list[Line]:
    """The four ends that the facets hit so far leave a tube."""
    e = extent
    one = mi.Float(1.0)
    return [
        Line(e.right, -one, e.right_slope),
        Line(e.left, one, e.left_slope),
        Line(e.top, e.top_slope, -one),
        Line(e.bottom, e.bottom_slope, one),
    ]


def _line(h: mi.Float, gu: mi.Float, gv: mi.Float) -> Line:
    largest = dr.maximum(dr.abs(gu), dr.abs(gv))
    used = largest * NOWHERE > h
    scale = dr.rcp(dr.select(used, largest, 1.0))
    return Line(
        dr.select(used, h * scale, NOWHERE),
        dr.select(used, gu * scale, 1.0),
        dr.select(used, gv * scale, 0.0),
    )


def selected(condition: mi.Bool, a: Sequence[Line], b: Sequence[Line]) -> list[Line]:
    """``a`` in the lanes where the condition holds, else ``b``."""
    return [
        Line(*(dr.select(condition, getattr(x, k), getattr(y, k)) for k in ("h", "gu", "gv")))
        for x, y in zip(a, b, strict=True)
    ]


def clipped(lines: Sequence[Line], extent: Extent, rim: tuple[mi.Float, mi.Float], exact: mi.Bool) -> Polygon:
    """Part of the facet within ``lines`` that a ray stands for.

    The rays on a facet share it out row by row of their lattice: each has its own cell, the outermost of a row all
    that is beyond it, and a row whose neighbour holds no ray takes that one too. Their parts so tile a convex facet
    without gap or overlap, up to its corners. Where a facet is narrower than the lattice everywhere, rays find it by
    chance: they stand for the facet's part of their row or column, with a weight of one over the chance. What fewer
    than three lines bound (the rim of a curved surface) has no corners: there a ray has its own cell, and what is
    beyond it up to an edge that is nearer than the next ray.
    """
    rows = [_Axis.of(line.h, line.gu, line.gv) for line in lines]
    columns = [_Axis.of(line.h, line.gv, line.gu) for line in lines]
    across = {j: _interval(rows, float(j)) for j in range(-ROWS, ROWS + 1)}
    wide = _wide(rows) & _wide(columns)
    low, high = across[0]
    bottom_end, top_end = _interval(columns, 0.0)
    left = dr.select(low <= -1.0, -0.5, -REACH_ALONG)
    right = dr.select(high >= 1.0, 0.5, REACH_ALONG)
    # an empty row belongs to the next below it that has rays, else to the next above
    top, bottom = mi.Float(REACH), mi.Float(-REACH)
    for j in range(ROWS, 0, -1):
        top = dr.select(_holds_ray(across[j]), j - 0.5, top)
        bottom = dr.select(_holds_ray(across[-j]), -0.5, bottom)
    # narrow: the part of the row, or of the column, whichever the facet crosses on the shorter way
    by_row = high - low < top_end - bottom_end
    left = dr.select(wide, left, dr.select(by_row, -REACH, -0.5))
    right = dr.select(wide, right, dr.select(by_row, REACH, 0.5))
    top = dr.select(wide, top, dr.select(by_row, 0.5, REACH))
    bottom = dr.select(wide, bottom, dr.select(by_row, -0.5, -REACH))
    chance = dr.clip(dr.select(by_row, high - low, top_end - bottom_end), LEAST_CHANCE, 1.0)
    used = sum((dr.select(line.h < NOWHERE, 1.0, 0.0) for line in lines), mi.Float(0.0))
    bounded = used > 2.5
    left = dr.select(bounded, left, dr.select(extent.left < 1.0, -REACH_RIM, -0.5))
    right = dr.select(bounded, right, dr.select(extent.right < 1.0, REACH_RIM, 0.5))
    top = dr.select(bounded, top, dr.select(extent.top < 1.0, REACH_RIM, 0.5))
    bottom = dr.select(bounded, bottom, dr.select(extent.bottom < 1.0, -REACH_RIM, -0.5))

    sides = []
    for value, axis, sign in ((bottom, rows, 1), (top, rows, -1)):
        a, b = _span(left, right, _interval(axis, value))
        sides.append((a, value, b, value) if sign > 0 else (b, value, a, value))
    for value, axis, sign in ((right, columns, 1), (left, columns, -1)):
        a, b = _span(bottom, top, _interval(axis, value))
        sides.append((value, a, value, b) if sign > 0 else (value, b, value, a))
    sides += [_side(k, lines, (left, right, bottom, top)) for k in range(len(lines))]
    exact &= bounded
    own = _rim(sides[4:], (left, right, bottom, top))
    rim = (dr.select(exact, own[0], rim[0]), dr.select(exact, own[1], rim[1]))
    weight = dr.rcp(dr.select(wide | ~bounded, 1.0, chance))
    return Polygon(tuple(sides), rim, weight, wide & exact)


@dataclass(frozen=True)
class _Axis:
    """Where a line crosses the rows: at ``at + slope row``, as a lower or an upper end."""

    at: mi.Float
    slope: mi.Float
    lower: mi.Bool

    @staticmethod
    def of(h: mi.Float, along: mi.Float, other: mi.Float) -> _Axis:
        inverse = -dr.rcp(_nonzero(along))
        return _Axis(h * inverse, other * inverse, along >= 0.0)


def _nonzero(x: mi.Float) -> mi.Float:
    """``x`` kept off zero, with its sign."""
    return dr.select(dr.abs(x) > 1e-6, x, dr.select(x >= 0.0, 1e-6, -1e-6))


def _interval(axes: Sequence[_Axis], row: float | mi.Float) -> tuple[mi.Float, mi.Float]:
    """Ends of a row within all lines; the second is below the first where none of it is."""
    low, high = mi.Float(-NOWHERE), mi.Float(NOWHERE)
    for a in axes:
        x = a.at + a.slope * row
        low = dr.select(a.lower, dr.maximum(low, x), low)
        high = dr.select(a.lower, high, dr.minimum(high, x))
    return low, high


def _holds_ray(interval: tuple[mi.Float, mi.Float]) -> mi.Bool:
    """Whether one of a row's rays, at whole numbers, lies within an interval."""
    return dr.floor(interval[1]) >= dr.ceil(interval[0])


def _wide(axes: Sequence[_Axis]) -> mi.Bool:
    """Whether somewhere the row within all lines is long enough to hold a ray for certain."""
    low, high = mi.Float(-NOWHERE), mi.Float(NOWHERE)
    for a, b in permutations(axes, 2):
        # between a lower end a and an upper end b
        counts = a.lower & ~b.lower
        length, growth = b.at - a.at - 1.0, b.slope - a.slope
        row = -length * dr.rcp(_nonzero(growth))
        low = dr.select(counts & (growth >= 0.0), dr.maximum(low, row), low)
        high = dr.select(counts & (growth < 0.0), dr.minimum(high, row), high)
    return low <= high


def _span(start: mi.Float, end: mi.Float, interval: tuple[mi.Float, mi.Float]) -> tuple[mi.Float, mi.Float]:
    """Part of ``start ... end`` within an interval; without length where there is none."""
    a, b = dr.maximum(start, interval[0]), dr.minimum(end, interval[1])
    there = b > a
    return dr.select(there, a, start), dr.select(there, b, start)


def _side(
    k: int, lines: Sequence[Line], box: tuple[mi.Float, mi.Float, mi.Float, mi.Float]
) -> tuple[mi.Float, mi.Float, mi.Float, mi.Float]:
    """Part of line ``k`` within the others and the box, the facet to its left."""
    line = lines[k]
    foot = -line.h * dr.rcp(dr.square(line.gu) + dr.square(line.gv))
    x, y = line.gu * foot, line.gv * foot
    dx, dy = line.gv, -line.gu
    low, high = mi.Float(-4.0 * NOWHERE), mi.Float(4.0 * NOWHERE)
    left, right, bottom, top = box
    others = [(other.h + other.gu * x + other.gv * y, other.gu * dx + other.gv * dy) for other in lines]
    del others[k]
    others += [(x - left, dx), (right - x, -dx), (y - bottom, dy), (top - y, -dy)]
    for height, rate in others:
        end = -height * dr.rcp(_nonzero(rate))
        lower = rate >= 0.0
        low = dr.select(lower, dr.maximum(low, end), low)
        high = dr.select(lower, high, dr.minimum(high, end))
    there = high > low
    low, high = dr.select(there, low, 0.0), dr.select(there, high, 0.0)
    x, y = dr.select(there, x, 0.0), dr.select(there, y, 0.0)
    return x + low * dx, y + low * dy, x + high * dx, y + high * dy


def _rim(
    sides: Sequence[tuple[mi.Float, mi.Float, mi.Float, mi.Float]],
    box: tuple[mi.Float, mi.Float, mi.Float, mi.Float],
) -> tuple[mi.Float, mi.Float]:
    """Corner of the facet within a part, else the middle of its sides, else the ray: where its return stands."""
    left, right, bottom, top = (x + shrink for x, shrink in zip(box, (1e-3, -1e-3, 1e-3, -1e-3), strict=True))
    corner, side = [mi.Float(0.0)] * 3, [mi.Float(0.0)] * 3
    for ax, ay, bx, by in sides:
        length = dr.sqrt(dr.square(bx - ax) + dr.square(by - ay))
        side = [a + length * b for a, b in zip(side, (0.5 * (ax + bx), 0.5 * (ay + by), 1.0), strict=True)]
        for x, y in ((ax, ay), (bx, by)):
            within = (length > 0.0) & (x > left) & (x < right) & (y > bottom) & (y < top)
            one = dr.select(within, 1.0, 0.0)
            corner = [a + one * b for a, b in zip(corner, (x, y, 1.0), strict=True)]
    has = corner[2] > 0.0
    x, y, n = (dr.select(has, a, b) for a, b in zip(corner, side, strict=True))
    n = dr.rcp(dr.select(n > 0.0, n, 1.0))
    return x * n, y * n


def phase_integral(
    q: mi.Vector3f, u: mi.Vector3f, v: mi.Vector3f, piece: Polygon
) -> tuple[mi.Complex2f, tuple[mi.Float, mi.Float]]:
    r"""Integral of ``exp(j q . r)`` over a polygon in tube units, times its weight (1 for a whole tube and q = 0).

    .. math::
        \iint e^{j Q \cdot x} d^2x = \sum_n \frac{Q \times \Delta_n}{j |Q|^2}
        e^{j Q \cdot m_n} \frac{\sin(Q \cdot \Delta_n / 2)}{Q \cdot \Delta_n / 2}

    over the sides :math:`\Delta_n` of middles :math:`m_n` (Gordon, IEEE TAP 23, 1975), referred to its rim, and the
    area and its first moment where the phase hardly changes.
    """
    qu, qv = dr.dot(q, u), dr.dot(q, v)
    squared = qu * qu + qv * qv
    small = squared < 1e-3
    total, twice_area, moment = mi.Complex2f(0.0, 0.0), mi.Float(0.0), mi.Float(0.0)
    phase = dr.sqrt(squared)
    # towards the glint all of the part returns, off it its edge
    at_edge = dr.select(piece.tiles, dr.clip(0.5 * (phase - 1.0), 0.0, 1.0), 1.0)
    rim = (piece.rim[0] * at_edge, piece.rim[1] * at_edge)
    inner = dr.select(piece.tiles, dr.clip(INNER_UP_TO - phase, 0.0, 1.0), 1.0)
    for n, (ax, ay, bx, by) in enumerate(piece.sides):
        ax, ay, bx, by = ax - rim[0], ay - rim[1], bx - rim[0], by - rim[1]
        start, end = qu * ax + qv * ay, qu * bx + qv * by
        half = 0.5 * (end - start)
        s, c = dr.sincos(0.5 * (start + end))
        short = dr.abs(half) < 0.05
        filled = dr.select(
            short, 1.0 - half * half * (1.0 / 6.0), dr.sin(half) * dr.rcp(dr.select(short, 1.0, half))
        )
        turn = (qu * (by - ay) - qv * (bx - ax)) * filled
        total += mi.Complex2f(c, s) * (turn * inner if n < 4 else turn)
        twice = ax * by - bx * ay
        twice_area += twice
        moment += twice * (start + end)
    total = mi.Complex2f(total.imag, -total.real) * dr.rcp(dr.select(small, 1.0, squared))
    area = 0.5 * twice_area
    x = moment * (1.0 / 6.0) * dr.rcp(dr.maximum(area, 1e-9))
    filled = dr.select(small, mi.Complex2f(1.0 - 0.5 * x * x, x) * area, total) * piece.weight
    return filled, rim


__all__ = ["Line", "Polygon", "clipped", "extent_lines", "facet_lines", "phase_integral", "selected"]
