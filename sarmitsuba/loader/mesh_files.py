"""Mesh files as triangles in float64."""

import errno
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.backend import mi
from sarmitsuba.errors import DataError, SceneError
from sarmitsuba.isolated import survive
from sarmitsuba.mesh.ply import read_ply
from sarmitsuba.parameters import one_line
from sarmitsuba.regular_files import check_regular, is_inside, read_bytes

if TYPE_CHECKING:
    import trimesh

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

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


class _Beside:
    """Files that a glTF file names: ordinary ones in its own folder and below, of bounded size, and no others.

    Raises an ``OSError`` for any other, whatever the version of the reader checks.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __getitem__(self, name: str) -> bytes:
        """Content of a file."""
        if "://" in name or not is_inside(name, self._folder):
            raise OSError(errno.EACCES, f'names "{one_line(name)}", which lies outside its folder')
        return read_bytes(self._folder / name)

    get = __getitem__


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
        check_regular(path)
        if path.suffix.lower() == ".ply" and (read := read_ply(path)) is not None:
            return read[0], _checked(*read, path, where)
        import trimesh

        if path.suffix.lower() == ".obj":
            options = {"file_type": "obj", "skip_materials": True, "maintain_order": True}
            loaded = trimesh.load_scene(BytesIO(_obj_geometry(path)), process=False, **options)
        else:
            loaded = _load(path)
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
            loaded = trimesh.load_scene(
                BytesIO(b"mtllib names\n" + _obj_geometry(path)),
                file_type="obj",
                resolver=_Names("".join(f"newmtl {name}\n" for name in names)),
                process=False,
            )
        else:
            loaded = _load(path)
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
    rows = (row.split() for row in read_bytes(path).split(b"\n") if b"usemtl" in row)
    found = (b" ".join(words[1:]) for words in rows if words and words[0] == b"usemtl" and len(words) > 1)
    return tuple(dict.fromkeys(name.decode("utf-8", "replace") for name in found))


def _obj_geometry(path: Path) -> bytes:
    """Text of an obj file without what would split its vertices: texture coordinates, normals; and without mtllib.

    Blanks are joined, so that names of materials are those of :func:`obj_materials`, and no row costs more than its
    length.
    """
    rows = []
    for row in read_bytes(path).split(b"\n"):
        words = row.split()
        if not words or words[0] in (b"mtllib", b"vt", b"vn"):
            continue
        if words[0] == b"f":
            words[1:] = [word.partition(b"/")[0] for word in words[1:]]
        rows.append(b" ".join(words))
    rows.append(b"")
    return b"\n".join(rows)


def _load(path: Path) -> "trimesh.Scene":
    """A mesh file of any other kind, with the buffers that it names if they lie beside it."""
    import trimesh

    kind, beside = path.suffix.lower().removeprefix("."), _Beside(path.parent)

    def load() -> "trimesh.Scene":
        return trimesh.load_scene(BytesIO(read_bytes(path)), file_type=kind, resolver=beside, process=False)

    survive(path, load)
    return load()


@contextmanager
def _reading(path: Path, where: str) -> Iterator[None]:
    """Turn what readers raise into one line."""
    try:
        yield
    except SceneError:
        raise
    except DataError as error:
        raise SceneError(f"{where}: cannot read mesh file {path.name}: {error}") from None
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
        check_regular(path)
        mesh = mi.load_dict({"type": "serialized", "filename": str(path), "shape_index": index})
        parameters = mi.traverse(mesh)
        vertices = np.array(parameters["vertex_positions"], dtype=np.float64).reshape(-1, 3)
        faces = np.array(parameters["faces"], dtype=np.int64).reshape(-1, 3).astype(np.int32)
    except OSError as error:
        raise SceneError(f"{where}: cannot read mesh file {path.name}: {error.strerror}") from error
    except (RuntimeError, KeyError, ValueError) as error:
        what = one_line(str(error).rpartition(f'{path.name}": ')[2] or "unreadable", 120)
        raise SceneError(f"{where}: cannot read mesh file {path.name}: {what}; export it as ply") from None
    return vertices, faces


__all__ = ["MeshPart", "obj_materials", "read_mesh", "read_parts", "read_serialized"]
