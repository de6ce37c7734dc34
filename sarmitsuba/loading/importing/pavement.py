"""Pavement around buildings, a kerb's height above the ground."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.loading.importing.buildings import FOOT, Building, wall_segments
from sarmitsuba.loading.importing.facades import FacadeOptions, wall_quads
from sarmitsuba.loading.importing.parts import Parts
from sarmitsuba.loading.importing.polygons import triangulate, why_unusable

if TYPE_CHECKING:
    pass

# corners of outlines are extended at most by this factor of the pavement's width
_MITRE = 1.5
# corners closer than this are one, m
_SAME = 1e-3


def add_pavement(parts: Parts, buildings: Iterable[Building], options: FacadeOptions, material: str) -> int:
    """Add one level slab below buildings on the plane z = 0 that reaches out to a kerb; returns its triangles.

    Parameters
    ----------
    parts : collection to which it is added
    buildings : those raised above the ground by ``min_height`` have none
    options : height of the kerb and width of the pavement
    material : of the pavement

    Notes
    -----
    Walls pass through the slab, so that no gap is left at their feet. Ignores streets: the pavement is as wide on all
    sides, and neighbours nearer than twice its width share it.
    """
    import shapely

    outlines = [
        b.polygon.buffer(options.pavement, join_style="mitre", mitre_limit=_MITRE)
        for b in buildings
        if b.ground == 0.0
    ]
    made = shapely.get_parts(shapely.union_all(outlines, grid_size=_SAME))
    before = parts.n_triangles
    for slab in made:
        if why_unusable(slab):
            continue
        corners, faces = triangulate(slab)
        parts.add(
            "pavement", material, np.column_stack([corners, np.full(len(corners), options.kerb)]), faces
        )
        for start, end in wall_segments(slab):
            parts.add("pavement", material, *wall_quads(start, end, -FOOT, options.kerb))
    return parts.n_triangles - before
