"""Flat metal facets at right angles that face each other, and the ray spacing that their double bounces need."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64, unit_rows

# rad; facets farther from a right angle return little by double bounces
ABOUT_RIGHT = np.radians(10.0)
# wavelengths, largest and least ray spacing, and least width of a chain. A tube of a double bounce is as wide as its
# spacing where the chain ends, not cut there as at an edge: above the first, the returns of corners off broadside
# are those of these stairs (benchmarks/studies/metal_corners.py); what is narrower than the last returns little
WIDEST_TUBE, FINEST_TUBE, NARROWEST = 1.5, 0.25, 0.5
# rays across a chain: with fewer, two lattices err alike
ACROSS_CHAIN = 4.0
# rays for the double bounces of a scene, halvings make them up to four times more: so many serve all of its corners,
# or half as many a part of them
MOST_RAYS = 32_000
# coarser spacings that are tried where the rays do not suffice, as factors
FACTORS = (1.0, 2.0, 4.0)
# most facets examined, the largest ones
MOST_FACETS = 1000
# least cosine of incidence, from any of the antenna's positions, of facets that are lit
LEAST_LIT = -0.1
# corners of a facet above which only the outermost ones in so many directions count
MOST_POINTS, OUTERMOST = 12, 16
# pairs of facets examined at a time; bounds the memory
PAIRS = 20_000


def corner_needs(
    corners: F64,
    part: I64,
    flat_metal: NDArray[np.bool_],
    closed: NDArray[np.bool_],
    wavelength: float,
    antennas: F64 | None = None,
) -> tuple[F64, F64]:
    r"""Ray spacings for double bounces between metal facets at right angles, m: (n,) that is planned, (n,) needed.

    A facet needs four rays across its widest chain, with spacings of 0.25 to 1.5 wavelengths. The width of a chain is
    the least of the common length along the line of intersection and of both facets' extents across it, in front of
    the other facet. Where ``MOST_RAYS`` do not suffice for all, half of them serve facets that need the fewest rays,
    then others with spacings twice and four times as wide. Infinite for facets without a chain of half a wavelength.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    part : (n,) flat facet of each triangle, of :func:`sarmitsuba.scene.mesh.boundary_edges.facets`
    flat_metal : (n,) triangles of flat metal
    closed : (n,) triangles whose edges all belong to two triangles: their back is inside a body
    wavelength : m
    antennas : (m, 3) float64, m, positions along the aperture; facets of bodies that are turned away from all of them
        need nothing. None: any position

    Notes
    -----
    Ignores shadows, motion (facets are as at time zero), facets beyond the ``MOST_FACETS`` largest ones, curved
    surfaces, and surfaces that are not metal.
    """
    planned, needed = np.full(len(corners), np.inf), np.full(len(corners), np.inf)
    rows = np.flatnonzero(flat_metal)
    if rows.size < 2:
        return planned, needed
    rows = rows[np.argsort(part[rows], kind="stable")]
    points = corners[rows]
    a, b = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    cross = np.stack([a[:, i - 2] * b[:, i - 1] - a[:, i - 1] * b[:, i - 2] for i in range(3)], axis=1)
    twice = np.sqrt(np.einsum("ti,ti->t", cross, cross))
    first = np.flatnonzero(np.diff(part[rows], prepend=part[rows[0]] - 1))
    facets = _MetalFacets.of(
        points, cross / np.maximum(twice, 1e-300)[:, None], 0.5 * twice, closed[rows], first
    )
    shown = facets.shown(antennas)
    # a narrow facet has narrow chains
    kept = (2.0 * facets.area >= NARROWEST * wavelength * facets.size) & (shown > 0.0)
    if kept.sum() > MOST_FACETS:
        kept &= facets.area >= np.partition(facets.area[kept], -MOST_FACETS)[-MOST_FACETS]
    width = np.zeros(len(first))
    chosen = np.flatnonzero(kept)
    one, two = facets.facing(chosen)
    for start in range(0, one.size, PAIRS):
        of = slice(start, start + PAIRS)
        found = facets.chain_width(one[of], two[of])
        np.maximum.at(width, one[of], found)
        np.maximum.at(width, two[of], found)
    need = np.clip(width / ACROSS_CHAIN, FINEST_TUBE * wavelength, WIDEST_TUBE * wavelength)
    need[width < NARROWEST * wavelength] = np.inf
    if np.isinf(need).all():
        return planned, needed
    number = np.repeat(np.arange(len(first)), np.diff(first, append=len(rows)))
    needed[rows], planned[rows] = need[number], _limit_needs(need, shown)[number]
    return planned, needed


def _limit_needs(need: F64, area: F64) -> F64:
    """Needs of facets (n,), m, that ``MOST_RAYS`` allow for their projected areas, m^2; infinite for others."""
    granted = np.full(need.size, np.inf)
    all_rays = float((area / np.square(need)).sum())
    left = float(MOST_RAYS) if all_rays <= MOST_RAYS else 0.5 * MOST_RAYS
    for factor in FACTORS:
        rays = area / np.square(factor * need)
        open_ = np.flatnonzero(np.isinf(granted) & np.isfinite(need))
        if not open_.size:
            break
        open_ = open_[np.argsort(rays[open_], kind="stable")]
        served = open_[np.cumsum(rays[open_]) <= left]
        granted[served] = factor * need[served]
        left -= float(rays[served].sum())
    return granted


class _MetalFacets:
    """Flat facets, one row each.

    Attributes
    ----------
    area : m^2
    size : m, diagonal of the bounding box
    """

    def __init__(self, area: F64, normal: F64, sheet: NDArray[np.bool_], low: F64, high: F64) -> None:
        self.area, self.normal, self.sheet, self.low, self.high = area, normal, sheet, low, high
        extent = high - low
        self.size: F64 = np.sqrt(np.einsum("fi,fi->f", extent, extent))
        self.points: F64 = np.zeros((0, 3))
        self.start = self.count = np.zeros(0, dtype=np.intp)

    @staticmethod
    def of(
        corners: F64, normal: F64, area: F64, closed: NDArray[np.bool_], first: NDArray[np.intp]
    ) -> "_MetalFacets":
        """Facets of triangles, those of one facet in turn from ``first`` on."""
        low, high = (
            np.minimum.reduceat(corners.min(axis=1), first),
            np.maximum.reduceat(corners.max(axis=1), first),
        )
        sheet = ~np.logical_and.reduceat(closed, first)
        count = np.diff(first, append=len(corners))
        facets = _MetalFacets(np.add.reduceat(area, first), normal[first], sheet, low, high)
        facets.points, facets.start, facets.count = _outermost(corners, normal[first], first, count)
        return facets

    def shown(self, antennas: F64 | None) -> F64:
        """Largest projected area of each facet from any antenna, m^2; 0 where all see its back, or its plane."""
        if antennas is None:
            return 0.5 * self.area
        away = antennas - 0.5 * (self.low.min(axis=0) + self.high.max(axis=0))
        away = unit_rows(away)
        cosine = self.normal @ away.T
        best = np.where(self.sheet, np.abs(cosine).max(axis=1), cosine.max(axis=1))
        return np.where(best > LEAST_LIT, np.maximum(best, -LEAST_LIT), 0.0) * self.area

    def facing(self, chosen: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Pairs of the chosen facets at right angles, no farther apart than the size of the smaller one."""
        if chosen.size < 2:
            return chosen[:0], chosen[:0]
        order = chosen[np.argsort(self.low[chosen, 0], kind="stable")]
        start = self.low[order, 0]
        # no farther than the size of the first one along x
        last = np.searchsorted(start, self.high[order, 0] + self.size[order], "right")
        count = last - np.arange(1, order.size + 1)
        one = np.repeat(np.arange(order.size), count)
        two = np.arange(one.size) - np.repeat(np.cumsum(count) - count, count) + one + 1
        one, two = order[one], order[two]
        for axis in (1, 2):
            near = np.minimum(self.size[one], self.size[two])
            apart = np.maximum(
                self.low[two, axis] - self.high[one, axis], self.low[one, axis] - self.high[two, axis]
            )
            kept = apart <= near
            one, two = one[kept], two[kept]
        right = np.abs(np.einsum("pi,pi->p", self.normal[one], self.normal[two])) < np.sin(ABOUT_RIGHT)
        one, two = one[right], two[right]
        gap = np.maximum(np.maximum(self.low[two] - self.high[one], self.low[one] - self.high[two]), 0.0)
        kept = np.einsum("pi,pi->p", gap, gap) <= np.square(np.minimum(self.size[one], self.size[two]))
        return one[kept], two[kept]

    def chain_width(self, one: NDArray[np.intp], two: NDArray[np.intp]) -> F64:
        """Width, m, of the chains between pairs of facets; 0 where they do not face each other."""
        m, n = self.normal[one], self.normal[two]
        along = np.stack([m[:, i - 2] * n[:, i - 1] - m[:, i - 1] * n[:, i - 2] for i in range(3)], axis=1)
        along /= np.sqrt(np.einsum("pi,pi->p", along, along))[:, None]
        heights, theirs = self._extents(two, m, along)
        widths, ours = self._extents(one, n, along)
        above, beyond = (
            np.einsum("pi,pi->p", self.points[self.start[k]], v) for k, v in ((one, m), (two, n))
        )
        across = (
            _lies_in_front(heights[0] - above, heights[1] - above, self.sheet[one]),
            _lies_in_front(widths[0] - beyond, widths[1] - beyond, self.sheet[two]),
        )
        common = np.minimum(theirs[1], ours[1]) - np.maximum(theirs[0], ours[0])
        return np.asarray(np.maximum(np.minimum(np.minimum(*across), common), 0.0))

    def _extents(self, of: NDArray[np.intp], *directions: F64) -> list[tuple[F64, F64]]:
        """Least and greatest coordinate of facets (n,) along directions (n, 3)."""
        count = self.count[of]
        first = np.cumsum(count) - count
        each = np.repeat(np.arange(of.size), count)
        points = self.points[np.arange(each.size) - first[each] + self.start[of][each]]
        found = []
        for direction in directions:
            values = np.einsum("pi,pi->p", points, direction[each])
            found.append((np.minimum.reduceat(values, first), np.maximum.reduceat(values, first)))
        return found


def _outermost(
    corners: F64, normal: F64, first: NDArray[np.intp], count: NDArray[np.intp]
) -> tuple[F64, NDArray[np.intp], NDArray[np.intp]]:
    """Corners of facets one after the other, the first one of each facet, and their number; few of large ones."""
    points = corners.reshape(-1, 3)
    start, count = 3 * first, 3 * count
    large = np.flatnonzero(count > MOST_POINTS)
    if not large.size:
        return points, start, count
    angle = 2.0 * np.pi / OUTERMOST * np.arange(OUTERMOST)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    added, total = [points], len(points)
    for k in large:
        own, n = points[start[k] : start[k] + count[k]], normal[k]
        u = own[1] - own[0]
        u = u / max(float(np.linalg.norm(u)), 1e-300)
        plane = own @ np.stack([u, np.cross(n, u)], axis=1)
        pick = np.unique((plane @ circle).argmax(axis=0))
        added.append(own[pick])
        start[k], count[k] = total, pick.size
        total += pick.size
    return np.concatenate(added), start, count


def _lies_in_front(low: F64, high: F64, both: NDArray[np.bool_]) -> F64:
    """Extent (n,), m, of heights above a plane; 0 where it begins higher than its length; of sheets the larger."""

    def above(bottom: F64, top: F64) -> F64:
        bottom = np.maximum(bottom, 0.0)
        return np.asarray(np.where(top - bottom >= bottom, np.maximum(top - bottom, 0.0), 0.0))

    return np.where(both, np.maximum(above(low, high), above(-high, -low)), above(low, high))
