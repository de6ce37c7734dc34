"""Boundary edges of flat facets, which limit a ray tube on each triangle."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.arrays import F32, F64, I64
from sarmitsuba.mesh.connected import connected
from sarmitsuba.mesh.pieces import SMOOTH_BEND, piece_sizes
from sarmitsuba.mesh.welding import weld

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
# least share of a triangle's width along a boundary edge that the edge must cover to limit it
FACING = 0.5


@dataclass(frozen=True, eq=False)
class Facets:
    """Boundary edges that limit a ray tube on each triangle.

    Parameters
    ----------
    edges : (n_faces, 4, 4) float32, up to four boundary edges ``(m_x, m_y, m_z, c)`` with ``m`` the unit vector in the
        plane, into the facet, and ``m . (p - corner 0) - c`` the distance from the edge in m; unused: ``(0, 0, 0, -1)``
    part : (n_faces,) number of the facet, or of its convex part, to which these edges belong
    creased : whether some boundary bends less than ``SMOOTH_BEND``
    closed : (n_faces,) whether these edges enclose the part, and are the same for all its triangles
    inner : (n_faces, 4) cuts between convex parts: the facet continues in its plane beyond them
    """

    edges: F32
    part: I64
    creased: bool
    closed: NDArray[np.bool_]
    inner: NDArray[np.bool_]


def boundary_edges(
    corners: F64,
    vertex: I64 | None = None,
    curved: NDArray[np.bool_] | None = None,
    wavelength: float = 0.0,
) -> F32:
    """Boundary edges of each triangle, see :func:`facets`."""
    return facets(corners, vertex, curved, wavelength).edges


def facets(
    corners: F64,
    vertex: I64 | None = None,
    curved: NDArray[np.bool_] | None = None,
    wavelength: float = 0.0,
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
    curved : (n_faces,) triangles that approximate a curved surface, see :mod:`sarmitsuba.mesh.curvature`; None: none
    wavelength : m; 0 makes every bend a boundary

    Notes
    -----
    Ignores T-junctions (the edges there count as boundaries), a fifth boundary edge in finely meshed facets, and
    boundary edges that limit only part of a triangle.
    """
    n = corners.shape[0]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    start, end = corners, np.roll(corners, -1, axis=1)
    along = end - start
    length = np.linalg.norm(along, axis=2)
    along /= np.maximum(length, 1e-300)[:, :, None]
    inward = np.cross(normal[:, None, :], along)

    vertex = weld(corners.reshape(-1, 3)) if vertex is None else vertex
    mate, mates_inward = _neighbours(vertex, inward)
    bend = np.einsum("fki,fki->fk", inward, mates_inward)  # -1: flat
    goes_on = (mate >= 0) & (bend < -np.cos(SMOOTH_BEND))
    # sine of a tiny bend from the difference of the normals: the cosine loses all digits
    off_plane = np.abs(np.einsum("fki,fi->fk", mates_inward, normal))
    # float32 files rotate small triangles far from the origin
    rounding = FLOAT32 * np.abs(corners).max(axis=(1, 2))
    height = np.linalg.norm(np.cross(along[:, 0], start[:, 2] - start[:, 0]), axis=1) * length[:, 0]
    height /= np.maximum(length.max(axis=1), 1e-300)
    tilt = rounding / np.maximum(height, 1e-300)
    # of both triangles, so that they agree
    flat = goes_on & (off_plane < FLAT_BEND + np.maximum(tilt[:, None], tilt[mate]))
    smooth = flat if curved is None else flat | (goes_on & curved[:, None] & curved[mate])
    if wavelength > 0.0 and (goes_on & ~smooth).any():
        width = piece_sizes(corners, _connected(np.where(flat, mate, -1)))[1]
        across = off_plane * np.maximum(width[:, None], width[mate])
        smooth = smooth | (goes_on & (across < LARGEST_BEND * wavelength))

    sharp = ~smooth
    boundary = _unused(n)
    inner = np.zeros((n, N_EDGES), dtype=bool)
    offset = np.einsum("fki,fki->fk", inward, start - corners[:, :1])
    boundary[:, :3][sharp] = np.concatenate([inward, offset[:, :, None]], axis=2)[sharp]

    ids = vertex.reshape(n, 3)
    edges = _TriangleEdges(corners, ids, along, inward, length, rounding, sharp, np.where(flat, mate, -1))
    part = edges.facet()
    shared = np.flatnonzero(flat.any(axis=1))
    if shared.size:
        shared = shared[~_simple_facets(edges, shared, boundary)]
    whole = _without_inner_vertices(edges, part, shared)
    if whole.any():
        pairs = _paired(edges, shared[whole])
        part = pairs.facet()
        _simple_facets(pairs, shared[whole], boundary)
        inner[shared[whole]] = _cuts(pairs, edges.mate, shared[whole], boundary)
        shared = shared[~whole]
    closed = ~(smooth & ~flat).any(axis=1)
    # the whole facet, where a neighbour in the plane continues as a curved surface
    closed = np.bincount(part, ~closed)[part] == 0
    closed[shared] = False
    for slab in np.array_split(shared, 1 + shared.size // SLAB):
        near = _around(edges.mate, slab)
        near = np.where((near >= 0) & sharp[near].any(axis=2), near, -1)
        count = (near >= 0).sum(axis=1)
        for most in np.unique(count[count > 0]):
            rows = np.flatnonzero(count == most)
            for some in np.array_split(rows, 1 + rows.size * most**2 // PAIRS):
                boundary[slab[some]] = _limits(edges, slab[some], -np.sort(-near[some], axis=1)[:, :most])
    return Facets(boundary.astype(np.float32), part, bool((goes_on & ~smooth).any()), closed, inner)


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

    def facet(self) -> I64:
        """(n,) number of the facet of each triangle."""
        return _connected(self.mate)


def _connected(mate: I64) -> I64:
    """Connected part of each triangle, with ``mate`` (n, 3) across its edges, -1 for none."""
    row, k = np.nonzero(mate >= 0)
    return connected(len(mate), row, mate[row, k])


def _simple_facets(edges: _TriangleEdges, faces: I64, boundary: F64) -> NDArray[np.bool_]:
    """Fill in the rows of ``faces`` whose facet is convex with at most ``N_EDGES`` boundary edges; returns which."""
    facet = np.unique(edges.facet()[faces], return_inverse=True)[1]
    count = int(facet.max()) + 1
    origin = np.zeros((count, 3))
    origin[facet] = edges.corners[faces, 0]
    size = np.zeros(count)
    points = edges.corners[faces] - origin[facet][:, None]
    np.maximum.at(size, facet, np.abs(points).max(axis=(1, 2)))
    rounding = np.zeros(count)
    np.maximum.at(rounding, facet, edges.rounding[faces])
    slack = 1e-6 * size + 2.0 * rounding

    own, k = np.nonzero(edges.sharp[faces])
    line = _straight(edges, facet, faces, own, k)
    first = np.unique(line, return_index=True)[1]  # an edge of every line
    share = edges.length[faces[own], k]
    inward = _sums(line, edges.inward[faces[own], k] * share[:, None])
    inward /= np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-300)
    middle = points[own, k] + 0.5 * (edges.along[faces[own], k] * share[:, None])
    offset = _sums(line, np.einsum("ei,ei->e", inward[line], middle)[:, None] * share[:, None])[:, 0]
    offset /= np.maximum(_sums(line, share[:, None])[:, 0], 1e-300)
    of = facet[own[first]]
    order = np.argsort(of, kind="stable")
    lines = np.bincount(of, minlength=count)
    column = np.arange(order.size) - np.repeat(np.cumsum(lines) - lines, lines)
    few = (lines <= N_EDGES)[of[order]]
    table = _unused(count)
    kept = order[few]
    table[of[kept], column[few]] = np.column_stack([inward[kept], offset[kept]])

    mine = table[facet]
    height = np.einsum("fsi,fpi->fsp", mine[:, :, :3], points) - mine[:, :, 3:]
    outside = np.zeros(count, dtype=bool)
    np.logical_or.at(outside, facet, (height < -slack[facet][:, None, None]).any(axis=(1, 2)))
    simple = ((lines <= N_EDGES) & ~outside)[facet]
    used = (mine[:, :, :3] != 0.0).any(axis=2)
    mine[:, :, 3] -= np.where(used, np.einsum("fsi,fi->fs", mine[:, :, :3], points[:, 0]), 0.0)
    boundary[faces[simple]] = mine[simple]
    return np.asarray(simple)


def _without_inner_vertices(edges: _TriangleEdges, facet: I64, faces: I64) -> NDArray[np.bool_]:
    """Whether each of ``faces`` lies in a facet of few sides with about as few triangles as its outline allows."""
    triangles = np.bincount(facet)
    outline = np.bincount(facet, edges.sharp.sum(axis=1))
    few = (triangles <= outline + 4) & (outline <= MOST_SIDES)
    return np.asarray(few[facet[faces]])


def _paired(edges: _TriangleEdges, faces: I64) -> _TriangleEdges:
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
    free = inside.copy()
    sides = edges.corners[:, 1:] - edges.corners[:, :1]
    height = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / edges.length.max(axis=1)
    narrowest = np.minimum(height[row], height[other])
    for e in np.flatnonzero(convex)[np.lexsort((-edges.length[row, k][convex], narrowest[convex]))]:
        a, b = int(row[e]), int(other[e])
        if free[a] and free[b]:
            free[a] = free[b] = False
            mate[a, k[e]] = b
            mate[b, (edges.mate[b] == a).argmax()] = a
    return replace(edges, mate=mate, sharp=np.where(inside[:, None], mate < 0, edges.sharp))


def _cuts(pairs: _TriangleEdges, mate: I64, faces: I64, boundary: F64) -> NDArray[np.bool_]:
    """(len(faces), N_EDGES) boundary edges that are cuts within a facet; ``mate`` (n, 3): of the uncut facets."""
    lines = boundary[faces]
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
    a, b = (edge[end] for end in _twins(key))  # corners of the facet where just two of its edges meet
    inward, length = edges.inward[face, k], edges.length[face, k]
    bend = np.linalg.norm(np.cross(inward[a], inward[b]), axis=1)
    allowed = FLAT_BEND + 2.0 * edges.rounding[face[a]] / np.maximum(np.minimum(length[a], length[b]), 1e-300)
    go_on = (bend < allowed) & (np.einsum("ei,ei->e", inward[a], inward[b]) > 0.0)
    return connected(n, a[go_on], b[go_on])


def _sums(group: I64, rows: F64) -> F64:
    """Sums of the rows of each group."""
    out = np.zeros((int(group.max(initial=-1)) + 1, rows.shape[1]))
    np.add.at(out, group, rows)
    return out


def _limits(edges: _TriangleEdges, faces: I64, near: I64) -> F64:
    """(len(faces), N_EDGES, 4) boundary edges of each triangle, chosen from those of ``near`` (n, m), nearest first."""
    n = len(faces)
    valid = edges.sharp[near].reshape(n, -1)
    inward = edges.inward[near].reshape(n, -1, 3)
    along = edges.along[near].reshape(n, -1, 3)
    length = edges.length[near].reshape(n, -1)
    corner = edges.corners[faces, 0]
    start = edges.corners[near].reshape(n, -1, 3) - corner[:, None]
    offset = np.einsum("nsi,nsi->ns", inward, start)
    points = edges.corners[faces] - corner[:, None]
    slack = 1e-6 * np.abs(points).max(axis=(1, 2)) + 2.0 * edges.rounding[faces]

    height = np.einsum("nsi,npi->nsp", inward, points) - offset[:, :, None]
    valid &= (height > -slack[:, None, None]).all(axis=2)
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

    out = _unused(n)
    row = np.arange(n)
    for k in range(N_EDGES):
        best = np.where(valid, lowest, np.inf).argmin(axis=1)
        found = valid[row, best]
        nearest = np.concatenate([inward[row, best], offset[row, best][:, None]], axis=1)
        out[found, k] = nearest[found]
        valid &= ~same[row, best]
        valid[row, best] = False
    return out


def _around(mate: I64, faces: I64) -> I64:
    """(n, m) triangles of the same plane up to ``RINGS`` edges away, with the triangle itself; -1 pads."""
    front = faces[:, None]
    rings = []
    for _ in range(RINGS):
        front = np.where(front[:, :, None] >= 0, mate[front], -1).reshape(len(faces), 3 * front.shape[1])
        rings.append(front)
    found = np.sort(np.concatenate([faces[:, None], *rings], axis=1), axis=1)
    found[:, 1:][found[:, 1:] == found[:, :-1]] = -1
    return found


def _neighbours(vertex: I64, inward: F64) -> tuple[I64, F64]:
    """Face across each edge (-1: none, or more than one) and that face's inward vector at the common edge."""
    n = inward.shape[0]
    ids = vertex.reshape(n, 3)
    start, end = ids, np.roll(ids, -1, axis=1)
    key = (np.minimum(start, end) * (ids.max() + 1) + np.maximum(start, end)).ravel()
    a, b = _twins(key)
    mate = np.full(3 * n, -1, dtype=np.int64)
    mate[a], mate[b] = b // 3, a // 3
    across = np.zeros((3 * n, 3))
    flat_inward = inward.reshape(-1, 3)
    across[a], across[b] = flat_inward[b], flat_inward[a]
    return mate.reshape(n, 3), across.reshape(n, 3, 3)


def _twins(key: I64) -> tuple[I64, I64]:
    """First and second index of every value that occurs exactly twice; values are not negative."""
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    pair = first[np.diff(first, append=len(key)) == 2]
    return order[pair], order[pair + 1]


def _unused(n: int) -> F64:
    """(n, N_EDGES, 4) boundary edges that limit nothing."""
    return np.tile([0.0, 0.0, 0.0, -1.0], (n, N_EDGES, 1))
