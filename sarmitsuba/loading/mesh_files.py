"""Mesh files as triangles in float64."""

import errno
import struct
from collections import Counter
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import F64, I32, I64
from sarmitsuba.core.errors import DataError, SceneError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.machine.encoding import json_value
from sarmitsuba.machine.isolated import survive
from sarmitsuba.machine.regular_files import check_regular, is_inside, read_bytes
from sarmitsuba.scene.mesh.formats import ObjMesh, read_obj, read_ply, read_serialized

if TYPE_CHECKING:
    import trimesh


# exceptions of the readers on malformed files
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
    """Files that a glTF file refers to: regular files of bounded size in its own folder and below.

    Raises an ``OSError`` for any other, whether or not the reader checks.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __getitem__(self, name: str) -> bytes:
        """Content of a file."""
        if "://" in name or not is_inside(name, self._folder):
            raise OSError(errno.EACCES, f'names "{one_line(name)}", which lies outside its folder')
        return read_bytes(self._folder / name)

    get = __getitem__


# most nodes of a file, and within each other
_MOST_NODES, _DEEPEST_NODE = 100_000, 1000
# suffixes of files whose parts have names
_NAMED_PARTS = (".glb", ".gltf")


@dataclass(frozen=True, eq=False)
class MeshPart:
    """Triangles of a mesh file that share a material.

    Parameters
    ----------
    name : of the part
    material : as the file names it; of a glTF part without one, the part's name; empty in files without names
    vertices : (n_v, 3) float64, unit and axes of the file, the file's transforms applied
    faces : (n_f, 3) int32
    """

    name: str
    material: str
    vertices: F64
    faces: I32


def read_mesh(path: Path, where: str) -> tuple[F64, I32]:
    """Triangles of a ply, obj or stl file, vertices as stored."""
    with _reading(path, where):
        if path.suffix.lower() == ".ply" and (read := read_ply(path)) is not None:
            return read[0], _check_mesh(*read, path, where)
        check_regular(path)
        if path.suffix.lower() == ".obj":
            mesh = read_obj(path)
            return mesh.vertices, _check_mesh(mesh.vertices, mesh.faces, path, where)
        import trimesh

        loaded = _load(path)
        parts = list(loaded.geometry.values())
        # these formats have no transforms: a single mesh is used without the copies of joining parts
        alone = len(parts) == 1 and isinstance(parts[0], trimesh.Trimesh)
        joined = parts[0] if alone else loaded.to_mesh()
        vertices = np.array(joined.vertices, dtype=np.float64)
        faces = np.array(
            getattr(joined, "faces", np.zeros((0, 3))), dtype=np.int64
        )  # point clouds have no faces
    return vertices, _check_mesh(vertices, faces, path, where)


def read_parts(path: Path, where: str) -> list[MeshPart]:
    """Parts of a mesh file, each with the name of its material.

    Raises
    ------
    SceneError : the file cannot be read, or holds no faces
    """
    with _reading(path, where):
        parts = _obj_parts(read_obj(path)) if path.suffix.lower() == ".obj" else _placed_parts(path, where)
    if not parts:
        raise SceneError(f"{where}: mesh file {path.name} holds no faces; a radar needs surfaces, not points")
    return parts


def _obj_parts(mesh: ObjMesh) -> list[MeshPart]:
    """Parts of an obj file: the faces of every material with their vertices, in order of the names."""
    order = np.argsort(mesh.group, kind="stable")
    used, starts = np.unique(mesh.group[order], return_index=True)
    parts, taken = [], Counter[str]()
    for group, rows in zip(used, np.split(order, starts[1:]), strict=True):
        corners, faces = np.unique(mesh.faces[rows], return_inverse=True)
        material = mesh.materials[group] if group >= 0 else ""
        name = (material if len(mesh.materials) > 1 else "") or mesh.objects[group] or "geometry"
        taken[name] += 1
        name = f"{name}_{taken[name] - 1}" if taken[name] > 1 else name
        vertices, rest = mesh.vertices[corners], faces.reshape(-1, 3).astype(np.int32)
        parts.append(MeshPart(name, material, vertices, rest))
    return sorted(parts, key=lambda part: part.name)


def _placed_parts(path: Path, where: str) -> list[MeshPart]:
    """Parts of a file whose nodes place meshes."""
    import trimesh

    loaded = _load(path)
    placed = _placements(loaded, path, where)
    parts = []
    for node in sorted(loaded.graph.nodes_geometry):
        matrix, key = placed[node], loaded.graph.transforms.node_data[node].get("geometry")
        mesh = loaded.geometry[key]
        if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
            continue  # lines and points
        corners = np.array(mesh.vertices, dtype=np.float64)
        vertices = corners @ matrix[:3, :3].T + matrix[:3, 3]
        faces = _check_mesh(vertices, np.array(mesh.faces, dtype=np.int64), path, where)
        material = getattr(getattr(mesh.visual, "material", None), "name", None)
        if not material and path.suffix.lower() in _NAMED_PARTS:
            material = node
        parts.append(MeshPart(str(node), str(material or ""), vertices, faces))
    return parts


def _placements(loaded: "trimesh.Scene", path: Path, where: str) -> dict[Hashable, F64]:
    """Transform (4, 4) of every node, from the root down: each is the product of the parent's and the node's."""
    from trimesh.transformations import fix_rigid

    graph = loaded.graph
    root = graph.base_frame
    placed: dict[Hashable, F64] = {root: np.eye(4)}
    level, depth = [root], 0
    while level:
        depth += 1
        below = [(node, child) for node in level for child in graph.transforms.children.get(node, ())]
        if depth > _DEEPEST_NODE or len(placed) + len(below) > _MOST_NODES:
            raise SceneError(
                f"{where}: mesh file {path.name} has more than {_MOST_NODES} nodes, or more than {_DEEPEST_NODE} "
                "within each other; join them before the export"
            )
        for node, child in below:
            own = graph.transforms.edge_data[node, child].get("matrix")
            with np.errstate(over="ignore", invalid="ignore"):  # far places are refused later
                placed[child] = placed[node] if own is None else placed[node] @ own
        level = [child for _, child in below]
    if graph.repair_rigid is None:
        return placed
    return {node: np.asarray(fix_rigid(matrix, graph.repair_rigid)) for node, matrix in placed.items()}


def obj_materials(path: Path) -> tuple[str, ...]:
    """Names of the materials that an obj file uses, in order of first use."""
    rows = (row.split() for row in read_bytes(path).split(b"\n") if b"usemtl" in row)
    found = (b" ".join(words[1:]) for words in rows if words and words[0] == b"usemtl" and len(words) > 1)
    return tuple(dict.fromkeys(name.decode("utf-8", "replace") for name in found))


def _load(path: Path) -> "trimesh.Scene":
    """A mesh file of any other format, with the buffers that it refers to in its own folder."""
    import trimesh

    kind, beside = path.suffix.lower().removeprefix("."), _Beside(path.parent)

    def load() -> "trimesh.Scene":
        content = read_bytes(path)
        try:
            return trimesh.load_scene(BytesIO(content), file_type=kind, resolver=beside, process=False)
        except (OSError, RecursionError):
            if kind == "gltf":
                json_value(
                    content
                )  # trimesh takes the text of a file whose JSON it cannot read for a file's name
            raise

    survive(path, load)
    return load()


@contextmanager
def _reading(path: Path, where: str) -> Iterator[None]:
    """Turn the readers' exceptions into one line."""
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


def _check_mesh(vertices: F64, faces: I64, path: Path, where: str) -> I32:
    if faces.ndim != 2 or faces.shape[0] == 0:
        raise SceneError(f"{where}: mesh file {path.name} holds no faces; a radar needs surfaces, not points")
    if faces.min() < 0 or faces.max() >= vertices.shape[0]:
        raise SceneError(
            f"{where}: mesh file {path.name} refers to vertex {faces.max()} of {vertices.shape[0]}; export "
            "it again"
        )
    return faces.astype(np.int32)


def read_shape(path: Path, index: int, where: str) -> tuple[F64, I32]:
    """Triangles of one shape of a ``serialized`` file, Mitsuba's binary format."""
    with _reading(path, where):
        vertices, faces = read_serialized(path, index)
        return vertices, _check_mesh(vertices, faces, path, where)
