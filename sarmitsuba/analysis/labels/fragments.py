"""Triangles cut into the pixels of an image: the points of surfaces at which a pixel's centre shows them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64

# largest error, in pixels, of a linear map from the image to a triangle
BENT = 0.02
# length of an edge, in pixels, from which it is divided
_SHORT = 0.25
# length of an edge, over its distance from the antenna, below which a triangle without a place in the image is dropped
_SMALL = 1e-3
# triangles divided at once, and spans of rows filled at once; bound the temporary arrays
_CHUNK, _SPANS = 200_000, 1_000_000
# corners of the parts of a triangle by the number of its divided edges, the undivided ones last: corners 0 to 2 and
# middles 3 to 5 of the edges that begin there
_PARTS = {
    1: ((0, 3, 2), (3, 1, 2)),
    2: ((3, 1, 4), (0, 3, 4), (0, 4, 2)),
    3: ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
}

# row and column, in pixels, of points (n, 3), m; NaN outside the radar's side
Placed = Callable[[F64], F64]
# whether spheres about points (n, 3) of radii (n,), m, may hold something of the image
Reached = Callable[[F64, F64], NDArray[np.bool_]]


@dataclass(frozen=True, eq=False)
class Fragments:
    """Points of surfaces at the centres of pixels.

    Parameters
    ----------
    pixel : (n,) number of the pixel, row by row
    face : (n,) row of the triangle
    point : (n, 3) float64, m
    area : (n,) float64, m^2 of surface that falls into a pixel there
    """

    pixel: I64
    face: I64
    point: F64
    area: F64

    def __getitem__(self, pick: NDArray[np.generic]) -> "Fragments":
        """Some of them."""
        return Fragments(*(getattr(self, f.name)[pick] for f in fields(self)))

    @staticmethod
    def joined(parts: list["Fragments"]) -> "Fragments":
        """Concatenation of several sets."""
        return Fragments(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Fragments)))


def fragments(
    corners: F64, placed: Placed, shape: tuple[int, int], antenna: F64, reached: Reached | None = None
) -> Fragments:
    """Every point of triangles whose place in the image is the centre of a pixel.

    A triangle is divided at the middles of its edges until the image shows each edge straight to ``BENT`` of a pixel;
    neighbours divide a common edge alike, so that no gap opens between them. An edge belongs to one of its two
    triangles: a connected surface that the image does not fold has one point in each pixel.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    placed : row and column (n, 2) of points (n, 3)
    shape : rows and columns of the image
    antenna : (3,) m; sizes of triangles without a place are judged from there
    reached : spheres that may hold something of the image; None: all
    """
    found = [_empty()]
    for start in range(0, len(corners), _CHUNK):
        rows = np.arange(start, min(start + _CHUNK, len(corners)))
        for triangle, place, face in _straight(corners[rows], rows, placed, shape, antenna, reached):
            found += list(_fill_triangles(triangle, place, face, shape))
    return Fragments.joined(found)


def _empty() -> Fragments:
    none = np.zeros(0, dtype=np.int64)
    return Fragments(none, none, np.zeros((0, 3)), np.zeros(0))


def _straight(
    corners: F64, face: I64, placed: Placed, shape: tuple[int, int], antenna: F64, reached: Reached | None
) -> Iterator[tuple[F64, F64, I64]]:
    """Parts of triangles that lie in the image and are straight there: corners, places (n, 3, 2) and rows of faces."""
    stack = [(corners, placed(corners.reshape(-1, 3)).reshape(-1, 3, 2), face)]
    while stack:
        corners, place, face = stack.pop()
        if len(face) > _CHUNK:
            half = len(face) // 2
            stack += [(corners[p], place[p], face[p]) for p in (slice(half), slice(half, None))]
            continue
        middle = 0.5 * (corners + np.roll(corners, -1, axis=1))
        between = placed(middle.reshape(-1, 3)).reshape(-1, 3, 2)
        bend = np.abs(between - 0.5 * (place + np.roll(place, -1, axis=1))).max(axis=2)
        every = np.concatenate([place, between], axis=1)
        known = np.isfinite(every).all(axis=(1, 2))
        with np.errstate(invalid="ignore"):
            spare = 2.0 * bend.max(axis=1)[:, None] + 1.0
            inside = ((every.max(axis=1) > -spare) & (every.min(axis=1) < np.array(shape) + spare)).all(
                axis=1
            )
        edge = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        large = edge.max(axis=1) > _SMALL * np.linalg.norm(corners[:, 0] - antenna, axis=1)
        if reached is not None:
            middles = corners.mean(axis=1)
            large &= reached(middles, np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1))
        kept = np.where(known, inside, np.isfinite(every).any(axis=(1, 2)) & large)
        corners, place, middle, between = (x[kept] for x in (corners, place, middle, between))
        face, bend, known = face[kept], bend[kept], known[kept]
        # decided by the edge alone, so alike on both sides of it; NaN: an end has no place
        steps = np.abs(np.roll(place, -1, axis=1) - place).max(axis=2)
        divided = ~(bend <= BENT) & ~(steps < _SHORT)
        whole = ~divided.any(axis=1)
        if whole.any():
            yield corners[whole], place[whole], face[whole]
        for count, pattern in _PARTS.items():
            pick = divided.sum(axis=1) == count
            if not pick.any():
                continue
            # divided edges first
            turn = _turn(divided[pick])
            nodes = np.concatenate(
                [_turn_entries(corners[pick], turn), _turn_entries(middle[pick], turn)], axis=1
            )
            spots = np.concatenate(
                [_turn_entries(place[pick], turn), _turn_entries(between[pick], turn)], axis=1
            )
            parts = np.array(pattern)
            stack.append(
                (
                    nodes[:, parts].reshape(-1, 3, 3),
                    spots[:, parts].reshape(-1, 3, 2),
                    np.repeat(face[pick], len(pattern)),
                )
            )


def _turn(divided: NDArray[np.bool_]) -> I64:
    """(n,) edge to begin with, so that divided edges come first in turn."""
    before = np.roll(divided, 1, axis=1)
    return np.where(divided.all(axis=1), 0, np.argmax(divided & ~before, axis=1))


def _turn_entries(values: F64, turn: I64) -> F64:
    """Entries (n, 3, m) of the corners in turn from another one."""
    order = (turn[:, None] + np.arange(3)) % 3
    return np.take_along_axis(values, order[..., None], axis=1)


def _fill_triangles(corners: F64, place: F64, face: I64, shape: tuple[int, int]) -> Iterator[Fragments]:
    """Points of straight triangles at the centres of pixels, some rows of pixels at a time."""
    rows, columns = shape
    low = np.clip(np.ceil(place[..., 0].min(axis=1)), 0, rows).astype(np.int64)
    high = np.clip(np.ceil(place[..., 0].max(axis=1)), 0, rows).astype(np.int64)
    a, b = place[:, 1] - place[:, 0], place[:, 2] - place[:, 0]
    twice = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    beside = (place[..., 1].max(axis=1) < 0.0) | (place[..., 1].min(axis=1) > columns - 1)
    height = np.where((twice == 0.0) | beside, 0, high - low)
    pick = np.flatnonzero(height)
    ends = np.cumsum(height[pick])
    for start, end in _groups(ends):
        own = np.repeat(pick[start:end], height[pick[start:end]])
        first = np.repeat(ends[start:end] - height[pick[start:end]], height[pick[start:end]])
        line = low[own] + np.arange(ends[start - 1] if start else 0, ends[end - 1]) - first
        left, right = _crossings(place[own], line)
        begin = np.clip(np.ceil(left), 0, columns).astype(np.int64)
        count = np.clip(np.ceil(right), 0, columns).astype(np.int64) - begin
        total = np.cumsum(count)
        for part, stop in _groups(total):
            n = count[part:stop]
            column = np.arange(int(n.sum())) - np.repeat(np.cumsum(n) - n, n) + np.repeat(begin[part:stop], n)
            row, i = np.repeat(line[part:stop], n), np.repeat(own[part:stop], n)
            d = np.stack([row, column], axis=1) - place[i, 0]
            u = (d[:, 0] * b[i, 1] - d[:, 1] * b[i, 0]) / twice[i]
            v = (a[i, 0] * d[:, 1] - a[i, 1] * d[:, 0]) / twice[i]
            one, two = corners[i, 1] - corners[i, 0], corners[i, 2] - corners[i, 0]
            yield Fragments(
                row * columns + column,
                face[i],
                corners[i, 0] + u[:, None] * one + v[:, None] * two,
                np.linalg.norm(np.cross(one, two), axis=1) / np.abs(twice[i]),
            )


def _groups(ends: I64) -> Iterator[tuple[int, int]]:
    """First and last entry of groups of entries whose sizes, with these running sums, add up to about ``_SPANS``."""
    start = 0
    while start < len(ends):
        done = int(ends[start - 1]) if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, done + _SPANS, side="right")))
        yield start, stop
        start = stop


def _crossings(place: F64, line: I64) -> tuple[F64, F64]:
    """Columns (n,) at which rows of pixels enter and leave triangles (n, 3, 2); an edge gives both sides the same."""
    left, right = np.full(len(line), np.inf), np.full(len(line), -np.inf)
    for k in range(3):
        p, q = place[:, k], place[:, (k + 1) % 3]
        swap = (p[:, 0] > q[:, 0]) | ((p[:, 0] == q[:, 0]) & (p[:, 1] > q[:, 1]))
        p, q = np.where(swap[:, None], q, p), np.where(swap[:, None], p, q)
        met = (p[:, 0] <= line) & (line < q[:, 0])
        with np.errstate(invalid="ignore", divide="ignore"):
            at = p[:, 1] + (line - p[:, 0]) / (q[:, 0] - p[:, 0]) * (q[:, 1] - p[:, 1])
        left = np.where(met, np.minimum(left, at), left)
        right = np.where(met, np.maximum(right, at), right)
    none = ~np.isfinite(left)
    return np.where(none, 0.0, left), np.where(none, 0.0, right)
