"""Triangles as flat mirrors, in which an antenna sees points and lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.scene.mesh.facet_edges import unit_normals

# lines times mirrors up to which every triangle is a mirror; beyond, the largest ones
MOST_PAIRS = 200_000_000
# the same that are looked at together
AT_ONCE = 250_000
# distance from a mirror's plane over the extent of the scene up to which a point lies in it
IN_PLANE = 1e-7
# distance over the extent by which lines may be beyond what a mirror shows, for rounding
ROUNDING = 1e-8


@dataclass(frozen=True, eq=False)
class MirrorFacets:
    """Triangles that show points to an antenna.

    Parameters
    ----------
    corners : (n, 3, 3) m
    normals : (n, 3) unit normals
    inward : (n, 3, 3) inward normals of the sides, in the plane
    sides : (n, 3) products of these with the sides' points
    largest : (n,) their numbers, the largest first
    extent : m, of the scene
    """

    corners: F64
    normals: F64
    inward: F64
    sides: F64
    largest: I64
    extent: float

    @staticmethod
    def of(triangles: F64, extent: float) -> MirrorFacets:
        """Triangles (n, 3, 3), m."""
        normals = unit_normals(triangles)
        inward = np.cross(normals[:, None], np.roll(triangles, -1, axis=1) - triangles)
        inside = np.einsum("nik,nik->ni", inward, triangles.mean(axis=1)[:, None] - triangles)
        inward *= np.sign(inside)[..., None]
        edges = triangles[:, 1:] - triangles[:, :1]
        area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
        sides = np.einsum("nik,nik->ni", inward, triangles)
        return MirrorFacets(triangles, normals, inward, sides, np.argsort(-area, kind="stable"), extent)

    def _point_towards(self, number: I64, antenna: F64) -> tuple[F64, F64]:
        """Unit normals (n, 3) of triangles towards the antenna, and its distance (n,), m, from their planes."""
        normal = self.normals[number]
        away = np.einsum("nk,nk->n", antenna - self.corners[number, 0], normal)
        return np.where(away[:, None] < 0.0, -normal, normal), np.abs(away)

    def seen(self, number: I64, points: F64, antenna: F64) -> tuple[NDArray[np.bool_], I64, F64, F64]:
        """How an antenna (3,), m, sees points (n, 3), m, in triangles by number (n,), one each.

        Returns
        -------
        inside : (n,) whether the points are above the triangle's plane, on the side of the antenna, and the path
            between them meets the triangle
        number : (n,) of the triangles
        normal : (n, 3) of the triangles, towards the antenna
        met : (n, 3) m, where the path meets the plane
        """
        normal, away = self._point_towards(number, antenna)
        height = np.einsum("nk,nk->n", points - self.corners[number, 0], normal)
        above = height > IN_PLANE * self.extent
        # where the line from the antenna to the image meets the mirror
        share = away / np.where(above, away + height, 1.0)
        met = antenna + (points - antenna - (2.0 * height)[:, None] * normal) * share[:, None]
        within = np.einsum("nik,nk->ni", self.inward[number], met) > self.sides[number]
        return above & within[:, 0] & within[:, 1] & within[:, 2], number, normal, met

    def lines_seen(self, start: F64, end: F64, antenna: F64) -> tuple[I64, I64, F64, F64]:
        """Parts of straight lines that an antenna (3,), m, may see in triangles.

        The region that a triangle shows is within four planes: its own, and those through the antenna's image and its
        sides.

        Parameters
        ----------
        start, end : (n, 3) m

        Returns
        -------
        mirror, line : (m,) numbers of the triangles and lines
        low, high : (m,) where on the line the part begins and ends, 0 to 1
        """
        some = np.sort(self.largest[: max(1, MOST_PAIRS // max(len(start), 1))])
        normal, away = self._point_towards(some, antenna)
        some, normal, away = some[away > 0.0], normal[away > 0.0], away[away > 0.0]
        corners = self.corners[some]
        image = antenna - (2.0 * away)[:, None] * normal
        across = np.cross(np.roll(corners, -1, axis=1) - corners, image[:, None] - corners)
        across *= np.sign(np.einsum("nik,nik->ni", across, self.inward[some]))[..., None]
        across /= np.maximum(np.linalg.norm(across, axis=2), 1e-300)[..., None]
        planes = np.concatenate([normal[:, None], across], axis=1)
        offset = np.einsum("nik,nik->ni", planes, np.concatenate([corners[:, :1], corners], axis=1))
        offset -= ROUNDING * self.extent
        points = np.concatenate([start, end]).T
        found = []
        step = max(1, AT_ONCE // max(len(start), 1))
        for first in range(0, len(some), step):
            own = planes[first : first + step]
            inner = (own.reshape(-1, 3) @ points).reshape(len(own), 4, 2, -1)
            inner -= offset[first : first + step, :, None, None]
            mirror, line = np.nonzero((np.maximum(inner[:, :, 0], inner[:, :, 1]) > 0.0).all(axis=1))
            a, b = inner[mirror, :, 0, line], inner[mirror, :, 1, line]
            crossed = a / np.where(a == b, 1.0, a - b)
            low, high = (
                np.where(a < 0.0, crossed, 0.0).max(axis=1),
                np.where(b < 0.0, crossed, 1.0).min(axis=1),
            )
            part = low <= high
            found.append((some[first + mirror[part]], line[part], low[part], high[part]))
        none = np.zeros(0, dtype=np.int64)
        found.append((none, none, np.zeros(0), np.zeros(0)))
        mirror, line, low, high = (np.concatenate(one) for one in zip(*found, strict=True))
        return mirror, line, low, high
