"""Start points of legs from points that lie on facets: displaced off the facets, to the side of the leg."""

import numpy as np

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.tracing.kernel.scene_tables import TraceScene

# m; distance within which a point counts as lying on a facet: meshes and heights in files are not more accurate
ON_SURFACE = 1e-3


def off_surfaces(trace_scene: TraceScene, position: F64, away: F64) -> F64:
    """Start points (n, 3) of legs from points (n, 3) along ``away`` (n, 3), off the facets that they touch, m."""
    start = position.copy()
    points, owner = np.unique(position, axis=0, return_inverse=True)
    for i, point in enumerate(points):
        mine = np.flatnonzero(owner.reshape(-1) == i)
        touched = _touched_facets(trace_scene.triangles, point, max(ON_SURFACE, trace_scene.clearance))
        start[mine] += _off_planes(touched, point, away[mine], trace_scene.clearance)
    return start


def _touched_facets(triangles: F64, point: F64, reach: float) -> F64:
    """Triangles (m, 3, 3), m, of (n, 3, 3), that lie within ``reach`` of the point."""
    near = (triangles.min(axis=1) - reach <= point) & (point <= triangles.max(axis=1) + reach)
    triangles = triangles[near.all(axis=1)]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal = unit_rows(normal)
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
    triangles: F64,
    point: F64,
    direction: F64,
    clearance: float,
) -> F64:
    """Displacements (n, 3), m, that move a point off triangles' planes, to the side of each direction (n, 3)."""
    step = np.zeros_like(direction)
    for _ in range(8 if len(triangles) > 1 else 1):
        for a, b, c in triangles:  # each plane in turn, until all are cleared
            normal = np.cross(b - a, c - a)
            normal /= np.linalg.norm(normal)
            side = np.where(direction @ normal >= 0.0, 1.0, -1.0)
            height = side * ((point - a) @ normal + step @ normal)
            step += (np.maximum(clearance - height, 0.0) * side)[:, None] * normal
    return step
