"""Sides of triangles that lie on one another without sharing both ends: T-junctions, and meshes with gaps."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from sarmitsuba.core.arrays import F64, I64

# widest gap between two sides on one line as shares of the shorter one, in turn: what meets closely is joined first
SHARES = (0.0, 1e-4, 1e-3, 2e-2, 2e-2)
# gaps as wide as this many of the widest so far are bridged too, up to this share of the shorter side
AS_WIDE, SHORTEST_SHARE = 2.0, 0.25
# sides and parts of sides shorter than this many of the widest gap are dropped
LEFT = 8.0
# rounding of a coordinate in a float32 file, with a margin for the difference of two points
ROUNDING = 8.0 * 2.0**-24
# length of the parts of a side in which ends of others are searched, in median lengths of all sides, and most parts
PART, MOST_PARTS = 4.0, 64.0


@dataclass(frozen=True, eq=False)
class JoinedSides:
    """Parts of sides on which no other side or a single one lies.

    Parameters
    ----------
    side : (n,) number of the side of every part
    partner : (n,) number of the side that lies on it, -1 for none; every pair of sides stands once
    low, high : (n,) ends of the part, as shares of the side's length
    gap : (n,) m, between the two sides; -1 for none
    """

    side: I64
    partner: I64
    low: F64
    high: F64
    gap: F64


def join_sides(start: F64, step: F64, owner: I64, widest: float = np.inf) -> JoinedSides:
    """Find the sides that lie on one another, as far as they overlap.

    Two sides lie on one another where their distance at both ends of the overlap is at most the rounding of float32
    plus one of ``SHARES`` of the shorter, or about the widest gap that has been found so, up to ``widest``. Parts on
    which two or more others lie are left out.

    Parameters
    ----------
    start, step : (n, 3) float64, m, of the sides: first end, and from there to the second
    owner : (n,) triangle of each side; sides of one triangle do not join
    widest : m, bound on the gap

    Notes
    -----
    Ignores facets narrower than the gaps about them: several of their sides then lie on one.
    """
    rounding = ROUNDING * float(np.abs(start).max(initial=0.0))
    side, low, high = np.arange(len(start)), np.zeros(len(start)), np.ones(len(start))
    pairs, known = [np.zeros((0, 5))], 0.0
    for share in SHARES:
        if side.size < 2:
            break
        size = (high - low)[:, None]
        first, over = start[side] + low[:, None] * step[side], size * step[side]
        length = np.linalg.norm(over, axis=1)
        allowed = np.maximum(share * length, np.minimum(AS_WIDE * known, SHORTEST_SHARE * length))
        found = _stage(first, over, owner[side], rounding + np.minimum(allowed, widest))
        known = max(known, float(found[:, 4].max(initial=0.0)))
        of = found[:, 0].astype(np.int64)
        here = np.column_stack([low[of] + found[:, i] * size[of, 0] for i in (2, 3)])
        paired = found[:, 1] >= 0
        partner = side[found[paired, 1].astype(np.int64)]
        pairs.append(np.column_stack([side[of[paired]], partner, here[paired], found[paired, 4]]))
        side, (low, high) = side[of[~paired]], here[~paired].T
    none = np.full(side.size, -1)
    rest = np.column_stack([side, none, low, high, none])
    table = np.concatenate([rest[np.argsort(side, kind="stable")], *pairs])
    # what is left between the ends of sides that meet over a gap is none
    length = np.linalg.norm(step, axis=1)[table[:, 0].astype(np.int64)]
    table = table[(table[:, 3] - table[:, 2]) * length > LEFT * known]
    return JoinedSides(table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), *table[:, 2:].T)


def _stage(start: F64, step: F64, owner: I64, reach: F64) -> F64:
    """Rows (side, partner or -1, low, high, gap or -1) of all parts; ``reach``: of all sides, widest gap, m."""
    n, length = len(start), np.linalg.norm(step, axis=1)
    a, b = _near(start, step, length, reach)
    apart = owner[a] != owner[b]
    a, b = a[apart], b[apart]
    # each pair in both orders
    both = np.sort(np.concatenate([a * n + b, b * n + a]))
    both = both[np.diff(both, prepend=-1) > 0]
    a, b = both // n, both % n

    bound = np.minimum(reach[a], reach[b])
    unit = step[a] / length[a, None]
    first = np.einsum("pi,pi->p", start[b] - start[a], unit)
    run = np.einsum("pi,pi->p", step[b], unit)
    low, high = np.clip(np.sort([first, first + run], axis=0), 0.0, length[a])
    gap, parallel = np.zeros(a.size), np.abs(run) > 0.5 * length[b]
    for t in (low, high):  # distance of both sides at the ends of the overlap
        along = ((t - first) / np.where(parallel, run, 1.0))[:, None]
        away = start[a] + t[:, None] * unit - start[b] - along * step[b]
        gap = np.maximum(gap, np.linalg.norm(away, axis=1))
    on = parallel & (gap <= bound) & (high - low > 2.0 * bound)
    a, b, low, high, bound, gap = a[on], b[on], low[on], high[on], bound[on], gap[on]
    # ends within the gap of the side's own ends are these
    low = np.where(low <= 2.0 * bound, 0.0, low / length[a])
    high = np.where(high >= length[a] - 2.0 * bound, 1.0, high / length[a])
    free = np.setdiff1d(np.arange(n), a)
    none = np.full(free.size, -1)
    alone = np.column_stack([free, none, np.zeros(free.size), np.ones(free.size), none])
    return np.concatenate([alone, _parts(a, b, low, high, gap, 2.0 * reach / length)])


def _near(start: F64, step: F64, length: F64, reach: F64) -> tuple[I64, I64]:
    """Pairs of sides: those that have an end of another within a ball over one of their parts, and the other."""
    ends = np.stack([start, start + step], axis=1).reshape(-1, 3)
    tree = scipy.spatial.cKDTree(ends)
    longest = PART * float(np.median(length))
    count = np.clip(np.ceil(length / longest), 1.0, MOST_PARTS).astype(np.int64)
    side = np.repeat(np.arange(len(start)), count)
    number = np.arange(side.size) - np.repeat(np.cumsum(count) - count, count)
    middle = start[side] + ((number + 0.5) / count[side])[:, None] * step[side]
    found = tree.query_ball_point(middle, 0.5 * length[side] / count[side] + 1.01 * reach[side])
    sizes = np.fromiter((len(each) for each in found), dtype=np.int64, count=side.size)
    a, end = np.repeat(side, sizes), np.concatenate([*found, []]).astype(np.int64)
    # ends near the side's line alone
    away = ends[end] - start[a]
    along = np.einsum("pi,pi->p", away, step[a]) / np.square(length[a])
    off = np.linalg.norm(away - along[:, None] * step[a], axis=1)
    kept = (off <= 1.01 * reach[a]) & (end // 2 != a)
    return a[kept], end[kept] // 2


def _parts(a: I64, b: I64, low: F64, high: F64, gap: F64, least: F64) -> F64:
    """Rows (side, partner or -1, low, high, gap or -1): parts of the sides ``a`` between the ends of sides on them.

    Parameters
    ----------
    a, b : (n,) sides and the sides on them from ``low`` to ``high``, across a ``gap``, sorted by a
    least : of all sides, share of the length below which a part is none
    """
    begin = np.flatnonzero(np.diff(a, prepend=-1))
    count = np.diff(begin, append=a.size)
    whole = (count == 1) & (low[begin] == 0.0) & (high[begin] == 1.0)
    simple = begin[whole]
    rows: list[tuple[float, ...]] = []
    for i, m in zip(begin[~whole].tolist(), count[~whole].tolist(), strict=True):
        here = slice(i, i + m)
        cuts = np.unique(np.concatenate([low[here], high[here], [0.0, 1.0]]))
        cuts = cuts[np.append(True, np.diff(cuts) > least[a[i]])]
        cuts[-1] = 1.0
        for one, other in pairwise(cuts.tolist()):
            middle = 0.5 * (one + other)
            over = np.flatnonzero((low[here] < middle) & (high[here] > middle))
            if over.size == 0:
                rows.append((a[i], -1.0, one, other, -1.0))
            elif over.size == 1:
                rows.append((a[i], b[i + over[0]], one, other, gap[i + over[0]]))
    table = np.concatenate(
        [
            np.column_stack([a[simple], b[simple], np.zeros(simple.size), np.ones(simple.size), gap[simple]]),
            np.array(rows, dtype=np.float64).reshape(-1, 5),
        ]
    )
    return np.asarray(table[(table[:, 1] < 0) | (table[:, 0] < table[:, 1])])
