"""Volumes that waves go through: crowns of trees, hedges, stands."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.scene.materials.vegetation.canopy import VolumeMedium
from sarmitsuba.scene.mesh.closed import enclosed_volume, surface_area


@dataclass(frozen=True, eq=False)
class Volume:
    """Closed volume filled evenly with a medium. It rests, and no surface of a scene knows of it.

    Parameters
    ----------
    name : of the shape
    vertices : (n_v, 3) float64, m, scene frame
    faces : (n_f, 3) int32, normals outwards
    medium : what it is filled with; where volumes overlap, both fill the place
    spacing : m, distance between the scatterers that represent it; 0: from the radar's resolution
    """

    name: str
    vertices: F64
    faces: I32
    medium: VolumeMedium
    spacing: float = 0.0

    @cached_property
    def content(self) -> float:
        """Volume, m^3."""
        return enclosed_volume(self.vertices, self.faces)

    @cached_property
    def mean_chord(self) -> float:
        """Mean chord length, four times the volume over the surface, m."""
        return 4.0 * self.content / surface_area(self.vertices, self.faces)

    @property
    def bounds(self) -> F64:
        """Lower and upper corner, (2, 3) m."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])
