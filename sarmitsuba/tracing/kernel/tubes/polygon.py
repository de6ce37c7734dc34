"""Part of a flat facet that one ray represents, exact up to the facet's corners, and the phase integral over it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import TypeAlias

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.kernel.tubes.tube import NOWHERE, TubeExtent

# phase integral, the two coordinates of its phase centre, and further results of its kind
Results: TypeAlias = "tuple[mi.Complex2f | mi.Float, ...]"
# rows of the lattice to each side that are searched for other rays on the facet
ROWS = 4
# largest extent of a part across its row, tubes, where no ray is nearer
REACH = ROWS + 0.5
# the same along the row, below an edge that crosses rows at an angle of one over twice that
REACH_ALONG = 30.0
# the same up to the rim of a curved surface
REACH_RIM = 1.5
# phase difference of neighbouring rays (rad) beyond which the terms of their common sides are left out. Over a
# bandwidth B about f these terms cancel only to B / 2 f times a fifth of the square of the phase
INNER_UP_TO = 2.0
# phase over a tube (rad) beyond which float32 cannot represent it (and sines of its sums leave -1 ... 1): such tubes
# graze a facet or were spread by curved mirrors, and their return is set to zero
MOST_PHASE = 1e6
# displacement of a part outwards, per length of an edge over its area, tubes: see :func:`part_integral`
END_SHIFT = 1.0 / 24.0
# least area, of a tube, by which a part's first moment is divided: slivers return next to nothing from anywhere
LEAST_PART = 0.02
# least chance of a ray to hit a narrow facet; bounds the weight
LEAST_CHANCE = 1e-3


@dataclass(frozen=True)
class HalfPlane:
    """Half-plane ``h + gu alpha + gv beta >= 0`` of tube units, the larger of ``|gu|, |gv|`` one.

    ``inner``: a cut between convex parts of one facet, not an edge of it.
    """

    h: mi.Float
    gu: mi.Float
    gv: mi.Float
    inner: mi.Bool


@dataclass(frozen=True)
class Side:
    """Properties of a side along an edge of the facet, in addition to its two ends.

    Parameters
    ----------
    along : (alpha, beta) of its direction, the larger one 1
    step_start, step_end : lengths of ``along`` between cuts of the edge, at ends where it continues in a neighbour's
        part; 0 at a corner of the facet
    inner : a cut between convex parts of one facet
    """

    along: tuple[mi.Float, mi.Float]
    step_start: mi.Float
    step_end: mi.Float
    inner: mi.Bool


@dataclass(frozen=True)
class Polygon:
    """Part of a convex facet in tube units: its sides counter-clockwise, and a weight.

    Parameters
    ----------
    sides : (alpha, beta) of start and end of each; absent sides have zero length
    edges : properties of the sides from the fifth on, which lie on edges of the facet
    rim : phase reference where the part is not exact and not in phase, see
        :class:`sarmitsuba.tracing.kernel.tubes.tube.Patch`
    weight : of its area
    exact : the parts of all rays tile the facet; the first four sides are common with parts of other rays
    """

    sides: tuple[tuple[mi.Float, mi.Float, mi.Float, mi.Float], ...]
    edges: tuple[Side, ...]
    rim: tuple[mi.Float, mi.Float]
    weight: mi.Float
    exact: mi.Bool

    def area(self) -> mi.Float:
        """Area relative to a whole tube, times the weight."""
        twice = sum((ax * by - bx * ay for ax, ay, bx, by in self.sides[1:]), self._first())
        return 0.5 * twice * self.weight

    def _first(self) -> mi.Float:
        ax, ay, bx, by = self.sides[0]
        return ax * by - bx * ay


def facet_lines(
    edges: Sequence[mi.Vector4f], inner: Sequence[mi.Bool], point: mi.Vector3f, u: mi.Vector3f, v: mi.Vector3f
) -> list[HalfPlane]:
    """Boundary edges of the facet in units of the tube that hit it.

    See :func:`sarmitsuba.tracing.kernel.tubes.tube.limit_extent`.
    """
    lines = []
    for edge, within in zip(edges, inner, strict=True):
        m = type(point)(edge[0], edge[1], edge[2])
        height = dr.maximum(dr.dot(m, point) - edge[3], 0.0)
        lines.append(_line(height, dr.dot(m, u), dr.dot(m, v), within))
    return lines


def extent_lines(extent: TubeExtent) -> list[HalfPlane]:
    """Four half-planes that limit a tube by the facets hit so far."""
    e = extent
    one = mi.Float(1.0)
    return [
        HalfPlane(e.right, -one, e.right_slope, mi.Bool(False)),
        HalfPlane(e.left, one, e.left_slope, mi.Bool(False)),
        HalfPlane(e.top, e.top_slope, -one, mi.Bool(False)),
        HalfPlane(e.bottom, e.bottom_slope, one, mi.Bool(False)),
    ]


def _line(h: mi.Float, gu: mi.Float, gv: mi.Float, inner: mi.Bool) -> HalfPlane:
    largest = dr.maximum(dr.abs(gu), dr.abs(gv))
    used = largest * NOWHERE > h
    scale = dr.rcp(dr.select(used, largest, 1.0))
    return HalfPlane(
        dr.select(used, h * scale, NOWHERE),
        dr.select(used, gu * scale, 1.0),
        dr.select(used, gv * scale, 0.0),
        inner,
    )


def select_lines(condition: mi.Bool, a: Sequence[HalfPlane], b: Sequence[HalfPlane]) -> list[HalfPlane]:
    """Lines ``a`` in the lanes where the condition holds, else ``b``."""
    return [
        HalfPlane(*(dr.select(condition, getattr(x, k), getattr(y, k)) for k in ("h", "gu", "gv", "inner")))
        for x, y in zip(a, b, strict=True)
    ]


@dataclass(frozen=True)
class Bounds:
    """Bounds of the part of a facet that one ray represents.

    Parameters
    ----------
    lines : half-planes whose intersection is the facet
    extent : of the tube, limited by the facets hit so far
    rim : phase reference where the part is not exact and not in phase
    exact : the lines bound a convex part of a flat facet on all sides
    """

    lines: Sequence[HalfPlane]
    extent: TubeExtent
    rim: tuple[mi.Float, mi.Float]
    exact: mi.Bool

    def apart(self) -> mi.Bool:
        """Whether no line cuts the ray's cell or the eight around it: :meth:`part` then is the cell."""
        out = mi.Bool(True)
        for line in self.lines:
            # tol: rounding of the same heights in :meth:`part`
            out &= line.h > 1.001 * (dr.abs(line.gu) + dr.abs(line.gv))
        return out

    def is_bounded(self) -> mi.Bool:
        """Whether there are at least three lines, so that the facet has corners."""
        near = sum((dr.select(line.h < NOWHERE, 1.0, 0.0) for line in self.lines), mi.Float(0.0))
        return self.exact | (near > 2.5)  # lines of a large facet may lie too far away to count

    def cancels(
        self, q: mi.Vector3f, u: mi.Vector3f, v: mi.Vector3f, kept_up_to: mi.Float | None = None
    ) -> mi.Bool:
        """Whether :func:`phase_integral` is zero, as all sides of the part are common ones and left out."""
        phase = dr.sqrt(dr.square(dr.dot(q, u)) + dr.square(dr.dot(q, v)))
        return self.exact & (_weigh_terms(phase, kept_up_to) == 0.0) & self.apart()

    def cell(self) -> Polygon:
        """The ray's cell."""
        low, high = mi.Float(-0.5), mi.Float(0.5)
        sides = (
            (low, low, high, low),
            (high, high, low, high),
            (high, low, high, high),
            (low, high, low, low),
        )
        return Polygon(sides, (), self.rim, mi.Float(1.0), self.exact)

    def part(self) -> Polygon:
        """The ray's part; see :func:`clip_facet`."""
        return clip_facet(self.lines, self.extent, self.rim, self.exact, self.is_bounded())

    def area(self) -> mi.Float:
        """Area of the part relative to a whole tube, times its weight."""
        area: mi.Float = dr.if_stmt(
            (),
            self.apart(),
            lambda: self.cell().area(),
            lambda: self.part().area(),
            label="edges",
            mode="symbolic",
        )
        return area


def clip_facet(
    lines: Sequence[HalfPlane],
    extent: TubeExtent,
    rim: tuple[mi.Float, mi.Float],
    exact: mi.Bool,
    bounded: mi.Bool,
) -> Polygon:
    """Part of the facet within ``lines`` that a ray represents.

    The facet is divided among the rays row by row of their lattice: each ray has its own cell, the outermost of a row
    also the rest of the row, and a row also includes a neighbouring row without rays. The parts tile a convex facet
    without gap or overlap, up to its corners. A facet narrower than the lattice everywhere is hit by chance: the rays
    represent the facet's part of their row or column, with a weight of one over the chance. An area bounded by fewer
    than three lines (the edge of a curved surface) has no corners: there a ray has its own cell, and the area beyond
    it up to an edge that is nearer than the next ray.
    """
    rows = [_Axis.of(line.h, line.gu, line.gv) for line in lines]
    columns = [_Axis.of(line.h, line.gv, line.gu) for line in lines]
    across = {j: _interval(rows, float(j)) for j in range(-ROWS, ROWS + 1)}
    wide = _wide(rows) & _wide(columns)
    low, high = across[0]
    bottom_end, top_end = _interval(columns, 0.0)
    left = dr.select(low <= -1.0, -0.5, -REACH_ALONG)
    right = dr.select(high >= 1.0, 0.5, REACH_ALONG)
    # an empty row belongs to the next row below that has rays, else to the next above
    top, bottom = mi.Float(REACH), mi.Float(-REACH)
    for j in range(ROWS, 0, -1):
        top = dr.select(_holds_ray(across[j]), j - 0.5, top)
        bottom = dr.select(_holds_ray(across[-j]), -0.5, bottom)
    # narrow: the part of the row or of the column, whichever the facet crosses over the shorter distance
    by_row = high - low < top_end - bottom_end
    left = dr.select(wide, left, dr.select(by_row, -REACH, -0.5))
    right = dr.select(wide, right, dr.select(by_row, REACH, 0.5))
    top = dr.select(wide, top, dr.select(by_row, 0.5, REACH))
    bottom = dr.select(wide, bottom, dr.select(by_row, -0.5, -REACH))
    chance = dr.clip(dr.select(by_row, high - low, top_end - bottom_end), LEAST_CHANCE, 1.0)
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
    cut = [_side(k, lines, (left, right, bottom, top)) for k in range(len(lines))]
    weight = dr.rcp(dr.select(wide | ~bounded, 1.0, chance))
    return Polygon((*sides, *(ends for ends, _ in cut)), tuple(side for _, side in cut), rim, weight, exact)


@dataclass(frozen=True)
class _Axis:
    """Crossing of a line with the rows, at ``at + slope row``, as a lower or an upper end."""

    at: mi.Float
    slope: mi.Float
    lower: mi.Bool

    @staticmethod
    def of(h: mi.Float, along: mi.Float, other: mi.Float) -> _Axis:
        inverse = -dr.rcp(_nonzero(along))
        return _Axis(h * inverse, other * inverse, along >= 0.0)


def _nonzero(x: mi.Float) -> mi.Float:
    """Value ``x`` bounded away from zero, with its sign."""
    return dr.select(dr.abs(x) > 1e-6, x, dr.select(x >= 0.0, 1e-6, -1e-6))


def _interval(axes: Sequence[_Axis], row: float | mi.Float) -> tuple[mi.Float, mi.Float]:
    """Interval of a row within all lines; the second end is below the first where it is empty."""
    low, high = mi.Float(-NOWHERE), mi.Float(NOWHERE)
    for a in axes:
        x = a.at + a.slope * row
        low = dr.select(a.lower, dr.maximum(low, x), low)
        high = dr.select(a.lower, high, dr.minimum(high, x))
    return low, high


def _holds_ray(interval: tuple[mi.Float, mi.Float]) -> mi.Bool:
    """Whether one of a row's rays, at integer positions, lies within an interval."""
    return dr.floor(interval[1]) >= dr.ceil(interval[0])


def _wide(axes: Sequence[_Axis]) -> mi.Bool:
    """Whether the facet is somewhere wider than the ray spacing along a row, so that a row certainly has a ray."""
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
    """Intersection of ``start ... end`` with an interval; of zero length where it is empty."""
    a, b = dr.maximum(start, interval[0]), dr.minimum(end, interval[1])
    there = b > a
    return dr.select(there, a, start), dr.select(there, b, start)


def _side(
    k: int, lines: Sequence[HalfPlane], box: tuple[mi.Float, mi.Float, mi.Float, mi.Float]
) -> tuple[tuple[mi.Float, mi.Float, mi.Float, mi.Float], Side]:
    """Segment of line ``k`` within the other lines and the box, with the facet to its left."""
    line = lines[k]
    foot = -line.h * dr.rcp(dr.square(line.gu) + dr.square(line.gv))
    x, y = line.gu * foot, line.gv * foot
    dx, dy = line.gv, -line.gu
    low, high = mi.Float(-4.0 * NOWHERE), mi.Float(4.0 * NOWHERE)
    left, right, bottom, top = box
    none = mi.Float(0.0)
    others = [(o.h + o.gu * x + o.gv * y, o.gu * dx + o.gv * dy, none) for o in lines]
    del others[k]
    # from column to column, and from row to row
    column, row = (dr.rcp(dr.maximum(dr.abs(d), 1.0 / REACH_ALONG)) for d in (dx, dy))
    others += [(x - left, dx, column), (right - x, -dx, column), (y - bottom, dy, row), (top - y, -dy, row)]
    step_low, step_high = none, none
    for height, rate, step in others:
        end = -height * dr.rcp(_nonzero(rate))
        lower = rate >= 0.0
        ends = lower & (end > low)
        low, step_low = dr.select(ends, end, low), dr.select(ends, step, step_low)
        ends = ~lower & (end < high)
        high, step_high = dr.select(ends, end, high), dr.select(ends, step, step_high)
    there = high > low
    low, high = dr.select(there, low, 0.0), dr.select(there, high, 0.0)
    step_low, step_high = dr.select(there, step_low, 0.0), dr.select(there, step_high, 0.0)
    x, y = dr.select(there, x, 0.0), dr.select(there, y, 0.0)
    ends = (x + low * dx, y + low * dy, x + high * dx, y + high * dy)
    return ends, Side((dx, dy), step_low, step_high, line.inner)


def phase_integral(
    q: mi.Vector3f,
    u: mi.Vector3f,
    v: mi.Vector3f,
    bounds: Bounds,
    longest: mi.Float,
    kept_up_to: mi.Float | None = None,
    of_part: Callable[..., Results] | None = None,
) -> Results:
    """Phase integral (:func:`part_integral`) over the part of a facet that one ray represents, and its phase centre.

    Most rays on a large facet are far from its edges and have the four sides of their cell. Neighbouring rays are
    launched together, so whole packets of lanes skip the computation that only edges need. ``of_part``: function like
    :func:`part_integral`, which it is by default, with further results.
    """
    compute = of_part or part_integral

    def inside() -> Results:
        return compute(q, u, v, bounds.cell(), longest, kept_up_to)

    def at_edge() -> Results:
        return compute(q, u, v, bounds.part(), longest, kept_up_to)

    result: Results = dr.if_stmt((), bounds.apart(), inside, at_edge, label="edges", mode="symbolic")
    return result


def _weigh_terms(phase: mi.Float, kept_up_to: mi.Float | None) -> mi.Float:
    """Weight of the terms of common sides, by the phase difference of neighbouring rays, see `part_integral`."""
    if kept_up_to is not None:
        phase = phase * (INNER_UP_TO * dr.rcp(kept_up_to))
    return dr.clip(INNER_UP_TO - phase, 0.0, 1.0)


def part_integral(
    q: mi.Vector3f,
    u: mi.Vector3f,
    v: mi.Vector3f,
    piece: Polygon,
    longest: mi.Float,
    kept_up_to: mi.Float | None = None,
) -> tuple[mi.Complex2f, mi.Float, mi.Float]:
    r"""Phase integral of ``exp(j q . r)`` over a polygon in tube units, times its weight (1 for a whole tube at q = 0).

    .. math::
        \iint e^{j Q \cdot x} d^2x = \sum_n \frac{Q \times \Delta_n}{j |Q|^2}
        e^{j Q \cdot m_n} \frac{\sin(Q \cdot \Delta_n / 2)}{Q \cdot \Delta_n / 2}

    over the sides :math:`\Delta_n` with midpoints :math:`m_n` (Gordon, IEEE TAP 23, 1975); the area and its first
    moment where the phase hardly changes. It is referred to the mean position of the terms, weighted by their modulus,
    and has the range of that position over the whole bandwidth.

    Neighbours on a facet have a common side and, where an edge of the facet is cut between them, a common end. Their
    terms cancel at the carrier, but less away from it if the phase changes fast from ray to ray. In that case the
    common side is left out, and of a side along an edge

    .. math:: \frac{Q \times \Delta}{j |Q|^2} \frac{e^{j Q \cdot b} - e^{j Q \cdot a}}{j Q \cdot \Delta}

    the term of the common end: the remaining terms belong to the corners of the facet.

    A part that is not exact (behind a mirror, on a curved surface) whose phase changes by less than 1 rad returns as a
    whole. Its phase centre then is its centroid, moved outwards by (edges :math:`\ell_n` with outer normals
    :math:`\nu_n`, area A, in tubes)

    .. math:: \frac{1}{24 A} \sum_n \ell_n \nu_n

    A sum of any smooth f over parts is a midpoint rule: the moments :math:`\tfrac1{24} \nabla^2 f` of the cells within
    the facet, left out by it, are a flux through the facet's edges, :math:`\tfrac1{24} \oint \partial_\nu f`, which
    these displacements add. Beyond 2 rad the part returns from its rim.

    Parameters
    ----------
    q : rad/m
    u, v : edges of the tube's footprint, m
    piece : part of the facet
    longest : m, upper bound of the ray spacing of all lattices: convex parts of one facet may be sampled by different
        lattices, and must agree on when the cut between them is left out
    kept_up_to : phase difference of neighbouring rays up to which common sides are kept, rad; None: ``INNER_UP_TO``
    """
    qu, qv = dr.dot(q, u), dr.dot(q, v)
    squared = qu * qu + qv * qv
    small = squared < 1e-3
    told = squared < MOST_PHASE**2
    qu, qv = dr.select(told, qu, 0.0), dr.select(told, qv, 0.0)

    def kept(phase: mi.Float) -> mi.Float:
        return dr.select(piece.exact, dr.detach(_weigh_terms(phase, kept_up_to)), 1.0)

    inner = kept(dr.sqrt(squared))
    normal = dr.cross(u, v)
    flat = dr.norm(dr.cross(q, normal)) * dr.rcp(dr.maximum(dr.norm(normal), 1e-30))  # q along the facet
    uncut = kept(flat * longest)
    total, twice_area = mi.Complex2f(0.0, 0.0), mi.Float(0.0)
    moment_u, moment_v, outwards_u, outwards_v = (mi.Float(0.0) for _ in range(4))
    place_u, place_v, sum_of_moduli = mi.Float(0.0), mi.Float(0.0), mi.Float(1e-20)
    for n, (ax, ay, bx, by) in enumerate(piece.sides):
        start, end = qu * ax + qv * ay, qu * bx + qv * by
        twice = ax * by - bx * ay
        twice_area += twice
        moment_u += twice * (ax + bx)
        moment_v += twice * (ay + by)
        if n >= 4:
            outwards_u += by - ay
            outwards_v += ax - bx
        half = 0.5 * (end - start)
        short = dr.abs(half) < 0.05
        filled = dr.select(
            short, 1.0 - half * half * (1.0 / 6.0), dr.sin(half) * dr.rcp(dr.select(short, 1.0, half))
        )
        turn = (qu * (by - ay) - qv * (bx - ax)) * filled
        terms = []
        if n < 4:
            turn *= inner
        else:
            edge = piece.edges[n - 4]
            dx, dy = edge.along
            rate = qu * dx + qv * dy
            weight_a, weight_b = (kept(dr.abs(rate) * step) for step in (edge.step_start, edge.step_end))
            both = dr.select(edge.inner, uncut, 1.0)
            turn *= dr.minimum(weight_a, weight_b) * both
            # the end that is a corner, or nearer to one: a separate term, with a phase lag of 90 degrees
            unequal = weight_b - weight_a
            at_end = unequal > 0.0
            alone = unequal * both * (qu * dy - qv * dx) * dr.rcp(dr.select(unequal == 0.0, 1.0, rate))
            s, c = dr.sincos(dr.select(at_end, end, start))
            total += mi.Complex2f(s, -c) * alone
            terms.append((dr.abs(alone), dr.select(at_end, bx, ax), dr.select(at_end, by, ay)))
        s, c = dr.sincos(0.5 * (start + end))
        total += mi.Complex2f(c, s) * turn
        terms.append((dr.abs(turn), 0.5 * (ax + bx), 0.5 * (ay + by)))
        for modulus, x, y in terms:
            place_u, place_v = place_u + modulus * x, place_v + modulus * y
            sum_of_moduli += modulus
    total = mi.Complex2f(total.imag, -total.real) * dr.rcp(dr.select(small, 1.0, squared))
    area = 0.5 * twice_area
    x = (qu * moment_u + qv * moment_v) * (1.0 / 6.0) * dr.rcp(dr.maximum(area, 1e-9))
    filled = dr.select(small, mi.Complex2f(1.0 - 0.5 * x * x, x) * area, total) * piece.weight
    filled = dr.select(told, filled, 0.0)
    scale = dr.rcp(sum_of_moduli)
    in_phase, per_area = _weigh_terms(dr.sqrt(squared), None), dr.rcp(dr.maximum(area, LEAST_PART))
    place = tuple(
        dr.select(
            piece.exact, mean * scale, dr.lerp(rim, per_area * (moment / 6.0 + END_SHIFT * step), in_phase)
        )
        for mean, rim, moment, step in zip(
            (place_u, place_v), piece.rim, (moment_u, moment_v), (outwards_u, outwards_v), strict=True
        )
    )
    s, c = dr.sincos(-(qu * place[0] + qv * place[1]))
    return filled * mi.Complex2f(c, s), place[0], place[1]
