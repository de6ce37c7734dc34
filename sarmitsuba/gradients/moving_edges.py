"""Rays on both sides of the edges of shapes: what moving outlines and shadows add to derivatives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.arrays import C64, F64, I64
from sarmitsuba.echo.sub_bands import RangeFilter
from sarmitsuba.mesh.boundary_edges import FLAT_BEND
from sarmitsuba.mesh.edge_pairs import edge_pairs
from sarmitsuba.mesh.pieces import SMOOTH_BEND
from sarmitsuba.mesh.welding import weld
from sarmitsuba.simulation.batches import Batch, BatchTracer, Traced
from sarmitsuba.simulation.pulses import EveryPulse, KeyPulse, Pulses
from sarmitsuba.trace.launch import EdgeSamples, LatticeLevel, LaunchFrame, LaunchGrid, project
from sarmitsuba.trace.tangents import Displacement

# distance of rays from the edge that they are beside, over the ray spacing and over the extent of the scene
BESIDE, ROUNDING = 1e-3, 1e-6
# samples of an edge within one ray spacing
PER_SPACING = 2.0
# points on edges times mirrors up to which every triangle is a mirror; beyond, the largest ones
MOST_PAIRS = 200_000_000
# distance from a mirror's plane over the extent of the scene up to which a point lies in it
IN_PLANE = 1e-7


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges of the facets of a scene.

    Parameters
    ----------
    start, end : (n, 3) float64, m
    normals : (n, 2, 3) unit normals of the two facets; equal for an edge of one
    smooth : (n,) whether both approximate a curved surface: such an edge matters as an outline alone
    faces : (n, 2) the facets
    """

    start: F64
    end: F64
    normals: F64
    smooth: NDArray[np.bool_]
    faces: I64

    @staticmethod
    def of(triangles: F64) -> Edges:
        """Edges of triangles (n_faces, 3, 3), m, but for those within a plane."""
        vertex = weld(triangles.reshape(-1, 3))
        first, second = edge_pairs(vertex)
        normal = _normals(triangles)
        bend = np.einsum("nk,nk->n", normal[first // 3], normal[second // 3])
        start = vertex.reshape(-1, 3)
        end = np.roll(start, -1, axis=1)
        key = np.minimum(start, end) * (int(vertex.max(initial=0)) + 1) + np.maximum(start, end)
        # every edge once, and its second facet where there are exactly two
        _, own = np.unique(key.ravel(), return_index=True)
        other = np.arange(3 * len(triangles))
        other[first] = second
        flat, smooth = (np.zeros(3 * len(triangles), dtype=bool) for _ in range(2))
        flat[first], smooth[first] = bend > np.cos(FLAT_BEND), bend > np.cos(SMOOTH_BEND)
        own = own[~flat[own]]
        ends = np.roll(triangles, -1, axis=1).reshape(-1, 3)
        faces = np.stack([own, other[own]], axis=1) // 3
        return Edges(triangles.reshape(-1, 3)[own], ends[own], normal[faces], smooth[own], faces)

    def seen(self, antenna: F64) -> NDArray[np.bool_]:
        """(n,) edges that may be seen from a place: any, but of a curved surface its outline alone."""
        front = np.einsum("nik,nk->ni", self.normals, antenna - self.start) > 0.0
        return np.where(self.smooth, front[:, 0] != front[:, 1], True)


def _normals(triangles: F64) -> F64:
    """(n, 3) unit normals of triangles (n, 3, 3)."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.asarray(cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300))


@dataclass(frozen=True, eq=False)
class _Points:
    """Points on edges, or their images in mirrors.

    Parameters
    ----------
    position : (n, 3) m
    step : (n, 3) m, along the edge, of the part that the point stands for
    velocity : (k, n, 3) m per unit, of the edge by each displacement
    faces : (n, 2) facets that meet in the edge
    leg : 1: the edges themselves; 2: images in a mirror
    """

    position: F64
    step: F64
    velocity: F64
    faces: I64
    leg: int = 1

    @staticmethod
    def of(
        edges: Edges, displacements: Sequence[Displacement], antenna: F64, frame: LaunchFrame, spacing: float
    ) -> _Points:
        """Middles of equal parts of the edges, so short that they are samples within a ray spacing."""
        seen = edges.seen(antenna)
        start, end = edges.start[seen], edges.end[seen]
        long = np.linalg.norm(project(end, antenna, frame) - project(start, antenna, frame), axis=1)
        n = np.maximum(np.ceil(long * (PER_SPACING / spacing)), 1.0).astype(np.int64)
        number = np.repeat(np.arange(len(n)), n)
        place = (np.arange(len(number)) - np.repeat(np.cumsum(n) - n, n) + 0.5) / n[number]
        position = start[number] + (end - start)[number] * place[:, None]
        faces = edges.faces[seen][number]
        velocity = np.zeros((len(displacements), len(position), 3))
        for own, displacement in zip(velocity, displacements, strict=True):
            if displacement.faces is not None:
                moved = displacement.faces[faces[:, 0]]
                own[moved] = _velocity(displacement, position[moved])
        return _Points(position, (end - start)[number] / n[number][:, None], velocity, faces)

    def __getitem__(self, which: NDArray[np.bool_]) -> _Points:
        return _Points(
            self.position[which], self.step[which], self.velocity[:, which], self.faces[which], self.leg
        )

    def together(self, others: Sequence[_Points]) -> _Points:
        """All points of several of one leg, these first."""
        every = (self, *others)
        return _Points(
            np.concatenate([p.position for p in every]),
            np.concatenate([p.step for p in every]),
            np.concatenate([p.velocity for p in every], axis=1),
            np.concatenate([p.faces for p in every]),
            every[-1].leg,
        )

    def images(
        self, triangles: F64, displacements: Sequence[Displacement], antenna: F64, extent: float
    ) -> Iterator[_Points]:
        """Images of the points in all triangles (n_faces, 3, 3) in which the antenna may see them."""
        normals = _normals(triangles)
        facing = np.einsum("nk,nk->n", normals, antenna - triangles[:, 0]) > 0.0
        mirrors = np.flatnonzero(facing | ~facing)
        most = max(1, MOST_PAIRS // max(len(self.position), 1))
        if len(mirrors) > most:
            area = np.linalg.norm(
                np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
            )
            mirrors = np.sort(np.argsort(-area, kind="stable")[:most])
        for i in mirrors.tolist():
            found = self._image(i, triangles[i], normals[i] * (1.0 if facing[i] else -1.0), displacements, antenna, extent)
            if found is not None:
                yield found

    def _image(
        self,
        face: int,
        corners: F64,
        n: F64,
        displacements: Sequence[Displacement],
        antenna: F64,
        extent: float,
    ) -> _Points | None:
        """Images in one triangle (3, 3) with the normal n towards the antenna; None where it shows none."""
        above = (self.position - corners[0]) @ n
        height = float((antenna - corners[0]) @ n)
        off = above > IN_PLANE * extent
        # where the line from the antenna to the image meets the mirror
        share = height / np.where(off, height + above, 1.0)
        met = antenna + (self.position - 2.0 * above[:, None] * n - antenna) * share[:, None]
        inside = off
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            inward = np.cross(n, b - a)
            inward *= np.sign(inward @ (corners.mean(axis=0) - a))
            inside = inside & ((met - a) @ inward > 0.0)
        if not inside.any():
            return None
        at, above, where = self.position[inside], above[inside], met[inside]
        step, velocity = self.step[inside], np.empty((len(displacements), int(inside.sum()), 3))
        for own, before, displacement in zip(velocity, self.velocity[:, inside], displacements, strict=True):
            mirror, turn = np.zeros_like(at), np.zeros(3)
            if displacement.faces is not None and displacement.faces[face]:
                mirror = _velocity(displacement, where)
                if displacement.gradient is not None:
                    pulled = n @ displacement.gradient
                    turn = n * (n @ pulled) - pulled
            own[:] = before - 2.0 * ((before - mirror) @ n)[:, None] * n
            own -= 2.0 * (above[:, None] * turn + ((at - where) @ turn)[:, None] * n)
        return _Points(
            at - 2.0 * above[:, None] * n,
            step - 2.0 * (step @ n)[:, None] * n,
            velocity,
            self.faces[inside],
            self.leg + 1,
        )


def _velocity(displacement: Displacement, points: F64) -> F64:
    """(n, 3) velocity of points (n, 3) of a face that is displaced, m per unit."""
    assert displacement.offset is not None
    if displacement.gradient is None:
        return np.broadcast_to(displacement.offset, points.shape)
    return np.asarray(displacement.offset + points @ displacement.gradient.T)


@dataclass(frozen=True, eq=False)
class _Beside:
    """Rays on both sides of points: places (n, 2) in the launch plane, m, and the rest as in :class:`EdgeSamples`."""

    place: F64
    weight: F64
    normal: F64
    speeds: F64
    faces: I64
    leg: I64

    @staticmethod
    def of(
        points: _Points,
        displacements: Sequence[Displacement],
        antenna: F64,
        frame: LaunchFrame,
        spacing: float,
        extent: float,
    ) -> _Beside:
        """Rays from the antenna, first those on one side of all points, then those on the other."""
        ux, uy, center = frame.axis_x[0], frame.axis_y[0], frame.center[0]
        plane = np.cross(ux, uy)
        leg = points.position - antenna
        depth = leg @ plane
        scale = ((center - antenna) @ plane) / depth

        def moved(velocity: F64) -> F64:
            """Velocity (n, 2) of the projections."""
            across = (velocity - leg * ((velocity @ plane) / depth)[:, None]) * scale[:, None]
            return np.stack([across @ ux, across @ uy], axis=1)

        at, along = project(points.position, antenna, frame), moved(points.step)
        length = np.linalg.norm(along, axis=1)
        normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.maximum(length, 1e-300)[:, None]
        speeds = np.stack(
            [
                (moved(v - d.antenna) * normal).sum(axis=1)
                for v, d in zip(points.velocity, displacements, strict=True)
            ]
        )
        off = max(BESIDE * spacing, ROUNDING * extent) * normal
        weight = length / spacing**2
        return _Beside(
            np.concatenate([at - off, at + off]),
            np.concatenate([weight, -weight]),
            np.concatenate([normal, normal]),
            np.concatenate([speeds, speeds], axis=1),
            np.concatenate([points.faces, points.faces]),
            np.full(2 * len(at), points.leg),
        )


class EdgeBatches(BatchTracer):
    """Tracing of rays on both sides of edges; its layers are the channels' derivatives by each displacement.

    The tracer's tangents are displacements alone.
    """

    @property
    def amplitudes(self) -> int:
        """Complex numbers of an echo: channels, which are not used, and their derivatives."""
        assert self.tracer.tangents is not None
        return super().amplitudes * (1 + self.tracer.tangents.count)

    def of_grid(self, pulses: Pulses, grid: C64, share: RangeFilter | None) -> C64:
        """See the base class."""
        return pulses.profiles(grid[len(self.tracer.sampling.scene.radar.channels) :], share)

    def trace(self, batch: Batch, lattices: Sequence[LaunchGrid] | None = None) -> Traced:
        """See the base class; ``lattices``: none, the rays are those beside edges."""
        assert lattices is None
        sampling = self.tracer.sampling
        middle = batch.start + (batch.stop - batch.start) // 2
        if batch.together:
            antennas = KeyPulse(sampling, batch.start, batch.stop).states.position
        else:
            antennas = EveryPulse(sampling, batch.start, batch.stop).states.position
        own = self.rays.at(middle if batch.together else batch.start)[batch.subset]
        return super().trace(batch, [self._grid(one, antennas) for one in own if one.serves(batch.start)])

    def _grid(self, lattice: LaunchGrid, antennas: F64) -> LaunchGrid:
        """Rays beside the edges in place of a lattice, seen from every antenna (n, 3), in each of its levels."""
        tangents, extent = self.tracer.tangents, self.tracer.trace_scene.extent
        assert tangents is not None
        frame = lattice.frame or self.tracer.sampling.window.frame
        levels: list[LatticeLevel] = []
        parts: list[list[_Beside]] = [[] for _ in antennas]
        first = 0
        for level in lattice.every_level:
            levels.append(replace(level, first=first))
            for points in self._points(lattice, frame, antennas[len(antennas) // 2], level.spacing):
                first += 2 * len(points.position)
                for own, antenna in zip(parts, antennas, strict=True):
                    own.append(
                        _Beside.of(points, tangents.displacements, antenna, frame, level.spacing, extent)
                    )
        every = [part for own in parts for part in own]
        place = np.concatenate([part.place for part in every]).astype(np.float32)
        return replace(
            lattice,
            x=place[:, 0],
            y=place[:, 1],
            levels=tuple(levels),
            n_own=len(antennas),
            edges=EdgeSamples(
                np.concatenate([part.weight for part in every]).astype(np.float32),
                np.concatenate([part.normal for part in every]),
                np.concatenate([part.speeds for part in every], axis=1).astype(np.float32),
                np.concatenate([part.faces for part in every]).astype(np.uint32),
                np.concatenate([part.leg for part in every]).astype(np.uint32),
            ),
        )

    def _points(
        self, lattice: LaunchGrid, frame: LaunchFrame, antenna: F64, spacing: float
    ) -> Iterator[_Points]:
        """Points on edges, then their images in mirrors, within the launch window."""
        scene, tangents = self.tracer.trace_scene, self.tracer.tangents
        assert tangents is not None
        half = np.array([lattice.half_x, lattice.half_y]) + lattice.taper

        def within(points: _Points) -> _Points:
            return points[(np.abs(project(points.position, antenna, frame)) <= half).all(axis=1)]

        displacements = tangents.displacements
        points = _Points.of(Edges.of(scene.triangles), displacements, antenna, frame, spacing)
        yield within(points)
        if self.tracer.flags.multi_bounce:
            images = list(points.images(scene.triangles, displacements, antenna, scene.extent))
            if images:
                yield within(images[0].together(images[1:]))
