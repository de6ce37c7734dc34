"""Validation and cleaning of triangle meshes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.core.arrays import F64, I32, I64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.scene.mesh.topology import weld

# height of a triangle, in roundings of its coordinates, below which it counts as a line
_ROUNDINGS = 8.0

# share of coordinates that are odd multiples of the step of single precision above which they are rounded to it: half
# of them by chance, no whole metres
_ODD = 0.1


def clean_mesh(name: str, vertices: ArrayLike, faces: ArrayLike) -> tuple[F64, I32, list[str]]:
    """Return the mesh without zero-area and duplicate faces, and one note for each kind removed.

    A face and its flipped copy are duplicates too: surfaces are two-sided for radar, and two coinciding
    sheets would return the field twice. Corners are compared by position, not by index. The winding that is kept
    does not depend on the order of the faces. Unused vertices are dropped.

    Parameters
    ----------
    name : name of the mesh in messages
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
        The mesh is empty, has non-finite vertices or indices out of range, or all its faces are removed.

    Notes
    -----
    Ignores coplanar overlap of faces with different corners, T-junctions and self-intersection: the tracer
    takes the nearest surface, so that no repair is needed.
    """
    joined = clean_meshes([name], [vertices], [faces])
    return joined.vertices, joined.faces, joined.notes


@dataclass(frozen=True, eq=False)
class JoinedMeshes:
    """Cleaned meshes in one pair of arrays.

    Parameters
    ----------
    vertices : (n_v, 3) float64, m
    faces : (n_f, 3) int32, into all vertices
    mesh : (n_f,) int64, mesh of each face
    notes : of all meshes, in their order
    repaired : (n_meshes,) bool, whether the mesh has a note
    kept : (n_f,) int64, row of each face among those given, all meshes one after the other
    """

    vertices: F64
    faces: I32
    mesh: I64
    notes: list[str]
    repaired: NDArray[np.bool_]
    kept: I64


def clean_meshes(
    names: Sequence[str], vertices: Sequence[ArrayLike], faces: Sequence[ArrayLike]
) -> JoinedMeshes:
    """Clean every mesh as `clean_mesh` does, all in the same array operations: a city has thousands of small ones.

    Raises
    ------
    SceneError
        As of `clean_mesh`, for the first invalid mesh.
    """
    v, f, mesh, mesh_of_vertex = _join_meshes(names, vertices, faces)
    n_meshes = len(names)
    n_given = np.bincount(mesh, minlength=n_meshes)

    keep = ~_zero_area(v, f)
    f, mesh = f[keep], mesh[keep]
    n_kept = np.bincount(mesh, minlength=n_meshes)
    for i in np.flatnonzero(n_kept == 0).tolist():
        raise SceneError(
            f'mesh "{names[i]}": all {n_given[i]} faces have zero area; check its scale and to_world'
        )

    # equal positions in two meshes are different vertices
    position = weld(v)
    first, n_same, n_flipped = _unique_faces(position + mesh_of_vertex * (int(position.max()) + 1), f, mesh)
    f, mesh = f[first], mesh[first]
    kept = np.flatnonzero(keep)[first]

    n_flat, n_copies = n_given - n_kept, n_same + n_flipped
    notes = []
    for i in np.flatnonzero(n_flat + n_copies).tolist():
        if n_flat[i]:
            notes.append(f'mesh "{names[i]}": removed {n_flat[i]} of {n_given[i]} faces without area')
        if n_copies[i]:
            copies = f"{n_copies[i]} duplicate faces of {n_given[i]}"
            notes.append(f'mesh "{names[i]}": removed {copies} ({n_flipped[i]} flipped copies)')

    used = np.zeros(v.shape[0], dtype=bool)
    used[f] = True
    if not used.all():
        f = (np.cumsum(used) - 1)[f]
        v = v[used]
    return JoinedMeshes(
        np.ascontiguousarray(v),
        np.ascontiguousarray(f, dtype=np.int32),
        mesh,
        notes,
        n_flat + n_copies > 0,
        kept,
    )


def single_precision_step(vertices: F64) -> float:
    """Step, m, of the largest coordinates (n, 3) where all of them are rounded to single precision; else 0."""
    if not len(vertices) or not np.isfinite(vertices).all():
        return 0.0
    with np.errstate(over="ignore"):
        single = vertices.astype(np.float32)
    if not (single == vertices).all():
        return 0.0
    column = np.unique(single[:, np.abs(single).max(axis=0).argmax()])
    step = np.abs(np.spacing(column)).astype(np.float64)
    odd = np.mod(column.astype(np.float64), 2.0 * step) != 0.0
    return float(step.max()) if odd.mean() > _ODD else 0.0


def _join_meshes(
    names: Sequence[str], vertices: Sequence[ArrayLike], faces: Sequence[ArrayLike]
) -> tuple[F64, I64, I64, I64]:
    """Vertices and faces of all meshes, and the mesh of every face and vertex; each mesh is checked."""
    given = [(np.asarray(v, dtype=np.float64), np.asarray(f)) for v, f in zip(vertices, faces, strict=True)]
    for name, (v, f) in zip(names, given, strict=True):
        _check_form(name, v, f)
    n_v, n_f = (np.array([len(pair[k]) for pair in given]) for k in (0, 1))
    numbers = np.arange(len(given))
    mesh, mesh_of_vertex = np.repeat(numbers, n_f), np.repeat(numbers, n_v)
    v = np.concatenate([corners for corners, _ in given])
    f = np.concatenate([indices for _, indices in given], dtype=np.int64, casting="unsafe")
    if not np.isfinite(v).all() or ((f < 0) | (f >= n_v[mesh][:, None])).any():
        for name, (corners, indices) in zip(names, given, strict=True):
            _check_numbers(name, corners, indices.astype(np.int64))
    return v, f + (np.cumsum(n_v) - n_v)[mesh][:, None], mesh, mesh_of_vertex


def _check_form(name: str, v: F64, f: NDArray[np.generic]) -> None:
    """Raise a SceneError where shapes or types are not those of a mesh."""
    if v.ndim != 2 or v.shape[-1] != 3:
        raise SceneError(f'mesh "{name}": vertices have the shape {v.shape}, not (n, 3)')
    if v.shape[0] == 0 or f.size == 0:
        counts = f"{v.shape[0]} vertices, {f.size // 3} faces"
        raise SceneError(f'mesh "{name}": empty ({counts}); give it triangles or remove it')
    if f.ndim != 2 or f.shape[-1] != 3 or f.dtype.kind not in "iu":
        found = f"the shape {f.shape} of {f.dtype}"
        raise SceneError(f'mesh "{name}": faces have {found}, not (n, 3) of integers')


def _check_numbers(name: str, v: F64, index: I64) -> None:
    """Raise a SceneError where vertices are not finite or faces refer to missing vertices."""
    bad = int((~np.isfinite(v)).any(axis=1).sum())
    if bad:
        count = f"{bad} of {v.shape[0]}"
        raise SceneError(f'mesh "{name}": {count} vertices are NaN or infinite; repair the mesh')
    wrong = int(((index < 0) | (index >= v.shape[0])).any(axis=1).sum())
    if wrong:
        count, last = f"{wrong} of {index.shape[0]}", v.shape[0] - 1
        raise SceneError(f'mesh "{name}": {count} faces have corners outside 0 ... {last}; repair the mesh')


def _zero_area(v: F64, f: I64) -> NDArray[np.bool_]:
    """(n_f,) bool: the height over the longest edge does not exceed the rounding of the coordinates."""
    a, b, c = v[f[:, 0]], v[f[:, 1]], v[f[:, 2]]
    cross = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.maximum.reduce([np.linalg.norm(e, axis=1) for e in (b - a, c - a, c - b)])
    size = np.maximum.reduce([np.abs(a), np.abs(b), np.abs(c)]).max(axis=1)
    rounding = _ROUNDINGS * np.finfo(np.float64).eps * size
    return np.asarray(cross <= rounding * longest)


def _unique_faces(vertex: I64, f: I64, mesh: I64) -> tuple[I64, I64, I64]:
    """Indices (ascending) of one face of each set of copies; removed copies per mesh, of equal and opposite winding.

    ``vertex`` labels the positions, with different labels in different meshes.
    """
    ids = vertex[f]
    low = ids.argmin(axis=1)
    # rotate the smallest label to the front: equal faces agree in all three, flipped ones swap the last two
    shift = (low[:, None] + np.arange(3)) % 3
    ids = np.take_along_axis(ids, shift, axis=1)
    flipped = ids[:, 1] > ids[:, 2]
    mid, high = np.minimum(ids[:, 1], ids[:, 2]), np.maximum(ids[:, 1], ids[:, 2])
    # unflipped copies sort first, so that the winding that is kept does not depend on face order
    order = np.lexsort((flipped, high, mid, ids[:, 0]))
    same = (np.diff(np.stack([ids[order, 0], mid[order], high[order]]), axis=1) == 0).all(axis=0)
    copy = np.concatenate([[False], same])
    starts = order[~copy]
    group = np.cumsum(~copy) - 1
    n_odd = np.bincount(group, weights=flipped[order])
    n_flipped = np.minimum(n_odd, np.bincount(group) - n_odd)
    n_meshes = int(mesh.max()) + 1
    flipped_of_mesh = np.bincount(mesh[starts], n_flipped, n_meshes).astype(np.int64)
    copies_of_mesh = np.bincount(mesh[order[copy]], minlength=n_meshes)
    return np.sort(starts), copies_of_mesh - flipped_of_mesh, flipped_of_mesh
