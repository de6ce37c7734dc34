"""Mesh attributes used by material maps: texture coordinates, and numbers at vertices or faces."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.errors import SceneError
from sarmitsuba.loading.elements import Element
from sarmitsuba.machine.regular_files import check_regular, read_bytes

# names of texture coordinates in PLY files
_UV = (("u", "v"), ("s", "t"), ("texture_u", "texture_v"))
_RECTANGLE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def corner_values(element: Element, path: Path | None, faces: I32, names: Sequence[str]) -> dict[str, F64]:
    """Attributes of a shape at the corners of its faces.

    Parameters
    ----------
    element : of the shape
    path : of its file, None where it has none
    faces : (n_faces, 3) as the shape was read
    names : ``uv``, ``vertex_NAME`` or ``face_NAME``

    Returns
    -------
    by name (n_faces, 3, 2) for ``uv`` and (n_faces, 3, 1) for numbers, float64; integers of a file are scaled by the
    largest value of their type, to 0 ... 1

    Raises
    ------
    SceneError : the shape lacks an attribute, or its file format has none that are read
    """
    where = element.where
    if element.plugin == "rectangle" and set(names) <= {"uv"}:
        at_vertices: dict[str, NDArray[np.generic]] = {"uv": _RECTANGLE}
    elif element.plugin == "ply" and path is not None:
        at_vertices = _read_ply_attributes(path, faces, names, where)
    elif element.plugin == "obj" and path is not None and set(names) <= {"uv"}:
        return {
            name: _flip_coordinates(_read_obj_attributes(path, faces, where), element, default=True)
            for name in names
        }
    else:
        raise SceneError(
            f"{where}: a map needs {', '.join(names)}, which a {element.plugin} does not have here; give map_extent, "
            "or the mesh as a ply file (uv also as obj or rectangle)"
        )
    values = spread_to_corners(at_vertices, faces, where)
    if "uv" in values:
        values["uv"] = _flip_coordinates(values["uv"], element, default=False)
    return values


def spread_to_corners(attributes: Mapping[str, ArrayLike], faces: I32, where: str) -> dict[str, F64]:
    """Values at the corners of faces, from values at vertices or (names that begin with ``face_``) of faces.

    Raises
    ------
    SceneError : their number is not that of the vertices or faces
    """
    out = {}
    for name, given in attributes.items():
        values = np.asarray(given)
        if values.dtype.kind == "u":
            values = values / float(np.iinfo(values.dtype).max)
        of_faces, columns = name.startswith("face_"), 2 if name == "uv" else 1
        wanted = len(faces) if of_faces else int(faces.max()) + 1
        values = np.asarray(values, dtype=np.float64)
        values = values.reshape(len(values), -1) if values.ndim in (1, 2) else np.zeros((0, 0))
        if values.shape[1] != columns or (len(values) != wanted if of_faces else len(values) < wanted):
            what = "faces" if of_faces else "vertices"
            raise SceneError(
                f'{where}: attribute "{name}" has the shape {np.shape(given)} for {wanted} {what}; give {columns} a '
                f"{what.removesuffix('s') if of_faces else 'vertex'}"
            )
        out[name] = np.repeat(values[:, None], 3, axis=1) if of_faces else values[faces]
    return out


def _flip_coordinates(uv: F64, element: Element, *, default: bool) -> F64:
    """Texture coordinates as in Mitsuba: v inverted with ``flip_tex_coords``."""
    if not element.values.get("flip_tex_coords", default):
        return uv
    return np.stack([uv[..., 0], 1.0 - uv[..., 1]], axis=-1)


def _read_ply_attributes(
    path: Path, faces: I32, names: Sequence[str], where: str
) -> dict[str, NDArray[np.generic]]:
    """Attributes of a PLY file whose faces are triangles."""
    import trimesh

    try:
        check_regular(path)
    except OSError as error:
        raise SceneError(f"{where}: cannot read {path.name}: {error.strerror}") from error
    mesh = trimesh.load_mesh(path, process=False, fix_texture=False)
    raw = getattr(mesh, "metadata", {}).get("_ply_raw", {})
    vertex, face = (raw.get(part, {}).get("data", {}) for part in ("vertex", "face"))
    indices = next(
        (np.asarray(face[key]) for key in ("vertex_indices", "vertex_index") if _has(face, key)), None
    )
    if indices is not None and indices.dtype.names:  # a list with its own length
        indices = indices["f1"]
    if indices is None or not np.array_equal(np.asarray(indices).reshape(-1, 3), faces):
        raise SceneError(
            f"{where}: {path.name} holds faces that are not triangles; triangulate it, since its attributes are used"
        )
    out: dict[str, NDArray[np.generic]] = {}
    for name in names:
        table = face if name.startswith("face_") else vertex
        if name == "uv":
            pair = next((p for p in _UV if all(_has(vertex, key) for key in p)), None)
            columns = [np.asarray(vertex[key]).reshape(-1) for key in pair or ()]
        else:
            key = next((k for k in (name.partition("_")[2], name) if _has(table, k)), None)
            columns = [np.asarray(table[key]).reshape(-1)] if key else []
        if not columns:
            raise SceneError(f'{where}: {path.name} has no attribute "{name}"; write it, or give map_extent')
        out[name] = np.stack(columns, axis=-1)
    return out


def _has(table: object, key: str) -> bool:
    names = getattr(getattr(table, "dtype", None), "names", None)
    return key in names if names else isinstance(table, dict) and key in table


def _read_obj_attributes(path: Path, faces: I32, where: str) -> F64:
    """(n_faces, 3, 2) texture coordinates of an obj file of triangles."""
    points: list[list[float]] = []
    corners: list[list[int]] = []
    try:
        for line in read_bytes(path).split(b"\n"):
            words = line.split()
            if not words or words[0] not in (b"vt", b"f"):
                continue
            if words[0] == b"vt":
                points.append([float(words[1]), float(words[2])])
            else:
                numbers = [int(word.split(b"/")[1]) for word in words[1:]]
                corners.append([k - 1 if k > 0 else len(points) + k for k in numbers])
        uv = np.asarray(points, dtype=np.float64)[np.asarray(corners, dtype=np.int64).reshape(-1, 3)]
    except (ValueError, IndexError):
        uv = np.zeros((0, 3, 2))
    if len(uv) != len(faces):
        raise SceneError(
            f"{where}: {path.name} has no texture coordinates at every corner of its triangles; export it again with "
            "them, triangulated, or give map_extent"
        )
    return uv
