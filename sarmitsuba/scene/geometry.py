"""What there is to see: triangles and ideal points."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]


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
    """

    vertices: F64
    faces: I32
    face_material: I32
    face_group: I32
    mesh_names: tuple[str, ...]
    mesh_face_offset: NDArray[np.int64]
    mesh_convex: tuple[bool, ...] = ()

    def __repr__(self) -> str:
        return f"Geometry({self.n_faces} faces, {self.vertices.shape[0]} vertices, {len(self.mesh_names)} meshes)"

    @property
    def n_faces(self) -> int:
        """Number of triangles."""
        return int(self.faces.shape[0])

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
    """Ideal isotropic scatterer, the same in every polarisation; hidden when a mesh stands before it.

    Parameters
    ----------
    name : of the shape it came from
    position : (3,) float64, m, scene frame
    rcs : m^2
    phase : rad, of its reflectivity
    """

    name: str
    position: F64
    rcs: float = 1.0
    phase: float = 0.0


__all__ = ["Geometry", "PointTarget"]
