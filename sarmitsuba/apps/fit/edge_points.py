"""Points on edges and their images in mirrors, with their velocities by displacements of shapes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.apps.fit.mirror_facets import MirrorFacets
from sarmitsuba.core.arrays import F64, I64, U32
from sarmitsuba.scene.mesh.facet_edges import FacetEdges
from sarmitsuba.tracing.derivatives.tangent_slots import EDGE_SHAPES, NO_SHAPE, ROW, SlotTangents
from sarmitsuba.tracing.derivatives.tangents import Displacement
from sarmitsuba.tracing.kernel.launch import LaunchFrame, project

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
