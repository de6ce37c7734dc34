"""Geometry of a scene: triangles and ideal points."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I32, I64
from sarmitsuba.scene.mesh.flat_parts import join_flat_parts
from sarmitsuba.scene.motion import STILL, Motion

# parts of one object are meshes that share what stands before this in their names: "house 7/walls", "house 7/roofs"
PART_MARK = "/"


@dataclass(frozen=True, eq=False)
class Geometry:
    """All triangles of a scene in one list, mesh after mesh.

    Parameters
    ----------
    vertices : (n_vertices, 3) float64, m, scene frame
    faces : (n_faces, 3) int32 vertex numbers
    face_material : (n_faces,) int32 index into ``Scene.materials``
    face_group : (n_faces,) int32; faces of one group form one smooth surface (they share diffuse anchors)
    mesh_names : n_meshes names
    mesh_face_offset : (n_meshes + 1,) int64; mesh i has the faces ``offset[i]:offset[i + 1]``
    mesh_convex : n_meshes, True where the mesh is known to be one closed convex body; empty: none is
    mesh_endless : n_meshes, True for ground without end, which does not count in the scene's extent; empty: none is
    mesh_motion : n_meshes, translation of each from ``vertices``, its place at time zero; empty: none moves
    corner_values : mesh attributes used by maps of its materials, at the corners of every face:
        (n_faces, 3, 2) float64 texture coordinates ``uv``, (n_faces, 3, 1) others; NaN where a mesh has none
    """

    vertices: F64
    faces: I32
    face_material: I32
    face_group: I32
    mesh_names: tuple[str, ...]
    mesh_face_offset: I64
    mesh_convex: tuple[bool, ...] = ()
    mesh_motion: tuple[Motion, ...] = ()
    mesh_endless: tuple[bool, ...] = ()
    corner_values: Mapping[str, F64] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Geometry({self.n_faces} faces, {self.vertices.shape[0]} vertices, {len(self.mesh_names)} meshes)"

    @property
    def n_faces(self) -> int:
        """Number of triangles."""
        return int(self.faces.shape[0])

    @property
    def face_mesh(self) -> I64:
        """(n_faces,) mesh of each face."""
        return np.searchsorted(self.mesh_face_offset, np.arange(self.n_faces), side="right") - 1

    @cached_property
    def _objects(self) -> tuple[tuple[str, ...], I64]:
        """Names of objects in the order of their first meshes, and the object of each mesh."""
        number: dict[tuple[str, int], int] = {}
        of_mesh = []
        for i, name in enumerate(self.mesh_names):
            whole, mark, part = name.rpartition(PART_MARK)
            key = (whole, -1) if mark and whole and part else (name, i)
            of_mesh.append(number.setdefault(key, len(number)))
        return tuple(name for name, _ in number), np.array(of_mesh, dtype=np.int64)

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of objects: meshes, those named ``OBJECT/PART`` joined to one."""
        return self._objects[0]

    @property
    def mesh_object(self) -> I64:
        """(n_meshes,) object of each mesh."""
        return self._objects[1]

    @property
    def face_object(self) -> I64:
        """(n_faces,) object of each face."""
        return self.mesh_object[self.face_mesh] if self.n_faces else np.zeros(0, dtype=np.int64)

    @cached_property
    def _faces_by_object(self) -> tuple[I64, I64]:
        """Faces in the order of their objects, and the first of each object, with the end."""
        of_face = self.face_object
        order = np.argsort(of_face, kind="stable")
        count = np.bincount(of_face, minlength=len(self.object_names))
        return order.astype(np.int64), np.concatenate([[0], np.cumsum(count)])

    def faces_of_object(self, number: int) -> I64:
        """Faces of an object, in their order."""
        order, first = self._faces_by_object
        return order[first[number] : first[number + 1]]

    @cached_property
    def flat_parts(self) -> tuple[F64, I64]:
        """Corners (n, 3, 3), m, of all triangles, flat parts of one mesh and material cut anew, and a face of each."""
        corners = np.asarray(self.vertices[self.faces], dtype=np.float64)
        kind = self.face_mesh * (int(self.face_material.max(initial=0)) + 1) + self.face_material
        return join_flat_parts(corners, kind)

    @property
    def moves(self) -> bool:
        """True where some mesh moves."""
        return any(not motion.still for motion in self.mesh_motion)

    def without_endless(self) -> "Geometry":
        """The geometry without ground without end, which lies behind all other meshes."""
        if not any(self.mesh_endless):
            return self
        return self.pick_meshes(range(self.mesh_endless.index(True)))

    def pick_meshes(self, meshes: Iterable[int]) -> "Geometry":
        """The geometry of some meshes, by ascending numbers, without ground without end."""
        picked = [i for i in meshes if not (i < len(self.mesh_endless) and self.mesh_endless[i])]
        rows = np.flatnonzero(np.isin(self.face_mesh, picked))
        used, kept = np.unique(self.faces[rows], return_inverse=True)
        return replace(
            self,
            vertices=self.vertices[used],
            faces=kept.reshape(-1, 3).astype(np.int32),
            face_material=self.face_material[rows],
            face_group=self.face_group[rows],
            mesh_names=tuple(self.mesh_names[i] for i in picked),
            mesh_face_offset=np.concatenate([[0], np.cumsum(np.diff(self.mesh_face_offset)[picked])]),
            mesh_convex=tuple(self.mesh_convex[i] for i in picked if i < len(self.mesh_convex)),
            mesh_motion=tuple(self.mesh_motion[i] for i in picked if i < len(self.mesh_motion)),
            mesh_endless=(),
            corner_values={name: values[rows] for name, values in self.corner_values.items()},
        )

    def equals(self, other: "Geometry") -> bool:
        """Whether another geometry has the same triangles, materials, groups and motions."""
        if self is other:
            return True
        arrays = ("vertices", "faces", "face_material", "face_group", "mesh_face_offset")
        same = self.mesh_names == other.mesh_names and self.mesh_motion == other.mesh_motion
        same &= (
            self.mesh_convex == other.mesh_convex and self.corner_values.keys() == other.corner_values.keys()
        )
        return (
            same
            and all(np.array_equal(getattr(self, name), getattr(other, name)) for name in arrays)
            and all(
                np.array_equal(rows, other.corner_values[k], equal_nan=True)
                for k, rows in self.corner_values.items()
            )
        )

    def moving_meshes(self) -> tuple[tuple[Motion, slice], ...]:
        """Motion and rows of ``faces`` of every mesh that moves."""
        offset = self.mesh_face_offset
        return tuple(
            (motion, slice(int(offset[i]), int(offset[i + 1])))
            for i, motion in enumerate(self.mesh_motion)
            if not motion.still
        )

    def frozen(self) -> "Geometry":
        """The geometry at rest in its position at time zero."""
        return replace(self, mesh_motion=()) if self.moves else self

    @property
    def bounds(self) -> F64:
        """(2, 3) float64 lower and upper corner, m, scene frame; zeros when there are no vertices."""
        if self.vertices.shape[0] == 0:
            return np.zeros((2, 3))
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def diameter(self) -> float:
        """Diagonal of the bounds, m."""
        low, high = self.bounds
        return float(np.linalg.norm(high - low))

    @property
    def ground_height(self) -> float:
        """Height of the ground, m: lower quartile, by area, of the heights of faces inclined by less than 45 degrees.

        This is the street level where there is ground, else the floors of the buildings. Undersides of closed bodies,
        such as that of a quay sunk into the water, do not count where open surfaces are a quarter or more of what
        faces the sky: then these are ground.
        """
        corner = self.vertices[self.faces]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        level = np.abs(normal[:, 2]) > np.hypot(normal[:, 0], normal[:, 1])
        if not level.any():
            return float(self.bounds[0, 2])
        outward = self._outward(corner, normal)[self.face_mesh]
        under, area = outward * normal[:, 2] < 0.0, np.abs(normal[:, 2])
        sheets = float(area[level & (outward == 0.0)].sum())
        # a cone on its base has no other level face
        if sheets > 0.0 and sheets >= 0.25 * float(area[level & ~under].sum()):
            level &= ~under
        height, area = corner[level, :, 2].mean(axis=1), area[level]
        order = np.argsort(height)
        share = np.cumsum(area[order])
        return float(height[order][np.searchsorted(share, 0.25 * share[-1])])

    def closed_bodies(self) -> NDArray[np.bool_]:
        """(n_meshes,) True for meshes that enclose a volume."""
        corner = self.vertices[self.faces]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        return np.asarray(self._outward(corner, normal) != 0.0)

    def _outward(self, corner: F64, normal: F64) -> F64:
        """For each mesh 1 where normals of a closed body point outwards, -1 where inwards, 0 for open meshes.

        The area vectors of a closed body, from ``corner`` (n_faces, 3, 3) and ``normal`` (n_faces, 3), add up to zero.
        """
        n, mesh = len(self.mesh_names), self.face_mesh
        first = corner[np.minimum(self.mesh_face_offset[:-1], self.n_faces - 1), 0]
        sums = np.stack([np.bincount(mesh, normal[:, k], n) for k in range(3)])
        area = np.bincount(mesh, np.linalg.norm(normal, axis=1), n)
        volume = np.bincount(mesh, np.einsum("ni,ni->n", corner[:, 0] - first[mesh], normal), n)
        closed = np.abs(sums).max(axis=0) <= 1e-6 * area  # float32 corners
        solid = np.abs(volume) > 1e-6 * area**1.5  # no sheet with two sides
        return np.where(closed & solid, np.sign(volume), 0.0)

    @staticmethod
    def empty() -> "Geometry":
        """Geometry without a triangle, for scenes of ideal points only."""
        return Geometry(
            vertices=np.zeros((0, 3)),
            faces=np.zeros((0, 3), dtype=np.int32),
            face_material=np.zeros(0, dtype=np.int32),
            face_group=np.zeros(0, dtype=np.int32),
            mesh_names=(),
            mesh_face_offset=np.zeros(1, dtype=np.int64),
        )


@dataclass(frozen=True, eq=False)
class PointTarget:
    """Ideal isotropic scatterer, equal in every polarisation; hidden behind meshes.

    Parameters
    ----------
    name : of the shape it came from
    position : (3,) float64, m, scene frame
    rcs : m^2
    phase : rad, of its reflectivity
    motion : translation from ``position``, its place at time zero
    """

    name: str
    position: F64
    rcs: float = 1.0
    phase: float = 0.0
    motion: Motion = STILL

    def position_at(self, time: F64) -> F64:
        """Position (..., 3) float64, m, scene frame, at times (...,) in s."""
        return np.asarray(self.position + self.motion.displacement(time))
