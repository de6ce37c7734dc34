"""Rays on both sides of the edges of shapes: what moving outlines and shadows add to derivatives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.apps.fit.edge_points import NO_MIRROR, Common, EdgePoints, Moves
from sarmitsuba.apps.fit.edge_sight import EdgeSight
from sarmitsuba.apps.fit.mirror_facets import MirrorFacets
from sarmitsuba.core.arrays import C64, F32, F64, I64, U32
from sarmitsuba.scene.mesh.facet_edges import FacetEdges
from sarmitsuba.simulation.execution.tracing import Batch, BatchTracer, Traced
from sarmitsuba.simulation.execution.tracing import EveryPulse, KeyPulse, Pulses
from sarmitsuba.tracing.derivatives.tangents import Tangents
from sarmitsuba.tracing.kernel.launch import EdgeSamples, LatticeLevel, LaunchFrame, LaunchGrid, project
from sarmitsuba.tracing.scatterers.edges.edge_state import SHADOWED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sarmitsuba.signal.raw.sub_bands import RangeFilter

# distance of rays from the edge that they are beside, over the ray spacing and over the extent of the scene
BESIDE, ROUNDING = 1e-3, 1e-6


@dataclass(frozen=True, eq=False)
class Samplings:
    """Sets of rays of one spacing and launch plane, for all of which points on edges are found at once.

    ``spacing`` : (k,) m; ``half`` : (k, 2) m, half extents of their windows; ``beside`` : (k,) m, distance of a ray
    from the edge that it is beside, in the launch plane
    """

    spacing: F64
    half: F64
    beside: F64

    @staticmethod
    def of(lattices: Sequence[LaunchGrid], extent: float) -> Samplings:
        """All levels of lattices, one lattice after the other; ``extent``: m, of the scene."""
        every = [(level.spacing, one) for one in lattices for level in one.every_level]
        spacing = np.array([own for own, _ in every])
        half = np.array([(one.half_x + one.taper, one.half_y + one.taper) for _, one in every])
        return Samplings(spacing, half, np.maximum(BESIDE * spacing, ROUNDING * extent))


@dataclass(frozen=True, eq=False)
class _RaysBeside:
    """Rays on both sides of points from one antenna: see :class:`EdgeSamples`.

    ``sampling`` : (n,) that they belong to; ``place`` : (n, 2) m, in the launch plane; ``speeds`` : (n, displacements)
    """

    sampling: I64
    place: F64
    weight: F64
    normal: F64
    speeds: F32
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
        samplings: Samplings,
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
        speeds = np.zeros((len(points), len(velocities)), dtype=np.float32)
        for own, velocity in zip(speeds.T, velocities, strict=True):
            if velocity.any():
                own[:] = (moved(velocity) * normal).sum(axis=1)
        sampling = points.sampling
        off = samplings.beside[sampling][:, None] * normal
        weight = length / samplings.spacing[sampling] ** 2
        mirrored = np.where(points.mirror == NO_MIRROR, 1, 2)
        faces, last = points.faces, np.where(points.shadows, SHADOWED, mirrored).astype(np.uint32)
        if points.shadows.any():
            # one ray in the shadow, with the weight of one in the light
            lit = np.sign((moved(points.mirrored(points.cast(points.side, antenna))) * normal).sum(axis=1))
            faces = np.column_stack([points.mirror, points.lit])
            at, weight = at - lit[:, None] * off, -lit * weight
        else:
            at, weight = np.concatenate([at - off, at + off]), np.concatenate([weight, -weight])
            sampling, last = np.tile(sampling, 2), np.tile(last, 2)
            normal, speeds, faces = (np.concatenate([x, x]) for x in (normal, speeds, faces))
            shapes = None if shapes is None else np.concatenate([shapes, shapes])
        return _RaysBeside(sampling, at, weight, normal, speeds, faces.astype(np.uint32), last, shapes)

    @staticmethod
    def together(parts: Sequence[_RaysBeside]) -> _RaysBeside:
        """All of several sets."""
        if len(parts) == 1:
            return parts[0]

        def of(name: str) -> F64 | None:
            own = [getattr(part, name) for part in parts]
            return None if own[0] is None else np.concatenate(own)

        return _RaysBeside(*(of(one.name) for one in fields(_RaysBeside)))  # type: ignore[arg-type]

    def __getitem__(self, which: I64) -> _RaysBeside:
        """Some of them."""
        own = (getattr(self, one.name) for one in fields(self))
        return _RaysBeside(*(None if x is None else x[which] for x in own))  # type: ignore[arg-type]


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
        self.facets = MirrorFacets.of(scene.triangles, scene.extent)

    def of(self, batch: Batch) -> list[LaunchGrid]:
        """Rays in place of the lattices of a batch."""
        middle = batch.start + (batch.stop - batch.start) // 2
        kind = KeyPulse if batch.together else EveryPulse
        antennas = kind(self.sampling, batch.start, batch.stop).states.position
        lattices = self.batches.rays.at(middle if batch.together else batch.start)[batch.subset]
        by_frame: dict[int, list[LaunchGrid]] = {}
        for one in lattices:
            if one.serves(batch.start):
                by_frame.setdefault(id(one.frame), []).append(_undivide_lattice(one))
        return [grid for some in by_frame.values() for grid in self._grids(some, antennas)]

    def _grids(self, lattices: Sequence[LaunchGrid], antennas: F64) -> Iterator[LaunchGrid]:
        """Rays in place of lattices of one launch plane, from every antenna (n, 3); none for those without edges."""
        frame = lattices[0].frame or self.sampling.window.frame
        samplings = Samplings.of(lattices, self.scene.extent)
        middle = antennas[len(antennas) // 2]
        parts = [
            (points, *self.moves.velocities(points, middle))
            for points in self._points(samplings, frame, middle)
            if len(points)
        ]
        if not parts:
            return
        every: list[tuple[_RaysBeside, I64]] = []
        for antenna in antennas:
            own = []
            for points, velocities, shapes in parts:
                if points.shadows.any() and antenna is not middle:
                    velocities, shapes = self.moves.velocities(points, antenna)
                own.append(_RaysBeside.of(points, velocities, shapes, antenna, frame, samplings))
            rays = _RaysBeside.together(own)
            every.append((rays, np.argsort(rays.sampling, kind="stable")))
        counts = np.bincount(every[0][0].sampling, minlength=len(samplings.spacing))
        first = np.append(0, np.cumsum(counts))
        number = 0
        for lattice in lattices:
            levels = lattice.every_level
            start, stop = first[number], first[number + len(levels)]
            if start < stop:
                own_first = (first[number : number + len(levels)] - start).tolist()
                found = tuple(replace(one, first=k) for one, k in zip(levels, own_first, strict=True))
                rays = _RaysBeside.together([one[order[start:stop]] for one, order in every])
                yield self._grid(lattice, found, rays, len(antennas))
            number += len(levels)

    @staticmethod
    def _grid(
        lattice: LaunchGrid, levels: tuple[LatticeLevel, ...], rays: _RaysBeside, n_own: int
    ) -> LaunchGrid:
        """Rays in place of one lattice."""
        samples = EdgeSamples(
            rays.weight.astype(np.float32),
            rays.normal,
            np.ascontiguousarray(rays.speeds.T),
            rays.faces,
            rays.leg,
            rays.shapes,
        )
        place = rays.place.astype(np.float32)
        return replace(lattice, x=place[:, 0], y=place[:, 1], levels=levels, n_own=n_own, edges=samples)

    def _points(
        self, samplings: Samplings, frame: LaunchFrame, antenna: F64
    ) -> tuple[EdgePoints, EdgePoints]:
        """Points on edges and their images in mirrors, then the images of their shadows, within the launch windows."""

        def within(points: EdgePoints) -> EdgePoints:
            inside = np.abs(project(points.image(antenna), antenna, frame)) <= samplings.half[points.sampling]
            return points[np.asarray(inside[:, 0] & inside[:, 1])]

        points = EdgePoints.of(self.edges, antenna, frame, samplings.spacing)
        sight = EdgeSight(self.scene, antenna, frame, samplings.beside, self.facets)
        seen, shadows = sight.of_edges(points)
        seen = within(seen)
        if not self.batches.tracer.flags.multi_bounce:
            return seen, shadows[np.zeros(0, dtype=np.int64)]
        # all at once, as every query is a launch
        images = [within(those.images(self.facets, antenna)) for those in (points, shadows)]
        found = sight.in_mirrors(EdgePoints.together(images))
        return EdgePoints.together([seen, found[~found.shadows]]), found[found.shadows]


def _undivide_lattice(lattice: LaunchGrid) -> LaunchGrid:
    """The lattice with one level for each spacing: rays beside edges serve all bounces, wherever cells are divided."""
    own = {
        (one.spacing, one.needs): replace(one, serves="all")
        for one in lattice.every_level
        if one.serves != "later"
    }
    return replace(lattice, levels=tuple(own.values()))


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

    def trace(
        self, batch: Batch, lattices: Sequence[LaunchGrid] | None = None, *, only_rays: bool = True
    ) -> Traced:
        """See the base class; ``lattices``: none, the rays are those beside edges."""
        assert lattices is None
        return super().trace(batch, self.edges.of(batch))

    @cached_property
    def edges(self) -> EdgeLattices:
        """Rays beside edges."""
        return EdgeLattices(self, Common(self.tangents.displacements))
