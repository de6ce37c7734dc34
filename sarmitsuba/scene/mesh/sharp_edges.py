"""Sharp edges of metal: edges of open sheets and wedges between two facets."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64, unit_rows
from sarmitsuba.scene.mesh.double_faces import double_faces
from sarmitsuba.scene.mesh.joined_sides import join_sides
from sarmitsuba.scene.mesh.pieces import SMOOTH_BEND
from sarmitsuba.scene.mesh.topology import weld

# least height of a triangle over its longest edge: flatter ones have no reliable normal
SLIVER = 1e-6
# widest gap between two sides that are taken for one edge, wavelengths
WIDEST_GAP = 0.02
# distance of two faces that are taken for one, over that gap
DOUBLE_SHARE = 0.05
# most gaps from the side of a triangle to the line in which the planes of two faces meet
MOST_GAPS = 4.0
# number of directions in a sheet, over half a circle, in which its width is tabulated
DIRECTIONS = 16


@dataclass(frozen=True, eq=False)
class SharpEdges:
    r"""Straight edges or pieces of edges, each with its wedge.

    The faces are two-sided. The wedge is the larger sector between them: where two sheets meet, the smaller sector is
    a corner, whose fringe field is ignored.

    Parameters
    ----------
    middle : (n, 3) float64, m
    length : (n,) float64, m
    angle : (n,) float64, exterior angle over pi: 2 for the rim of a sheet, above 1
    inward : (n, 2, 3) float64, unit vectors in both faces (equal at a rim), across the edge and away from it
    normal : (n, 2, 3) float64, unit normals of both faces into the exterior
    weight : (n,) float64, share of the amplitude in the taper of the illumination
    span : (n, DIRECTIONS) float64, m, extent of the sheet of a rim in the mid directions of equal parts of the half
        circle from one end of the edge to the other, backwards along it first; infinite for wedges, and where unknown
    gap : (n,) float64, m, between the sides of two triangles that lie on one another and make the edge; -1 for rims,
        and where the triangles share both its ends
    thickness : (n,) float64, m, of the plate whose face between two wedges a rim stands for; 0 for others
    parts : (n, 2) float64, shares of the parts with the electric and with the magnetic field along the edge
    doubled : number of triangles that lie on those of another shape, and were left out
    rms_height : (n, 2) float64, m, of the roughness of both faces; empty where all are smooth
    """

    middle: F64
    length: F64
    angle: F64
    inward: F64
    normal: F64
    weight: F64
    span: F64
    gap: F64
    thickness: F64
    parts: F64
    doubled: int = 0
    rms_height: F64 = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def n(self) -> int:
        """Number of edges."""
        return int(self.length.size)

    @cached_property
    def along(self) -> F64:
        """(n, 3) unit vectors of the edges."""
        return np.cross(self.inward[:, 0], self.normal[:, 0])

    @property
    def thin_text(self) -> str:
        """Note on rims of thin plates; empty without such edges."""
        thin = self.thickness[self.thickness > 0.0]
        if not thin.size:
            return ""
        return f"{thin.size} of {self.n} metal edges are rims of plates up to {1e3 * float(thin.max()):.2g} mm thick"

    @property
    def joined_text(self) -> str:
        """Note on edges of facets that share no corners, and on double faces; empty without such."""
        joined, notes = self.gap[self.gap >= 0.0], []
        if self.doubled:
            notes.append(f"{self.doubled} metal triangles on those of another shape are left out")
        if joined.size:
            notes.append(self._joined_sides_text(joined))
        return "; ".join(notes)

    def _joined_sides_text(self, joined: F64) -> str:
        apart = f", up to {1e3 * float(joined.max()):.2g} mm apart" if joined.max() > 1e-6 else ""
        return f"{joined.size} of {self.n} metal edges are of facets that share no corners there{apart}"

    def of(self, rows: NDArray[np.bool_] | I64) -> "SharpEdges":
        """Selected edges."""
        return replace(
            self,
            middle=self.middle[rows],
            length=self.length[rows],
            angle=self.angle[rows],
            inward=self.inward[rows],
            normal=self.normal[rows],
            weight=self.weight[rows],
            span=self.span[rows],
            gap=self.gap[rows],
            thickness=self.thickness[rows],
            parts=self.parts[rows],
            rms_height=self.rms_height[rows] if len(self.rms_height) else self.rms_height,
        )

    def weigh(self, share: F64) -> "SharpEdges":
        """Edges with their amplitudes multiplied by a share (n,), without those of share 0."""
        return replace(self, weight=self.weight * share).of(share > 0.0)

    def cut(self, longest: float) -> "SharpEdges":
        """Edges cut into equal pieces of at most ``longest``, m."""
        count = np.maximum(1, np.ceil(self.length / longest * (1.0 - 1e-9)).astype(np.int64))
        rows = np.repeat(np.arange(self.n), count)
        number = np.arange(rows.size) - np.repeat(np.cumsum(count) - count, count)
        pieces = self.of(rows)
        length = pieces.length / count[rows]
        shift = (number + 0.5) * length - 0.5 * pieces.length
        return replace(pieces, middle=pieces.middle + shift[:, None] * pieces.along, length=length)


def sharp_edges(
    corners: F64, metal: NDArray[np.bool_], widest: float = np.inf, shape: I64 | None = None
) -> SharpEdges:
    """Sharp edges of and between metal triangles.

    A side of one triangle is a rim. An edge of two is sharp where they bend by more than ``SMOOTH_BEND``; smaller
    bends approximate a curved surface. Two triangles meet where they share both ends of a side, or as far as their
    sides lie on one another (T-junctions, gaps), see :func:`sarmitsuba.scene.mesh.joined_sides.join_sides`.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m, of all triangles
    metal : (n,) perfect conductors
    widest : m, bound on the gap between sides that lie on one another
    shape : (n,) number of the shape of each triangle: metal triangles that lie on those of another shape are left out,
        see :func:`sarmitsuba.scene.mesh.double_faces.double_faces`; None: all belong to one

    Notes
    -----
    Ignores edges of three triangles and more, and those between metal and another material. A side that lies within
    another triangle is a rim: :func:`sarmitsuba.tracing.scatterers.edges.diffraction.find_uncovered` removes rims that
    touch another object.
    """
    corners, doubled = np.asarray(corners, dtype=np.float64), 0
    if shape is not None:
        rows = np.flatnonzero(metal)
        twice = np.zeros(len(corners), dtype=bool)
        distance = DOUBLE_SHARE * widest if np.isfinite(widest) else 0.0
        twice[rows] = double_faces(corners[rows], shape[rows], distance)
        doubled = int(twice.sum())
        corners, metal = corners[~twice], metal[~twice]
    ids = weld(corners.reshape(-1, 3)).reshape(-1, 3)
    of_metal = np.zeros(int(ids.max(initial=-1)) + 1, dtype=bool)
    of_metal[ids[metal]] = True
    near = (
        of_metal[ids[:, 0]] | of_metal[ids[:, 1]] | of_metal[ids[:, 2]]
    )  # all others share no edge with metal
    corners, metal, ids = corners[near], metal[near], ids[near]
    side = np.roll(corners, -1, axis=1) - corners
    normal = np.cross(side[:, 0], -side[:, 2])
    area = np.linalg.norm(normal, axis=1)
    size = np.square(side).sum(axis=2).max(axis=1, initial=0.0)
    whole = area > SLIVER * size
    normal /= np.where(area > 0.0, area, 1.0)[:, None]

    ends = np.sort(np.stack([ids, np.roll(ids, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    key = ends[:, 0] * (int(ids.max(initial=0)) + 1) + ends[:, 1]
    order = np.argsort(key, kind="stable")
    order = order[whole[order // 3]]
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    count = np.diff(first, append=order.size)
    two, lone = first[count == 2], order[first[count == 1]]
    start, step = corners.reshape(-1, 3), side.reshape(-1, 3)
    length = np.linalg.norm(step, axis=1)
    along = step / np.maximum(length, 1e-300)[:, None]
    inward = np.cross(np.repeat(normal, 3, axis=0), along)

    # sides of one triangle, and of two: numbers of the sides, and the part of the first as shares of its length
    lone, a, b = lone[metal[lone // 3]], order[two], order[two + 1]
    both = metal[a // 3] & metal[b // 3]
    joins = join_sides(start[lone], step[lone], lone // 3, widest)
    pair, parts = joins.partner >= 0, np.column_stack([joins.low, joins.high])
    rim, rim_part = lone[joins.side[~pair]], parts[~pair]
    a = np.concatenate([a[both], lone[joins.side[pair]]])
    b = np.concatenate([b[both], lone[joins.partner[pair]]])
    part = np.concatenate([np.tile([0.0, 1.0], (int(both.sum()), 1)), parts[pair]])
    gap = np.concatenate([np.full(int(both.sum()), -1.0), joins.gap[pair]])

    opening = np.arccos(np.clip(np.einsum("ei,ei->e", inward[a], inward[b]), -1.0, 1.0))
    sharp = np.pi - opening > SMOOTH_BEND
    a, b, part, gap, opening = a[sharp], b[sharp], part[sharp], gap[sharp], opening[sharp]
    # two coinciding sheets have one rim
    folded = opening < SLIVER
    rim, rim_part = np.concatenate([rim, a[folded]]), np.concatenate([rim_part, part[folded]])
    a, b, part, gap, opening = a[~folded], b[~folded], part[~folded], gap[~folded], opening[~folded]
    edge, shares = np.concatenate([rim, a]), np.concatenate([rim_part, part])
    faces_in = np.stack([inward[edge], np.concatenate([inward[rim], inward[b]])], axis=1)
    own = normal[rim // 3]
    wedge = np.stack([_away(inward[a], inward[b]), _away(inward[b], inward[a])], axis=1)
    faces_out = np.concatenate([np.stack([own, -own], axis=1), wedge])
    exterior = np.concatenate([np.full(rim.size, 2.0), 2.0 - opening / np.pi])
    middle = start[edge] + shares.mean(axis=1)[:, None] * step[edge]
    middle[rim.size :] += _step_towards_plane(middle[rim.size :], inward[a], start[b], normal[b // 3], gap)
    return SharpEdges(
        middle,
        (shares[:, 1] - shares[:, 0]) * length[edge],
        exterior,
        faces_in,
        faces_out,
        np.ones(edge.size),
        np.full((edge.size, DIRECTIONS), np.inf),
        np.concatenate([np.full(rim.size, -1.0), gap]),
        np.zeros(edge.size),
        np.ones((edge.size, 2)),
        doubled,
    )


def _step_towards_plane(middle: F64, inward: F64, other: F64, normal: F64, gap: F64) -> F64:
    """(n, 3) steps in a face, across the edge, to where the plane of the other face meets it; 0 without a gap."""
    slope = np.einsum("ei,ei->e", inward, normal)
    step = np.einsum("ei,ei->e", other - middle, normal) / np.where(slope == 0.0, 1.0, slope)
    near = np.abs(step) <= MOST_GAPS * gap
    return np.asarray(np.where(near, step, 0.0)[:, None] * inward)


def _away(face: F64, other: F64) -> F64:
    """(n, 3) unit normals of faces on the side away from others, from inward vectors of both."""
    across = np.einsum("ei,ei->e", face, other)[:, None] * face - other
    return unit_rows(across)
