"""Sharp edges of metal: edges of open sheets, wedges between two facets, and rims of thin plates.

A rim is a pair of wedges a small part of a wavelength apart, which diffract as one half plane.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64, unit_rows
from sarmitsuba.scene.mesh.double_faces import double_faces
from sarmitsuba.scene.mesh.joined_sides import join_sides
from sarmitsuba.scene.mesh.pieces import SMOOTH_BEND
from sarmitsuba.scene.mesh.topology import weld

# least height of a triangle over its longest edge: flatter ones have no reliable normal
SLIVER = 1e-6
# widest gap between two sides that are taken for one edge, wavelengths
WIDEST_GAP = 0.02
# distance of two faces that are taken for one, over that gap
DOUBLE_SHARE = 0.05
# most gaps from the side of a triangle to the line in which the planes of two faces meet
MOST_GAPS = 4.0
# number of directions in a sheet, over half a circle, in which its width is tabulated
DIRECTIONS = 16


@dataclass(frozen=True, eq=False)
class SharpEdges:
    r"""Straight edges or pieces of edges, each with its wedge.

    The faces are two-sided. The wedge is the larger sector between them: where two sheets meet, the smaller sector is
    a corner, whose fringe field is ignored.

    Parameters
    ----------
    middle : (n, 3) float64, m
    length : (n,) float64, m
    angle : (n,) float64, exterior angle over pi: 2 for the rim of a sheet, above 1
    inward : (n, 2, 3) float64, unit vectors in both faces (equal at a rim), across the edge and away from it
    normal : (n, 2, 3) float64, unit normals of both faces into the exterior
    weight : (n,) float64, share of the amplitude in the taper of the illumination
    span : (n, DIRECTIONS) float64, m, extent of the sheet of a rim in the mid directions of equal parts of the half
        circle from one end of the edge to the other, backwards along it first; infinite for wedges, and where unknown
    gap : (n,) float64, m, between the sides of two triangles that lie on one another and make the edge; -1 for rims,
        and where the triangles share both its ends
    thickness : (n,) float64, m, of the plate whose face between two wedges a rim stands for; 0 for others
    parts : (n, 2) float64, shares of the parts with the electric and with the magnetic field along the edge
    doubled : number of triangles that lie on those of another shape, and were left out
    rms_height : (n, 2) float64, m, of the roughness of both faces; empty where all are smooth
    """

    middle: F64
    length: F64
    angle: F64
    inward: F64
    normal: F64
    weight: F64
    span: F64
    gap: F64
    thickness: F64
    parts: F64
    doubled: int = 0
    rms_height: F64 = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def n(self) -> int:
        """Number of edges."""
        return int(self.length.size)

    @cached_property
    def along(self) -> F64:
        """(n, 3) unit vectors of the edges."""
        return np.cross(self.inward[:, 0], self.normal[:, 0])

    @property
    def thin_text(self) -> str:
        """Note on rims of thin plates; empty without such edges."""
        thin = self.thickness[self.thickness > 0.0]
        if not thin.size:
            return ""
        return f"{thin.size} of {self.n} metal edges are rims of plates up to {1e3 * float(thin.max()):.2g} mm thick"

    @property
    def joined_text(self) -> str:
        """Note on edges of facets that share no corners, and on double faces; empty without such."""
        joined, notes = self.gap[self.gap >= 0.0], []
        if self.doubled:
            notes.append(f"{self.doubled} metal triangles on those of another shape are left out")
        if joined.size:
            notes.append(self._joined_sides_text(joined))
        return "; ".join(notes)

    def _joined_sides_text(self, joined: F64) -> str:
        apart = f", up to {1e3 * float(joined.max()):.2g} mm apart" if joined.max() > 1e-6 else ""
        return f"{joined.size} of {self.n} metal edges are of facets that share no corners there{apart}"

    def of(self, rows: NDArray[np.bool_] | I64) -> "SharpEdges":
        """Selected edges."""
        return replace(
            self,
            middle=self.middle[rows],
            length=self.length[rows],
            angle=self.angle[rows],
            inward=self.inward[rows],
            normal=self.normal[rows],
            weight=self.weight[rows],
            span=self.span[rows],
            gap=self.gap[rows],
            thickness=self.thickness[rows],
            parts=self.parts[rows],
            rms_height=self.rms_height[rows] if len(self.rms_height) else self.rms_height,
        )

    def weigh(self, share: F64) -> "SharpEdges":
        """Edges with their amplitudes multiplied by a share (n,), without those of share 0."""
        return replace(self, weight=self.weight * share).of(share > 0.0)

    def cut(self, longest: float) -> "SharpEdges":
        """Edges cut into equal pieces of at most ``longest``, m."""
        count = np.maximum(1, np.ceil(self.length / longest * (1.0 - 1e-9)).astype(np.int64))
        rows = np.repeat(np.arange(self.n), count)
        number = np.arange(rows.size) - np.repeat(np.cumsum(count) - count, count)
        pieces = self.of(rows)
        length = pieces.length / count[rows]
        shift = (number + 0.5) * length - 0.5 * pieces.length
        return replace(pieces, middle=pieces.middle + shift[:, None] * pieces.along, length=length)


def sharp_edges(
    corners: F64, metal: NDArray[np.bool_], widest: float = np.inf, shape: I64 | None = None
) -> SharpEdges:
    """Sharp edges of and between metal triangles.

    A side of one triangle is a rim. An edge of two is sharp where they bend by more than ``SMOOTH_BEND``; smaller
    bends approximate a curved surface. Two triangles meet where they share both ends of a side, or as far as their
    sides lie on one another (T-junctions, gaps), see :func:`sarmitsuba.scene.mesh.joined_sides.join_sides`.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m, of all triangles
    metal : (n,) perfect conductors
    widest : m, bound on the gap between sides that lie on one another
    shape : (n,) number of the shape of each triangle: metal triangles that lie on those of another shape are left out,
        see :func:`sarmitsuba.scene.mesh.double_faces.double_faces`; None: all belong to one

    Notes
    -----
    Ignores edges of three triangles and more, and those between metal and another material. A side that lies within
    another triangle is a rim: :func:`sarmitsuba.tracing.scatterers.edges.diffraction.find_uncovered` removes rims that
    touch another object.
    """
    corners, doubled = np.asarray(corners, dtype=np.float64), 0
    if shape is not None:
        rows = np.flatnonzero(metal)
        twice = np.zeros(len(corners), dtype=bool)
        distance = DOUBLE_SHARE * widest if np.isfinite(widest) else 0.0
        twice[rows] = double_faces(corners[rows], shape[rows], distance)
        doubled = int(twice.sum())
        corners, metal = corners[~twice], metal[~twice]
    ids = weld(corners.reshape(-1, 3)).reshape(-1, 3)
    of_metal = np.zeros(int(ids.max(initial=-1)) + 1, dtype=bool)
    of_metal[ids[metal]] = True
    near = (
        of_metal[ids[:, 0]] | of_metal[ids[:, 1]] | of_metal[ids[:, 2]]
    )  # all others share no edge with metal
    corners, metal, ids = corners[near], metal[near], ids[near]
    side = np.roll(corners, -1, axis=1) - corners
    normal = np.cross(side[:, 0], -side[:, 2])
    area = np.linalg.norm(normal, axis=1)
    size = np.square(side).sum(axis=2).max(axis=1, initial=0.0)
    whole = area > SLIVER * size
    normal /= np.where(area > 0.0, area, 1.0)[:, None]

    ends = np.sort(np.stack([ids, np.roll(ids, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    key = ends[:, 0] * (int(ids.max(initial=0)) + 1) + ends[:, 1]
    order = np.argsort(key, kind="stable")
    order = order[whole[order // 3]]
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    count = np.diff(first, append=order.size)
    two, lone = first[count == 2], order[first[count == 1]]
    start, step = corners.reshape(-1, 3), side.reshape(-1, 3)
    length = np.linalg.norm(step, axis=1)
    along = step / np.maximum(length, 1e-300)[:, None]
    inward = np.cross(np.repeat(normal, 3, axis=0), along)

    # sides of one triangle, and of two: numbers of the sides, and the part of the first as shares of its length
    lone, a, b = lone[metal[lone // 3]], order[two], order[two + 1]
    both = metal[a // 3] & metal[b // 3]
    joins = join_sides(start[lone], step[lone], lone // 3, widest)
    pair, parts = joins.partner >= 0, np.column_stack([joins.low, joins.high])
    rim, rim_part = lone[joins.side[~pair]], parts[~pair]
    a = np.concatenate([a[both], lone[joins.side[pair]]])
    b = np.concatenate([b[both], lone[joins.partner[pair]]])
    part = np.concatenate([np.tile([0.0, 1.0], (int(both.sum()), 1)), parts[pair]])
    gap = np.concatenate([np.full(int(both.sum()), -1.0), joins.gap[pair]])

    opening = np.arccos(np.clip(np.einsum("ei,ei->e", inward[a], inward[b]), -1.0, 1.0))
    sharp = np.pi - opening > SMOOTH_BEND
    a, b, part, gap, opening = a[sharp], b[sharp], part[sharp], gap[sharp], opening[sharp]
    # two coinciding sheets have one rim
    folded = opening < SLIVER
    rim, rim_part = np.concatenate([rim, a[folded]]), np.concatenate([rim_part, part[folded]])
    a, b, part, gap, opening = a[~folded], b[~folded], part[~folded], gap[~folded], opening[~folded]
    edge, shares = np.concatenate([rim, a]), np.concatenate([rim_part, part])
    faces_in = np.stack([inward[edge], np.concatenate([inward[rim], inward[b]])], axis=1)
    own = normal[rim // 3]
    wedge = np.stack([_away(inward[a], inward[b]), _away(inward[b], inward[a])], axis=1)
    faces_out = np.concatenate([np.stack([own, -own], axis=1), wedge])
    exterior = np.concatenate([np.full(rim.size, 2.0), 2.0 - opening / np.pi])
    middle = start[edge] + shares.mean(axis=1)[:, None] * step[edge]
    middle[rim.size :] += _step_towards_plane(middle[rim.size :], inward[a], start[b], normal[b // 3], gap)
    return SharpEdges(
        middle,
        (shares[:, 1] - shares[:, 0]) * length[edge],
        exterior,
        faces_in,
        faces_out,
        np.ones(edge.size),
        np.full((edge.size, DIRECTIONS), np.inf),
        np.concatenate([np.full(rim.size, -1.0), gap]),
        np.zeros(edge.size),
        np.ones((edge.size, 2)),
        doubled,
    )


def _step_towards_plane(middle: F64, inward: F64, other: F64, normal: F64, gap: F64) -> F64:
    """(n, 3) steps in a face, across the edge, to where the plane of the other face meets it; 0 without a gap."""
    slope = np.einsum("ei,ei->e", inward, normal)
    step = np.einsum("ei,ei->e", other - middle, normal) / np.where(slope == 0.0, 1.0, slope)
    near = np.abs(step) <= MOST_GAPS * gap
    return np.asarray(np.where(near, step, 0.0)[:, None] * inward)


def _away(face: F64, other: F64) -> F64:
    """(n, 3) unit normals of faces on the side away from others, from inward vectors of both."""
    across = np.einsum("ei,ei->e", face, other)[:, None] * face - other
    return unit_rows(across)


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
