"""Smooth groups: sets of faces that represent one curved or flat surface."""

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64, I32, I64
from sarmitsuba.scene.mesh.topology import label_connected, weld

# edges with more faces than this (hubs of fans of billboards) join no faces
_MAX_FACES_AT_EDGE = 32


def smooth_groups(
    vertices: ArrayLike, faces: ArrayLike, angle_deg: float = 20.0, mesh: I64 | None = None
) -> I32:
    """Labels of smooth pieces of surface: faces joined over shared edges that bend less than an angle.

    Edges are matched by the position of their ends, so meshes that repeat vertices at every corner work. The
    bend does not depend on the winding: a neighbour of opposite winding counts with its normal reversed.

    Parameters
    ----------
    vertices : (n_v, 3) float, m
    faces : (n_f, 3) int, none of zero area
    angle_deg : largest bend that still joins, degrees
    mesh : (n_f,) mesh of every face, if there are several: faces of different meshes are never joined

    Returns
    -------
    (n_f,) int32, group of every face, 0 ... n_groups - 1, in the order of their first faces

    Notes
    -----
    Ignores T-junctions: faces that touch along parts of their edges are not joined. Nor are those around an
    edge shared by more than 32 faces.
    """
    v = np.asarray(vertices, dtype=np.float64)
    f = np.asarray(faces, dtype=np.int64)
    n_f = f.shape[0]
    if n_f == 0:
        return np.zeros(0, dtype=np.int32)
    normal = _unit_normals(v, f)
    ids = weld(v)[f]
    if mesh is not None:
        # equal positions in two meshes are different vertices; numbered without gaps, so that pairs fit 64 bits
        _, ids = np.unique(ids + mesh[:, None] * (int(ids.max()) + 1), return_inverse=True)
        ids = ids.reshape(f.shape)
    start = ids.ravel()
    end = np.roll(ids, -1, axis=1).ravel()
    forward = start < end
    n_ids = int(ids.max()) + 1
    key = np.minimum(start, end) * n_ids + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    key, forward = key[order], forward[order]
    owner = order // 3

    # faces at one edge are consecutive in the sorted list; compare every pair of them
    change = np.flatnonzero(np.diff(key)) + 1
    run = np.diff(np.concatenate([[0], change, [key.size]]))
    length = np.repeat(run, run)
    cos_limit = float(np.cos(np.deg2rad(angle_deg)))
    rows, cols = [], []
    candidate = np.flatnonzero((length > 1) & (length <= _MAX_FACES_AT_EDGE))
    for step in range(1, int(min(run.max(), _MAX_FACES_AT_EDGE))):
        candidate = candidate[candidate + step < key.size]
        candidate = candidate[key[candidate] == key[candidate + step]]
        if not candidate.size:
            break
        a, b = owner[candidate], owner[candidate + step]
        cosine = np.einsum("ij,ij->i", normal[a], normal[b])
        # neighbours of the same winding traverse their common edge in opposite directions
        cosine = np.where(forward[candidate] == forward[candidate + step], -cosine, cosine)
        smooth = cosine > cos_limit
        rows.append(a[smooth])
        cols.append(b[smooth])
    row = np.concatenate(rows) if rows else np.zeros(0, dtype=np.int64)
    col = np.concatenate(cols) if cols else np.zeros(0, dtype=np.int64)
    return label_connected(n_f, row, col).astype(np.int32)


def _unit_normals(v: F64, f: I64) -> F64:
    cross = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
    norm = np.linalg.norm(cross, axis=1, keepdims=True)
    return np.asarray(cross / np.where(norm > 0.0, norm, 1.0))
