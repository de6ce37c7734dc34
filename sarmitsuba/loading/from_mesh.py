"""Mesh files as scenes: glTF, obj, ply, stl, off; materials by name, unit and up axis by standard, guess or option.

Also the unit and the up axis of scene files made for light, which state neither.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.loading.assemble import MAX_COORDINATE, MeshSurface
from sarmitsuba.loading.collect import Collector
from sarmitsuba.loading.elements import Element, walk
from sarmitsuba.loading.mesh_files import MeshPart, read_parts
from sarmitsuba.loading.names_of_materials import check_chosen
from sarmitsuba.loading.shapes import NUMBERED, MeshReader, Placed
from sarmitsuba.loading.tables import SENSOR
from sarmitsuba.scene.mesh.model_units import (
    LIKELY_WALL,
    TALLEST_WALL,
    UNITS,
    ShapeExtent,
    doubtful_unit,
    up_axis,
    y_ground,
)

Up = Literal["auto", "y", "z"]
UPS: tuple[str, ...] = get_args(Up)
SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl", ".off")
_GLTF = (".glb", ".gltf")
# from y up to z up: x stays, y becomes z
_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
# shapes that can be ground or stand on it, read in no time; ids of Blender's exporter; least cosine of a turned axis
_FLAT = ("ply", "obj", "stl", "serialized", "rectangle", "cube")
_EXPORTED = re.compile(rf"{NUMBERED.pattern}$|mat-|mesh-")
_TURNED = 0.99


@dataclass(frozen=True)
class MeshOptions:
    """Properties that a mesh file does not contain; of a scene file the first two, for its shapes.

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
    unit = _describe_unit(options, "m as glTF has it" if suffix.lower() in _GLTF else "")
    return matrix, (
        f"{name}: {said}, unit {unit}: {span[0]:.4g} m x {span[1]:.4g} m wide and {span[2]:.4g} m high (--up and "
        "--unit change that)"
    )


def _describe_unit(options: MeshOptions, stated: str = "") -> str:
    """The unit in words; ``stated``: the file's, if it says one."""
    if options.unit != "auto":
        return f"{options.unit} as asked"
    return stated or "m, which the file does not say"


@dataclass(frozen=True, eq=False)
class SceneFrame:
    """Map from the coordinates of a scene file's shapes to metres east, north and up.

    Parameters
    ----------
    matrix : (4, 4) float64
    up : the axis that points up, and the reason
    doubt : warning where the axis is in doubt; empty: none
    """

    matrix: F64
    up: str
    doubt: str = ""


def find_frame(
    label: str, root: Element, shapes: Sequence[Placed], reader: MeshReader, options: MeshOptions
) -> SceneFrame:
    """Frame of a scene file: as asked for, else metres, and z up unless the scene was made with y up.

    That is believed where all shapes stand on ground whose normal is y, and Blender's exporter wrote the file or most
    shapes were turned from z up to y up; where only the ground says so there is a warning. Files with a radar are in
    its frame, and there is a warning where they hardly are.

    Parameters
    ----------
    label : start of the warning
    root : of the scene
    shapes : of the scene, as in the file
    reader : of mesh files
    options : of the user
    """
    up, said, doubt = options.up, f"{options.up} up as asked", ""
    if up == "auto":
        up, said = "z", "z up"
        flat = [p for p in shapes if p.element.plugin in _FLAT]
        read = ((p, *reader.triangles(p)) for p in flat)
        with np.errstate(over="ignore", invalid="ignore"):  # such meshes are refused when they are checked
            extents = {p.name: ShapeExtent.of(v[f]) for p, v, f in read if len(f)}
            ground = y_ground(list(extents.values()))
        if ground >= 0:
            name = one_line(list(extents)[ground])
            sure, placed = _from_blender(root) or _were_turned(flat), has_radar(root)
            if sure and not placed:
                up, said = "y", f'y up by its ground "{name}"'
            elif sure or not placed:
                doubt = f'{label}: is y up? "{name}" looks like ground below all else; give --up y, or --up z'
    matrix = np.eye(4)
    matrix[:3, :3] = UNITS.get(options.unit, 1.0) * (_Y_UP if up == "y" else np.eye(3))
    return SceneFrame(matrix, said, doubt)


def describe_frame(
    label: str, frame: SceneFrame, surfaces: Sequence[MeshSurface], options: MeshOptions
) -> tuple[str, str]:
    """Note on a scene file's up axis, unit and size, and the warning where it can hardly be in metres (or empty).

    Parameters
    ----------
    label : start of both
    frame : of the file
    surfaces : of the scene, in its frame
    options : of the user
    """
    low, high = (np.array([getattr(s.vertices, e)(axis=0) for s in surfaces]) for e in ("min", "max"))
    span = high.max(axis=0) - low.min(axis=0)
    note = (
        f"{label}: {frame.up}, unit {_describe_unit(options)}: {span[0]:.4g} m x {span[1]:.4g} m wide and "
        f"{span[2]:.4g} m high (--up and --unit change that)"
    )
    # wider ones are refused, or warned of, with the scene
    if (
        options.unit != "auto"
        or not LIKELY_WALL < span[2] <= TALLEST_WALL
        or not span.max() <= MAX_COORDINATE
    ):
        return note, ""
    doubt = doubtful_unit(np.concatenate([s.vertices[s.faces] for s in surfaces]), LIKELY_WALL)
    return (
        note,
        f"{label}: is its unit the metre? Then {doubt}; give --unit cm, mm, in, ft or m" if doubt else "",
    )


def has_radar(root: Element) -> bool:
    """Whether a scene has a radar, so that its shapes are in the radar's frame."""
    return any(sensor.plugin == SENSOR.plugin for sensor in root.of_kind("sensor"))


def _from_blender(root: Element) -> bool:
    """Whether ids are those that Blender's Mitsuba exporter gives."""
    return any(_EXPORTED.match(element.id) for element in walk(root) if element.id)


def _were_turned(shapes: Sequence[Placed]) -> bool:
    """Whether the transforms of most shapes turn their own z upwards along y."""
    upwards = np.array([p.to_world[:3, 2] / (np.linalg.norm(p.to_world[:3, 2]) or 1.0) for p in shapes])
    return int((upwards[:, 1] > _TURNED).sum()) > len(shapes) // 2


def _turn(suffix: str, parts: list[MeshPart], options: MeshOptions) -> tuple[F64, str]:
    """Rotation (3, 3) of the file's axes into east, north, up, and the note about it."""
    if options.up != "auto":
        up, said = options.up, f"{options.up} up as asked"
    elif suffix.lower() in _GLTF:
        up, said = "y", "y up as glTF has it"
    else:
        up = "y" if up_axis(_triangles(parts)) == 1 else "z"
        said = f"{up} up by its shape"
    if up == "y":
        return _Y_UP, said
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
