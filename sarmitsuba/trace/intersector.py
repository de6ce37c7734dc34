"""Ray-tracing structure (Embree or OptiX) of a set of triangles."""

from __future__ import annotations

import numpy as np

from sarmitsuba.arrays import F32
from sarmitsuba.backend import mi


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
