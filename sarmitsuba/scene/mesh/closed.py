"""Closed surfaces: test, enclosed volume and area."""

import numpy as np

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.scene.mesh.topology import weld


def is_closed(vertices: F64, faces: I32) -> bool:
    """Whether every edge of the faces (n, 3) is used equally often in both directions."""
    corner = weld(vertices)[faces]
    edge = np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]])
    edge = edge[edge[:, 0] != edge[:, 1]]
    low, high = edge.min(axis=1), edge.max(axis=1)
    _, number = np.unique(np.stack([low, high], axis=1), axis=0, return_inverse=True)
    balance = np.bincount(number.reshape(-1), weights=np.where(edge[:, 0] == low, 1.0, -1.0))
    return bool(faces.size) and not balance.any()


def enclosed_volume(vertices: F64, faces: I32) -> float:
    """Volume enclosed by a closed mesh, m^3; negative where its normals point inwards."""
    a, b, c = (vertices[faces[:, i]] - vertices[faces[0, 0]] for i in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def surface_area(vertices: F64, faces: I32) -> float:
    """Area of all faces, m^2."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
