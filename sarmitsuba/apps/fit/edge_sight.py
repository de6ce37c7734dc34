"""What an antenna sees on both sides of edges, of their images in mirrors, and the shadows that edges cast.

Edges may lie behind each other within the distance of the rays beside them, such as all of a box that are in one plane
with the antenna. What is hidden then must count once: an edge counts where nothing before it ends there too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.apps.fit.edge_points import NO_SHADOW, EdgePoints
from sarmitsuba.core.arrays import unit_rows
from sarmitsuba.tracing.kernel.first_facets import first_facets
from sarmitsuba.tracing.kernel.intersector import leave_surface
from sarmitsuba.tracing.kernel.launch import project

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sarmitsuba.apps.fit.mirror_facets import MirrorFacets
    from sarmitsuba.core.arrays import F64, I64
    from sarmitsuba.tracing.kernel.launch import LaunchFrame
    from sarmitsuba.tracing.kernel.scene_tables import TraceScene


@dataclass(frozen=True, eq=False)
class EdgeSight:
    """EdgeSight of an antenna.

    Parameters
    ----------
    scene : that it sees
    antenna : (3,) m
    frame : launch plane
    beside : (k,) m, distance in it from an edge at which rays tell what is there, for each sampling of the points
    facets : of the scene
    """

    scene: TraceScene
    antenna: F64
    frame: LaunchFrame
    beside: F64
    facets: MirrorFacets

    def of_edges(self, points: EdgePoints) -> tuple[EdgePoints, EdgePoints]:
        """Points on edges that nothing hides, and the shadows of those before something farther away."""
        if not len(points):
            return points, points
        sides, normal = self._sides(points)
        face, away = first_facets(self.scene, self.antenna, sides)
        edge = np.linalg.norm(points.position - self.antenna, axis=1)
        seen = self._reaches_edges(points, face, away, edge)
        points, face, away, normal, edge = (
            points[seen],
            face[:, seen],
            away[:, seen],
            normal[seen],
            edge[seen],
        )
        far = np.argmax(away, axis=0)
        lit = face[far, np.arange(len(points))]
        found = replace(
            points,
            lit=lit,
            lit_point=self.facets.corners[lit, 0],
            lit_normal=self.facets.normals[lit],
            side=np.where(far[:, None] == 0, -1.0, 1.0) * normal,
        )
        place = np.linalg.norm(found.place(self.antenna) - self.antenna, axis=1)
        behind = (place > edge + self.scene.clearance) & np.isfinite(place)
        own = (points.faces == lit[:, None]).any(axis=1)
        return points, found[(lit != NO_SHADOW) & behind & ~own]

    def in_mirrors(self, points: EdgePoints) -> EdgePoints:
        """Images of points in mirrors that nothing hides, before the mirror and behind it; of shadows before it alone.

        The kernel traces the rays to where the shadow is.
        """
        if not len(points):
            return points
        sides, _ = self._sides(points)
        face, away = first_facets(self.scene, self.antenna, sides)
        seen = (face == points.mirror).all(axis=0)
        points, sides, away = points[seen], sides[:, seen], away[:, seen]
        behind = np.flatnonzero(~points.shadows)
        if not len(behind):
            return points
        own, sides, away = points[behind], sides[:, behind], away[:, behind]
        out = sides - self.antenna
        out = unit_rows(out)
        n = own.normal
        met = self.antenna + out * away[..., None]
        back = out - 2.0 * np.einsum("snk,nk->sn", out, n)[..., None] * n
        start = leave_surface(met, n, out, self.scene.clearance)
        face, away = first_facets(self.scene, start, start + back)
        edge = np.linalg.norm(own.position - start, axis=2)
        kept = np.ones(len(points), dtype=bool)
        kept[behind] = self._reaches_edges(own, face, away, edge)
        return points[kept]

    def _reaches_edges(self, points: EdgePoints, face: I64, away: F64, edge: F64) -> NDArray[np.bool_]:
        """Whether rays on both sides of edges at a distance, m, go as far, or meet a facet in a plane with the edge."""
        clearance = self.scene.clearance
        from_facet = points.position - self.facets.corners[face, 0]
        off = np.einsum("snk,snk->sn", from_facet, self.facets.normals[face])
        return np.asarray(((np.abs(off) < clearance) | (away > edge - clearance)).all(axis=0))

    def _sides(self, points: EdgePoints) -> tuple[F64, F64]:
        """(2, n, 3) m, both sides of points in the launch plane, and the normals (n, 3) to the second one."""
        ux, uy, center = self.frame.axis_x[0], self.frame.axis_y[0], self.frame.center[0]
        image = points.image(self.antenna)
        at = project(image, self.antenna, self.frame)
        step = points.mirrored(points.cast(points.step, self.antenna))
        along = project(image + step, self.antenna, self.frame) - at
        normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
        normal /= np.maximum(np.linalg.norm(along, axis=1), 1e-300)[:, None]
        normal = normal[:, :1] * ux + normal[:, 1:] * uy
        place = center + at[:, :1] * ux + at[:, 1:] * uy
        off = self.beside[points.sampling][:, None] * normal
        return np.stack([place - off, place + off]), normal
