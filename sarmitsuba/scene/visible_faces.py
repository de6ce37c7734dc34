"""Visible faces of a scene, and which of them are metal."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material


@dataclass(frozen=True, eq=False)
class VisibleFaces:
    """Triangles that waves meet.

    Parameters
    ----------
    face : (n,) int64, their numbers in the geometry
    corners : (n, 3, 3) float64, m, scene frame
    metal : (n,) perfect conductors
    shape : (n,) int64, number of each one's mesh
    """

    face: I64
    corners: F64
    metal: NDArray[np.bool_]
    shape: I64

    @staticmethod
    def of(geometry: Geometry, materials: Sequence[Material]) -> "VisibleFaces":
        """Faces whose material is not invisible."""
        hidden, metal = (
            np.array([getattr(m, name) for m in materials], dtype=bool)[geometry.face_material]
            for name in ("invisible", "metallic")
        )
        face = np.flatnonzero(~hidden)
        corners = np.asarray(geometry.vertices[geometry.faces[face]], dtype=np.float64)
        return VisibleFaces(face, corners, metal[face], geometry.face_mesh[face])
