"""Triangle meshes as they come: refused when they cannot mean anything, cleaned when they can."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from sarmitsuba.errors import SceneError

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

# a triangle lower than this many roundings of its own coordinates is a line
_ROUNDINGS = 8.0
# edges shared by more faces than this (hubs of fans of billboards) join nothing
_MAX_FACES_AT_EDGE = 32


def clean_mesh(name: str, vertices: ArrayLike, faces: ArrayLike) -> tuple[F64, I32, list[str]]:
    """Return the mesh without zero-area and duplicate faces, and one note for each kind removed.

    A face and its flipped copy are duplicates too: surfaces are two-sided for radar, and two coinciding
    sheets would return the field twice. Corners are compared by position, not by index. Which winding stays
    does not depend on the order of the faces. Vertices that no face uses are dropped.

    Parameters
    ----------
    name : what messages call the mesh
    vertices : (n_v, 3) float, m, any frame
    faces : (n_f, 3) int, corner indices

    Returns
    -------
    vertices : (n_v', 3) float64, m
    faces : (n_f', 3) int32, in the order of the input
    notes : one line for each kind of face removed, naming the mesh and the counts

    Raises
    ------
    SceneError
        The mesh is empty, has vertices that are not finite or indices out of range, or nothing is left of it.

    Notes
    -----
    Ignores coplanar overlap of faces with different corners, T-junctions and self-intersection: the tracer
    takes the nearest surface, and they need no repair.
    """
    v = np.asarray(vertices, dtype=np.float64)
    f = np.asarray(faces)
    _refuse(name, v, f)
    f = f.astype(np.int64)
    notes: list[str] = []
    n_given = f.shape[0]

    keep = ~_zero_area(v, f)
    n_flat = n_given - int(keep.sum())
    if n_flat:
        notes.append(f'mesh "{name}": removed {n_flat} of {n_given} faces without area')
    f = f[keep]
    if not f.size:
        raise SceneError(f'mesh "{name}": all {n_given} faces have zero area; check its scale and to_world')

    first, n_same, n_flipped = _unique_faces(weld(v), f)
    if n_same + n_flipped:
        n_copies = f"{n_same + n_flipped} duplicate faces of {n_given}"
        notes.append(f'mesh "{name}": removed {n_copies} ({n_flipped} flipped copies)')
        f = f[first]

    used = np.zeros(v.shape[0], dtype=bool)
    used[f] = True
    if not used.all():
        f = (np.cumsum(used) - 1)[f]
        v = v[used]
    return np.ascontiguousarray(v), np.ascontiguousarray(f, dtype=np.int32), notes


def smooth_groups(vertices: ArrayLike, faces: ArrayLike, angle_deg: float = 20.0) -> I32:
    """Label the smooth pieces of surface: faces joined over shared edges that bend less than an angle.

    Edges are matched by the position of their ends, so meshes that repeat vertices at every corner work. The
    bend does not depend on the winding: a neighbour wound the other way counts with its normal turned over.

    Parameters
    ----------
    vertices : (n_v, 3) float, m
    faces : (n_f, 3) int, none of zero area
    angle_deg : largest bend that still joins, degrees

    Returns
    -------
    (n_f,) int32, group of every face, 0 ... n_groups - 1

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
    start = ids.ravel()
    end = np.roll(ids, -1, axis=1).ravel()
    forward = start < end
    n_ids = int(ids.max()) + 1
    key = np.minimum(start, end) * n_ids + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    key, forward = key[order], forward[order]
    owner = order // 3

    # faces around one edge are neighbours in the sorted list; compare every pair of them
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
        # neighbours of one winding walk their common edge in opposite directions
        cosine = np.where(forward[candidate] == forward[candidate + step], -cosine, cosine)
        smooth = cosine > cos_limit
        rows.append(a[smooth])
        cols.append(b[smooth])
    row = np.concatenate(rows) if rows else np.zeros(0, dtype=np.int64)
    col = np.concatenate(cols) if cols else np.zeros(0, dtype=np.int64)
    graph = coo_matrix((np.ones(row.size, dtype=np.int8), (row, col)), shape=(n_f, n_f))
    _, label = connected_components(graph, directed=False)
    return np.asarray(label, dtype=np.int32)


def write_ply(path: Path, vertices: ArrayLike, faces: ArrayLike) -> None:
    """Write a binary PLY file with double-precision vertices, so that what is read back is exact.

    Parameters
    ----------
    path : file to write
    vertices : (n_v, 3) float, m
    faces : (n_f, 3) int
    """
    v = np.asarray(vertices, dtype="<f8")
    rows = np.zeros(len(np.asarray(faces)), dtype=[("n", "u1"), ("corner", "<i4", (3,))])
    rows["n"] = 3
    rows["corner"] = faces
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {v.shape[0]}"]
    header += [f"property double {axis}" for axis in "xyz"]
    header += [f"element face {rows.size}", "property list uchar int vertex_indices", "end_header", ""]
    path.write_bytes("\n".join(header).encode() + v.tobytes() + rows.tobytes())


def _refuse(name: str, v: F64, f: NDArray[Any]) -> None:
    if v.ndim != 2 or v.shape[-1] != 3:
        raise SceneError(f'mesh "{name}": vertices have the shape {v.shape}, not (n, 3)')
    if v.shape[0] == 0 or f.size == 0:
        counts = f"{v.shape[0]} vertices, {f.size // 3} faces"
        raise SceneError(f'mesh "{name}": empty ({counts}); give it triangles or remove it')
    if f.ndim != 2 or f.shape[-1] != 3 or not np.issubdtype(f.dtype, np.integer):
        found = f"the shape {f.shape} of {f.dtype}"
        raise SceneError(f'mesh "{name}": faces have {found}, not (n, 3) of integers')
    bad = int((~np.isfinite(v)).any(axis=1).sum())
    if bad:
        count = f"{bad} of {v.shape[0]}"
        raise SceneError(f'mesh "{name}": {count} vertices are NaN or infinite; repair the mesh')
    wrong = int(((f < 0) | (f >= v.shape[0])).any(axis=1).sum())
    if wrong:
        count, last = f"{wrong} of {f.shape[0]}", v.shape[0] - 1
        raise SceneError(f'mesh "{name}": {count} faces have corners outside 0 ... {last}; repair the mesh')


def _zero_area(v: F64, f: I64) -> NDArray[np.bool_]:
    """(n_f,) bool: the height over the longest edge is no more than the rounding of the coordinates."""
    a, b, c = v[f[:, 0]], v[f[:, 1]], v[f[:, 2]]
    cross = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.maximum.reduce([np.linalg.norm(e, axis=1) for e in (b - a, c - a, c - b)])
    size = np.maximum.reduce([np.abs(a), np.abs(b), np.abs(c)]).max(axis=1)
    rounding = _ROUNDINGS * np.finfo(np.float64).eps * size
    return np.asarray(cross <= rounding * longest)


def _unit_normals(v: F64, f: I64) -> F64:
    cross = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
    norm = np.linalg.norm(cross, axis=1, keepdims=True)
    return np.asarray(cross / np.where(norm > 0.0, norm, 1.0))


def weld(v: F64) -> I64:
    """(n_v,) int64 label of every position, equal for vertices at exactly the same place.

    Labels depend on the positions alone, not on the order of the vertices: the rank of a 64-bit hash of the
    three coordinates' bits, or of the coordinates themselves should two of them ever collide.
    """
    bits = np.ascontiguousarray(v + 0.0).view(np.uint64)  # + 0.0 makes -0 and 0 the same bits
    with np.errstate(over="ignore"):
        h = np.zeros(v.shape[0], dtype=np.uint64)
        for k in range(3):  # splitmix64 rounds
            h = (h ^ bits[:, k]) * np.uint64(0x9E3779B97F4A7C15)
            h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            h = h ^ (h >> np.uint64(31))
    _, first, label = np.unique(h, return_index=True, return_inverse=True)
    if not np.array_equal(bits, bits[first[label]]):
        _, label = np.unique(v + 0.0, axis=0, return_inverse=True)
    return np.asarray(label.reshape(-1), dtype=np.int64)


def _unique_faces(weld: I64, f: I64) -> tuple[I64, int, int]:
    """Pick one face of each set of copies (ascending), and count the same-wound and flipped ones that go."""
    ids = weld[f]
    low = ids.argmin(axis=1)
    # rotate the smallest label to the front: equal faces agree in all three, flipped ones swap the last two
    turn = (low[:, None] + np.arange(3)) % 3
    ids = np.take_along_axis(ids, turn, axis=1)
    flipped = ids[:, 1] > ids[:, 2]
    mid, high = np.minimum(ids[:, 1], ids[:, 2]), np.maximum(ids[:, 1], ids[:, 2])
    # straight copies sort before flipped ones, so that the winding that stays does not depend on face order
    order = np.lexsort((flipped, high, mid, ids[:, 0]))
    same = (np.diff(np.stack([ids[order, 0], mid[order], high[order]]), axis=1) == 0).all(axis=0)
    copy = np.concatenate([[False], same])
    starts = order[~copy]
    group = np.cumsum(~copy) - 1
    n_odd = np.bincount(group, weights=flipped[order])
    n_flipped = int(np.minimum(n_odd, np.bincount(group) - n_odd).sum())
    return np.sort(starts), int(copy.sum()) - n_flipped, n_flipped


__all__ = ["clean_mesh", "smooth_groups", "weld", "write_ply"]
