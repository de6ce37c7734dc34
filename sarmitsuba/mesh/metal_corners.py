"""Flat metal facets at right angles that face each other, and the ray spacing that their double bounces need."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.arrays import F64, I64

# rad; facets farther from a right angle return little by double bounces
ABOUT_RIGHT = np.radians(10.0)
# wavelengths, largest and least ray spacing. A tube of a double bounce is as wide as its spacing where the chain ends,
# not cut there as at a facet's edge: above the first, the returns of corners off broadside are those of these stairs
# (benchmarks/studies/metal_corners.py); what is narrower than the second returns little
WIDEST_TUBE, FINEST_TUBE = 1.5, 0.5
# rays across a chain
ACROSS_CHAIN = 2.0
# rays for the double bounces of a scene, a sixth of the bound on finer lattices: halvings make it up to four times more
MOST_RAYS = 100_000
# coarser spacings that are tried where the rays do not suffice, as factors
FACTORS = (1.0, 2.0, 4.0)
# most facets examined, the largest ones
MOST_FACETS = 2000


def corner_needs(
    corners: F64, part: I64, flat_metal: NDArray[np.bool_], closed: NDArray[np.bool_], wavelength: float
) -> tuple[F64, F64]:
    r"""Ray spacings for double bounces between metal facets at right angles, m: (n,) that is planned, (n,) needed.

    A facet needs a spacing of 1.5 wavelengths, and two rays across the narrowest of its chains, but no less than half a
    wavelength. The narrow side of a chain is the least of the common length along the line of intersection and of both
    facets' extents across it, in front of the other facet. Facets that need the fewest rays are served first, within
    ``MOST_RAYS``, then others with spacings twice and four times as wide. Infinite for facets without such a partner.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    part : (n,) flat facet of each triangle, of :func:`sarmitsuba.mesh.boundary_edges.facets`
    flat_metal : (n,) triangles of flat metal
    closed : (n,) triangles whose edges all belong to two triangles: their back is inside a body
    wavelength : m

    Notes
    -----
    Ignores shadows, the direction of the radar, motion (facets are as at time zero), facets beyond the ``MOST_FACETS``
    largest ones, curved surfaces, and surfaces that are not metal.
    """
    planned, needed = np.full(len(corners), np.inf), np.full(len(corners), np.inf)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1)
    rows = np.flatnonzero(flat_metal & (area > 0.0))
    if rows.size < 2:
        return planned, needed
    _, facet = np.unique(part[rows], return_inverse=True)
    total = np.bincount(facet, area[rows])
    kept = np.zeros(total.size, dtype=bool)
    kept[np.argsort(-total, kind="stable")[:MOST_FACETS]] = True
    rows, facet = rows[kept[facet]], (np.cumsum(kept) - 1)[facet[kept[facet]]]
    order = np.argsort(facet, kind="stable")
    rows, facet, total = rows[order], facet[order], total[kept]
    first = np.flatnonzero(np.diff(facet, prepend=-1))
    normal = cross[rows[first]] / np.linalg.norm(cross[rows[first]], axis=1, keepdims=True)
    sheet = ~np.logical_and.reduceat(closed[rows], first)
    width = np.full(total.size, np.inf)
    for one, others in _chains(corners[rows], facet, first, normal, sheet):
        width[one] = min(width[one], others)
    need = np.clip(width / ACROSS_CHAIN, FINEST_TUBE * wavelength, WIDEST_TUBE * wavelength)
    need[np.isinf(width)] = np.inf
    needed[rows], planned[rows] = need[facet], _within_bound(need, total)[facet]
    return planned, needed


def _within_bound(need: F64, area: F64) -> F64:
    """Needs of facets (n,), m, that ``MOST_RAYS`` allow; infinite for others. A facet shows half of its area."""
    granted, left = np.full(need.size, np.inf), float(MOST_RAYS)
    for factor in FACTORS:
        rays = 0.5 * area / np.square(factor * need)
        open_ = np.flatnonzero(np.isinf(granted) & np.isfinite(need))
        open_ = open_[np.argsort(rays[open_], kind="stable")]
        served = open_[np.cumsum(rays[open_]) <= left]
        granted[served] = factor * need[served]
        left -= float(rays[served].sum())
    return granted


def _chains(
    corners: F64, facet: I64, first: NDArray[np.intp], normal: F64, sheet: NDArray[np.bool_]
) -> Iterator[tuple[int, float]]:
    """Number of a facet, and the least width, m, of the chains from it to others; of both sides of sheets."""
    right = np.abs(normal @ normal.T) < np.sin(ABOUT_RIGHT)
    last = np.append(first[1:], len(facet))
    points = corners.reshape(-1, 3)
    low, high = (pick(corners, axis=1) for pick in (np.min, np.max))
    low, high = np.minimum.reduceat(low, first), np.maximum.reduceat(high, first)
    size = np.linalg.norm(high - low, axis=1)
    for i in np.flatnonzero(right.any(axis=1)):
        own = points[3 * first[i] : 3 * last[i]]
        gap = np.linalg.norm(np.maximum(np.maximum(low - high[i], low[i] - high), 0.0), axis=1)
        other = np.flatnonzero(right[i] & (gap <= np.minimum(size, size[i])))
        if not other.size:
            continue
        of = np.concatenate([np.arange(first[j], last[j]) for j in other])
        start = np.flatnonzero(np.diff(facet[of], prepend=-1))
        theirs = corners[of]
        n = normal[other]
        along = np.cross(normal[i], n)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        each = np.repeat(np.arange(other.size), (last - first)[other])
        base = corners[first[other], 0]
        heights = _ranges(np.einsum("tki,i->tk", theirs - own[0], normal[i]), start)
        lengths = _ranges(np.einsum("tki,ti->tk", theirs, along[each]), start)
        widths = _of_points((own[:, None] - base) * n)
        ours = _of_points(own[:, None] * along)
        common = np.minimum(lengths[1], ours[1]) - np.maximum(lengths[0], ours[0])
        across = _in_front(*heights, bool(sheet[i])), _in_front(*widths, sheet[other])
        narrow = np.minimum(np.minimum(*across), common)
        narrow = narrow[narrow > 1e-6 * size[i]]
        if narrow.size:
            yield int(i), float(narrow.min())


def _ranges(values: F64, start: NDArray[np.intp]) -> tuple[F64, F64]:
    """Least and greatest of the values (n, 3) of triangles from each start to the next."""
    return np.minimum.reduceat(values.min(axis=1), start), np.maximum.reduceat(values.max(axis=1), start)


def _of_points(products: F64) -> tuple[F64, F64]:
    """Least and greatest scalar product over points, from the products (points, n, 3) by component."""
    values = products.sum(axis=2)
    return np.asarray(values.min(axis=0)), np.asarray(values.max(axis=0))


def _in_front(low: F64, high: F64, both: bool | NDArray[np.bool_]) -> F64:
    """Extent (n,), m, of heights above a facet's plane; 0 where it begins higher than its length; of sheets the larger."""

    def above(bottom: F64, top: F64) -> F64:
        bottom = np.maximum(bottom, 0.0)
        return np.asarray(np.where(top - bottom >= bottom, np.maximum(top - bottom, 0.0), 0.0))

    return np.where(both, np.maximum(above(low, high), above(-high, -low)), above(low, high))
