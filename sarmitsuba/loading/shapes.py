"""Shapes of a scene file as triangles in float64: mesh files read with trimesh, the others tessellated."""

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import did_you_mean, one_line
from sarmitsuba.loading.attributes import corner_values
from sarmitsuba.loading.elements import Element, Opaque, Property
from sarmitsuba.loading.mesh_files import read_mesh, read_shape
from sarmitsuba.scene.geometry import PART_MARK
from sarmitsuba.scene.mesh import tessellate
from sarmitsuba.scene.motion import STILL, Motion

MAX_FACES = 400_000  # most faces of one tessellated shape
SPHERE_MIN_SAGITTA = 1.4e-5  # least sagitta over the radius; gives MAX_FACES
_MESH_FILES = ("ply", "obj", "stl")
_MOVING = ("velocity", "acceleration")
_COMMON = ("to_world", "flip_normals", *_MOVING)
_MESH = (*_COMMON, "filename", "face_normals", "flip_tex_coords")
# parameters of every supported shape; those without geometry are accepted and ignored
SHAPE_PARAMETERS: dict[str, tuple[str, ...]] = {
    "ply": _MESH,
    "obj": _MESH,
    "stl": _MESH,
    "serialized": (*_MESH, "shape_index"),
    "rectangle": _COMMON,
    "cube": _COMMON,
    "disk": _COMMON,
    "sphere": (*_COMMON, "center", "radius"),
    "cylinder": (*_COMMON, "p0", "p1", "radius"),
    "linearcurve": (*_COMMON, "filename"),
    "radar_ground": ("material", "level", "extent"),
    "shapegroup": (),
    "instance": ("to_world", *_MOVING),
    "merge": _MOVING,
}
# ids that an exporter gives to shapes without one
NUMBERED = re.compile(r"elm__\d+")
_OBJECTS = ("bsdf", "shape", "emitter", "medium", "texture", "sensor", "volume")
_MAX_NESTING = 16
_IDENTITY = np.eye(4)
_MAX_POINT = 1e15  # bound, m; beyond, distances between points overflow


@dataclass(frozen=True, eq=False)
class Placed:
    """A shape element with its placement.

    Parameters
    ----------
    element : of a shape with a surface
    name : see `name_shape`, with a number where it is taken
    to_world : (4, 4) float64, file frame
    motion : in the file frame, not turned by ``to_world``
    """

    element: Element
    name: str
    to_world: F64
    motion: Motion = STILL

    def moved(self, vertices: F64) -> F64:
        """(n, 3) points of the shape's coordinates in the file frame, m."""
        if self.to_world is _IDENTITY:
            return vertices + 0.0  # no negative zeros, as from the product
        with np.errstate(over="ignore", invalid="ignore"):  # refused when the mesh is checked
            return np.asarray(vertices @ self.to_world[:3, :3].T + self.to_world[:3, 3])

    def in_frame(self, matrix: F64) -> "Placed":
        """The shape and its motion, mapped by a matrix (4, 4); not ``radar_ground``, which is level in any frame."""
        if self.element.plugin == "radar_ground":
            return self
        motion = self.motion
        if not motion.still:
            turned = (matrix[:3, :3] @ np.array(vector) for vector in (motion.velocity, motion.acceleration))
            motion = Motion.of(*turned)
        return replace(self, to_world=matrix @ self.to_world, motion=motion)

    @property
    def is_curved(self) -> bool:
        """True for shapes whose facets stand for one smooth surface."""
        return self.element.plugin in ("sphere", "disk", "cylinder")

    @property
    def is_convex(self) -> bool:
        """True for shapes that are one closed convex body; affine maps keep convexity."""
        return self.element.plugin in ("sphere", "cube")


@dataclass
class MeshReader:
    """Triangulates shapes; caches the mesh files read.

    Parameters
    ----------
    sagitta : bound of the distance between a curved shape and its facets, m
    notes : filled with one line for every shape that misses the bound
    """

    sagitta: float
    notes: list[str] = field(default_factory=list)
    _files: dict[tuple[Path, int], tuple[F64, I32]] = field(default_factory=dict)

    def triangles(self, placed: Placed) -> tuple[F64, I32]:
        """Vertices (n_v, 3) float64 in the file frame, m, and faces (n_f, 3) int32.

        Raises
        ------
        SceneError : the mesh file is missing or unreadable, or a value is invalid
        """
        vertices, faces = self._local(placed)
        return placed.moved(vertices), faces

    def corner_values(self, placed: Placed, faces: I32, names: Sequence[str]) -> dict[str, F64]:
        """Attributes of a shape used by maps, see `sarmitsuba.loading.attributes.corner_values`."""
        element = placed.element
        path = mesh_path(element) if element.plugin in _MESH_FILES else None
        return corner_values(element, path, faces, names)

    def _local(self, placed: Placed) -> tuple[F64, I32]:
        element, where = placed.element, placed.element.where
        plugin = element.plugin
        if plugin in _MESH_FILES or plugin == "serialized":
            return self._file(element)
        if plugin == "rectangle":
            return tessellate.rectangle()
        if plugin == "cube":
            return tessellate.cube()
        linear = placed.to_world[:3, :3]
        radius = _radius(element)
        if plugin == "disk":
            return tessellate.disk(max(self._local_sagitta(linear[:, :2]), 1e-10))
        if plugin == "sphere":
            wanted = self._local_sagitta(linear)
            sagitta = max(wanted, SPHERE_MIN_SAGITTA * radius)
            if sagitta > wanted:
                self.notes.append(
                    f"{where}: tessellated to a sagitta of {sagitta / wanted * self.sagitta:.3g} m, not "
                    f"{self.sagitta:.3g} m, at {MAX_FACES} faces"
                )
            vertices, faces = tessellate.sphere(radius, sagitta)
            return vertices + sphere_center(element), faces
        return self._cylinder(element, linear)

    def _local_sagitta(self, linear: F64) -> float:
        """Sagitta bound in the local coordinates of a shape that ``linear`` maps to the world."""
        if not np.isfinite(linear).all():
            return self.sagitta  # refused when the mesh is checked
        scale = float(np.linalg.norm(linear, 2))
        return self.sagitta / scale if scale > 0.0 else self.sagitta

    def _cylinder(self, element: Element, linear: F64) -> tuple[F64, I32]:
        p0, p1, radius = cylinder_axis(element)
        length = float(np.linalg.norm(p1 - p0))
        z = (p1 - p0) / length
        x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
        x /= np.linalg.norm(x)
        frame = np.stack([x, np.cross(z, x), z])
        with np.errstate(over="ignore", invalid="ignore"):
            across = linear @ frame[:2].T
        sagitta = max(self._local_sagitta(across), 1e-9 * radius)
        vertices, faces = tessellate.cylinder(radius, 0.0, length, sagitta)
        return p0 + vertices @ frame, faces

    def _file(self, element: Element) -> tuple[F64, I32]:
        path = mesh_path(element)
        index = element.values.get("shape_index", 0)
        key = (path, int(index) if isinstance(index, int) else 0)
        if key not in self._files:
            if element.plugin == "serialized":
                self._files[key] = read_shape(path, key[1], element.where)
            else:
                self._files[key] = read_mesh(path, element.where)
        return self._files[key]


def placed_shapes(root: Element) -> Iterator[Placed]:
    """Every shape with a surface, in the file's coordinates, shape groups through their instances.

    Raises
    ------
    SceneError : a shape is of an unknown kind or has an unknown parameter
    """
    taken: dict[str, int] = {}
    for element in root.of_kind("shape"):
        yield from _expand(element, _IDENTITY, STILL, taken, 0)


def sphere_center(element: Element) -> F64:
    """Centre (3,) float64 of a sphere element in its own coordinates."""
    return _vector(element, "center", np.zeros(3))


def cylinder_axis(element: Element) -> tuple[F64, F64, float]:
    """Both ends of a cylinder element, (3,) float64, and its radius, in its own coordinates.

    Raises
    ------
    SceneError : the ends are one point, or a value is invalid
    """
    p0 = _vector(element, "p0", np.zeros(3))
    p1 = _vector(element, "p1", np.array([0.0, 0.0, 1.0]))
    if float(np.linalg.norm(p1 - p0)) == 0.0:
        raise SceneError(f"{element.where}: p0 and p1 are the same point; move one of them")
    return p0, p1, _radius(element)


def mesh_path(element: Element) -> Path:
    """File of a mesh element.

    Raises
    ------
    SceneError : it has no file name, or there is no such file
    """
    name = element.values.get("filename")
    if not isinstance(name, str) or not name:
        raise SceneError(f'{element.where}: no mesh file is named; give <string name="filename" value=.../>')
    path = os.path.join(element.folder, name)
    if not os.path.isfile(path):
        parent = os.path.dirname(path)
        beside = os.listdir(parent) if os.path.isdir(parent) else []
        guess = did_you_mean(os.path.basename(path), beside) or "; check filename"
        raise SceneError(
            f'{element.where}: mesh file "{one_line(name)}" not found in {element.folder}{guess}'
        )
    return Path(path)


def _expand(
    element: Element, outer: F64, carried: Motion, taken: dict[str, int], depth: int, whole: str = ""
) -> Iterator[Placed]:
    plugin = element.plugin
    _check_parameters(element)
    if depth > _MAX_NESTING:
        raise SceneError(f"{element.where}: shapes are nested more than {_MAX_NESTING} deep; flatten them")
    matrix = outer
    if "to_world" in element.values:
        with np.errstate(over="ignore", invalid="ignore"):
            matrix = outer @ _matrix(element)
        if not np.isfinite(matrix).all():
            raise SceneError(f"{element.where}: nested to_world transforms overflow; check their numbers")
    motion = _motion(element, carried)
    if plugin in ("instance", "merge"):
        inner = list(element.of_kind("shape"))
        if plugin == "instance":
            inner = [part for group in inner for part in (group.of_kind("shape"))]
        if not inner:
            raise SceneError(
                f"{element.where}: {plugin} holds no shape; refer to a shapegroup with shapes in it"
            )
        if plugin == "instance" and len(inner) > 1 and not whole:
            whole = _number(_name_instance(element), taken)
        for part in inner:
            yield from _expand(part, matrix, motion, taken, depth + 1, whole)
    elif plugin != "shapegroup":
        name = name_shape(element)
        name = f"{whole}{PART_MARK}{name.replace(PART_MARK, ' ')}" if whole else name
        yield Placed(element, _number(name, taken), matrix, motion)


def _check_parameters(element: Element) -> None:
    """Raise a SceneError for an unknown shape or parameter."""
    plugin = element.plugin
    if plugin not in SHAPE_PARAMETERS:
        known = ", ".join(SHAPE_PARAMETERS)
        guess = did_you_mean(plugin, SHAPE_PARAMETERS)
        raise SceneError(
            f'{element.where}: shape type "{plugin}" is not supported{guess or f"; use one of {known}"}'
        )
    for name, value in element.given().items():
        if name not in SHAPE_PARAMETERS[plugin] and not _is_object(value):
            guess = did_you_mean(name, SHAPE_PARAMETERS[plugin])
            known = ", ".join(SHAPE_PARAMETERS[plugin]) or "no parameters"
            raise SceneError(
                f'{element.where}: unknown parameter "{name}"{guess or f"; {plugin} knows {known}"}'
            )


def _number(name: str, taken: dict[str, int]) -> str:
    """A name, from its second use on with a number."""
    taken[name] = taken.get(name, 0) + 1
    return name if taken[name] == 1 else f"{name}.{taken[name]}"


def _name_instance(element: Element) -> str:
    """Name of an instance of several shapes, which are parts of it: its id, or that of its group."""
    ids = (element.id, *(group.id for group in element.of_kind("shape")), element.plugin)
    return next(name for name in ids if name and not NUMBERED.fullmatch(name)).replace(PART_MARK, " ")


def name_shape(element: Element) -> str:
    """Name of a shape: its id, or its plugin without one; in place of an id by Blender's exporter the object's name.

    The exporter numbers shapes (``elm__3``) and names mesh files ``OBJECT.ply``, or ``OBJECT-MATERIAL.ply`` for each of
    several materials. The latter become ``OBJECT/MATERIAL``.
    """
    file = element.values.get("filename")
    if not NUMBERED.fullmatch(element.id) or not isinstance(file, str):
        return element.id or element.plugin
    name = PurePosixPath(file).stem.replace(PART_MARK, " ")
    for bsdf in element.of_kind("bsdf"):
        material = bsdf.id.removeprefix("mat-")
        whole, mark = name[: -len(material) - 1], name[-len(material) - 1 : -len(material) or None]
        same = name[-len(material) :].replace(".", "_") == material.replace(".", "_")
        if material and same and whole and mark == "-":
            return f"{whole}{PART_MARK}{material.replace(PART_MARK, ' ')}"
    return name or element.id


def _is_object(value: object) -> bool:
    """True for nested objects, which may have any name; only BSDFs and shapes have a meaning here."""
    return isinstance(value, Opaque) and value.kind in _OBJECTS


def _matrix(element: Element) -> F64:
    value = element.values.get("to_world")
    if value is None:
        return np.eye(4)
    matrix = np.asarray(value, dtype=np.float64) if isinstance(value, np.ndarray) else np.zeros(0)
    if matrix.shape != (4, 4):
        raise SceneError(f'{element.where}: to_world is not a transform; give <transform name="to_world">')
    if not np.isfinite(matrix).all() or np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-9:
        raise SceneError(f"{element.where}: to_world is not a finite affine transform; check its numbers")
    return matrix


def _motion(element: Element, carried: Motion) -> Motion:
    """Motion of a shape: its own, else that of the shape that contains it."""
    given = {name: value for name in _MOVING if (value := element.values.get(name)) is not None}
    if not given:
        return carried
    if not carried.still:
        raise SceneError(
            f"{element.where}: it has a velocity inside a shape that moves; give the velocity to one of the two"
        )
    try:
        return Motion.of(**{name: _components(value) for name, value in given.items()})
    except SceneError as error:
        raise SceneError(
            f'{element.where}: {error}, for example <vector name="velocity" x="0" y="8" z="0"/>'
        ) from None


def _components(value: Property) -> ArrayLike:
    """Components of a vector, or numbers of a text such as ``0 8 0``, separated by blanks or commas."""
    if not isinstance(value, str):
        return value if isinstance(value, np.ndarray) else (np.nan,)
    try:
        return [float(number) for number in value.replace(",", " ").split()]
    except ValueError:
        return (np.nan,)


def _vector(element: Element, name: str, default: F64) -> F64:
    value = element.values.get(name, default)
    if not isinstance(value, np.ndarray) or value.shape != (3,) or not (np.abs(value) <= _MAX_POINT).all():
        raise SceneError(
            f'{element.where}: {name} = {one_line(value)} is not a finite point; give <point name="{name}">'
        )
    return value


def _radius(element: Element) -> float:
    value = element.values.get("radius", 1.0)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < 1e9:
        raise SceneError(
            f"{element.where}: radius = {one_line(value)} m is not between 0 m and 1e9 m; give a positive "
            "radius"
        )
    return float(value)
