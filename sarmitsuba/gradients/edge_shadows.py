"""Shadows of edges on what lies behind them, as an antenna sees them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.backend import dr, mi
from sarmitsuba.gradients.edge_points import NO_SHADOW, EdgePoints
from sarmitsuba.mesh.facet_edges import unit_normals
from sarmitsuba.trace.device_arrays import vector_rows
from sarmitsuba.trace.intersector import query_ray
from sarmitsuba.trace.launch import project
from sarmitsuba.trace.propagation import before_bounds

if TYPE_CHECKING:
    from sarmitsuba.arrays import F64, I64
    from sarmitsuba.trace.launch import LaunchFrame
    from sarmitsuba.trace.scene_tables import TraceScene


def shadows(
    points: EdgePoints, scene: TraceScene, antenna: F64, frame: LaunchFrame, beside: float
) -> EdgePoints:
    """Points on edges that the antenna sees before something farther away, with the facet that they shadow.

    Parameters
    ----------
    points : on edges themselves
    antenna : (3,) m
    frame : launch plane
    beside : m, distance in it from the edge at which rays tell what is there
    """
    if not len(points):
        return points
    ux, uy, center = frame.axis_x[0], frame.axis_y[0], frame.center[0]
    at = project(points.position, antenna, frame)
    along = project(points.position + points.step, antenna, frame) - at
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(along, axis=1), 1e-300)[:, None]
    ends = np.concatenate([at - beside * normal, at + beside * normal])
    face, away = _first(scene, antenna, center + ends[:, :1] * ux + ends[:, 1:] * uy)
    face, away = face.reshape(2, -1), away.reshape(2, -1)
    # of the two sides the farther one, if the edge itself is not hidden
    far = np.argmax(away, axis=0)
    rows = np.arange(len(points))
    lit = face[far, rows]
    triangles = scene.triangles[lit]
    found = replace(
        points,
        lit=lit,
        lit_point=triangles[:, 0],
        lit_normal=unit_normals(triangles),
        side=np.where(far[:, None] == 0, -1.0, 1.0) * (normal[:, :1] * ux + normal[:, 1:] * uy),
    )
    edge = np.linalg.norm(points.position - antenna, axis=1)
    place = np.linalg.norm(found.place(antenna) - antenna, axis=1)
    clear = scene.clearance
    before = (away.min(axis=0) > edge - clear) & (place > edge + clear) & np.isfinite(place)
    own = (points.faces == lit[:, None]).any(axis=1)
    return found[(lit != NO_SHADOW) & before & ~own]


def _first(scene: TraceScene, antenna: F64, towards: F64) -> tuple[I64, F64]:
    """Facets (n,) that an antenna (3,) sees towards points (n, 3), m, and their distances; ``NO_SHADOW``, inf: none."""
    start, position = dr.gather(mi.Vector3d, vector_rows(towards), dr.arange(mi.UInt32, len(towards))), antenna
    leg = start - mi.Vector3d(*(dr.opaque(mi.Float64, float(x)) for x in position))
    distance = dr.norm(leg)
    d = leg / distance
    back = dr.minimum(distance, before_bounds(start, d, scene))
    query = query_ray(mi.Point3f(start - d * back), mi.Vector3f(d))
    found = scene.mi_scene.ray_intersect_preliminary(query, coherent=True)
    valid = found.is_valid()
    away = dr.select(valid, distance - back + mi.Float64(found.t), np.inf)
    face = dr.select(valid, mi.Int32(found.prim_index), NO_SHADOW)
    dr.eval(face, away)
    return np.array(face, dtype=np.int64), np.array(away)
