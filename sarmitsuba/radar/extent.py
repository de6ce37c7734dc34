"""Extent of the scatterers: their outline and the default aim point."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.boxes import box_of_each

# m; faces that reach no higher above the level of the ground are ground, kerbs and pavements included
_ABOVE_GROUND = 0.5
# share of the plan that such ground covers in scenes on a plain; in others, such as terrain, bodies have walls
_PLAIN = 0.5
# cosine of the least slope of a wall, 60 degrees
_WALL = 0.5


@dataclass(frozen=True, eq=False)
class Extent:
    """Outline and middle of all scatterers, scene frame.

    Parameters
    ----------
    outline : (n, 3) float64, m; points whose convex hull contains all scatterers
    middle : (3,) float64, m; default aim point: the middle of the outline, on the ground
    faces : (n_faces, 3) triangles of the first points of the outline; None: the outline is a hull, filled with
        scatterers. Points of no triangle are scatterers too
    endless : (n, 3) float64, m; corners of ground without end, which automatic sizes do not count; None: none
    """

    outline: F64
    middle: F64
    faces: I32 | None = None
    endless: F64 | None = None

    @staticmethod
    def of_box(low: F64, high: F64) -> "Extent":
        """Extent of an axis-parallel box with the ground at its bottom; (3,) lower and upper corner, m."""
        ends = np.stack([low, high])
        corners = np.array(
            [[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
        )
        return Extent(corners, np.array([*(0.5 * (ends[0] + ends[1])[:2]), ends[0, 2]]))

    def in_axes(self, origin: F64, axes: F64) -> tuple[F64, F64]:
        """Lower and upper corner (3,) of the outline's box, from ``origin``, along the rows of ``axes``."""
        local = (self.outline - origin) @ axes.T
        return local.min(axis=0), local.max(axis=0)

    def lit_in_axes(self, origin: F64, axes: F64) -> tuple[F64, F64]:
        """The same with ground without end."""
        if self.endless is None:
            return self.in_axes(origin, axes)
        return replace(self, outline=np.concatenate([self.outline, self.endless])).in_axes(origin, axes)

    @cached_property
    def bodies(self) -> I32:
        """Triangles without the ground, (n, 3).

        On a plain they are all that reach above it; on terrain the walls, all triangles where there are none.
        """
        assert self.faces is not None
        if not len(self.faces):
            return self.faces
        corners = self.outline[self.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        plan, area = 0.5 * np.abs(normal[:, 2]), 0.5 * np.linalg.norm(normal, axis=1)
        low = corners[..., 2].max(axis=1) <= self.middle[2] + _ABOVE_GROUND
        sides = np.ptp(corners[..., :2].reshape(-1, 2), axis=0)
        if plan[low].sum() >= _PLAIN * float(np.prod(sides)):
            picked = ~low
        else:
            picked = (plan < _WALL * area) & ~low
        return self.faces[picked] if picked.any() else self.faces

    def is_empty(self, center: F64, reach: float) -> bool:
        """Whether no body and no point lies within a horizontal distance ``reach`` of ``center``, (2,), m."""
        if self.faces is None:
            return False
        # all of a small scene is near: its triangles need not be looked at
        if (np.hypot(*(self.outline[:, :2] - center).T) <= reach).all():
            return False
        low, high, _ = self._parts(self.bodies)
        gap = np.maximum(np.maximum(low - center, center - high), 0.0)
        return bool((np.linalg.norm(gap, axis=1) > reach).all())

    def densest(self, size: float) -> "Extent":
        """The same with the middle in the square of ``size``, m, that holds the largest area of bodies.

        Squares overlap by half; an ideal point counts as one square metre.
        """
        assert self.faces is not None
        low, high, area = self._parts(self.bodies)
        places = 0.5 * (low + high)
        cell = np.floor((places - places.min(axis=0)) / (0.5 * size)).astype(np.int64)
        cells, index = np.unique(cell, axis=0, return_inverse=True)
        held = np.bincount(index.reshape(-1), area)
        total = {tuple(c): float(h) for c, h in zip(cells.tolist(), held, strict=True)}
        corner = max(
            total, key=lambda c: sum(total.get((c[0] + i, c[1] + j), 0.0) for i in (0, 1) for j in (0, 1))
        )
        inside = ((cell >= corner) & (cell <= np.add(corner, 1))).all(axis=1)
        ends = np.clip([low[inside].min(axis=0), high[inside].max(axis=0)], *_around(places[inside], size))
        return replace(self, middle=np.array([*ends.mean(axis=0), self.middle[2]]))

    def _parts(self, faces: I32) -> tuple[F64, F64, F64]:
        """Horizontal bounds (n, 2) of triangles and of points of none, and their areas (n,), m^2."""
        corners = self.outline[faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        alone = np.ones(len(self.outline), dtype=bool)
        alone[self.faces] = False
        points = self.outline[alone, :2]
        low, high = box_of_each(corners[..., :2])
        return (
            np.concatenate([low, points]),
            np.concatenate([high, points]),
            np.concatenate([0.5 * np.linalg.norm(across, axis=1), np.ones(len(points))]),
        )


def _around(places: F64, size: float) -> tuple[F64, F64]:
    """Corners of the square of ``size`` about the middle of places, (2,) each."""
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
    return middle - 0.5 * size, middle + 0.5 * size
