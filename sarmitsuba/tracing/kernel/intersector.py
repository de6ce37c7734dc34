"""Ray-tracing structure (Embree or OptiX) of a set of triangles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import F32
from sarmitsuba.machine.backend import dr, mi

if TYPE_CHECKING:
    from typing import TypeVar

    from sarmitsuba.core.arrays import F64

    # positions and directions of one point or of many, (..., 3)
    Place = TypeVar("Place", F64, mi.Vector3f)

# components of directions below this are traced as 0: they move a ray by less than float32 rounding of its origin
LEAST_COMPONENT = 1e-12


def intersector(corners: F32) -> mi.Scene:
    """Ray-tracing structure of triangles (n_faces, 3, 3), m.

    Every face has its own three vertices, so that the face's number is its row in all tables. Vertices still coincide
    along shared edges, because equal float64 values round to equal float32 values.
    """
    n = len(corners)
    mesh = mi.Mesh("scene", vertex_count=3 * n, face_count=n)
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float(corners.reshape(-1))
    params["faces"] = mi.UInt32(np.arange(3 * n, dtype=np.uint32))
    params.update()
    return mi.load_dict({"type": "scene", "embree_use_robust_intersections": True, "mesh": mesh})


def query_ray(origin: mi.Point3f, direction: mi.Vector3f, distance: mi.Float | None = None) -> mi.Ray3f:
    """Ray for an intersector, without the components of its direction that are only rounding.

    Embree misses triangles where neighbouring lanes have components of very different size below about 1e-15, such as
    0, 1e-18 and 1e-24: rays along an axis but for rounding.

    Parameters
    ----------
    origin : m
    direction : unit vectors
    distance : m, end of the ray; None: none
    """
    level = mi.Vector3f(dr.select(dr.abs(direction) < LEAST_COMPONENT, 0.0, direction))
    return mi.Ray3f(origin, level) if distance is None else mi.Ray3f(origin, level, distance, 0.0, [])


def clearance_of(extent: float) -> float:
    """Distance off a facet at which rays that leave it start, m: eight times the float32 rounding of positions.

    Mitsuba's own ``spawn_ray`` takes 9e-5 (1 + max|p|), half a metre in a scene 10 km across.

    Parameters
    ----------
    extent : m, largest coordinate
    """
    return 1e-5 + 8.0 * 2.0**-24 * extent


def leave_surface(point: Place, outward: Place, inward: Place, clearance: float | mi.Float) -> Place:
    """Start of a ray that leaves a surface, m: off it, and back along ``inward``, in front of other facets of a corner.

    Parameters
    ----------
    point : m, on the surface
    outward, inward : unit vectors, such as the normal and the direction of the wave that arrives
    clearance : m, see :func:`clearance_of`
    """
    return point + (outward - inward) * clearance
