"""Edges of the facets of a mesh, which bound its visible part; closed surfaces, their volume and area."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I32, I64, unit_rows
from sarmitsuba.scene.mesh.boundary_edges import FLAT_BEND
from sarmitsuba.scene.mesh.pieces import SMOOTH_BEND
from sarmitsuba.scene.mesh.topology import edge_pairs, weld

# distance over the extent of all triangles within which corners are one
TOGETHER = 1e-7


@dataclass(frozen=True, eq=False)
class FacetEdges:
    """Edges of the facets of a scene.

    Parameters
    ----------
    start, end : (n, 3) float64, m
    normals : (n, 2, 3) unit normals of the two facets; equal for an edge of one
    smooth : (n,) whether both approximate a curved surface
    faces : (n, 2) the facets
    """

    start: F64
    end: F64
    normals: F64
    smooth: NDArray[np.bool_]
    faces: I64

    @staticmethod
    def of(triangles: F64, body: I64 | None = None) -> FacetEdges:
        """Edges of triangles (n_faces, 3, 3), m, each once, but for those within a plane.

        Parameters
        ----------
        body : (n_faces,) to which the triangles belong; edges in which two bodies touch are left out. None: one body
        """
        corners = triangles.reshape(-1, 3)
        size = float(np.ptp(corners, axis=0).max(initial=0.0))
        vertex = weld(np.round(corners / (TOGETHER * size)) if size > 0.0 else corners)
        first, second = edge_pairs(vertex)
        normal = unit_normals(triangles)
        bend = np.einsum("nk,nk->n", normal[first // 3], normal[second // 3])
        start = vertex.reshape(-1, 3)
        end = np.roll(start, -1, axis=1)
        key = np.minimum(start, end) * (int(vertex.max(initial=0)) + 1) + np.maximum(start, end)
        _, own = np.unique(key.ravel(), return_index=True)
        other = np.arange(3 * len(triangles))
        other[first] = second
        flat, smooth = (np.zeros(3 * len(triangles), dtype=bool) for _ in range(2))
        flat[first], smooth[first] = bend > np.cos(FLAT_BEND), bend > np.cos(SMOOTH_BEND)
        own = own[~flat[own]]
        ends = np.roll(triangles, -1, axis=1).reshape(-1, 3)
        if body is not None:
            own = own[body[own // 3] == body[other[own] // 3]]
        faces = np.stack([own, other[own]], axis=1) // 3
        return FacetEdges(corners[own], ends[own], normal[faces], smooth[own], faces)

    def seen(self, antenna: F64) -> NDArray[np.bool_]:
        """(n,) edges that may bound the part visible from a place (3,), m: of a curved surface its outline alone."""
        front = np.einsum("nik,nk->ni", self.normals, antenna - self.start) > 0.0
        return np.asarray(np.where(self.smooth, front[:, 0] != front[:, 1], True))


def unit_normals(triangles: F64) -> F64:
    """(n, 3) unit normals of triangles (n, 3, 3)."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return unit_rows(cross)


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
