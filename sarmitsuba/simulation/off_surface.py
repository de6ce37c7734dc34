"""Starts of legs from points that lie on facets: off their planes, on the side that the leg leaves to."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.trace.scene_tables import TraceScene

# m; a point so near a facet lies on it: meshes and heights read from files are hardly more exact
ON_SURFACE = 1e-3


def off_surfaces(
    trace_scene: TraceScene, position: NDArray[np.float64], away: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Starts (n, 3) of legs from points (n, 3) along ``away`` (n, 3), off the facets that the points lie on, m."""
    start = position.copy()
    points, owner = np.unique(position, axis=0, return_inverse=True)
    for i, point in enumerate(points):
        mine = np.flatnonzero(owner.reshape(-1) == i)
        touched = _touched_facets(trace_scene.triangles, point, max(ON_SURFACE, trace_scene.clearance))
        start[mine] += _off_planes(touched, point, away[mine], trace_scene.clearance)
    return start


def _touched_facets(
    triangles: NDArray[np.float64], point: NDArray[np.float64], reach: float
) -> NDArray[np.float64]:
    """Those of the triangles (n, 3, 3) that lie within ``reach`` of the point, (m, 3, 3), m."""
    near = (triangles.min(axis=1) - reach <= point) & (point <= triangles.max(axis=1) + reach)
    triangles = triangles[near.all(axis=1)]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    on_plane = np.abs(np.einsum("ni,ni->n", point - triangles[:, 0], normal)) <= reach
    inside = np.full(len(triangles), True)
    beside = np.full(len(triangles), np.inf)
    for k in range(3):
        corner, edge = triangles[:, k], triangles[:, (k + 1) % 3] - triangles[:, k]
        step = point - corner
        inside &= np.einsum("ni,ni->n", np.cross(normal, edge), step) >= 0.0
        share = np.einsum("ni,ni->n", step, edge) / np.einsum("ni,ni->n", edge, edge)
        foot = step - np.clip(share, 0.0, 1.0)[:, None] * edge
        beside = np.minimum(beside, np.linalg.norm(foot, axis=1))
    return np.asarray(triangles[(on_plane & inside) | (beside <= reach)])


def _off_planes(
    triangles: NDArray[np.float64],
    point: NDArray[np.float64],
    direction: NDArray[np.float64],
    clearance: float,
) -> NDArray[np.float64]:
    """Steps (n, 3) that take a point off triangles' planes, to the side that each direction (n, 3) points to, m."""
    step = np.zeros_like(direction)
    for _ in range(8 if len(triangles) > 1 else 1):
        for a, b, c in triangles:  # each plane in turn, until all are cleared
            normal = np.cross(b - a, c - a)
            normal /= np.linalg.norm(normal)
            side = np.where(direction @ normal >= 0.0, 1.0, -1.0)
            height = side * ((point - a) @ normal + step @ normal)
            step += (np.maximum(clearance - height, 0.0) * side)[:, None] * normal
    return step


__all__ = ["ON_SURFACE", "off_surfaces"]
