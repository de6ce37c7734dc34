"""Test whether a triangle mesh is one closed convex body: a ray that it reflects never hits it again."""

import numpy as np

from sarmitsuba.core.arrays import F64, I32, I64, unit_rows

# distance of a vertex from a plane, over the longest edge of the bounds, up to which it lies in the plane: float64
# rounding of a transformed mesh, and float32 of a file
SLACK = 1e-6


def one_sided(normals: F64, corners: F64, points: F64, slack: float) -> bool:
    """Whether no plane of a face has points on both sides; tested on at most 64 faces, the first few of them first.

    Parameters
    ----------
    normals, corners : (n_faces, 3) of each face, the latter one of its vertices, m
    points : (n, 3) vertices, m
    slack : m
    """
    n = len(normals)
    pick = np.unique(np.linspace(0, n - 1, min(n, 64)).round().astype(int))
    for few in (pick[:: len(pick) // 4], pick) if n > 16 else (pick,):
        offset = np.einsum("ij,ij->i", normals[few], corners[few])
        height = normals[few] @ points.T - offset[:, None]
        if not ((height.min(axis=1) >= -slack) | (height.max(axis=1) <= slack)).all():
            return False
    return True


def merge_vertices(vertices: F64, faces: I32, slack: float) -> I64:
    """(n_f, 3) vertex numbers after merging vertices within about ``slack`` (m) of each other."""
    rounded = np.round(vertices / max(slack, 1e-12)).astype(np.int64)
    _, number = np.unique(rounded, axis=0, return_inverse=True)
    return np.asarray(number.reshape(-1)[faces], dtype=np.int64)


def face_edges(faces: I32 | I64) -> I64:
    """(3 n_f, 2) ends of the first edge of every face, then of the second ones, then of the third."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)


def is_convex_body(vertices: F64, faces: I32) -> bool:
    """Whether a mesh is one closed convex surface.

    From the centre all faces show their back: every closed piece then covers the sphere of directions at least once.
    All faces together cover it exactly once: the surface is one piece, and star-shaped. No edge is concave: a
    star-shaped surface then is convex at every vertex too, and a closed locally convex surface is convex (Tietze and
    Nakajima). Edges count as concave beyond the slack; the sum of many shallower ones is tested against the planes of
    a few faces.

    Parameters
    ----------
    vertices : (n_v, 3) float64, m
    faces : (n_f, 3) int32
    """
    if len(faces) < 4:
        return False
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    points = vertices[used]
    slack = SLACK * float(np.ptp(points, axis=0).max())
    middle = points.mean(axis=0)
    a, b, c = (vertices[faces[:, i]] - middle for i in range(3))
    triple = np.einsum("ij,ij->i", a, np.cross(b, c))
    outward = np.sign(triple)
    if (outward == 0).any() or abs(outward.sum()) != len(faces):
        return False
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    ab, ac, bc = (np.einsum("ij,ij->i", v, w) for v, w in ((a, b), (a, c), (b, c)))
    solid = 2.0 * np.arctan2(np.abs(triple), la * lb * lc + ab * lc + ac * lb + bc * la)
    if abs(float(solid.sum()) / (4.0 * np.pi) - 1.0) > 1e-6:
        return False

    f = merge_vertices(vertices, faces, slack)
    ends = np.sort(face_edges(f), axis=1)
    key = ends[:, 0] * (int(f.max()) + 1) + ends[:, 1]
    order = np.argsort(key, kind="stable")
    key, face = key[order], np.tile(np.arange(len(f)), 3)[order]
    if len(key) % 2 or (key[::2] != key[1::2]).any() or (key[1:-1:2] == key[2::2]).any():
        return False  # an edge with one face, or with more than two
    first, second = face[::2], face[1::2]
    centre = (a + b + c) / 3.0
    towards = centre[second] - centre[first]
    normals = np.cross(b - a, c - a)
    normals = unit_rows(normals)
    concave = np.einsum("ij,ij->i", normals[first] * outward[first, None], towards) > slack
    # a dish of very many facets is deep although none of its edges is
    return not concave.any() and one_sided(normals, a + middle, points, slack)
