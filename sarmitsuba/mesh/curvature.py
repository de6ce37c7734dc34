"""Curvature of the smooth surface that facets approximate."""

import numpy as np

from sarmitsuba.arrays import F64, I32, I64
from sarmitsuba.mesh.welding import weld

# largest distance of the smooth surface from its facet, wavelengths: beyond it the facet is taken as flat
LARGEST_SAGITTA = 1.0 / 8.0
# largest angle between a corner's mean normal and the facet's normal in a smooth surface
LARGEST_LEAN = np.radians(30.0)
_FLAT = 1e-6  # rad, bend below which a facet counts as flat


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
    n = corners.shape[0]
    edge = np.roll(corners, -1, axis=1) - corners
    normal = np.cross(edge[:, 0], -edge[:, 2])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    if not _bent(normal, group):
        return None
    unit = edge / np.maximum(np.linalg.norm(edge, axis=2, keepdims=True), 1e-300)
    angle = np.arccos(np.clip(-np.einsum("fki,fki->fk", unit, np.roll(unit, 1, axis=1)), -1.0, 1.0))

    # one label per vertex and group: surfaces that meet at an edge keep their own normals there
    vertex = weld(corners.reshape(-1, 3)) if vertex is None else vertex
    _, label = np.unique(
        vertex * (int(group.max()) + 1) + np.repeat(group.astype(np.int64), 3), return_inverse=True
    )
    label = label.reshape(-1)
    weighted = (angle[:, :, None] * normal[:, None, :]).reshape(-1, 3)
    mean = np.stack([np.bincount(label, weighted[:, i]) for i in range(3)], axis=1)
    mean = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
    at_corner = mean[label].reshape(n, 3, 3)
    smooth = np.einsum("fki,fi->fk", at_corner, normal).min(axis=1) > np.cos(LARGEST_LEAN)

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
    if not s.any():
        return None
    full = np.einsum("fai,fab,fbj->fij", frame, s, frame)
    out = np.zeros((n, 8))
    out[:, :3] = full[:, [0, 1, 2], [0, 1, 2]]
    out[:, 3:6] = full[:, [0, 0, 1], [1, 2, 2]]
    return out


def _bent(normal: F64, group: I32 | I64) -> bool:
    """Whether the normals of some group differ."""
    count = np.bincount(group)
    mean = np.stack([np.bincount(group, normal[:, i]) for i in range(3)], axis=1)
    length = np.linalg.norm(mean, axis=1)
    return bool((length[count > 1] < (1.0 - 1e-9) * count[count > 1]).any())
