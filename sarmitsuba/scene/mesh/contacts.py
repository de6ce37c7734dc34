"""Places where parts of a surface touch or cross without sharing edges."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64, unit_rows
from sarmitsuba.scene.mesh.double_faces import TriangleBalls
from sarmitsuba.scene.mesh.remesh import distance_to_triangles

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
