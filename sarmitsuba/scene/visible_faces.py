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
    """Triangles that waves meet, flat parts in as few as they need: statements depend on no cut.

    Parameters
    ----------
    face : (n,) int64, number in the geometry of a face that each lies in, or is
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
        corners, face = geometry.flat_parts
        hidden, metal = (
            np.array([getattr(m, name) for m in materials], dtype=bool)[geometry.face_material[face]]
            for name in ("invisible", "metallic")
        )
        face, metal = face[~hidden], metal[~hidden]
        return VisibleFaces(face, corners[~hidden], metal, geometry.face_mesh[face])
