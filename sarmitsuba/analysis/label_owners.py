"""Shapes and materials of a scene as owners of echoes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.analysis.label_sight import ground_shapes
from sarmitsuba.core.arrays import F64, I64, U32
from sarmitsuba.core.errors import ResourceError
from sarmitsuba.scene.geometry import Geometry, PointTarget
from sarmitsuba.scene.ground import level_rim
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.scatterers import ScattererKind, Target, kinds_in_order, targets_by_kind
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.tracing.kernel.path_groups import IS_GROUND, MECHANISMS, MOST_OWNERS, PathOwners
from sarmitsuba.tracing.kernel.source import Launch

# places along the sides of triangles by which the mesh of an edge is found, at most
_SIDES = 200_000
_CONTINUED = " (continued)"
# material of echoes whose place has none, and all that stand for one where there is no surface
OTHER = "other"


def no_surface_materials() -> tuple[str, ...]:
    """Materials of echoes that belong to no surface."""
    kinds = (*(kind.mechanism for kind in kinds_in_order()), ScattererKind.mechanism)
    return (*dict.fromkeys(kinds), "point", OTHER)


@dataclass(frozen=True, eq=False)
class SceneShapes:
    """Shapes of a scene in one list: objects of meshes, scatterers by their kinds, ideal points.

    Parameters
    ----------
    names : of all, objects one by one, others that share a name once
    first : number of the first one of every kind
    ground : (n,) whether each is ground
    """

    names: tuple[str, ...]
    first: Mapping[str, int]
    ground: NDArray[np.bool_]

    @staticmethod
    def of(scene: Scene, classes: Mapping[str, str]) -> "SceneShapes":
        """Shapes of a scene as loaded."""
        kinds = {"mesh": scene.geometry.object_names} | {
            kind: tuple(dict.fromkeys(thing.name for thing in things))
            for kind, things in _find_shapes_beside_mesh(scene).items()
        }
        names = tuple(name for group in kinds.values() for name in group)
        starts = np.cumsum([0, *(len(group) for group in kinds.values())]).tolist()
        ground = np.zeros(len(names), dtype=bool)
        ground[: len(kinds["mesh"])] = ground_shapes(scene, classes)
        return SceneShapes(names, dict(zip(kinds, starts, strict=False)), ground)

    def number(self, kind: str, name: str) -> int:
        """Number of a shape; of several of a kind with one name, that they share."""
        return self.names.index(name, self.first[kind])

    @property
    def n(self) -> int:
        """Number of shapes."""
        return len(self.names)


class SceneOwners:
    """Owners of the echoes of a run.

    Parameters
    ----------
    scene : as loaded
    run : of it
    shapes : of it

    Attributes
    ----------
    paths : owners in the kernel
    shape : (n,) shape of each owner, the number of shapes for echoes of none
    material : (n,) material of each owner, index into ``materials``
    materials : names
    point : (n_points,) owner of each ideal point of the run
    """

    def __init__(self, scene: Scene, run: Run, shapes: SceneShapes) -> None:
        self.run, self.shapes = run, shapes
        self._number: dict[tuple[int, int], int] = {}
        self.materials: list[str] = []
        of_row, n_materials = np.zeros(1, dtype=np.uint32), 1
        self._object = np.zeros(0, dtype=np.int64)
        if run.trace_scene is not None and run.scene.geometry.n_faces:
            self._object = _object_of_faces(scene, run.scene.geometry)
            of_row, n_materials = self._rows(run.trace_scene.geometry_faces)
        self._of_kind: dict[str, I64] = {}
        for kind, things in _find_shapes_beside_mesh(run.scene).items():
            number = [self._owner(shapes.number(kind, thing.name), kind) for thing in things]
            self._of_kind[kind] = np.array(number, dtype=np.int64)
        self.point = self._of_kind["point"]
        self._other = self._owner(shapes.n, OTHER)
        by_mesh: dict[int, int] = {}
        for (shape, _), owner in self._number.items():
            by_mesh.setdefault(shape, owner)
        self._by_mesh = by_mesh
        if len(self._number) > MOST_OWNERS:
            raise ResourceError(
                f"{scene.name}: labels: {len(self._number)} shapes and materials, above {MOST_OWNERS}; join meshes"
            )
        keys = np.array(list(self._number), dtype=np.int64).reshape(-1, 2)
        self.shape, self.material = keys[:, 0], keys[:, 1]
        self.paths = PathOwners(of_row, n_materials, len(self._number), self._find_launch_owners)

    def _owner(self, shape: int, material: str) -> int:
        """Number of an owner, which is new or known."""
        if material not in self.materials:
            self.materials.append(material)
        return self._number.setdefault((shape, self.materials.index(material)), len(self._number))

    def _rows(self, faces: NDArray[np.intp]) -> tuple[U32, int]:
        """Owners by row of the tables and material, and the number of materials that are told apart in a row."""
        geometry, materials = self.run.scene.geometry, self.run.scene.materials
        names = material_names(materials)
        mapped = any(m.maps is not None and m.maps.classes is not None for m in materials)
        mesh, own = self._object[faces], geometry.face_material[faces].astype(np.int64)
        n = len(names) if mapped else 1
        out = np.zeros((len(faces), n), dtype=np.uint32)
        pairs, row = np.unique(np.stack([mesh, own], axis=1), axis=0, return_inverse=True)
        table = np.zeros((len(pairs), n), dtype=np.uint32)
        for i, (shape, material) in enumerate(pairs.tolist()):
            bit = np.uint32(IS_GROUND if self.shapes.ground[shape] else 0)
            of_materials = range(len(names)) if mapped else [material]
            table[i] = [np.uint32(self._owner(shape, names[m])) | bit for m in of_materials]
        out[:] = table[row.reshape(-1)]
        return out.reshape(-1), n

    def _find_launch_owners(self, launch: Launch) -> tuple[int, U32]:
        """Number of the mechanism of a launch of scatterers, and the owner of each scatterer."""
        part = launch.part
        find = getattr(launch.source, "scatterers_of", None)
        found = None if find is None else find(part)
        name = getattr(found, "mechanism", "scatterer")
        count = slice(part.first, part.first + part.count)
        if found is None:
            owner = np.full(part.count, self._other)
        elif hasattr(found, "middle"):
            owner = self._find_object_owners(self._object[self._sides(found.middle[count])])
        elif hasattr(found, "face"):
            owner = self._find_pair_owners(found.face[count])
        elif name in self._of_kind and hasattr(found, "owner"):
            owner = self._of_kind[name][found.owner[count]]
        else:
            owner = np.full(part.count, self._other)
        return MECHANISMS.index(name), np.asarray(owner, dtype=np.uint32)

    def _find_object_owners(self, mesh: I64) -> I64:
        """An owner of each mesh (n,), whatever its material."""
        return np.array([self._by_mesh.get(m, self._other) for m in mesh.tolist()], dtype=np.int64)

    def _find_pair_owners(self, rows: NDArray[np.intp]) -> I64:
        """Owners of pairs of scatterers from the rows (n, 2) of their faces: the end that is not ground, or in turn."""
        assert self.run.trace_scene is not None
        mesh = self._object[self.run.trace_scene.geometry_faces[rows]]
        ground = self.shapes.ground[mesh]
        end = np.where(ground[:, 0] == ground[:, 1], np.arange(len(rows)) % 2, ground[:, 0].astype(np.int64))
        return self._find_object_owners(mesh[np.arange(len(rows)), end])

    def _sides(self, middle: F64) -> I64:
        """Face (n,) at whose side places (n, 3), m, lie."""
        tree, face = self._places_on_sides
        return np.asarray(face[tree.query(middle)[1]])

    @cached_property
    def _places_on_sides(self) -> "tuple[scipy.spatial.cKDTree, I64]":
        """Places along the sides of all triangles, and the face of each."""
        geometry = self.run.scene.geometry
        corners = geometry.vertices[geometry.faces]
        side = np.roll(corners, -1, axis=1) - corners
        length = np.linalg.norm(side, axis=2)
        share = _SIDES * length / max(float(length.sum()), 1e-300)
        count = np.maximum(1, np.ceil(share)).astype(np.int64).reshape(-1)
        row = np.repeat(np.arange(count.size), count)
        along = (np.arange(row.size) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[row]
        points = corners.reshape(-1, 3)[row] + along[:, None] * side.reshape(-1, 3)[row]
        return scipy.spatial.cKDTree(points), row // 3


def material_names(materials: Sequence[Material]) -> list[str]:
    """Names of materials and of the parts of mapped ones, in the order of their numbers in the kernel."""
    return [material.name.removesuffix(_CONTINUED) for material in list_with_parts(materials)]


def _find_shapes_beside_mesh(scene: Scene) -> "dict[str, list[Target | PointTarget]]":
    """Shapes other than meshes, by the mechanism of their echoes."""
    found: dict[str, list[Target | PointTarget]] = {}
    for kind, targets in targets_by_kind(scene.scatterers).items():
        found.setdefault(kind.mechanism, []).extend(targets)
    return found | {"point": list(scene.points)}


def _object_of_faces(scene: Scene, geometry: Geometry) -> I64:
    """Object of the scene as loaded for every face of the traced geometry; ground that goes on is that of its rim."""
    mesh, n = geometry.face_mesh, len(scene.geometry.mesh_names)
    if (mesh >= n).any():
        rim = level_rim(scene.geometry)
        assert rim is not None
        mesh = np.where(mesh < n, mesh, scene.geometry.face_mesh[rim.face[0]])
    return np.asarray(scene.geometry.mesh_object[mesh])
