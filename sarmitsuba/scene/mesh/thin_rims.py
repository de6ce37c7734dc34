"""Rims of thin metal plates: pairs of wedges a small part of a wavelength apart, which diffract as one half plane."""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64, unit_rows
from sarmitsuba.scene.mesh.sharp_edges import DIRECTIONS, WIDEST_GAP, SharpEdges, sharp_edges

# thickness, wavelengths, up to which a rim stands for both wedges, and from which on the wedges stand for themselves:
# electric field along the edge, magnetic field along it
ELECTRIC, MAGNETIC = (0.04, 0.06), (0.10, 0.18)
# thickness, wavelengths, below which two wedges are not two independent ones
ONE_EDGE = MAGNETIC[1]
# cosine of the largest angle between directions that count as one: the bend below which facets are one surface
ALIKE = float(np.cos(np.radians(10.0)))
# largest deviation of the exterior angle of a wedge from a right angle's, over pi
SQUARE = 0.1
# parts of edges shorter than this share of a thickness, and overlaps of this share, are none
LEFT = 1e-3
# samples on an edge by which its neighbours are found, at most
SAMPLES = 16


def wedge_shares(thickness: F64) -> F64:
    """Shares (n, 2) of two single wedges in the diffraction of a rim, of its electric and of its magnetic part.

    Parameters
    ----------
    thickness : (n,) wavelengths

    Notes
    -----
    Rms error of the amplitude of boxes 1.5 to 6 wavelengths wide, in units of the edge-on amplitude, against the
    method of moments. Electric field along the edge: a rim 0.01, 0.06, 0.12 at thicknesses of 0.01, 0.04, 0.06
    wavelengths, two wedges 0.12, 0.09, 0.08. Magnetic field: 0.2, 0.25, 0.5 at 0.01, 0.05, 0.13, wedges 0.6 to 0.7.
    """
    t = np.asarray(thickness, dtype=np.float64)[:, None]
    low, high = np.array([ELECTRIC, MAGNETIC]).T
    return np.asarray(np.clip((t - low) / (high - low), 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pairs of wedges that share a narrow face.

    Parameters
    ----------
    edge : (2, n) their numbers
    low, high : (2, n) m, ends of the overlap from the middle of either edge
    between : (n, 3) m, from the first to the second, across both
    broad : (n, 3) sum of the inward vectors of both broad faces
    """

    edge: I64
    low: F64
    high: F64
    between: F64
    broad: F64

    def of(self, rows: NDArray[np.bool_]) -> "_Pairs":
        """Selected pairs."""
        return _Pairs(
            self.edge[:, rows], self.low[:, rows], self.high[:, rows], self.between[rows], self.broad[rows]
        )


def metal_edges(corners: F64, metal: NDArray[np.bool_], wavelength: float, shape: I64) -> SharpEdges:
    """Sharp edges of and between metal triangles as waves of a length meet them: gaps closed, thin plates with one rim.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m, of all triangles
    metal : (n,) perfect conductors
    wavelength : m
    shape : (n,) number of the shape of each triangle
    """
    return replace_thin_rims(sharp_edges(corners, metal, WIDEST_GAP * wavelength, shape), wavelength)


def replace_thin_rims(edges: SharpEdges, wavelength: float) -> SharpEdges:
    """Edges with the rims of thin plates in place of, or beside, their two wedges.

    Two parallel right-angled wedges whose narrow face they share are one rim over their overlap. The parts of a rim
    and of its wedges add up to the whole (:func:`wedge_shares`); wedges without a share are dropped.

    Parameters
    ----------
    edges : whole edges
    wavelength : m

    Notes
    -----
    Ignores bars whose both sides are thin, whose edges have two partners: these stay wedges.
    """
    pairs = _pairs(edges, ONE_EDGE * wavelength)
    if not pairs.between.size:
        return edges
    thickness = np.linalg.norm(pairs.between, axis=1)
    shares = wedge_shares(thickness / wavelength)
    alone = np.ones(edges.n, dtype=bool)
    alone[pairs.edge] = False
    own, low, high = pairs.edge.reshape(-1), pairs.low.reshape(-1), pairs.high.reshape(-1)
    kept = [edges.of(alone), _part(edges, own, low, high, np.concatenate([shares, shares]))]
    for edge in np.unique(own):  # what no rim lies over
        rows = np.flatnonzero(own == edge)
        rows = rows[np.argsort(low[rows])]
        reach = 0.5 * edges.length[edge]
        begin, stop = np.concatenate([[-reach], high[rows]]), np.concatenate([low[rows], [reach]])
        free = stop - begin > LEFT * thickness.min()
        number = np.full(int(free.sum()), edge)
        kept.append(_part(edges, number, begin[free], stop[free], np.ones((number.size, 2))))
    first = edges.of(pairs.edge[0])
    along, half = first.along, 0.5 * (pairs.low[0] + pairs.high[0])
    inward = unit_rows(pairs.broad)
    inward -= _dot(inward, along)[:, None] * along
    inward = unit_rows(inward)
    normal, one = np.cross(along, inward), np.ones(first.n)
    kept.append(
        SharpEdges(
            first.middle + half[:, None] * along + 0.5 * pairs.between,
            pairs.high[0] - pairs.low[0],
            2.0 * one,
            np.stack([inward, inward], axis=1),
            np.stack([normal, -normal], axis=1),
            one,
            np.full((first.n, DIRECTIONS), np.inf),
            -one,
            thickness,
            1.0 - shares,
        )
    )
    arrays = [name for name in SharpEdges.__dataclass_fields__ if name != "doubled"]
    joined = {name: np.concatenate([getattr(x, name) for x in kept]) for name in arrays}
    found = SharpEdges(**joined, doubled=edges.doubled)
    return found.of(np.asarray(found.parts.any(axis=1)))


def _part(edges: SharpEdges, rows: I64, low: F64, high: F64, parts: F64) -> SharpEdges:
    """Parts of edges from ``low`` to ``high``, m from their middles."""
    some = edges.of(rows)
    middle = some.middle + (0.5 * (low + high))[:, None] * some.along
    return replace(some, middle=middle, length=high - low, parts=parts)


def _pairs(edges: SharpEdges, thickest: float) -> _Pairs:
    """Pairs of wedges with a common face at most ``thickest``, m, wide."""
    i, j = _near(edges, np.flatnonzero(np.abs(edges.angle - 1.5) < SQUARE), thickest)
    one, other = edges.of(i), edges.of(j)
    apart = other.middle - one.middle
    shift, turn = _dot(apart, one.along), np.sign(_dot(one.along, other.along))
    between = apart - shift[:, None] * one.along
    low = np.maximum(-0.5 * one.length, shift - 0.5 * other.length)
    high = np.minimum(0.5 * one.length, shift + 0.5 * other.length)
    width = np.linalg.norm(between, axis=1)
    to = between / np.maximum(width, 1e-300)[:, None]
    # the common face: the one of each wedge that leads to the other
    here, there = np.einsum("pfi,pi->pf", one.inward, to), np.einsum("pfi,pi->pf", other.inward, -to)
    row = np.arange(i.size)
    broad = np.stack([one.inward[row, here.argmin(axis=1)], other.inward[row, there.argmin(axis=1)]], axis=1)
    found = (np.abs(_dot(one.along, other.along)) > ALIKE) & (width > 0.0) & (width <= thickest)
    found &= (high - low > LEFT * width) & (here.max(axis=1) > ALIKE) & (there.max(axis=1) > ALIKE)
    found &= _dot(broad[:, 0], broad[:, 1]) > ALIKE
    ends = np.sort([turn * (low - shift), turn * (high - shift)], axis=0)
    pairs = _Pairs(
        np.stack([i, j]), np.stack([low, ends[0]]), np.stack([high, ends[1]]), between, broad.sum(axis=1)
    ).of(found)
    return pairs.of(_alone(pairs))


def _near(edges: SharpEdges, rows: I64, distance: float) -> I64:
    """Pairs (2, n) of selected edges that may lie within a distance, m, from one another; with all that do.

    By samples at steps of powers of two: long edges are compared with each other and with all shorter ones at their own
    step, so that the number of samples does not depend on the size of the scene.
    """
    step = np.maximum(edges.length[rows] / SAMPLES, distance)
    level = np.ceil(np.log2(step / distance)).astype(np.int64)
    found = [np.zeros((0, 2), dtype=np.int64)]
    for rung in np.unique(level):
        step_here = distance * 2.0**rung
        long, all_long = _samples(edges, rows[level == rung], step_here)
        short, all_short = _samples(edges, rows[level <= rung], step_here)
        near = scipy.spatial.cKDTree(all_long).sparse_distance_matrix(
            scipy.spatial.cKDTree(all_short), distance + step_here, output_type="ndarray"
        )
        couple = np.stack([long[near["i"]], short[near["j"]]], axis=1)
        found.append(np.unique(np.sort(couple[couple[:, 0] != couple[:, 1]], axis=1), axis=0))
    return np.asarray(np.unique(np.concatenate(found), axis=0).T)


def _samples(edges: SharpEdges, rows: I64, step: float) -> tuple[I64, F64]:
    """Numbers (n,) of edges and places (n, 3), m, in the middles of equal parts of at most ``step``, m."""
    count = np.ceil(edges.length[rows] / step).astype(np.int64)
    number = np.repeat(rows, count)
    place = np.arange(number.size) - np.repeat(np.cumsum(count) - count, count)
    shift = (place + 0.5) * np.repeat(edges.length[rows] / count, count) - 0.5 * edges.length[number]
    return number, edges.middle[number] + shift[:, None] * edges.along[number]


def _alone(pairs: _Pairs) -> NDArray[np.bool_]:
    """Pairs (n,) none of whose edges has two partners at one place."""
    own, low, high = pairs.edge.reshape(-1), pairs.low.reshape(-1), pairs.high.reshape(-1)
    number = np.tile(np.arange(pairs.edge.shape[1]), 2)
    order = np.lexsort((low, own))
    own, low, high, number = own[order], low[order], high[order], number[order]
    over = (own[1:] == own[:-1]) & (low[1:] < high[:-1] - LEFT * (high[:-1] - low[:-1]))
    alone = np.ones(pairs.edge.shape[1], dtype=bool)
    alone[number[1:][over]] = alone[number[:-1][over]] = False
    return alone


def _dot(a: F64, b: F64) -> F64:
    return np.asarray(np.einsum("pi,pi->p", a, b))
