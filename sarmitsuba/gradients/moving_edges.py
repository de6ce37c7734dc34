"""Rays on both sides of the edges of shapes: what moving outlines and shadows add to derivatives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.arrays import C64, F64, U32
from sarmitsuba.gradients.edge_points import NO_MIRROR, Common, EdgePoints, MirrorFacets, Moves
from sarmitsuba.gradients.edge_sight import EdgeSight
from sarmitsuba.mesh.facet_edges import FacetEdges
from sarmitsuba.simulation.batches import Batch, BatchTracer, Traced
from sarmitsuba.simulation.pulses import EveryPulse, KeyPulse, Pulses
from sarmitsuba.trace.edge_state import SHADOWED
from sarmitsuba.trace.launch import EdgeSamples, LatticeLevel, LaunchFrame, LaunchGrid, project
from sarmitsuba.trace.tangents import Tangents

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sarmitsuba.echo.sub_bands import RangeFilter

# distance of rays from the edge that they are beside, over the ray spacing and over the extent of the scene
BESIDE, ROUNDING = 1e-3, 1e-6


def beside(spacing: float, extent: float) -> float:
    """Distance of a ray from the edge that it is beside, in the launch plane, m."""
    return max(BESIDE * spacing, ROUNDING * extent)


@dataclass(frozen=True, eq=False)
class _RaysBeside:
    """Rays on both sides of points from one antenna, first on one side of all: see :class:`EdgeSamples`.

    ``place`` : (n, 2) m, in the launch plane
    """

    place: F64
    weight: F64
    normal: F64
    speeds: F64
    faces: U32
    leg: U32
    shapes: U32 | None

    @staticmethod
    def of(
        points: EdgePoints,
        velocities: F64,
        shapes: U32 | None,
        antenna: F64,
        frame: LaunchFrame,
        spacing: float,
        extent: float,
    ) -> _RaysBeside:
        """Rays from the antenna (3,), m; ``velocities``, ``shapes``: see :meth:`Moves.velocities`."""
        ux, uy, center = frame.axis_x[0], frame.axis_y[0], frame.center[0]
        plane = np.cross(ux, uy)
        image = points.image(antenna)
        leg = image - antenna
        depth = leg @ plane
        scale = ((center - antenna) @ plane) / depth

        def moved(velocity: F64) -> F64:
            """Velocity (n, 2) of the projections."""
            across = (velocity - leg * ((velocity @ plane) / depth)[:, None]) * scale[:, None]
            return np.stack([across @ ux, across @ uy], axis=1)

        at, along = project(image, antenna, frame), moved(points.mirrored(points.cast(points.step, antenna)))
        length = np.linalg.norm(along, axis=1)
        normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.maximum(length, 1e-300)[:, None]
        speeds = np.stack([(moved(v) * normal).sum(axis=1) for v in velocities])
        off = beside(spacing, extent) * normal
        weight = length / spacing**2
        if points.shadows:
            # one ray in the shadow, with the weight of one in the light
            lit = np.sign((moved(points.mirrored(points.cast(points.side, antenna))) * normal).sum(axis=1))
            facets = np.column_stack([points.mirror, points.lit]).astype(np.uint32)
            last: U32 = np.full(len(points), SHADOWED, dtype=np.uint32)
            return _RaysBeside(at - lit[:, None] * off, -lit * weight, normal, speeds, facets, last, shapes)
        return _RaysBeside(
            np.concatenate([at - off, at + off]),
            np.concatenate([weight, -weight]),
            np.concatenate([normal, normal]),
            np.concatenate([speeds, speeds], axis=1),
            np.concatenate([points.faces, points.faces]).astype(np.uint32),
            np.tile(np.where(points.mirror == NO_MIRROR, 1, 2), 2).astype(np.uint32),
            None if shapes is None else np.concatenate([shapes, shapes]),
        )


class EdgeLattices:
    """Rays beside the edges of a scene, in place of lattices.

    Parameters
    ----------
    batches : whose lattices they replace
    moves : displacements
    """

    def __init__(self, batches: BatchTracer, moves: Moves) -> None:
        self.batches, self.moves = batches, moves
        scene, sampling = batches.tracer.trace_scene, batches.tracer.sampling
        self.scene, self.sampling = scene, sampling
        self.edges = FacetEdges.of(scene.triangles, sampling.scene.geometry.face_mesh[scene.geometry_faces])
        self.mirrors = MirrorFacets.of(scene.triangles, scene.extent)

    def of(self, batch: Batch) -> list[LaunchGrid]:
        """Rays in place of the lattices of a batch."""
        middle = batch.start + (batch.stop - batch.start) // 2
        kind = KeyPulse if batch.together else EveryPulse
        antennas = kind(self.sampling, batch.start, batch.stop).states.position
        lattices = self.batches.rays.at(middle if batch.together else batch.start)[batch.subset]
        found = (self._grid(one, antennas) for one in lattices if one.serves(batch.start))
        return [grid for grid in found if grid is not None]

    def _grid(self, lattice: LaunchGrid, antennas: F64) -> LaunchGrid | None:
        """Rays in place of a lattice, from every antenna (n, 3), in each of its levels; None: no edge."""
        frame = lattice.frame or self.sampling.window.frame
        extent, middle = self.scene.extent, antennas[len(antennas) // 2]
        levels: list[LatticeLevel] = []
        parts: list[list[_RaysBeside]] = [[] for _ in antennas]
        first = 0
        for level in lattice.every_level:
            levels.append(replace(level, first=first))
            for points in self._points(lattice, frame, middle, level.spacing):
                first += (1 if points.shadows else 2) * len(points)
                velocities, own_shapes = self.moves.velocities(points, middle)
                for own, antenna in zip(parts, antennas, strict=True):
                    if points.shadows and antenna is not middle:
                        velocities, own_shapes = self.moves.velocities(points, antenna)
                    own.append(
                        _RaysBeside.of(points, velocities, own_shapes, antenna, frame, level.spacing, extent)
                    )
        if not first:
            return None
        every = [part for own in parts for part in own]
        place = np.concatenate([part.place for part in every]).astype(np.float32)
        shapes = [part.shapes for part in every if part.shapes is not None]
        samples = EdgeSamples(
            np.concatenate([part.weight for part in every]).astype(np.float32),
            np.concatenate([part.normal for part in every]),
            np.concatenate([part.speeds for part in every], axis=1).astype(np.float32),
            np.concatenate([part.faces for part in every]),
            np.concatenate([part.leg for part in every]),
            np.concatenate(shapes) if shapes else None,
        )
        return replace(
            lattice, x=place[:, 0], y=place[:, 1], levels=tuple(levels), n_own=len(antennas), edges=samples
        )

    def _points(
        self, lattice: LaunchGrid, frame: LaunchFrame, antenna: F64, spacing: float
    ) -> Iterator[EdgePoints]:
        """Points on edges, then their images in mirrors and those of their shadows, within the launch window."""
        half = np.array([lattice.half_x, lattice.half_y]) + lattice.taper

        def within(points: EdgePoints) -> EdgePoints:
            inside = np.abs(project(points.image(antenna), antenna, frame)) <= half
            return points[np.asarray(inside.all(axis=1))]

        points = EdgePoints.of(self.edges, antenna, frame, spacing)
        sight = EdgeSight(self.scene, antenna, frame, beside(spacing, self.scene.extent))
        seen, shadows = sight.of_edges(points)
        yield within(seen)
        if self.batches.tracer.flags.multi_bounce:
            for those in (points, shadows):
                yield sight.in_mirrors(within(those.images(self.mirrors, antenna)))


class EdgeBatches(BatchTracer):
    """Tracing of rays on both sides of edges; its layers are the channels' derivatives by each displacement.

    The tracer's tangents are displacements alone.
    """

    @property
    def tangents(self) -> Tangents:
        """Derivatives that are recorded."""
        assert isinstance(self.tracer.tangents, Tangents)
        return self.tracer.tangents

    @property
    def amplitudes(self) -> int:
        """Complex numbers of an echo: channels, which are not used, and their derivatives."""
        return super().amplitudes * self.tangents.recorded

    def of_grid(self, pulses: Pulses, grid: C64, share: RangeFilter | None) -> C64:
        """See the base class."""
        return pulses.profiles(grid[len(self.tracer.sampling.scene.radar.channels) :], share)

    def trace(self, batch: Batch, lattices: Sequence[LaunchGrid] | None = None) -> Traced:
        """See the base class; ``lattices``: none, the rays are those beside edges."""
        assert lattices is None
        return super().trace(batch, self.edges.of(batch))

    @cached_property
    def edges(self) -> EdgeLattices:
        """Rays beside edges."""
        return EdgeLattices(self, Common(self.tangents.displacements))
