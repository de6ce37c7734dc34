"""Triangle meshes as they come: refused when they cannot mean anything, cleaned when they can."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.errors import SceneError
from sarmitsuba.mesh.welding import weld

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

# a triangle lower than this many roundings of its own coordinates is a line
_ROUNDINGS = 8.0


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


def _unique_faces(vertex: I64, f: I64) -> tuple[I64, int, int]:
    """Pick one face of each set of copies (ascending), and count the same-wound and flipped ones that go."""
    ids = vertex[f]
    low = ids.argmin(axis=1)
    # rotate the smallest label to the front: equal faces agree in all three, flipped ones swap the last two
    shift = (low[:, None] + np.arange(3)) % 3
    ids = np.take_along_axis(ids, shift, axis=1)
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


__all__ = ["clean_mesh"]
