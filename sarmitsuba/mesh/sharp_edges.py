"""Sharp edges of metal: edges of open sheets and wedges between two facets."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.arrays import F64, I64
from sarmitsuba.mesh.pieces import SMOOTH_BEND
from sarmitsuba.mesh.welding import weld

# least height of a triangle over its longest edge: flatter ones have no reliable normal
SLIVER = 1e-6
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
    """

    middle: F64
    length: F64
    angle: F64
    inward: F64
    normal: F64
    weight: F64
    span: F64

    @property
    def n(self) -> int:
        """Number of edges."""
        return int(self.length.size)

    @cached_property
    def along(self) -> F64:
        """(n, 3) unit vectors of the edges."""
        return np.cross(self.inward[:, 0], self.normal[:, 0])

    def of(self, rows: NDArray[np.bool_] | I64) -> "SharpEdges":
        """Selected edges."""
        columns = (self.middle, self.length, self.angle, self.inward, self.normal, self.weight, self.span)
        return SharpEdges(*(column[rows] for column in columns))

    def weighted(self, share: F64) -> "SharpEdges":
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


def sharp_edges(corners: F64, metal: NDArray[np.bool_]) -> SharpEdges:
    """Sharp edges of and between metal triangles.

    An edge of one triangle is a rim. An edge of two is sharp where they bend by more than ``SMOOTH_BEND``; smaller
    bends approximate a curved surface.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m, of all triangles
    metal : (n,) perfect conductors

    Notes
    -----
    Ignores edges of three triangles and more, and those between metal and another material. Where triangles meet
    without sharing both ends of an edge (T-junctions), each side counts as a rim:
    :func:`sarmitsuba.trace.edges.uncovered` removes rims that touch another object.
    """
    corners = np.asarray(corners, dtype=np.float64)
    side = np.roll(corners, -1, axis=1) - corners
    normal = np.cross(side[:, 0], -side[:, 2])
    area = np.linalg.norm(normal, axis=1)
    size = np.square(side).sum(axis=2).max(axis=1, initial=0.0)
    whole = area > SLIVER * size
    normal /= np.where(area > 0.0, area, 1.0)[:, None]

    ids = weld(corners.reshape(-1, 3)).reshape(-1, 3)
    ends = np.sort(np.stack([ids, np.roll(ids, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    key = ends[:, 0] * (int(ids.max(initial=0)) + 1) + ends[:, 1]
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    count = np.diff(first, append=key.size)
    one, two = first[count == 1], first[count == 2]
    rim, a, b = order[one], order[two], order[two + 1]
    kept = metal & whole
    rim = rim[kept[rim // 3]]
    both = kept[a // 3] & kept[b // 3]
    a, b = a[both], b[both]

    start, step = corners.reshape(-1, 3), side.reshape(-1, 3)
    length = np.linalg.norm(step, axis=1)
    along = step / np.maximum(length, 1e-300)[:, None]
    inward = np.cross(np.repeat(normal, 3, axis=0), along)

    opening = np.arccos(np.clip(np.einsum("ei,ei->e", inward[a], inward[b]), -1.0, 1.0))
    sharp = np.pi - opening > SMOOTH_BEND
    a, b, opening = a[sharp], b[sharp], opening[sharp]
    # two coinciding sheets have one rim
    folded = opening < SLIVER
    rim = np.concatenate([rim, a[folded]])
    a, b, opening = a[~folded], b[~folded], opening[~folded]
    edge = np.concatenate([rim, a])
    faces_in = np.stack([inward[edge], np.concatenate([inward[rim], inward[b]])], axis=1)
    own = normal[rim // 3]
    wedge = np.stack([_away(inward[a], inward[b]), _away(inward[b], inward[a])], axis=1)
    faces_out = np.concatenate([np.stack([own, -own], axis=1), wedge])
    exterior = np.concatenate([np.full(rim.size, 2.0), 2.0 - opening / np.pi])
    middle = start[edge] + 0.5 * step[edge]
    return SharpEdges(
        middle,
        length[edge],
        exterior,
        faces_in,
        faces_out,
        np.ones(edge.size),
        np.full((edge.size, DIRECTIONS), np.inf),
    )


def _away(face: F64, other: F64) -> F64:
    """(n, 3) unit normals of faces on the side away from others, from inward vectors of both."""
    across = np.einsum("ei,ei->e", face, other)[:, None] * face - other
    return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True))
