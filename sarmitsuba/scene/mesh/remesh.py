"""Meshes of even triangles of one size, for solvers of surface currents: sharp edges and rims stay where they are.

Triangles meet corner to corner: sides are cut where corners of others lie on them. Places where parts of a surface
touch or cross without sharing edges are found.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64, unit_rows
from sarmitsuba.scene.mesh.double_faces import TriangleBalls

# edges longer and shorter than these many of the wanted length are split and collapsed
LONGEST, SHORTEST = 4.0 / 3.0, 0.8
# rad: bend of edges of the given surface, and turn of rims, whose corners stay, so that nothing narrow is given up
HARD = np.radians(30.0)
# distance over wanted length by which a surface may leave a corner that is given up, and least cosine of the turn of
# its facets
DEVIATION, TURN = 0.03, 0.2
# least cosine between new facets of a turned edge and the mean of the old ones
UPRIGHT = 0.5
# points at a time that are moved back onto a surface
_AT_ONCE = 20_000
# least quality of triangles, 1 for even ones, that no collapse may go below unless others were worse
SLIVER = 0.15
# quality below which the normal of a triangle is rounding
NEEDLE = 1e-3
ROUNDS, FLIPS, SMOOTHINGS, COLLAPSES = 5, 4, 2, 30
# share of the corners that may go below which collapsing ends
FEW = 0.02


@dataclass(frozen=True, eq=False)
class _Edges:
    """Edges of a mesh: ends (n, 2), triangles of each side (3 m,) by edge number, count, first two sides, bend."""

    ends: I64
    of_side: I64
    count: I64
    first: I64
    second: I64
    bend: F64

    @staticmethod
    def of(vertices: F64, faces: I64) -> "_Edges":
        start, end = np.roll(faces, -1, axis=1).ravel(), np.roll(faces, -2, axis=1).ravel()
        n = int(faces.max(initial=0)) + 1
        side = np.minimum(start, end) * n + np.maximum(start, end)
        order = np.argsort(side, kind="stable")
        begin = np.flatnonzero(np.diff(side[order], prepend=-1))
        key, count = side[order[begin]], np.diff(begin, append=side.size)
        of_side = np.empty(side.size, dtype=np.int64)
        of_side[order] = np.repeat(np.arange(key.size), count)
        first = order[begin]
        second = np.where(count == 2, order[np.minimum(begin + 1, order.size - 1)], -1)
        ends = np.stack([key // n, key % n], axis=1)
        bend = np.full(key.size, np.pi)
        two = np.flatnonzero(count == 2)
        a, b = vertices[ends[two, 0]], vertices[ends[two, 1]]
        along = unit_rows(b - a)
        inward = []
        for side in (first[two], second[two]):
            off = vertices[faces.ravel()[side]] - a
            inward.append(unit_rows(off - np.einsum("nc,nc->n", off, along)[:, None] * along))
        bend[two] = np.arccos(np.clip(-np.einsum("nc,nc->n", *inward), -1.0, 1.0))
        return _Edges(ends, of_side, count, first, second, bend)

    def has(self, low: I64, high: I64) -> NDArray[np.bool_]:
        """Whether there is an edge between two corners, the smaller number first."""
        n = int(self.ends.max(initial=0)) + 1
        key, wanted = self.ends[:, 0] * n + self.ends[:, 1], low * n + high
        place = np.minimum(np.searchsorted(key, wanted), max(key.size - 1, 0))
        return np.asarray((high < n) & (key[place] == wanted))

    def lengths(self, vertices: F64) -> F64:
        """(n,) m."""
        return np.asarray(np.linalg.norm(vertices[self.ends[:, 1]] - vertices[self.ends[:, 0]], axis=1))


def remesh(vertices: F64, faces: I64, length: float) -> tuple[F64, I64]:
    """Mesh of the same surface with edges of about one length.

    Parameters
    ----------
    vertices : (n, 3) float64, m
    faces : (m, 3) int64; triangles meet corner to corner (:func:`sarmitsuba.scene.mesh.remesh.conforming`)
    length : m, wanted; no edge is longer than ``LONGEST`` times it

    Returns
    -------
    vertices, faces : of the new mesh. Corners lie on the old surface

    Notes
    -----
    Edges of the given surface that bend by more than 30 degrees, rims and junctions keep their places. Smooth curved
    surface finer than ``length`` is coarsened to chords, which leave it by ``DEVIATION`` times ``length``; coarser one
    keeps its facets. Splits, collapses, flips and smoothing after Botsch and Kobbelt, A Remeshing Approach to
    Multiresolution Modeling (2004), each on independent sets at a time; smoothed corners return to the old surface.
    """
    vertices, faces = np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64)
    if not len(faces):
        return _compact(vertices, faces)
    surface = _Surface(vertices[faces])
    lines = _hard_edges(vertices, faces)
    for _ in range(ROUNDS):
        vertices, faces, lines = _split(vertices, faces, lines, LONGEST * length)
        faces, lines = _collapse(vertices, faces, lines, length)
        faces = _flip_all(vertices, faces, lines, length)
        for _ in range(SMOOTHINGS):
            vertices = _smooth(vertices, faces, lines, surface, length)
    vertices, faces, lines = _split(vertices, faces, lines, LONGEST * length)
    vertices, faces = _compact(vertices, _flip_all(vertices, faces, lines, length))
    return surface.nearest(vertices), faces


class _Surface:
    """Triangles (m, 3, 3) that points are moved back onto."""

    def __init__(self, corners: F64) -> None:
        from scipy.spatial import cKDTree

        self._corners = corners
        middle = corners.mean(axis=1)
        self._tree = cKDTree(middle)
        self._balls = TriangleBalls(middle, np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1))

    def nearest(self, points: F64) -> F64:
        """Nearest points (n, 3) of the surface."""
        found = np.empty_like(points)
        for some in np.array_split(np.arange(len(points)), 1 + len(points) // _AT_ONCE):
            here = points[some]
            # the nearest triangle is no farther than the nearest middle
            reach, first = self._tree.query(here)
            row, triangle = self._balls.near(here, np.asarray(reach, dtype=np.float64))
            row, triangle = np.append(np.arange(some.size), row), np.append(first, triangle)
            there = nearest_on_triangles(here[row], self._corners[triangle])
            off = np.linalg.norm(there - here[row], axis=1)
            order = np.lexsort((off, row))
            best = order[np.flatnonzero(np.diff(row[order], prepend=-1))]
            found[some] = there[best]
        return found


def _hard_edges(vertices: F64, faces: I64) -> I64:
    """Ends (n, 2), the smaller number first, of edges that bend by more than ``HARD``, of rims and of junctions."""
    edges = _Edges.of(vertices, faces)
    return np.asarray(edges.ends[(edges.count != 2) | (edges.bend > HARD)])


def _among(ends: I64, lines: I64) -> NDArray[np.bool_]:
    """Whether edges (n, 2) are among others, all with the smaller number first."""
    n = int(max(ends.max(initial=0), lines.max(initial=0))) + 1
    return np.isin(ends[:, 0] * n + ends[:, 1], lines[:, 0] * n + lines[:, 1])


def _compact(vertices: F64, faces: I64) -> tuple[F64, I64]:
    used, number = np.unique(faces, return_inverse=True)
    return vertices[used], np.asarray(number.reshape(-1, 3), dtype=np.int64)


def _split(vertices: F64, faces: I64, lines: I64, longest: float) -> tuple[F64, I64, I64]:
    """Halve edges that are too long, those first that are the longest of all their triangles."""
    while True:
        edges = _Edges.of(vertices, faces)
        size = edges.lengths(vertices)
        if size.max(initial=0.0) <= longest:
            return vertices, faces, lines
        # rank by length; equal lengths by number
        rank = np.empty(size.size, dtype=np.int64)
        rank[np.argsort(size, kind="stable")] = np.arange(size.size)
        mine = edges.of_side.reshape(-1, 3)
        top = rank[mine].argmax(axis=1)
        best = mine[np.arange(len(faces)), top]
        votes = np.bincount(best, minlength=size.size)
        chosen = (votes == edges.count) & (size > longest)
        middle = np.full(size.size, -1)
        middle[chosen] = len(vertices) + np.arange(int(chosen.sum()))
        cut_lines = chosen & _among(edges.ends, lines)
        halves = [np.stack([edges.ends[cut_lines, i], middle[cut_lines]], axis=1) for i in (0, 1)]
        lines = np.concatenate([lines[~_among(lines, edges.ends[cut_lines])], *halves])
        vertices = np.concatenate(
            [vertices, 0.5 * (vertices[edges.ends[chosen, 0]] + vertices[edges.ends[chosen, 1]])]
        )
        cut = np.flatnonzero(chosen[best])
        place, m = top[cut], middle[best[cut]]
        apex = faces[cut, place]
        a, b = faces[cut, (place + 1) % 3], faces[cut, (place + 2) % 3]
        whole = np.delete(faces, cut, axis=0)
        faces = np.concatenate([whole, np.stack([apex, a, m], axis=1), np.stack([apex, m, b], axis=1)])


def _collapse(vertices: F64, faces: I64, lines: I64, length: float) -> tuple[I64, I64]:
    """Move corners of short edges into their other end, where the surface stays the same."""
    for _ in range(COLLAPSES):
        edges = _Edges.of(vertices, faces)
        size = edges.lengths(vertices)
        short = size < SHORTEST * length
        if not short.any():
            break
        n = len(vertices)
        # corners of rims and hard edges move along these only; those of junctions and where lines turn not at all
        line = _among(edges.ends, lines)
        on_line = np.bincount(edges.ends[line].ravel(), minlength=n) > 0
        fixed = _turning(vertices, edges.ends[line])
        fixed[edges.ends[edges.count > 2].ravel()] = True
        number = np.flatnonzero(short)
        move = np.concatenate([edges.ends[number, 0], edges.ends[number, 1]])
        into = np.concatenate([edges.ends[number, 1], edges.ends[number, 0]])
        edge = np.concatenate([number, number])
        allowed = ~fixed[move] & (~on_line[move] | line[edge])
        move, into, edge = move[allowed], into[allowed], edge[allowed]
        good = _keeps_surface(vertices, faces, edges, move, into, edge, length)
        move, into, edge = move[good], into[good], edge[good]
        if not move.size:
            break
        # one edge of every corner, then corners whose rings are apart, in an order without pattern
        order = np.random.default_rng(0).permutation(move.size)
        rank = np.full(n, np.iinfo(np.int64).max)
        np.minimum.at(rank, move[order], np.arange(order.size))
        best = order[rank[rank < np.iinfo(np.int64).max]]
        both = np.concatenate([edges.ends, edges.ends[:, ::-1]])
        claim = rank.copy()
        np.minimum.at(claim, both[:, 1], rank[both[:, 0]])
        lost = np.zeros(n, dtype=bool)
        beaten = claim[both[:, 1]] < rank[both[:, 0]]
        lost[both[beaten, 0]] = True
        lost |= claim < rank
        candidates = best.size
        best = best[~lost[move[best]]]
        to = np.arange(n)
        to[move[best]] = into[best]
        faces = to[faces]
        lines = np.sort(to[lines], axis=1)
        lines = np.unique(lines[lines[:, 0] < lines[:, 1]], axis=0)
        flat = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
        faces = faces[~flat]
        if best.size < FEW * candidates:
            break
    return faces, lines


def _turning(vertices: F64, ends: I64) -> NDArray[np.bool_]:
    """Corners at which lines of edges (n, 2) end, branch, or turn by more than ``HARD``."""
    n = len(vertices)
    along = unit_rows(vertices[ends[:, 1]] - vertices[ends[:, 0]])
    total = np.zeros((n, 3))
    np.add.at(total, ends[:, 0], along)
    np.add.at(total, ends[:, 1], -along)
    count = np.bincount(ends.ravel(), minlength=n)
    # two unit vectors away from a corner sum to nothing on a straight line
    turns = np.linalg.norm(total, axis=1) > 2.0 * np.sin(0.5 * HARD)
    return np.asarray((count > 0) & ((count != 2) | turns))


def _keeps_surface(
    vertices: F64, faces: I64, edges: _Edges, move: I64, into: I64, edge: I64, length: float
) -> NDArray[np.bool_]:
    """Whether the surface about a moved corner stays near it, no facet turns over, and the mesh keeps its topology."""
    n = len(vertices)
    # triangles of each corner
    corner = faces.ravel()
    order = np.argsort(corner, kind="stable")
    count = np.bincount(corner, minlength=n)
    begin = np.cumsum(count) - count
    each = count[move]
    row = np.repeat(np.arange(move.size), each)
    side = order[begin[move][row] + np.arange(row.size) - (np.cumsum(each) - each)[row]]
    triangle = faces[side // 3]
    stays = ~(triangle == into[row][:, None]).any(axis=1)
    new = np.where(triangle == move[row][:, None], into[row][:, None], triangle)
    before, after = (_cross(vertices[t]) for t in (triangle, new))
    same = np.einsum("nc,nc->n", unit_rows(before), unit_rows(after)) > TURN
    # slivers have no normal that counts; how far the surface leaves the corner does
    same |= _quality(vertices[triangle]) < NEEDLE
    span = np.linalg.norm(vertices[new] - np.roll(vertices[new], 1, axis=1), axis=2).max(axis=1)
    fine = (same & (span <= LONGEST * length)) | ~stays
    good = np.bincount(row, ~fine, minlength=move.size) == 0
    worst_before, worst_after = np.ones(move.size), np.ones(move.size)
    np.minimum.at(worst_before, row, _quality(vertices[triangle]))
    np.minimum.at(worst_after, row[stays], _quality(vertices[new[stays]]))
    good &= worst_after >= np.minimum(SLIVER, worst_before)
    away = np.full(move.size, np.inf)
    tested = np.flatnonzero(stays & good[row])
    off = distance_to_triangles(vertices[move[row[tested]]], vertices[new[tested]])
    np.minimum.at(away, row[tested], off)
    good &= away < DEVIATION * length
    # corners next to both ends are those opposite to the edge
    near = np.concatenate([triangle[:, 0], triangle[:, 1], triangle[:, 2]])
    rows = np.concatenate([row, row, row])
    pair = np.sort(rows * n + near)
    pair = pair[np.diff(pair, prepend=-1) > 0]
    rows, near = pair // n, pair % n
    free = (near != move[rows]) & (near != into[rows])
    low, high = np.minimum(near, into[rows]), np.maximum(near, into[rows])
    meets = free & edges.has(low, high)
    common = np.bincount(rows, meets, minlength=move.size)
    return np.asarray(good & (common == edges.count[edge]))


def _cross(t: F64) -> F64:
    return np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])


def _quality(t: F64) -> F64:
    """Area of triangles (n, 3, 3) over that of even ones with the same squared sides, 0 to 1."""
    square = np.square(t - np.roll(t, 1, axis=1)).sum(axis=(1, 2))
    return np.asarray(2.0 * np.sqrt(3.0) * np.linalg.norm(_cross(t), axis=1) / np.maximum(square, 1e-300))


def nearest_on_triangles(points: F64, t: F64) -> F64:
    """Nearest points (n, 3) of triangles (n, 3, 3) to points (n, 3)."""
    normal = _cross(t)
    unit = unit_rows(normal)
    best, beside = np.empty_like(points), np.full(len(points), np.inf)
    inside = np.einsum("nc,nc->n", normal, normal) > 0.0
    for i in range(3):
        a, step = t[:, i], t[:, (i + 1) % 3] - t[:, i]
        off = points - a
        inside &= np.einsum("nc,nc->n", np.cross(normal, step), off) >= 0.0
        share = np.einsum("nc,nc->n", off, step) / np.maximum(np.einsum("nc,nc->n", step, step), 1e-300)
        foot = a + np.clip(share, 0.0, 1.0)[:, None] * step
        away = np.linalg.norm(points - foot, axis=1)
        nearer = away < beside
        best[nearer], beside[nearer] = foot[nearer], away[nearer]
    height = np.einsum("nc,nc->n", points - t[:, 0], unit)
    return np.where(inside[:, None], points - height[:, None] * unit, best)


def distance_to_triangles(points: F64, t: F64) -> F64:
    """Distance (n,) of points (n, 3) from triangles (n, 3, 3)."""
    return np.asarray(np.linalg.norm(points - nearest_on_triangles(points, t), axis=1))


def _flip_all(vertices: F64, faces: I64, lines: I64, length: float) -> I64:
    for _ in range(FLIPS):
        faces, flipped = _flip(vertices, faces, lines, length)
        if not flipped:
            break
    return faces


def _flip(vertices: F64, faces: I64, lines: I64, length: float) -> tuple[I64, bool]:
    """Turn edges whose opposite angles sum to more than half a turn (Delaunay), but lines, where the surface stays."""
    edges = _Edges.of(vertices, faces)
    number = np.flatnonzero((edges.count == 2) & ~_among(edges.ends, lines))
    one, two = edges.first[number], edges.second[number]
    flat = faces.ravel()
    c, d = flat[one], flat[two]
    a = faces[one // 3, (one % 3 + 1) % 3]
    b = faces[one // 3, (one % 3 + 2) % 3]
    angle = _angle(vertices, c, a, b) + _angle(vertices, d, a, b)
    n = len(vertices)
    fresh = ~edges.has(np.minimum(c, d), np.maximum(c, d))
    old, other = _cross(vertices[np.stack([a, b, c], axis=1)]), _cross(vertices[np.stack([b, a, d], axis=1)])
    mean = unit_rows(old + other)
    left, right = np.stack([a, d, c], axis=1), np.stack([d, b, c], axis=1)
    holds = np.ones(number.size, dtype=bool)
    for t in (left, right):
        holds &= np.einsum("nc,nc->n", unit_rows(_cross(vertices[t])), mean) > UPRIGHT
    # the surface moves by the distance of the two diagonals
    across = unit_rows(np.cross(vertices[b] - vertices[a], vertices[d] - vertices[c]))
    holds &= np.abs(np.einsum("nc,nc->n", across, vertices[c] - vertices[a])) < DEVIATION * length
    wanted = np.flatnonzero((angle > np.pi + 1e-6) & fresh & holds)
    if not wanted.size:
        return faces, False
    order = wanted[np.argsort(-angle[wanted], kind="stable")]
    claim = np.full(len(faces), order.size)
    rank = np.arange(order.size)
    for side in (one, two):
        np.minimum.at(claim, side[order] // 3, rank)
    # new edges that two flips would both make
    first = order[(claim[one[order] // 3] == rank) & (claim[two[order] // 3] == rank)]
    _, pick = np.unique(np.minimum(c, d)[first] * n + np.maximum(c, d)[first], return_index=True)
    first = first[pick]
    faces = faces.copy()
    faces[one[first] // 3], faces[two[first] // 3] = left[first], right[first]
    return faces, True


def _angle(vertices: F64, apex: I64, a: I64, b: I64) -> F64:
    u, v = unit_rows(vertices[a] - vertices[apex]), unit_rows(vertices[b] - vertices[apex])
    return np.asarray(np.arccos(np.clip(np.einsum("nc,nc->n", u, v), -1.0, 1.0)))


def _smooth(vertices: F64, faces: I64, lines: I64, surface: _Surface, length: float) -> F64:
    """Move corners halfway to the middle of their neighbours and back onto the surface; those of lines stay."""
    edges = _Edges.of(vertices, faces)
    n = len(vertices)
    free = np.bincount(faces.ravel(), minlength=n) > 0
    free[lines.ravel()] = False
    both = np.concatenate([edges.ends, edges.ends[:, ::-1]])
    total = np.stack(
        [np.bincount(both[:, 0], vertices[both[:, 1], i], minlength=n) for i in range(3)], axis=1
    )
    middle = total / np.maximum(np.bincount(both[:, 0], minlength=n), 1)[:, None]
    there = vertices.copy()
    there[free] = surface.nearest(0.5 * (vertices[free] + middle[free]))
    before, size = _cross(vertices[faces]), _quality(vertices[faces])
    row, corner = np.repeat(np.arange(len(faces)), 3), faces.ravel()
    for _ in range(5):
        moved = np.where(free[:, None], there, vertices)
        t = moved[faces]
        same = np.einsum("nc,nc->n", unit_rows(before), unit_rows(_cross(t))) > TURN
        bad = ~same | (_quality(t) < np.minimum(SLIVER, size))
        # the old corner stays near the new surface
        off = distance_to_triangles(vertices[corner], t[row])
        away = np.full(n, np.inf)
        np.minimum.at(away, corner, off)
        free &= ~(away > DEVIATION * length)
        if not bad.any() and not (away[corner] > DEVIATION * length).any():
            return moved
        free[faces[bad].ravel()] = False
    return vertices


# passes in which sides are cut; each cuts one side of a triangle
_PASSES = 200
# corners within the tolerance of one, in the mean, beyond which they are first joined in cubes, and cubes across it
_NEIGHBOURS, _CUBES = 40, 4


def conforming(corners: F64, tolerance: float) -> tuple[F64, I64]:
    """Mesh of the same surface in which no corner lies within the side of another triangle.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    tolerance : m, distance within which corners are one, and lie on a side

    Returns
    -------
    vertices : (n_v, 3) float64, m
    faces : (m, 3) int64, without triangles narrower than the tolerance, and each once

    Notes
    -----
    Surfaces that cross each other, or touch within a face, are not joined.
    """
    vertices, faces = _join_corners(corners, tolerance)
    for _ in range(_PASSES):
        faces = _once(vertices, faces, tolerance)
        cut, place, at = _cuts(vertices, faces, tolerance)
        if not cut.size:
            break
        apex = faces[cut, place]
        a, b = faces[cut, (place + 1) % 3], faces[cut, (place + 2) % 3]
        faces = np.concatenate(
            [np.delete(faces, cut, axis=0), np.stack([apex, a, at], axis=1), np.stack([apex, at, b], axis=1)]
        )
    used, number = np.unique(faces, return_inverse=True)
    return vertices[used], np.asarray(number.reshape(-1, 3), dtype=np.int64)


def _join_corners(corners: F64, tolerance: float) -> tuple[F64, I64]:
    """Vertices and faces; corners nearer to another one than the tolerance are that one, not chains of them."""
    points, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    label = join_points(points, tolerance)[number.reshape(-1)]
    used, number = np.unique(label, return_inverse=True)
    return points[used], np.asarray(number.reshape(-1, 3), dtype=np.int64)


def join_points(points: F64, tolerance: float) -> I64:
    """Number (n,) of the point that stands for each: itself, or one within the tolerance that stands for itself."""
    from scipy.spatial import cKDTree

    rows, cell = np.arange(len(points)), np.arange(len(points))
    tree = cKDTree(points)
    if tree.count_neighbors(tree, tolerance) > _NEIGHBOURS * len(points):
        # many in a ball: one of each small cube first
        place = np.floor(points / (tolerance / _CUBES)).astype(np.int64)
        _, rows, cell = np.unique(place, axis=0, return_index=True, return_inverse=True)
        cell = cell.reshape(-1)
        tree = cKDTree(points[rows])
    pairs = tree.query_pairs(tolerance, output_type="ndarray")
    own = np.arange(rows.size)
    if len(pairs):
        low, high = pairs.min(axis=1), pairs.max(axis=1)
        order = np.lexsort((high, low))
        low, high = low[order], high[order]
        start = np.searchsorted(low, np.arange(rows.size + 1))
        taken = np.zeros(rows.size, dtype=bool)
        for i in np.unique(low):
            if not taken[i]:
                near = high[start[i] : start[i + 1]]
                near = near[~taken[near]]
                taken[near], own[near] = True, i
    return np.asarray(rows[own[cell]], dtype=np.int64)


def _once(vertices: F64, faces: I64, tolerance: float) -> I64:
    """Faces without those that have no height, and without copies."""
    t = vertices[faces]
    area = np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
    longest = np.linalg.norm(t - np.roll(t, 1, axis=1), axis=2).max(axis=1)
    own = np.sort(faces, axis=1)
    wide = (area > 0.5 * tolerance * longest) & (own[:, 0] < own[:, 1]) & (own[:, 1] < own[:, 2])
    faces, own = faces[wide], own[wide]
    _, first = np.unique(own, axis=0, return_index=True)
    return faces[np.sort(first)]


def _cuts(vertices: F64, faces: I64, tolerance: float) -> tuple[I64, I64, I64]:
    """Triangles to cut, number of the corner opposite to the cut side, and the corner that lies on it."""
    from scipy.spatial import cKDTree

    start, end = np.roll(faces, -1, axis=1).ravel(), np.roll(faces, -2, axis=1).ravel()
    key = np.minimum(start, end) * len(vertices) + np.maximum(start, end)
    _, of, count = np.unique(key, return_inverse=True, return_counts=True)
    open_side = np.flatnonzero(count[of.reshape(-1)] == 1)
    if not open_side.size:
        return (np.zeros(0, dtype=np.int64),) * 3
    rim = np.unique(np.concatenate([start[open_side], end[open_side]]))
    tree = cKDTree(vertices[rim])
    a, b = vertices[start[open_side]], vertices[end[open_side]]
    length = np.linalg.norm(b - a, axis=1)
    found = tree.query_ball_point(0.5 * (a + b), 0.5 * length + tolerance)
    each = np.fromiter((len(f) for f in found), dtype=np.int64, count=len(found))
    row = np.repeat(np.arange(open_side.size), each)
    vertex = rim[np.concatenate([*found, []]).astype(np.int64)]
    along = (b - a) / np.maximum(length, 1e-300)[:, None]
    off = vertices[vertex] - a[row]
    place = np.einsum("nc,nc->n", off, along[row])
    away = np.linalg.norm(off - place[:, None] * along[row], axis=1)
    inside = (away < tolerance) & (place > tolerance) & (place < length[row] - tolerance)
    row, vertex, place = row[inside], vertex[inside], place[inside]
    # nearest to the middle first; one side of a triangle at a time
    order = np.argsort(np.abs(place - 0.5 * length[row]), kind="stable")
    side, vertex = open_side[row[order]], vertex[order]
    _, first = np.unique(side // 3, return_index=True)
    side, vertex = side[first], vertex[first]
    return side // 3, side % 3, vertex


# rad: two triangles at an edge that are nearer to one another than this lie on one another
FOLDED = np.radians(2.0)


def contacts(vertices: F64, faces: I64, distance: float) -> F64:
    """Places (n, 3), m, where corners or edges meet triangles that are not next to them.

    Parameters
    ----------
    vertices : (n_v, 3) float64, m
    faces : (m, 3) int64, of triangles of about one size
    distance : m, nearer than this a corner touches a triangle of the mean size; nearer in proportion, a narrower one:
        opposite sides of thin bodies do not touch
    """
    t = vertices[faces]
    twice = np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
    longest = np.linalg.norm(t - np.roll(t, 1, axis=1), axis=2).max(axis=1)
    height = twice / np.maximum(longest, 1e-300)
    reach = distance * np.minimum(1.0, height / np.maximum(np.median(longest), 1e-300))
    middle = t.mean(axis=1)
    balls = TriangleBalls(middle, np.linalg.norm(t - middle[:, None], axis=2).max(axis=1))
    row, triangle = balls.near(vertices, np.full(len(vertices), distance))
    # next to a corner: triangles that share a corner with one of its own
    near = _apart(row, triangle, faces, len(vertices))
    row, triangle = row[near], triangle[near]
    touching = row[distance_to_triangles(vertices[row], t[triangle]) < reach[triangle]]
    ends = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    a, b = vertices[ends[:, 0]], vertices[ends[:, 1]]
    edge, other = balls.near(0.5 * (a + b), 0.5 * np.linalg.norm(b - a, axis=1))
    free = ~(faces[other][:, :, None] == ends[edge][:, None, :]).any(axis=(1, 2))
    edge, other = edge[free], other[free]
    place, crosses = _crossing(a[edge], b[edge], t[other])
    return np.concatenate([vertices[touching], place[crosses], _folds(vertices, faces)])


def _folds(vertices: F64, faces: I64) -> F64:
    """Middles (n, 3) of edges at which two triangles lie on one another."""
    start, end = np.roll(faces, -1, axis=1).ravel(), np.roll(faces, -2, axis=1).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    key = low * len(vertices) + high
    along = vertices[high] - vertices[low]
    along = unit_rows(along)
    inward = vertices[faces.ravel()] - vertices[low]
    inward = inward - np.einsum("nc,nc->n", inward, along)[:, None] * along
    inward = unit_rows(inward)
    order = np.argsort(key, kind="stable")
    found = []
    for apart in (1, 2, 3):  # up to four triangles at an edge
        a, b = order[:-apart], order[apart:]
        same = (key[a] == key[b]) & (np.einsum("nc,nc->n", inward[a], inward[b]) > np.cos(FOLDED))
        found.append(0.5 * (vertices[low[a[same]]] + vertices[high[a[same]]]))
    return np.concatenate(found)


def _apart(row: I64, triangle: I64, faces: I64, n: int) -> NDArray[np.bool_]:
    """Whether a corner and a triangle have no triangle of the corner between them."""
    from scipy.sparse import csr_matrix

    m = len(faces)
    of = csr_matrix(
        (np.ones(3 * m, dtype=np.int32), (faces.ravel(), np.repeat(np.arange(m), 3))), shape=(n, m)
    )
    ring = ((of @ of.T) > 0).tocsr()
    next_to = np.zeros(row.size, dtype=bool)
    for i in range(3) if row.size else ():
        next_to |= np.asarray(ring[row, faces[triangle, i]]).ravel().astype(bool)
    return ~next_to


def _crossing(a: F64, b: F64, t: F64) -> tuple[F64, NDArray[np.bool_]]:
    """Crossing of segments with triangles (Moeller and Trumbore, 1997), and whether there is one."""
    step, u, v = b - a, t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]
    p = np.cross(step, v)
    det = np.einsum("nc,nc->n", u, p)
    scale = np.linalg.norm(step, axis=1) * np.linalg.norm(np.cross(u, v), axis=1)
    steep = np.abs(det) > 1e-9 * scale
    inverse = 1.0 / np.where(steep, det, 1.0)
    off = a - t[:, 0]
    x = np.einsum("nc,nc->n", off, p) * inverse
    q = np.cross(off, u)
    y = np.einsum("nc,nc->n", step, q) * inverse
    s = np.einsum("nc,nc->n", v, q) * inverse
    hit = steep & (x > 0.0) & (y > 0.0) & (x + y < 1.0) & (s > 0.0) & (s < 1.0)
    return a + s[:, None] * step, hit
