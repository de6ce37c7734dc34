"""Mesh files as triangles in float64."""

import errno
import re
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
from sarmitsuba.scene.geometry import PART_MARK
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
    """Triangles of a mesh file that share an object and a material.

    Parameters
    ----------
    name : of the part: its object, ``OBJECT/MATERIAL`` for one of several materials; the material without objects
    material : as the file names it; of a glTF part without one, the part's name; empty in files without names
    vertices : (n_v, 3) float64, unit and axes of the file, the file's transforms applied
    faces : (n_f, 3) int32
    whole : object that it is a part of; empty where the file names none
    """

    name: str
    material: str
    vertices: F64
    faces: I32
    whole: str = ""


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
    """Parts of an obj file: the faces of every object and material with their vertices, in order of the names."""
    pair = mesh.owner * (len(mesh.materials) + 1) + mesh.group + 1
    order = np.argsort(pair, kind="stable")
    used, starts = np.unique(pair[order], return_index=True)
    owner, group = np.divmod(used, len(mesh.materials) + 1)
    several = np.bincount(owner) > 1
    parts, taken = [], Counter[str]()
    for o, g, rows in zip(owner, group - 1, np.split(order, starts[1:]), strict=True):
        corners, faces = np.unique(mesh.faces[rows], return_inverse=True)
        material = mesh.materials[g] if g >= 0 else ""
        whole = _clean(mesh.objects[o])
        name = _name_part(whole, material if several[o] else "") or material or "geometry"
        taken[name] += 1
        name = f"{name}_{taken[name] - 1}" if taken[name] > 1 else name
        vertices, rest = mesh.vertices[corners], faces.reshape(-1, 3).astype(np.int32)
        parts.append(MeshPart(name, material, vertices, rest, whole))
    return sorted(parts, key=lambda part: part.name)


def _clean(name: str) -> str:
    """Name of an object without the mark of its parts."""
    return name.replace(PART_MARK, " ")


def _name_part(whole: str, material: str) -> str:
    """Name of an object's part of a material; the object itself where it has one material."""
    return f"{whole}{PART_MARK}{_clean(material) or 'no material'}" if whole and material else whole


def _placed_parts(path: Path, where: str) -> list[MeshPart]:
    """Parts of a file whose nodes place meshes."""
    import trimesh

    loaded = _load(path)
    placed = _placements(loaded, path, where)
    named = path.suffix.lower() in _NAMED_PARTS
    whole_of, of_file = _nodes_of_file(loaded), {key: i for i, key in enumerate(loaded.geometry)}
    nodes, several, taken = loaded.graph.transforms.node_data, Counter(whole_of.values()), Counter[str]()
    parts = []

    def by_file(node: Hashable) -> tuple[str, int]:
        return str(whole_of[node]), of_file[nodes[node]["geometry"]]

    for node in sorted(whole_of, key=by_file):
        mesh = loaded.geometry[nodes[node]["geometry"]]
        if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
            continue  # lines and points
        matrix, corners = placed[node], np.array(mesh.vertices, dtype=np.float64)
        vertices = corners @ matrix[:3, :3].T + matrix[:3, 3]
        faces = _check_mesh(vertices, np.array(mesh.faces, dtype=np.int64), path, where)
        whole = str(whole_of[node])
        material = str(
            getattr(getattr(mesh.visual, "material", None), "name", None) or (whole if named else "")
        )
        name = _name_part(_clean(whole), material if several[whole_of[node]] > 1 else "")
        taken[name] += 1
        name = f"{name}_{taken[name] - 1}" if taken[name] > 1 else name
        parts.append(MeshPart(name, material, vertices, faces, _clean(whole) if named else ""))
    return parts


def _nodes_of_file(loaded: "trimesh.Scene") -> dict[Hashable, Hashable]:
    """Node of the file for every node with a mesh: trimesh makes one, with a random name, for each primitive."""
    parents = {child: parent for parent, below in loaded.graph.transforms.children.items() for child in below}

    def node_of_file(node: Hashable) -> Hashable:
        parent = parents.get(node)
        return parent if re.fullmatch(f"{re.escape(str(parent))}_\\w{{6}}", str(node)) else node

    return {node: node_of_file(node) for node in loaded.graph.nodes_geometry}


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
