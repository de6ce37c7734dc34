"""Mesh files as scenes: glTF, obj, ply, stl, off; materials by name, unit and up axis by standard, guess or option."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from sarmitsuba.arrays import F64
from sarmitsuba.errors import SceneError
from sarmitsuba.loader.collect import Collector
from sarmitsuba.loader.mesh_files import MeshPart, read_parts
from sarmitsuba.loader.names_of_materials import check_chosen
from sarmitsuba.mesh.model_units import LIKELY_WALL, doubtful_unit, up_axis

Up = Literal["auto", "y", "z"]
UPS: tuple[str, ...] = get_args(Up)
UNITS: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "ft": 0.3048, "in": 0.0254}
SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl", ".off")
_GLTF = (".glb", ".gltf")


@dataclass(frozen=True)
class MeshOptions:
    """Properties that a mesh file does not contain.

    Parameters
    ----------
    up : axis of the file that points up; ``auto`` is y in glTF, as its standard says, else a guess from the shape
    unit : of the file's coordinates, a name of ``UNITS``; ``auto`` is metres where that is plausible
    materials : material of the library by the file's name of it, in place of the guess from that name; by ``*`` that of
        all others, and of parts without a name
    """

    up: Up = "auto"
    unit: str = "auto"
    materials: Mapping[str, str] = field(default_factory=dict)


def is_mesh_file(path: Path) -> bool:
    """Whether a file is read as a mesh, by its suffix."""
    return path.suffix.lower() in SUFFIXES


def add_mesh_file(collector: Collector, path: Path, options: MeshOptions) -> None:
    """Add every part of a mesh file, with z up and in metres, and note the assumptions.

    Raises
    ------
    SceneError : the file cannot be read, cannot be in metres, or an option does not fit it

    Warns
    -----
    SarmitsubaWarning : materials with unknown names, which are read as concrete
    """
    parts = read_parts(path, path.name)
    check_chosen(options.materials, {part.material for part in parts if part.material}, path.name)
    matrix, said = upright(path.name, path.suffix, parts, options)
    collector.notes.append(said)
    vertices = [part.vertices @ matrix.T for part in parts]
    collector.add_parts(path.name, parts, vertices, options.materials)


def upright(name: str, suffix: str, parts: list[MeshPart], options: MeshOptions) -> tuple[F64, str]:
    """Matrix (3, 3) from a file's coordinates to metres east, north and up, and the note about it.

    Raises
    ------
    SceneError : the coordinates are hardly metres, and no unit is given
    """
    turn, said = _turn(suffix, parts, options)
    matrix = _scale(name, parts, turn, options) * turn
    span = np.ptp(np.concatenate([part.vertices @ matrix.T for part in parts]), axis=0)
    return matrix, (
        f"{name}: {said}, unit {options.unit if options.unit != 'auto' else 'm'}: {span[0]:.4g} m x "
        f"{span[1]:.4g} m wide and {span[2]:.4g} m high (--up and --unit change that)"
    )


def _turn(suffix: str, parts: list[MeshPart], options: MeshOptions) -> tuple[F64, str]:
    """Rotation (3, 3) of the file's axes into east, north, up, and the note about it."""
    if options.up != "auto":
        up, said = options.up, f"{options.up} up as asked"
    elif suffix.lower() in _GLTF:
        up, said = "y", "y up as glTF has it"
    else:
        up = "y" if up_axis(_triangles(parts)) == 1 else "z"
        said = f"{up} up by its shape"
    if up == "y":  # x stays, y becomes z
        return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), said
    return np.eye(3), said


def _scale(name: str, parts: list[MeshPart], turn: F64, options: MeshOptions) -> float:
    """Metres of the file's unit."""
    if options.unit != "auto":
        return UNITS[options.unit]
    triangles = _triangles(parts) @ turn.T
    doubt = doubtful_unit(triangles, LIKELY_WALL)
    if doubt:
        height = float(np.ptp(triangles.reshape(-1, 3)[:, 2]))
        likely = ", ".join(f"--unit {unit} ({UNITS[unit] * height:.3g} m high)" for unit in ("cm", "mm"))
        raise SceneError(
            f"{name}: is its unit the metre? Then {doubt}; give {likely}, in, ft or km, or --unit m if it is right; "
            'or --up where "up" is wrong'
        )
    return 1.0


def _triangles(parts: list[MeshPart]) -> F64:
    return np.concatenate([part.vertices[part.faces] for part in parts])
