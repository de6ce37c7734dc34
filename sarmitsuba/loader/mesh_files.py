"""Mesh files as triangles in float64."""

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.backend import mi
from sarmitsuba.errors import SceneError
from sarmitsuba.parameters import one_line

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

# what a reader that meets arbitrary bytes raises
_READER_ERRORS = (
    ValueError,
    LookupError,
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


def read_mesh(path: Path, where: str) -> tuple[F64, I32]:
    """Triangles of a ply, obj or stl file, vertices as they are."""
    import trimesh

    options = {"skip_materials": True, "maintain_order": True} if path.suffix.lower() == ".obj" else {}
    try:
        mesh = trimesh.load_mesh(path, process=False, **options)
        if isinstance(mesh, trimesh.Scene):
            mesh = mesh.to_mesh()
        vertices = np.array(mesh.vertices, dtype=np.float64)
        faces = np.array(mesh.faces, dtype=np.int64)
    except OSError as error:
        raise SceneError(f"{where}: cannot read mesh file {path.name}: {error.strerror or error}") from error
    except _READER_ERRORS as error:
        what = one_line(error) or type(error).__name__
        raise SceneError(
            f"{where}: mesh file {path.name} is malformed: {what}; export it again as ply or obj"
        ) from error
    if faces.ndim != 2 or faces.shape[0] == 0:
        raise SceneError(f"{where}: mesh file {path.name} holds no faces; a radar needs surfaces, not points")
    if faces.min() < 0 or faces.max() >= vertices.shape[0]:
        raise SceneError(
            f"{where}: mesh file {path.name} refers to vertex {faces.max()} of {vertices.shape[0]}; export "
            "it again"
        )
    return vertices, faces.astype(np.int32)


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


__all__ = ["read_mesh", "read_serialized"]
