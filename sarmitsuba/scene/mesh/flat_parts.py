"""Flat parts of a mesh in as few triangles as their outlines need, however they are cut."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.scene.mesh.topology import edge_pairs, label_connected, weld

# rad, bend up to which two triangles are one plane, and turn up to which an outline is straight
LEVEL, STRAIGHT = 1e-4, 1e-4
# positions that count as one, and distance of corners from a plane or a straight side, over the extent of the surface
SAME = 1e-6
# corners of an outline that is cut into triangles: the time grows with the square
MOST_CORNERS = 1000


def join_flat_parts(corners: F64, kind: I64) -> tuple[F64, I64]:
    """Triangles of a surface whose flat parts are cut anew, and the row of a given one that each lies in.

    Corners are given up where every part that has them is straight or whole around them, so that triangles which met
    corner to corner still do.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    kind : (n,) triangles of one number may be joined

    Returns
    -------
    corners, row : (m, 3, 3) float64 and (m,) int64; those given where nothing is saved

    Notes
    -----
    Parts with holes, whose outline meets itself, of more than ``MOST_CORNERS`` corners, or of triangles that are wound
    against each other, stay as they are.
    """
    n = len(corners)
    every = np.arange(n)
    if n < 3:
        return corners, every
    low = corners.reshape(-1, 3).min(axis=0)
    grid = SAME * max(float((corners.reshape(-1, 3).max(axis=0) - low).max()), 1e-300)
    vertex = weld(np.round((corners.reshape(-1, 3) - low) / grid))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.linalg.norm(normal, axis=1)
    unit = normal / np.maximum(twice, 1e-300)[:, None]
    first, second = edge_pairs(vertex)
    a, b = first // 3, second // 3
    joined = (np.einsum("ei,ei->e", unit[a], unit[b]) > 1.0 - 0.5 * LEVEL**2) & (kind[a] == kind[b])
    joined &= vertex[first] != vertex[second]
    if not joined.any():
        return corners, every
    part = label_connected(n, a[joined], b[joined])
    size = np.bincount(part)
    if size.max() < 3:
        return corners, every
    inner = np.zeros(3 * n, dtype=bool)
    inner[first[joined]] = inner[second[joined]] = True
    outline = _Outlines.of(corners, vertex, part, np.flatnonzero(~inner), grid)
    keep = np.ones(n, dtype=bool)
    new, row = [], []
    order = np.argsort(part, kind="stable")
    begin = np.cumsum(size) - size
    for k in np.flatnonzero((size > outline.kept_corners - 2) & (size > 2) & outline.simple):
        loop = outline.loop_of(int(k))
        own = order[begin[k] : begin[k] + size[k]]
        up = unit[own[twice[own].argmax()]]
        if loop is None or np.ptp(corners[own].reshape(-1, 3) @ up) > 2.0 * grid:
            continue
        cut = _cut(loop, up)
        if cut is None or not np.isclose(_areas(cut).sum(), 0.5 * twice[own].sum(), rtol=1e-4):
            continue
        keep[own] = False
        new.append(cut)
        row.append(np.full(len(cut), own[0]))
    if not new:
        return corners, every
    rows = np.concatenate([every[keep], *row])
    found = np.concatenate([corners[keep], *new])
    # in the order of the given triangles
    order = np.argsort(rows, kind="stable")
    return found[order], rows[order]


class _Outlines:
    """Outlines of all parts of a mesh.

    Attributes
    ----------
    kept_corners : (n_parts,) corners of each outline that stay
    simple : (n_parts,) whether the outline meets itself nowhere
    """

    def __init__(self, ends: I64, after: I64, part: I64, kept: NDArray[np.bool_], places: F64) -> None:
        self._order = np.argsort(part, kind="stable")
        self._after, self._kept, self._places = after, kept, places
        n = int(part.max(initial=-1)) + 1
        self._count = np.bincount(part, minlength=n)
        self._begin = np.cumsum(self._count) - self._count
        self.kept_corners = np.bincount(part, kept[ends].astype(np.float64), minlength=n)
        self._at_start = kept[ends]
        bad = np.zeros(n, dtype=bool)
        bad[part[after < 0]] = True
        self.simple = ~bad

    @staticmethod
    def of(corners: F64, vertex: I64, part: I64, side: I64, grid: float) -> "_Outlines":
        """Outlines made of some sides of triangles, three times the triangle's number plus the corner's."""
        start, end = vertex[side], np.roll(vertex.reshape(-1, 3), -1, axis=1).ravel()[side]
        flat = corners.reshape(-1, 3)
        here, there = flat[side], np.roll(corners, -1, axis=1).reshape(-1, 3)[side]
        own = part[side // 3]
        n_vertices = int(vertex.max()) + 1
        key, wanted = own * n_vertices + start, own * n_vertices + end
        order = np.argsort(key, kind="stable")
        ordered = key[order]
        place = np.searchsorted(ordered, wanted)
        place = np.minimum(place, len(ordered) - 1)
        count = np.searchsorted(ordered, wanted, side="right") - np.searchsorted(ordered, wanted)
        after = np.where((ordered[place] == wanted) & (count == 1), order[place], -1)
        along = there - here
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
        turn = np.linalg.norm(along - along[after], axis=1)
        kept = np.zeros(n_vertices, dtype=bool)
        kept[end[(after < 0) | (turn > STRAIGHT)]] = True
        found = _Outlines(start, after, own, kept, here)
        while found._bulging(start, own, grid):
            found = _Outlines(start, after, own, kept, here)
        return found

    def _bulging(self, start: I64, part: I64, grid: float) -> bool:
        """Keep corners of chains that leave the straight line between kept ones; whether there are any."""
        found = False
        for k in np.flatnonzero(self.simple & (self._count > self.kept_corners) & (self.kept_corners > 1)):
            sides = self._walk(int(k))
            if sides is None:
                continue
            points = self._places[sides]
            corner = np.flatnonzero(self._at_start[sides])
            a = points[corner][np.cumsum(self._at_start[sides]) - 1]
            b = points[np.roll(corner, -1)][np.cumsum(self._at_start[sides]) - 1]
            way = b - a
            way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-300)
            off = points - a
            off -= np.einsum("ni,ni->n", off, way)[:, None] * way
            far = np.linalg.norm(off, axis=1) > grid
            if far.any():
                self._kept[start[sides[far]]] = True
                found = True
        return found

    def _walk(self, k: int) -> I64 | None:
        """Sides of a part's outline in a row, from a corner that stays; None where there are several outlines."""
        own = self._order[self._begin[k] : self._begin[k] + self._count[k]]
        corner = own[self._at_start[own]]
        if corner.size < 3:
            return None
        sides = [int(corner[0])]
        while (following := int(self._after[sides[-1]])) != sides[0]:
            if len(sides) == own.size:
                return None
            sides.append(following)
        return np.array(sides) if len(sides) == own.size else None

    def loop_of(self, k: int) -> F64 | None:
        """Corners (n, 3), m, of a part's outline that stay; None where it has holes or too many."""
        sides = self._walk(k)
        if sides is None:
            return None
        loop = self._places[sides[self._at_start[sides]]]
        return loop if len(loop) <= MOST_CORNERS else None


def _areas(t: F64) -> F64:
    """Areas of triangles (n, 3, 3), m^2."""
    return np.asarray(0.5 * np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1))


def _cut(loop: F64, up: F64) -> F64 | None:
    """Triangles (n - 2, 3, 3) of a polygon (n, 3) about a normal, by its ears, the roundest first; None without one."""
    axis = np.eye(3)[np.abs(up).argmin()]
    x = np.cross(up, axis)
    x /= np.linalg.norm(x)
    p = (loop - loop[0]) @ np.stack([x, np.cross(up, x)], axis=1)
    left = list(range(len(p)))
    found = []
    while len(left) > 3:
        here = np.array(left)
        a, b, c = p[np.roll(here, 1)], p[here], p[np.roll(here, -1)]
        sides = [b - a, c - b, a - c]
        longest = np.max([np.square(s).sum(axis=1) for s in sides], axis=0)
        area = sides[0][:, 0] * sides[1][:, 1] - sides[0][:, 1] * sides[1][:, 0]
        quality = area / np.maximum(longest, 1e-300)
        for i in np.argsort(-quality, kind="stable"):
            if quality[i] <= 1e-9:
                return None
            own = here[[i - 1, i, (i + 1) % here.size]]
            others = p[np.setdiff1d(here, own)]
            inside = np.ones(len(others), dtype=bool)
            for u, v in ((own[0], own[1]), (own[1], own[2]), (own[2], own[0])):
                side, off = p[v] - p[u], others - p[u]
                inside &= side[0] * off[:, 1] - side[1] * off[:, 0] >= -1e-12 * longest[i]
            if not inside.any():
                found.append(own)
                del left[i]
                break
        else:
            return None
    return np.asarray(loop[np.array([*found, left])], dtype=np.float64)
