"""First facets on straight lines, such as those that an antenna sees."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.kernel.device_arrays import vector_rows
from sarmitsuba.tracing.kernel.intersector import query_ray
from sarmitsuba.tracing.kernel.propagation import measure_to_bounds

if TYPE_CHECKING:
    from sarmitsuba.tracing.kernel.scene_tables import TraceScene

# in place of a facet's number: there is none
NO_FACET = -1


def first_facets(scene: TraceScene, start: F64, towards: F64) -> tuple[I64, F64]:
    """First facets (...,) on rays from a place towards points (..., 3), m, and their distances.

    ``NO_FACET`` and inf where there is none.

    Parameters
    ----------
    scene : geometry on the device
    start : (3,) of all rays, such as an antenna, or (..., 3), m
    towards : (..., 3) m
    """
    shape = towards.shape[:-1]
    number = dr.arange(mi.UInt32, int(np.prod(shape)))
    one = start.ndim == 1
    origin = dr.gather(mi.Vector3d, vector_rows(start.reshape(-1, 3)), number * 0 if one else number)
    leg = dr.gather(mi.Vector3d, vector_rows(towards.reshape(-1, 3)), number) - origin
    distance = dr.norm(leg)
    d = leg / distance
    if one:  # an antenna may be far away
        skipped = dr.maximum(distance - measure_to_bounds(origin + leg, d, scene), 0.0)
        origin, offset = origin + d * skipped, skipped
    else:
        offset = mi.Float64(0.0)
    found = scene.mi_scene.ray_intersect_preliminary(
        query_ray(mi.Point3f(origin), mi.Vector3f(d)), coherent=True
    )
    valid = found.is_valid()
    away = dr.select(valid, offset + mi.Float64(found.t), np.inf)
    face = dr.select(valid, mi.Int32(found.prim_index), NO_FACET)
    dr.eval(face, away)
    return np.array(face, dtype=np.int64).reshape(shape), np.array(away).reshape(shape)
