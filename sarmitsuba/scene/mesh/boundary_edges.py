"""Boundary edges of flat facets, which limit a ray tube on each triangle."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F32, F64, I64, unit_rows
from sarmitsuba.scene.mesh.pieces import SMOOTH_BEND, piece_sizes
from sarmitsuba.scene.mesh.topology import edge_pairs, label_connected, twins, weld

# bend (rad) times width (wavelengths) below which narrow flat strips count as one surface: pi / 8 of phase
LARGEST_BEND = 1.0 / 16.0
# bend below which two triangles lie in one plane, rad
FLAT_BEND = 1e-4
N_EDGES = 4
# most sides of a facet that is cut into convex parts: those of a disc would be slivers
MOST_SIDES = 24
# number of edges away up to which triangles of the same facet contribute their boundary edges
RINGS = 3
# pairs of triangles compared at a time; bounds the memory
PAIRS = 200_000
# triangles whose neighbourhoods are searched at a time
SLAB = 20_000
# relative rounding of a coordinate in a float32 file
FLOAT32 = 2.0**-23
# distance of vertices from a straight boundary edge, wavelengths, and bend there (rad) up to which they are on it
STRAIGHT, LARGEST_TURN = 1e-3, 0.5
# least share of a triangle's width along a boundary edge that the edge must cover to limit it
FACING = 0.5


@dataclass(frozen=True, eq=False)
class Facets:
    """Boundary edges that limit a ray tube on each triangle.

    Parameters
    ----------
    edges : (n_faces, 4, 4) float32, up to four boundary edges ``(m_x, m_y, m_z, c)`` with ``m`` the unit vector in the
        plane, into the facet, and ``m . (p - corner 0) - c`` the distance from the edge in m; unused: ``(0, 0, 0, -1)``
    uncreased : the same if every bend below ``SMOOTH_BEND`` continued the surface; None where no boundary bends less
    part : (n_faces,) number of the facet, or of its convex part, to which ``edges`` belong
    closed : (n_faces,) whether ``edges`` enclose the part, and are the same for all its triangles
    inner : (n_faces, 4) ``edges`` that are cuts between convex parts: the facet continues in its plane beyond them
    """

    edges: F32
    uncreased: F32 | None
    part: I64
    closed: NDArray[np.bool_]
    inner: NDArray[np.bool_]


def facets(
    corners: F64,
    vertex: I64 | None = None,
    curved: NDArray[np.bool_] | None = None,
    wavelength: float = 0.0,
    pairs: tuple[I64, I64] | None = None,
) -> Facets:
    """Flat facet of each triangle, and its boundary edges.

    The surface continues across an edge where both neighbours lie in one plane, or where they bend less than
    ``SMOOTH_BEND`` and both approximate a curved surface or are so narrow that bend times width is below
    ``LARGEST_BEND`` wavelengths (the strips of a cone, whose tip has no curvature). Every other edge is a boundary,
    even a crease of one degree.

    All triangles of a convex facet with up to four straight boundary edges have these. Other facets without inner
    vertices are cut into triangles and convex quadrilaterals with their own boundary edges: the cuts are boundaries
    too, and the area that a tube loses on one side of a cut it has on the other. In finer meshed facets a triangle has
    its own boundary edges, and those of triangles up to ``RINGS`` edges away that it lies inside of and mostly faces,
    nearest first.

    Parameters
    ----------
    corners : (n_faces, 3, 3) float64, m
    vertex : (3 n_faces,) welded vertex of every corner; None: computed here
    curved : (n_faces,) triangles that approximate a curved surface, see :mod:`sarmitsuba.scene.mesh.smooth_surface`;
        None: none
    wavelength : m; 0 makes every bend a boundary
    pairs : of :func:`sarmitsuba.scene.mesh.topology.edge_pairs`; None: computed here

    Notes
    -----
    Ignores T-junctions (the edges there count as boundaries), a fifth boundary edge in finely meshed facets, and
    boundary edges that limit only part of a triangle.
    """
    n = corners.shape[0]
    vertex = weld(corners.reshape(-1, 3)) if vertex is None else vertex
    pairs = edge_pairs(vertex) if pairs is None else pairs
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = unit_rows(normal)
    along = np.roll(corners, -1, axis=1) - corners
    length = np.linalg.norm(along, axis=2)
    along /= np.maximum(length, 1e-300)[:, :, None]
    inward = np.cross(normal[:, None, :], along)
    # float32 files rotate small triangles far from the origin
    rounding = FLOAT32 * _largest(corners)
    height = np.linalg.norm(np.cross(along[:, 0], corners[:, 2] - corners[:, 0]), axis=1) * length[:, 0]
    height /= np.maximum(length.max(axis=1), 1e-300)
    tilt = rounding / np.maximum(height, 1e-300)

    # both sides of the edges that the surface may continue across, one side after the other
    one, two = pairs
    sides = inward.reshape(-1, 3)
    inward_1, inward_2 = sides[one], sides[two]
    bend = np.einsum("ei,ei->e", inward_1, inward_2)  # -1: flat
    goes_on = np.flatnonzero(bend < -np.cos(SMOOTH_BEND))
    one, two = one[goes_on], two[goes_on]
    here, there = np.concatenate([one, two]), np.concatenate([two, one])
    own, other = here // 3, there // 3
    # sine of a tiny bend from the difference of the normals: the cosine loses all digits
    across = np.concatenate([inward_2[goes_on], inward_1[goes_on]])
    off_plane = np.abs(np.einsum("ei,ei->e", across, normal[own]))
    flat = off_plane < FLAT_BEND + np.maximum(tilt[own], tilt[other])  # tilt of both, so that they agree
    mate = np.full(3 * n, -1, dtype=np.int64)
    mate[here[flat]] = other[flat]
    facet = label_connected(n, own[flat], other[flat])
    smooth = flat if curved is None else flat | (curved[own] & curved[other])
    if wavelength > 0.0 and not smooth.all():
        width = piece_sizes(corners, facet)[1]
        narrow = off_plane * np.maximum(width[own], width[other]) < LARGEST_BEND * wavelength
        smooth = smooth | narrow

    sharp = np.ones(3 * n, dtype=bool)
    sharp[here[smooth]] = False
    ids, mate = vertex.reshape(n, 3), mate.reshape(n, 3)
    # outlines are as little straight as facets are flat, see :mod:`sarmitsuba.scene.mesh.flattening`
    rounding = np.maximum(rounding, STRAIGHT * wavelength)
    edges = _TriangleEdges(corners, ids, along, inward, length, rounding, sharp.reshape(n, 3), mate)
    outlines = _outlines(edges, facet, np.arange(n))
    # the whole facet, where a neighbour in the plane continues as a curved surface
    opens = np.bincount(outlines.part[own[smooth & ~flat]], minlength=int(outlines.part.max(initial=-1)) + 1)
    closed = ~outlines.fine & (opens[outlines.part] == 0)
    uncreased = None
    if not smooth.all():
        sharp[here] = False
        bounded = np.zeros(n, dtype=bool)
        bounded[facet[own[~smooth]]] = True  # by a crease
        faces = np.flatnonzero(bounded[facet])
        uncreased = outlines.edges.copy()
        uncreased[faces] = _outlines(replace(edges, sharp=sharp.reshape(n, 3)), facet, faces).edges[faces]
    return Facets(outlines.edges, uncreased, outlines.part, closed, outlines.inner)


@dataclass(frozen=True, eq=False)
class _TriangleEdges:
    """Edges of all triangles.

    Parameters
    ----------
    corners : (n, 3, 3), m
    ids : (n, 3) welded vertices of the corners
    along, inward : (n, 3, 3) unit vectors of edge k from corner k to the next
    length : (n, 3), m
    rounding : (n,), m, of the corners
    sharp : (n, 3) boundaries of facets
    mate : (n, 3) triangle of the same plane across the edge, -1 for none
    """

    corners: F64
    ids: I64
    along: F64
    inward: F64
    length: F64
    rounding: F64
    sharp: NDArray[np.bool_]
    mate: I64

    def own(self, faces: I64) -> F64:
        """(len(faces), N_EDGES, 4) boundary edges of each triangle alone."""
        lines = _make_unused(faces.size)
        row, k = np.nonzero(self.sharp[faces])
        inward, start = self.inward[faces[row], k], self.corners[faces[row], k]
        offset = np.einsum("ei,ei->e", inward, start - self.corners[faces[row], 0])
        lines[row, k] = np.column_stack([inward, offset])
        return lines


@dataclass(frozen=True, eq=False)
class _FacetOutlines:
    """Boundary edges of selected triangles; arrays as in :class:`Facets`, of all triangles.

    Parameters
    ----------
    fine : (n,) selected triangles of finely meshed facets, whose triangles have different boundary edges
    """

    edges: F32
    part: I64
    inner: NDArray[np.bool_]
    fine: NDArray[np.bool_]


def _outlines(edges: _TriangleEdges, facet: I64, faces: I64) -> _FacetOutlines:
    """Boundary edges of the triangles ``faces``, which are all those of some facets."""
    n = len(facet)
    boundary = _make_unused(n).astype(np.float32)
    inner, fine = np.zeros((n, N_EDGES), dtype=bool), np.zeros(n, dtype=bool)
    alone = (edges.mate[faces] < 0).all(axis=1)
    boundary[faces[alone]] = edges.own(faces[alone])
    shared = faces[~alone]
    simple, lines = _simple_facets(edges, facet, shared)
    boundary[shared[simple]] = lines[simple]
    shared = shared[~simple]
    whole = _lacks_inner_vertices(edges, facet, shared)
    if whole.any():
        cut = shared[whole]
        pairs = _pair_triangles(edges, cut)
        row, k = np.nonzero(pairs.mate >= 0)
        facet = label_connected(n, row, pairs.mate[row, k])
        simple, lines = _simple_facets(pairs, facet, cut)
        lines[~simple] = edges.own(cut[~simple])
        inner[cut] = _cuts(pairs, edges.mate, cut, lines)
        boundary[cut] = lines
        shared = shared[~whole]
    fine[shared] = True
    for slab in np.array_split(shared, 1 + shared.size // SLAB):
        near = _around(edges, slab)
        count = (near >= 0).sum(axis=1)
        for most in np.unique(count[count > 0]):
            rows = np.flatnonzero(count == most)
            for some in np.array_split(rows, 1 + rows.size * most**2 // PAIRS):
                boundary[slab[some]] = _limits(edges, slab[some], near[some, :most])
    return _FacetOutlines(boundary, facet, inner, fine)


def _make_unused(n: int) -> F64:
    """(n, N_EDGES, 4) boundary edges that limit nothing."""
    return np.tile([0.0, 0.0, 0.0, -1.0], (n, N_EDGES, 1))


def _largest(values: F64) -> F64:
    """Largest modulus in each row (n,) of an array (n, 3, 3)."""
    columns = np.abs(values.reshape(-1, 9).T)
    return np.asarray(np.maximum.reduce(columns))


def _simple_facets(edges: _TriangleEdges, facet: I64, faces: I64) -> tuple[NDArray[np.bool_], F64]:
    """Which of ``faces`` lie in a convex facet with at most ``N_EDGES`` boundary edges, and these edges (others: any).

    Returns
    -------
    simple : (len(faces),)
    lines : (len(faces), N_EDGES, 4) float64, as in :class:`Facets`
    """
    if not faces.size:
        return np.zeros(0, dtype=bool), np.zeros((0, N_EDGES, 4))
    facet = _renumber_labels(facet[faces])
    count = int(facet.max()) + 1
    origin = np.zeros((count, 3))
    origin[facet] = edges.corners[faces, 0]
    points = edges.corners[faces] - origin[facet][:, None]
    size = np.zeros(count)
    np.maximum.at(size, facet, _largest(points))
    rounding = np.zeros(count)
    np.maximum.at(rounding, facet, edges.rounding[faces])
    slack = 1e-6 * size + 3.0 * rounding

    own, k = np.nonzero(edges.sharp[faces])
    line = _straight(edges, facet, faces, own, k)
    first = np.zeros(int(line.max(initial=-1)) + 1, dtype=np.int64)  # an edge of every line
    first[line[::-1]] = np.arange(line.size)[::-1]
    share = edges.length[faces[own], k]
    inward = _sums(line, edges.inward[faces[own], k] * share[:, None])
    inward = unit_rows(inward)
    middle = points[own, k] + 0.5 * (edges.along[faces[own], k] * share[:, None])
    offset = _sums(line, np.einsum("ei,ei->e", inward[line], middle)[:, None] * share[:, None])[:, 0]
    offset /= np.maximum(_sums(line, share[:, None])[:, 0], 1e-300)
    of = facet[own[first]]
    order = np.argsort(of, kind="stable")
    lines = np.bincount(of, minlength=count)
    column = np.arange(order.size) - np.repeat(np.cumsum(lines) - lines, lines)
    few = (lines <= N_EDGES)[of[order]]
    table = _make_unused(count)
    kept = order[few]
    table[of[kept], column[few]] = np.column_stack([inward[kept], offset[kept]])

    found = table[facet]
    x, y, z = np.ascontiguousarray(points.T)  # by corner and triangle
    outside = np.zeros(count, dtype=bool)
    for line_of in np.moveaxis(found, 1, 0):
        m_x, m_y, m_z, c = np.ascontiguousarray(line_of.T)
        low = np.minimum.reduce(m_x * x + m_y * y + m_z * z) - c
        outside[facet[low < -slack[facet]]] = True
    # edges of a line are on it: those of a curved outline are not
    for step in (0, 1):
        ends = points[own, (k + step) % 3]
        height = np.einsum("ei,ei->e", inward[line], ends) - offset[line]
        outside[facet[own[np.abs(height) > slack[facet[own]]]]] = True
    found[:, :, 3] -= np.einsum("fsi,fi->fs", found[:, :, :3], points[:, 0])
    return ((lines <= N_EDGES) & ~outside)[facet], found


def _renumber_labels(label: I64) -> I64:
    """Labels without gaps, in the same order; they are small and not negative."""
    occurs = np.zeros(int(label.max()) + 1, dtype=bool)
    occurs[label] = True
    return np.asarray((np.cumsum(occurs) - 1)[label])


def _lacks_inner_vertices(edges: _TriangleEdges, facet: I64, faces: I64) -> NDArray[np.bool_]:
    """Whether each of ``faces`` lies in a facet of few sides with about as few triangles as its outline allows."""
    triangles = np.bincount(facet)
    outline = np.bincount(facet, edges.sharp.sum(axis=1))
    few = (triangles <= outline + 4) & (outline <= MOST_SIDES)
    return np.asarray(few[facet[faces]])


def _pair_triangles(edges: _TriangleEdges, faces: I64) -> _TriangleEdges:
    """Cut the facets of ``faces`` into triangles and convex pairs of triangles; the narrowest are paired first."""
    inside = np.zeros(len(edges.corners), dtype=bool)
    inside[faces] = True
    row, k = np.nonzero((edges.mate >= 0) & inside[:, None])
    other = edges.mate[row, k]
    once = row < other
    row, k, other = row[once], k[once], other[once]
    ends = np.stack([edges.ids[row, k], edges.ids[row, (k + 1) % 3]], axis=1)
    far = (edges.ids[other][:, :, None] != ends[:, None, :]).all(axis=2).argmax(axis=1)
    point = edges.corners[other, far]
    slack = 1e-6 * edges.length[row].max(axis=1) + 2.0 * edges.rounding[row]
    convex = np.ones(row.size, dtype=bool)
    for step in (1, 2):
        side = (k + step) % 3
        height = np.einsum("ei,ei->e", edges.inward[row, side], point - edges.corners[row, side])
        convex &= height > -slack
    mate = np.where(inside[:, None], -1, edges.mate)
    height = np.zeros(len(inside))
    sides = edges.corners[faces, 1:] - edges.corners[faces, :1]
    height[faces] = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / edges.length[faces].max(
        axis=1
    )
    narrowest = np.minimum(height[row], height[other])
    left = np.flatnonzero(convex)[np.lexsort((-edges.length[row, k][convex], narrowest[convex]))]
    while left.size:  # those that come first among all of both their triangles
        rank, best = np.arange(left.size), np.full(len(inside), left.size)
        a, b = row[left], other[left]
        np.minimum.at(best, a, rank)
        np.minimum.at(best, b, rank)
        chosen = (best[a] == rank) & (best[b] == rank)
        mate[a[chosen], k[left[chosen]]] = b[chosen]
        mate[b[chosen], (edges.mate[b[chosen]] == a[chosen, None]).argmax(axis=1)] = a[chosen]
        taken = np.zeros(len(inside), dtype=bool)
        taken[a[chosen]] = taken[b[chosen]] = True
        left = left[~(taken[a] | taken[b])]
    return replace(edges, mate=mate, sharp=np.where(inside[:, None], mate < 0, edges.sharp))


def _cuts(pairs: _TriangleEdges, mate: I64, faces: I64, lines: F64) -> NDArray[np.bool_]:
    """(len(faces), N_EDGES) boundary edges that are cuts within a facet; ``mate`` (n, 3): of the uncut facets."""
    found = {cut: np.zeros(lines.shape[:2], dtype=bool) for cut in (True, False)}
    # edges of the triangle itself and of its mate in the convex part
    other = np.where(pairs.mate[faces] >= 0, pairs.mate[faces], -1).max(axis=1)
    for owner in (faces, np.where(other >= 0, other, faces)):
        for k in range(3):
            start = pairs.corners[owner, k] - pairs.corners[faces, 0]
            height = np.einsum("fli,fi->fl", lines[:, :, :3], start) - lines[:, :, 3]
            slack = 1e-6 * pairs.length[owner].max(axis=1) + 2.0 * pairs.rounding[owner]
            on = np.einsum("fli,fi->fl", lines[:, :, :3], pairs.inward[owner, k]) > 1.0 - FLAT_BEND
            on &= (np.abs(height) < slack[:, None]) & pairs.sharp[owner, k][:, None]
            goes_on = (mate[owner, k] >= 0)[:, None]
            found[True] |= on & goes_on
            found[False] |= on & ~goes_on
    return np.asarray(found[True] & ~found[False])


def _straight(
    edges: _TriangleEdges,
    facet: I64,
    faces: I64,
    own: I64,
    k: I64,
) -> I64:
    """Number of the straight boundary edge of which each sharp edge (``k`` of ``faces[own]``) is a piece."""
    n = own.size
    face = faces[own]
    ends = np.concatenate([edges.ids[face, k], edges.ids[face, (k + 1) % 3]])
    edge = np.tile(np.arange(n), 2)
    key = np.tile(facet[own], 2) * (int(edges.ids.max()) + 1) + ends
    a, b = (edge[end] for end in twins(key))  # corners of the facet where just two of its edges meet
    inward, length = edges.inward[face, k], edges.length[face, k]
    bend = np.linalg.norm(np.cross(inward[a], inward[b]), axis=1)
    allowed = FLAT_BEND + 6.0 * edges.rounding[face[a]] / np.maximum(np.minimum(length[a], length[b]), 1e-300)
    go_on = (bend < np.minimum(allowed, LARGEST_TURN)) & (np.einsum("ei,ei->e", inward[a], inward[b]) > 0.0)
    return label_connected(n, a[go_on], b[go_on])


def _sums(group: I64, rows: F64) -> F64:
    """Sums of the rows of each group."""
    # of no rows the counts are integers
    return np.stack([np.bincount(group, column) for column in rows.T], axis=1).astype(np.float64, copy=False)


def _limits(edges: _TriangleEdges, faces: I64, near: I64) -> F64:
    """(len(faces), N_EDGES, 4) boundary edges of each triangle, chosen from edges ``near`` (n, m), nearest first."""
    n = len(faces)
    inward, along = edges.inward.reshape(-1, 3)[near], edges.along.reshape(-1, 3)[near]
    length = edges.length.reshape(-1)[near]
    corner = edges.corners[faces, 0]
    start = edges.corners.reshape(-1, 3)[near] - corner[:, None]
    offset = np.einsum("nsi,nsi->ns", inward, start)
    points = edges.corners[faces] - corner[:, None]
    slack = 1e-6 * np.abs(points).max(axis=(1, 2)) + 2.0 * edges.rounding[faces]

    height = np.einsum("nsi,npi->nsp", inward, points) - offset[:, :, None]
    valid = (height > -slack[:, None, None]).all(axis=2)
    lowest = height.min(axis=2)
    # share of the triangle's width along the edge that the edge covers; pieces of one straight edge together
    position = np.einsum("nsi,npi->nsp", along, points) - np.einsum("nsi,nsi->ns", along, start)[:, :, None]
    low, high = position.min(axis=2), position.max(axis=2)
    cover = np.clip(np.minimum(high, length) - np.maximum(low, 0.0), 0.0, None) / np.maximum(
        high - low, 1e-300
    )
    same = np.einsum("nsi,nri->nsr", inward, inward) > 1.0 - FLAT_BEND**2
    same &= np.abs(offset[:, :, None] - offset[:, None, :]) < slack[:, None, None]
    covered = np.einsum("nsr,nr->ns", same, np.where(valid, cover, 0.0))
    valid &= covered > FACING

    out = _make_unused(n)
    row = np.arange(n)
    for k in range(N_EDGES):
        best = np.where(valid, lowest, np.inf).argmin(axis=1)
        found = valid[row, best]
        nearest = np.concatenate([inward[row, best], offset[row, best][:, None]], axis=1)
        out[found, k] = nearest[found]
        valid &= ~same[row, best]
        valid[row, best] = False
    return out


def _around(edges: _TriangleEdges, faces: I64) -> I64:
    """(n, m) boundary edges of the same plane up to ``RINGS`` triangles away, three times the triangle's number plus k.

    Those of the triangle of the highest number first; -1 pads.
    """
    front = faces[:, None]
    rings = [front]
    for _ in range(RINGS):
        front = np.where(front[:, :, None] >= 0, edges.mate[front], -1).reshape(
            len(faces), 3 * front.shape[1]
        )
        rings.append(front)
    found = -np.sort(-np.concatenate(rings, axis=1), axis=1)
    found[:, 1:][found[:, 1:] == found[:, :-1]] = -1
    sharp = edges.sharp[found] & (found >= 0)[:, :, None]
    row, near, k = np.nonzero(sharp)
    count = sharp.sum(axis=(1, 2))
    out = np.full((len(faces), int(count.max(initial=0))), -1, dtype=np.int64)
    out[row, np.arange(row.size) - np.repeat(np.cumsum(count) - count, count)] = 3 * found[row, near] + k
    return out
