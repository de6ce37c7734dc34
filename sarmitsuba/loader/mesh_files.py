"""Mesh files as triangles in float64."""

import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.backend import mi
from sarmitsuba.errors import SceneError
from sarmitsuba.mesh.ply import read_ply
from sarmitsuba.parameters import one_line

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

_USEMTL = re.compile(rb"(?m)^[ \t]*usemtl[ \t]+(.*?)[ \t\r]*$")
# what a reader that meets arbitrary bytes raises
_READER_ERRORS = (
    ValueError,
    LookupError,
    NameError,
    TypeError,
    AttributeError,
    ArithmeticError,
    RuntimeError,
    AssertionError,
    EOFError,
    ImportError,
    MemoryError,
    struct.error,
)


class _Names:
    """Stands for the folder of an obj file: whatever is asked for is a list of names of materials."""

    def __init__(self, text: str) -> None:
        self._text = text.encode()

    def __getitem__(self, name: str) -> bytes:
        """The list."""
        return self._text


# of files whose parts have names of their own
_NAMED_PARTS = (".glb", ".gltf")


@dataclass(frozen=True, eq=False)
class MeshPart:
    """Triangles of a mesh file that share a material.

    Parameters
    ----------
    name : of the part
    material : as the file names it; of a glTF part without one, the part's name; empty in files without names
    vertices : (n_v, 3) float64, unit and axes of the file, the file's own transforms applied
    faces : (n_f, 3) int32
    """

    name: str
    material: str
    vertices: F64
    faces: I32


def read_mesh(path: Path, where: str) -> tuple[F64, I32]:
    """Triangles of a ply, obj or stl file, vertices as they are."""
    with _reading(path, where):
        if path.suffix.lower() == ".ply" and (read := read_ply(path)) is not None:
            return read[0], _checked(*read, path, where)
        import trimesh

        if path.suffix.lower() == ".obj":
            options = {"file_type": "obj", "skip_materials": True, "maintain_order": True}
            loaded = trimesh.load_scene(BytesIO(_obj_geometry(path)), process=False, **options)
        else:
            loaded = trimesh.load_scene(path, process=False)
        parts = list(loaded.geometry.values())
        # these formats place nothing: an only mesh is taken as it is, without the copies that joining parts makes
        alone = len(parts) == 1 and isinstance(parts[0], trimesh.Trimesh)
        mesh = parts[0] if alone else loaded.to_mesh()
        vertices = np.array(mesh.vertices, dtype=np.float64)
        faces = np.array(getattr(mesh, "faces", np.zeros((0, 3))), dtype=np.int64)  # points alone have none
    return vertices, _checked(vertices, faces, path, where)


def read_parts(path: Path, where: str) -> list[MeshPart]:
    """Parts of a mesh file, each with the name of its material.

    Raises
    ------
    SceneError : the file cannot be read, or holds no faces
    """
    import trimesh

    with _reading(path, where):
        if path.suffix.lower() == ".obj":
            # names are all that matters: the .mtl file may be missing, and its textures are not read
            names = obj_materials(path)
            text = _USEMTL.sub(lambda found: b"usemtl " + b" ".join(found[1].split()), _obj_geometry(path))
            loaded = trimesh.load_scene(
                BytesIO(b"mtllib names\n" + text),
                file_type="obj",
                resolver=_Names("".join(f"newmtl {name}\n" for name in names)),
                process=False,
            )
        else:
            loaded = trimesh.load_scene(path, process=False)
        parts = []
        for node in sorted(loaded.graph.nodes_geometry):
            matrix, key = loaded.graph[node]
            mesh = loaded.geometry[key]
            if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
                continue  # lines and points
            corners = np.array(mesh.vertices, dtype=np.float64)
            vertices = corners @ np.asarray(matrix)[:3, :3].T + np.asarray(matrix)[:3, 3]
            faces = _checked(vertices, np.array(mesh.faces, dtype=np.int64), path, where)
            material = getattr(getattr(mesh.visual, "material", None), "name", None)
            if not material and path.suffix.lower() in _NAMED_PARTS:
                material = node
            parts.append(MeshPart(str(node), str(material or ""), vertices, faces))
    if not parts:
        raise SceneError(f"{where}: mesh file {path.name} holds no faces; a radar needs surfaces, not points")
    return parts


def obj_materials(path: Path) -> tuple[str, ...]:
    """Names of the materials that an obj file uses, in order of first use."""
    found = _USEMTL.findall(path.read_bytes())
    return tuple(dict.fromkeys(" ".join(name.decode("utf-8", "replace").split()) for name in found))


def _obj_geometry(path: Path) -> bytes:
    """Text of an obj file without what would split its vertices: texture coordinates, normals; and without mtllib."""
    text = re.sub(rb"(?m)^[ \t]*(mtllib|vt|vn)\b.*$", b"", path.read_bytes())
    return re.sub(rb"(?m)^[ \t]*f[ \t].*$", lambda found: re.sub(rb"/\S*", b"", found[0]), text)


@contextmanager
def _reading(path: Path, where: str) -> Iterator[None]:
    """Turn what readers raise into one line."""
    try:
        yield
    except SceneError:
        raise
    except OSError as error:
        raise SceneError(f"{where}: cannot read mesh file {path.name}: {error.strerror or error}") from error
    except _READER_ERRORS as error:
        what = one_line(error) or type(error).__name__
        raise SceneError(
            f"{where}: mesh file {path.name} is malformed: {what}; export it again as ply or obj"
        ) from error


def _checked(vertices: F64, faces: NDArray[np.int64], path: Path, where: str) -> I32:
    if faces.ndim != 2 or faces.shape[0] == 0:
        raise SceneError(f"{where}: mesh file {path.name} holds no faces; a radar needs surfaces, not points")
    if faces.min() < 0 or faces.max() >= vertices.shape[0]:
        raise SceneError(
            f"{where}: mesh file {path.name} refers to vertex {faces.max()} of {vertices.shape[0]}; export "
            "it again"
        )
    return faces.astype(np.int32)


def read_serialized(path: Path, index: int, where: str) -> tuple[F64, I32]:
    """Triangles of Mitsuba's own binary format, through Mitsuba (float32 vertices)."""
    try:
        mesh = mi.load_dict({"type": "serialized", "filename": str(path), "shape_index": index})
        parameters = mi.traverse(mesh)
        vertices = np.array(parameters["vertex_positions"], dtype=np.float64).reshape(-1, 3)
        faces = np.array(parameters["faces"], dtype=np.int64).reshape(-1, 3).astype(np.int32)
    except (RuntimeError, KeyError, ValueError) as error:
        what = one_line(str(error).rpartition(f'{path.name}": ')[2] or "unreadable", 120)
        raise SceneError(f"{where}: cannot read mesh file {path.name}: {what}; export it as ply") from None
    return vertices, faces


__all__ = ["MeshPart", "obj_materials", "read_mesh", "read_parts", "read_serialized"]
