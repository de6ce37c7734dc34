"""Rays on both sides of the edges of shapes: the contribution of moving outlines and shadows to derivatives.

Points on edges, and their images in mirrors, have velocities by the displacements of shapes. An antenna sees both
sides of an edge, and the shadow that the edge casts. Edges may lie behind each other within the distance of the rays
beside them, such as all of a box that are in one plane with the antenna. A hidden part then must count once: an edge
counts where nothing before it ends there too.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.apps.fit.mirror_facets import MirrorFacets
from sarmitsuba.core.arrays import C64, F32, F64, I64, U32, unit_rows
from sarmitsuba.scene.mesh.facet_edges import FacetEdges
from sarmitsuba.simulation.execution.tracing import Batch, BatchTracer, EveryPulse, KeyPulse, Pulses, Traced
from sarmitsuba.tracing.derivatives.edge_state import SHADOWED
from sarmitsuba.tracing.derivatives.tangent_slots import EDGE_SHAPES, NO_SHAPE, ROW, SlotTangents
from sarmitsuba.tracing.derivatives.tangents import Displacement, Tangents
from sarmitsuba.tracing.kernel.first_facets import first_facets
from sarmitsuba.tracing.kernel.intersector import leave_surface
from sarmitsuba.tracing.kernel.launch import EdgeSamples, LatticeLevel, LaunchFrame, LaunchGrid, project

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from sarmitsuba.apps.fit.mirror_facets import MirrorFacets
    from sarmitsuba.core.arrays import F64, I64
    from sarmitsuba.signal.sub_bands import RangeFilter
    from sarmitsuba.tracing.kernel.launch import LaunchFrame
    from sarmitsuba.tracing.kernel.scene_tables import TraceScene


# samples of an edge within one ray spacing; what is lit of it ends between two of them
PER_SPACING = 4.0
# points times mirrors that are looked at together
PAIRS = 500_000
# share of a line by which the part of it that a mirror may show is looked at farther
MARGIN = 1e-6
# in place of the number of a mirror: it is seen directly; of a lit facet: the edge itself is seen, not its shadow
NO_MIRROR = NO_SHADOW = -1


@dataclass(frozen=True, eq=False)
class EdgePoints:
    """Points on edges as the antenna sees them: themselves, their images in mirrors, or those of their shadows.

    Parameters
    ----------
    edge, sampling : (n,) number of the edge, and that of the set of rays whose spacing it is sampled for
    position : (n, 3) m, of the edge itself
    step : (n, 3) m, along the edge, of the part that the point stands for
    faces : (n, 2) facets that meet in the edge
    mirror : (n,) facet in which it is seen, or ``NO_MIRROR``
    normal : (n, 3) unit normal of the mirror; zero without
    met : (n, 3) m, where the path meets the mirror
    lit : (n,) facet that the shadow of the edge is on, as the antenna sees it, or ``NO_SHADOW``
    lit_point, lit_normal : (n, 3) m, a point of that facet, and its unit normal; zero without
    side : (n, 3) unit vector from the edge into the light
    """

    edge: I64
    sampling: I64
    position: F64
    step: F64
    faces: I64
    mirror: I64
    normal: F64
    met: F64
    lit: I64
    lit_point: F64
    lit_normal: F64
    side: F64

    @staticmethod
    def of(edges: FacetEdges, antenna: F64, frame: LaunchFrame, spacings: F64) -> EdgePoints:
        """Middles of equal parts of the edges, so short that they are samples within each ray spacing, (k,) m.

        In the order of the edges, and along each.
        """
        seen = np.flatnonzero(edges.seen(antenna))
        start, end = edges.start[seen], edges.end[seen]
        long = np.linalg.norm(project(end, antenna, frame) - project(start, antenna, frame), axis=1)
        n = np.maximum(np.ceil(long[:, None] * (PER_SPACING / spacings)), 1.0).astype(np.int64).ravel()
        part = np.repeat(np.arange(len(n)), n)
        place = (np.arange(len(part)) - np.repeat(np.cumsum(n) - n, n) + 0.5) / n[part]
        order = np.argsort(part // len(spacings) + place, kind="stable")
        part, place = part[order], place[order]
        number = part // len(spacings)
        along = (end - start)[number]
        zero, none = np.broadcast_to(np.zeros(3), along.shape), np.full(len(number), NO_MIRROR)
        return EdgePoints(
            seen[number],
            part % len(spacings),
            start[number] + along * place[:, None],
            along / n[part][:, None],
            edges.faces[seen][number],
            mirror=none,
            normal=zero,
            met=zero,
            lit=none,
            lit_point=zero,
            lit_normal=zero,
            side=zero,
        )

    @staticmethod
    def together(parts: Sequence[EdgePoints]) -> EdgePoints:
        """All of several sets."""
        every = ([getattr(part, own.name) for part in parts] for own in fields(EdgePoints))
        return EdgePoints(*(np.concatenate(one) for one in every))

    @property
    def facets(self) -> I64:
        """(n, ``EDGE_SHAPES``) facets that move the points: those of the edges, mirrors and lit facets."""
        return np.column_stack([self.faces, self.mirror, self.lit])

    def __len__(self) -> int:
        """Number of points."""
        return len(self.position)

    def __getitem__(self, which: NDArray[np.bool_] | I64) -> EdgePoints:
        """Some of them."""
        rows = np.flatnonzero(which) if which.dtype == bool else which

        def of(values: F64) -> F64:
            if len(values) and not values.strides[0]:  # the same for all
                return np.broadcast_to(values[0], (len(rows), *values.shape[1:]))
            return np.asarray(values[rows])

        return EdgePoints(*(of(getattr(self, own.name)) for own in fields(self)))  # type: ignore[arg-type]

    @property
    def shadows(self) -> NDArray[np.bool_]:
        """(n,) whether they are those of shadows."""
        return np.asarray(self.lit != NO_SHADOW)

    def _share(self, antenna: F64) -> tuple[F64, F64, F64]:
        """(n, 3) m, from the antenna to the edge; (n, 1) the way to the lit facet over that; (n, 3) 1/m, its tilt."""
        leg = self.position - antenna
        towards = np.einsum("nk,nk->n", leg, self.lit_normal)
        shaded = self.lit != NO_SHADOW
        tilt = self.lit_normal / np.where(shaded, towards, 1.0)[:, None]
        share = np.where(shaded, np.einsum("nk,nk->n", self.lit_point - antenna, tilt), 1.0)
        return leg, share[:, None], tilt

    def cast(self, velocity: F64, antenna: F64, lit: F64 | float = 0.0) -> F64:
        """(n, 3) velocities of the shadows, of those (n, 3) of the edges and of the ``lit`` facets there."""
        if not self.shadows.any():
            return velocity
        leg, share, tilt = self._share(antenna)
        own = share * velocity
        return np.asarray(own - leg * np.einsum("nk,nk->n", own - lit, tilt)[:, None])

    def place(self, antenna: F64) -> F64:
        """(n, 3) m, the points themselves, or their shadows."""
        if not self.shadows.any():
            return self.position
        leg, share, _ = self._share(antenna)
        return np.asarray(np.where(self.lit[:, None] == NO_SHADOW, self.position, antenna + share * leg))

    def mirrored(self, vectors: F64) -> F64:
        """Vectors (n, 3) as the antenna sees them."""
        along = np.einsum("nk,nk->n", vectors, self.normal)
        return np.asarray(vectors - 2.0 * along[:, None] * self.normal)

    def image(self, antenna: F64) -> F64:
        """(n, 3) m, where the antenna sees the points or shadows."""
        return self.met + self.mirrored(self.place(antenna) - self.met)

    def images(self, mirrors: MirrorFacets, antenna: F64) -> EdgePoints:
        """Images in all triangles in which the antenna may see them; points of an edge or shadow follow each other."""
        if not len(self):
            return self
        place = self.place(antenna)
        lines = np.column_stack([self.edge, self.lit])
        new = (np.diff(lines, axis=0, prepend=-2) != 0).any(axis=1)
        number, starts = np.cumsum(new) - 1, np.flatnonzero(new)
        start, end = place[starts], place[np.append(starts[1:], len(self)) - 1]
        mirror, line, low, high = mirrors.lines_seen(start, end, antenna)
        along = end - start
        along /= np.maximum(np.einsum("nk,nk->n", along, along), 1e-300)[:, None]
        # rises from line to line, and along each from 0 to 1
        key = 2.0 * number + np.einsum("nk,nk->n", place - start[number], along[number])
        first = np.searchsorted(key, 2.0 * line + low - MARGIN)
        n = np.searchsorted(key, 2.0 * line + high + MARGIN, side="right") - first
        rows, found = [], []
        for some in np.split(np.arange(len(n)), np.flatnonzero(np.diff(np.cumsum(n) // PAIRS)) + 1):
            own = n[some]
            row = np.arange(own.sum()) + np.repeat(first[some] - np.cumsum(own) + own, own)
            inside, *seen = mirrors.seen(np.repeat(mirror[some], own), place[row], antenna)
            rows.append(row[inside])
            found.append([one[inside] for one in seen])
        number, normal, met = (np.concatenate(one) for one in zip(*found, strict=True))
        return replace(self[np.concatenate(rows)], mirror=number, normal=normal, met=met)

    def velocity(
        self,
        offset: F64,
        gradient: F64,
        moved: NDArray[np.bool_],
        antenna: F64,
    ) -> F64:
        """(n, 3) velocity of the images, m per unit.

        Parameters
        ----------
        offset, gradient : (n, 3) m and (n, 3, 3), displacement per unit
        moved : (n, 4) whether it moves the facets that meet in the edges, the mirrors, and the lit facets
        antenna : (3,) m
        """
        mirror_moved = moved[:, 2]

        def of(points: F64, share: F64) -> F64:
            return np.asarray((offset + np.einsum("nij,nj->ni", gradient, points)) * share[:, None])

        n, place = self.normal, self.place(antenna)
        from_mirror = place - self.met
        above = np.einsum("nk,nk->n", from_mirror, n)
        edge, mirror = (
            of(self.position, moved[:, :2].mean(axis=1)),
            of(self.met, mirror_moved.astype(np.float64)),
        )
        edge = self.cast(edge, antenna, of(place, moved[:, 3].astype(np.float64)))
        pulled = np.einsum("ni,nij->nj", n, gradient) * mirror_moved[:, None]
        turn = n * np.einsum("nk,nk->n", n, pulled)[:, None] - pulled
        nearer = np.einsum("nk,nk->n", edge - mirror, n) + np.einsum("nk,nk->n", from_mirror, turn)
        return np.asarray(edge - 2.0 * (nearer[:, None] * n + above[:, None] * turn))


class Moves(ABC):
    """Displacements by which points move."""

    @abstractmethod
    def velocities(self, points: EdgePoints, antenna: F64) -> tuple[F64, U32 | None]:
        """(k, n, 3) m per unit, and the (n, ``EDGE_SHAPES``) numbers of the shapes that move them.

        ``antenna`` : (3,) m, from which shadows are seen. None where the displacements are the same for all rays.
        """


@dataclass(frozen=True, eq=False)
class Common(Moves):
    """Displacements that are the same for all rays."""

    displacements: Sequence[Displacement]

    def velocities(self, points: EdgePoints, antenna: F64) -> tuple[F64, None]:
        """See the base class."""
        out, n = np.zeros((len(self.displacements), len(points), 3)), len(points)
        for own, d in zip(out, self.displacements, strict=True):
            if d.faces is None or d.offset is None:
                continue  # the parallax of an antenna is a displacement over the slant range
            gradient = np.zeros((3, 3)) if d.gradient is None else d.gradient
            facets = points.facets
            own += points.velocity(
                np.broadcast_to(d.offset, (n, 3)),
                np.broadcast_to(gradient, (n, 3, 3)),
                (facets != NO_MIRROR) & d.faces[facets],
                antenna,
            )
        return out, None


class OfShapes(Moves):
    """Displacements of many shapes, by their numbers."""

    def __init__(self, tangents: SlotTangents) -> None:
        self.ways = tangents.ways
        self.shape: U32 = np.array(tangents.shape)
        self.rows = np.array(tangents.rows).reshape(-1, self.ways, ROW // 4, 4)[..., :3]

    def velocities(self, points: EdgePoints, antenna: F64) -> tuple[F64, U32]:
        """See the base class."""
        facets = points.facets
        own_shape = np.where(facets == NO_MIRROR, np.uint32(NO_SHAPE), self.shape[facets])
        shapes = own_shape.copy()
        for i in range(1, EDGE_SHAPES):  # each once
            shapes[(shapes[:, :i] == shapes[:, i : i + 1]).any(axis=1), i] = NO_SHAPE
        out = np.zeros((EDGE_SHAPES * self.ways, len(points), 3))
        for i, own in enumerate(shapes.T):
            known = np.flatnonzero(own != NO_SHAPE)
            if not len(known):
                continue
            some, number = points[known], own[known]
            moved = own_shape[known] == number[:, None]
            for way in range(self.ways):
                rows = self.rows[number, way]
                out[i * self.ways + way, known] = some.velocity(rows[:, 0], rows[:, 1:], moved, antenna)
        return out, shapes.astype(np.uint32)


@dataclass(frozen=True, eq=False)
class EdgeSight:
    """EdgeSight of an antenna.

    Parameters
    ----------
    scene : that it sees
    antenna : (3,) m
    frame : launch plane
    beside : (k,) m, distance in it from an edge at which rays tell the surface there, for each sampling of the points
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
