"""Smooth surface through the corners of facets: its curvature, its distance from them, and finer facets on it."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I32, I64, unit_rows
from sarmitsuba.core.errors import SceneError
from sarmitsuba.scene.mesh.smooth_groups import smooth_groups
from sarmitsuba.scene.mesh.topology import edge_pairs, weld

# largest distance of the smooth surface from its facet, wavelengths: beyond it the facet is taken as flat
LARGEST_SAGITTA = 1.0 / 8.0
# largest angle between a corner's mean normal and the facet's normal in a smooth surface
LARGEST_LEAN = np.radians(30.0)
_FLAT = 1e-6  # rad, bend below which a facet counts as flat
_SAME_CURVATURE = 1e-8  # difference of normals that cannot bend a facet by that much


def facet_curvature(
    corners: F64,
    group: I32 | I64,
    wavelength: float,
    vertex: I64 | None = None,
) -> F64 | None:
    r"""Shape operator of the smooth surface that the facets of each group approximate.

    With :math:`\mathbf n_i` the mean normals at a facet's corners, weighted by the angles of the facets there,

    .. math:: d\mathbf n = S\, d\mathbf p

    is fitted to their differences along its edges and made symmetric.

    Parameters
    ----------
    corners : (n_faces, 3, 3) float64, m
    group : (n_faces,) smooth group of each face
    wavelength : m
    vertex : (3 n_faces,) welded vertex of every corner; None: computed here

    Returns
    -------
    (n_faces, 8) float64, 1/m: S_xx, S_yy, S_zz, S_xy, S_xz, S_yz of the face's normal, two unused; zero for flat
        facets, and for those so large that the surface would lie more than an eighth of a wavelength off them. None
        when all are zero

    Notes
    -----
    Ignores groups whose facets are not wound alike (their normals cancel; they stay flat).
    """
    side_1, side_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(side_1, side_2)
    normal = unit_rows(normal)
    if not _bent(normal, group):
        return None
    first = np.zeros(int(group.max()) + 1, dtype=np.int64)
    first[group[::-1]] = np.arange(group.size)[::-1]
    differs = (np.abs(normal - normal[first[group]]) > _SAME_CURVATURE).any(axis=1)
    curved = np.zeros(first.size, dtype=bool)
    curved[group[differs]] = True
    faces = np.flatnonzero(curved[group])
    vertex = weld(corners[faces].reshape(-1, 3)) if vertex is None else vertex.reshape(-1, 3)[faces].ravel()
    mean = _mean_normals(corners[faces], normal[faces], vertex, group[faces])
    lean = np.abs(mean - normal[faces, None]) > _SAME_CURVATURE
    rows = np.flatnonzero(lean.any(axis=(1, 2)))
    faces = faces[rows]
    operator = _shape_operator(corners[faces], normal[faces], mean[rows], wavelength)
    if not operator.any():
        return None
    out = np.zeros((group.size, 8))
    out[faces, :3] = operator[:, [0, 1, 2], [0, 1, 2]]
    out[faces, 3:6] = operator[:, [0, 0, 1], [1, 2, 2]]
    return out


def _mean_normals(corners: F64, normal: F64, vertex: I64, group: I32 | I64) -> F64:
    """(n, 3, 3) mean normals at the corners of each facet, of all facets of its group there."""
    edge = np.roll(corners, -1, axis=1) - corners
    unit = unit_rows(edge)
    angle = np.arccos(np.clip(-np.einsum("fki,fki->fk", unit, np.roll(unit, 1, axis=1)), -1.0, 1.0))
    # one label per vertex and group: surfaces that meet at an edge keep their own normals there
    key = vertex * (int(group.max()) + 1) + np.repeat(group.astype(np.int64), 3)
    _, label = np.unique(key, return_inverse=True)
    label = label.reshape(-1)
    weighted = (angle[:, :, None] * normal[:, None, :]).reshape(-1, 3)
    sums = np.stack([np.bincount(label, weighted[:, i]) for i in range(3)], axis=1)
    mean = unit_rows(sums.astype(np.float64, copy=False))
    return np.asarray(mean[label].reshape(-1, 3, 3))


def _shape_operator(corners: F64, normal: F64, at_corner: F64, wavelength: float) -> F64:
    """(n, 3, 3) shape operator of each facet, from the mean normals at its corners; zero where it counts as flat."""
    edge = np.roll(corners, -1, axis=1) - corners
    unit = unit_rows(edge)
    smooth = np.einsum("fki,fi->fk", at_corner, normal).min(axis=1, initial=1.0) > np.cos(LARGEST_LEAN)

    # 2 x 2 in the facet's plane: S E = D for the two edges from corner 0
    t1 = unit[:, 0]
    t2 = np.cross(normal, t1)
    frame = np.stack([t1, t2], axis=1)
    steps = np.einsum("fai,fki->fak", frame, np.stack([edge[:, 0], -edge[:, 2]], axis=1))
    normal_change = np.einsum("fai,fki->fak", frame, at_corner[:, 1:] - at_corner[:, :1])
    size = steps[:, 0, 0] * steps[:, 1, 1]
    usable = smooth & (np.abs(size) > 1e-300)
    inverse = np.zeros_like(steps)
    inverse[:, 0, 0], inverse[:, 1, 1], inverse[:, 0, 1] = steps[:, 1, 1], steps[:, 0, 0], -steps[:, 0, 1]
    inverse = inverse / np.where(usable, size, 1.0)[:, None, None]
    s = np.where(usable[:, None, None], normal_change @ inverse, 0.0)
    s = 0.5 * (s + np.swapaxes(s, 1, 2))

    along = np.einsum("fai,fki->fka", frame, edge)
    bend = np.abs(np.einsum("fka,fab,fkb->fk", along, s, along)).max(axis=1)  # twice 4 sagittas
    longest = np.linalg.norm(edge, axis=2).max(axis=1)
    flat = (bend / np.maximum(longest, 1e-300) < _FLAT) | (bend / 8.0 > LARGEST_SAGITTA * wavelength)
    s[flat] = 0.0
    return np.asarray(np.einsum("fai,fab,fbj->fij", frame, s, frame))


def _bent(normal: F64, group: I32 | I64) -> bool:
    """Whether the normals of some group differ."""
    count = np.bincount(group)
    mean = np.stack([np.bincount(group, normal[:, i]) for i in range(3)], axis=1)
    length = np.linalg.norm(mean, axis=1)
    return bool((length[count > 1] < (1.0 - 1e-9) * count[count > 1]).any())


# most triangles of a fitted surface, and most halvings of an edge
MOST_FACES, MOST_HALVINGS = 4_000_000, 12
# deg: bend between two facets of one plane
_LEVEL = 0.1
# difference of normals within a plane
_SAME = 1e-4


def facet_sagitta(corners: F64, group: I32 | I64) -> F64:
    """Height (n,) m of the smooth surface over each facet's longest arc; 0 where facets are flat or stand for a bend.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    group : (n,) smooth group of each facet

    Notes
    -----
    Facets of one plane are one. Planes that bend towards fewer than two others of their group, such as the slopes of
    a flat roof, are no part of a curved surface.
    """
    bent = _find_bent_groups(corners, group)
    if not bent.all():
        out = np.zeros(len(corners))
        if bent.any():
            out[bent] = facet_sagitta(corners[bent], group[bent])
        return out
    if not len(corners):
        return np.zeros(0)
    vertex = weld(corners.reshape(-1, 3))
    plane = smooth_groups(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), _LEVEL)
    first, second = edge_pairs(vertex)
    a, b = first // 3, second // 3
    bent = (group[a] == group[b]) & (plane[a] != plane[b])
    sides = np.unique(
        np.concatenate([np.stack([plane[a], plane[b]], 1)[bent], np.stack([plane[b], plane[a]], 1)[bent]]),
        axis=0,
    )
    curved = np.bincount(sides[:, 0], minlength=int(plane.max()) + 1)[plane] > 1
    if not curved.any():
        return np.zeros(len(corners))
    normal = _corner_normals(corners, vertex, group)
    start, end = corners, np.roll(corners, -1, axis=1)
    rise = _rise(start, end, normal, np.roll(normal, -1, axis=1))
    return np.where(curved, np.linalg.norm(rise, axis=2).max(axis=1), 0.0)


def _find_bent_groups(corners: F64, group: I32 | I64) -> NDArray[np.bool_]:
    """Whether the facets of each one's group have different normals."""
    if not len(corners):
        return np.zeros(0, dtype=bool)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = unit_rows(normal)
    _, first, label = np.unique(group, return_index=True, return_inverse=True)
    differs = (np.abs(normal - normal[first[label]]) > _SAME).any(axis=1)
    return np.asarray(np.bincount(label, differs)[label] > 0)


def smooth_surface(vertices: F64, faces: I32, group: I32 | I64, sagitta: float) -> tuple[F64, I32, I64]:
    r"""Finer facets on the smooth surface through the corners of a mesh.

    Every edge becomes an arc that is square to the mean normals of the facets at its ends, as a circle's is:

    .. math:: \mathbf m = \tfrac12 (\mathbf p_1 + \mathbf p_2) + \tfrac c4 \sum_i \mathrm{sign}\,
        \frac{\tan(\alpha_i / 2)}{\cos \alpha_i} \mathbf n_i, \quad \sin \alpha_i = \mathbf n_i \cdot
        (\mathbf p_i - \mathbf p_j) / c

    with the chord c. It is halved until it lies below the arc by at most ``sagitta``.

    Parameters
    ----------
    vertices : (n_v, 3) float64, m
    faces : (n_f, 3) int32
    group : (n_f,) smooth group of each facet; an edge between two groups stays a crease, and becomes an arc along it
    sagitta : m

    Returns
    -------
    vertices, faces : of the finer mesh
    parent : (n,) int64, ascending, the given face of each

    Raises
    ------
    SceneError
        More than ``MOST_FACES`` facets would be needed.

    Notes
    -----
    Exact for spheres and circular cylinders whose normals are; corners stay. Ignores facets that are not wound alike,
    which stay flat, and curvature along open rims beyond that of the surface.

    References
    ----------
    After Vlachos and others, Curved PN Triangles (2001), with arcs of circles in place of cubics.
    """
    given = np.asarray(vertices, dtype=np.float64)
    _, first, label = np.unique(weld(given), return_index=True, return_inverse=True)
    points, corner = given[first], label.reshape(-1)[faces].astype(np.int64)
    normal = _corner_normals(points[corner], corner.ravel(), group)
    parent = np.arange(len(faces))
    for _ in range(MOST_HALVINGS):
        start, end = corner, np.roll(corner, -1, axis=1)
        low, high = np.minimum(start, end), np.maximum(start, end)
        key = (low * len(points) + high).ravel()
        edge, first, number = np.unique(key, return_index=True, return_inverse=True)
        number = number.reshape(-1, 3)
        other = np.roll(normal, -1, axis=1)
        rise = _rise(points[start], points[end], normal, other).reshape(-1, 3)
        # at a crease the arc is square to the normals of both sides: what they have in common
        crease = _crease_rise(points, edge, number.ravel(), start.ravel(), end.ravel(), normal, rise)
        cut = np.linalg.norm(crease, axis=1) > sagitta
        if not cut.any():
            break
        middle = np.full(edge.size, -1, dtype=np.int64)
        middle[cut] = len(points) + np.arange(int(cut.sum()))
        a, b = edge[cut] // len(points), edge[cut] % len(points)
        points = np.concatenate([points, 0.5 * (points[a] + points[b]) + crease[cut]])
        corner, normal, parent = _divide_triangles(
            corner, middle[number], normal, _interpolate_normals(normal, other), parent
        )
        if len(corner) > MOST_FACES:
            raise SceneError(
                f"smooth surface: more than {MOST_FACES} facets would lie within {sagitta:.2g} m of it; take a lower "
                "frequency, or leave smooth out"
            )
    order = np.argsort(parent, kind="stable")
    return points, corner[order].astype(np.int32), parent[order]


def _corner_normals(corners: F64, vertex: I64, group: I32 | I64) -> F64:
    """(n, 3, 3) mean normals at the corners of facets of each group; the facet's where they lean too far.

    Weights after Max, Weights for Computing Vertex Normals from Facet Normals (1999): exact on spheres.
    """
    ahead, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    size = np.maximum(np.square(ahead).sum(axis=2) * np.square(back).sum(axis=2), 1e-300)
    weighted = (np.cross(ahead, back) / size[..., None]).reshape(-1, 3)
    # one label per vertex and group: surfaces that meet at an edge keep their own normals there
    key = vertex * (int(group.max()) + 1) + np.repeat(group.astype(np.int64), 3)
    _, label = np.unique(key, return_inverse=True)
    label = label.reshape(-1)
    sums = np.stack([np.bincount(label, weighted[:, i]) for i in range(3)], axis=1)
    total = unit_rows(sums.astype(np.float64, copy=False))
    mean = total[label].reshape(-1, 3, 3)
    own = np.cross(ahead[:, 0], back[:, 0])
    own = unit_rows(own)
    leans = np.einsum("nkc,nc->nk", mean, own) < np.cos(LARGEST_LEAN)
    return np.where(leans[..., None], own[:, None], mean)


def _rise(start: F64, end: F64, first: F64, second: F64) -> F64:
    """Vectors (..., 3) m from the middles of chords to those of the arcs square to the normals at both ends."""
    step = end - start
    chord = np.maximum(np.linalg.norm(step, axis=-1, keepdims=True), 1e-300)
    total = np.zeros_like(step)
    for normal, along in ((first, -step), (second, step)):
        sine = np.clip((normal * along).sum(axis=-1, keepdims=True) / chord, -0.9, 0.9)
        half = np.tan(0.5 * np.arcsin(sine)) / np.sqrt(1.0 - sine**2)
        total = total + 0.25 * chord * half * normal
    return np.asarray(total)


def _crease_rise(points: F64, edge: I64, number: I64, start: I64, end: I64, normal: F64, rise: F64) -> F64:
    """Rise (n_edges, 3) of every edge: of its sides, or where these differ, of the arc square to all normals.

    Parameters
    ----------
    edge : key of each edge; ``number``, ``start``, ``end`` : (3 n,) edge of each side, and its ends
    normal : (n, 3, 3) at the corners ; ``rise`` : (3 n, 3) of the sides
    """
    count = np.bincount(number, minlength=edge.size)
    mean = np.stack([np.bincount(number, rise[:, i], edge.size) for i in range(3)], axis=1) / count[:, None]
    off = np.zeros(edge.size)
    np.maximum.at(off, number, np.linalg.norm(rise - mean[number], axis=1))
    length = np.linalg.norm(points[edge // len(points)] - points[edge % len(points)], axis=1)
    torn = np.flatnonzero((off > 1e-6 * length) & (count == 2))
    if not torn.size:
        return mean
    order = np.argsort(number, kind="stable")
    begin = np.searchsorted(number[order], torn)
    one, two = order[begin], order[begin + 1]
    flat, ahead = normal.reshape(-1, 3), np.roll(normal, -1, axis=1).reshape(-1, 3)
    a, b = points[start[one]], points[end[one]]
    alike = start[one] == start[two]
    ends = []
    for here, there in (
        (flat[one], np.where(alike[:, None], flat[two], ahead[two])),
        (ahead[one], np.where(alike[:, None], ahead[two], flat[two])),
    ):
        tangent = np.cross(here, there)
        size = np.linalg.norm(tangent, axis=1, keepdims=True)
        chord = unit_rows(b - a)
        tangent = np.where(size > 1e-3, tangent / np.maximum(size, 1e-300), chord)
        across = chord - (chord * tangent).sum(axis=1, keepdims=True) * tangent
        ends.append(across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12))
    # outward from the chord at its start, inward at its end
    mean[torn] = _rise(a, b, -ends[0], ends[1])
    return mean


def _interpolate_normals(first: F64, second: F64) -> F64:
    """Normals in the middle of sides, (n, 3, 3)."""
    total = first + second
    return unit_rows(total)


def _divide_triangles(
    corner: I64, middle: I64, normal: F64, between: F64, parent: I64
) -> tuple[I64, F64, I64]:
    """Triangles cut at the middles (n, 3) of their sides, -1 for none; side i begins at corner i."""
    split = middle >= 0
    count = split.sum(axis=1)
    out_c, out_n, out_p = [corner[count == 0]], [normal[count == 0]], [parent[count == 0]]

    def add(rows: NDArray[np.intp], *places: NDArray[np.intp]) -> None:
        """Triangles of corners 0 to 2 and middles 3 to 5 of each row."""
        both = np.concatenate([corner[rows], middle[rows]], axis=1)
        normals = np.concatenate([normal[rows], between[rows]], axis=1)
        for place in places:
            pick = np.arange(rows.size)[:, None], place
            out_c.append(both[pick])
            out_n.append(normals[pick])
            out_p.append(parent[rows])

    def around(i: NDArray[np.intp], *steps: int) -> NDArray[np.intp]:
        """Places of corners (0 to 2) and middles (3 to 5) counted from corner i."""
        return np.stack([(i + s) % 3 + 3 * (s // 3) for s in steps], axis=1)

    rows = np.flatnonzero(count == 3)
    zero = np.zeros(rows.size, dtype=np.intp)
    add(rows, *(around(zero, *s) for s in ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5))))
    rows = np.flatnonzero(count == 1)
    i = split[rows].argmax(axis=1)
    add(rows, around(i, 0, 3, 2), around(i, 3, 1, 2))
    rows = np.flatnonzero(count == 2)
    i = (~split[rows]).argmax(axis=1)  # the whole side begins at corner i
    add(rows, around(i, 0, 1, 4), around(i, 0, 4, 5), around(i, 5, 4, 2))
    return np.concatenate(out_c), np.concatenate(out_n), np.concatenate(out_p)
