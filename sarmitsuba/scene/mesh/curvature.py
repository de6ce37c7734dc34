"""Curvature of the smooth surface that facets approximate."""

import numpy as np

from sarmitsuba.core.arrays import F64, I32, I64, unit_rows
from sarmitsuba.scene.mesh.topology import weld

# largest distance of the smooth surface from its facet, wavelengths: beyond it the facet is taken as flat
LARGEST_SAGITTA = 1.0 / 8.0
# largest angle between a corner's mean normal and the facet's normal in a smooth surface
LARGEST_LEAN = np.radians(30.0)
_FLAT = 1e-6  # rad, bend below which a facet counts as flat
_SAME = 1e-8  # difference of normals that cannot bend a facet by that much


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
    (n_faces, 8) float64, 1/m: S_xx, S_yy, S_zz, S_xy, S_xz, S_yz of the face's own normal, two unused; zero for flat
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
    differs = (np.abs(normal - normal[first[group]]) > _SAME).any(axis=1)
    curved = np.zeros(first.size, dtype=bool)
    curved[group[differs]] = True
    faces = np.flatnonzero(curved[group])
    vertex = weld(corners[faces].reshape(-1, 3)) if vertex is None else vertex.reshape(-1, 3)[faces].ravel()
    mean = _mean_normals(corners[faces], normal[faces], vertex, group[faces])
    lean = np.abs(mean - normal[faces, None]) > _SAME
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
