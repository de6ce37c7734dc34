"""Lattices over small parts of the scene: finer rays where a piece of surface is narrower than the rays are apart."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.trace.launch import LaunchFrame, project

F64 = NDArray[np.float64]

# triangles are cut until they are no longer than so many steps of the lattice: what the track does between the antennas
# differs from end to end of a long one
LONGEST = 500.0
# steps that a lattice goes on beyond the outline: for rounding, and what the track does between the antennas
RIM = 0.1
# steps within which corners count as one, and those of a convex outline may lie on the wrong side of its edges
SAME, ON_EDGE = 1e-3, 1e-6
# rows of outlines, and triangles, that are laid out at once: bounds the temporary arrays
MOST_ROWS, MOST_TRIANGLES = 1_000_000, 100_000


def nodes_over(
    triangles: F64,
    antennas: F64,
    frame: LaunchFrame,
    spacing: float,
    rotation: float,
    shift: F64,
    rim: float = RIM,
    reach: tuple[float, float] = (np.inf, np.inf),
) -> tuple[F64, F64]:
    """Nodes of a square lattice that lie over the outlines of triangles, in coordinates of the launch plane.

    Parameters
    ----------
    triangles : (n, 3, 3) float64, m, scene frame
    antennas : (m, 3) float64, m; the outline is the convex hull of what these see
    frame : launch plane
    spacing, rotation, shift : of the lattice, m, rad and (2,) m
    rim : steps that the lattice goes on beyond the outlines
    reach : m, largest modulus of x and of y

    Returns
    -------
    x, y : (n_nodes,) float64, m, each node once, in order of its row and column
    """
    c, s = np.cos(rotation), np.sin(rotation)
    turn = np.array([[c, -s], [s, c]])
    # no row and no column of the window lies farther out
    most = min(float(np.hypot(*reach)) / spacing + 2.0, 2.0**30)
    runs = [np.zeros((0, 3), dtype=np.int64)]
    pieces = cut(triangles, LONGEST * spacing)
    for first in range(0, len(pieces), MOST_TRIANGLES):
        corners = pieces[first : first + MOST_TRIANGLES]
        seen = [(project(corners, antenna, frame) - shift) @ turn / spacing for antenna in antennas]
        runs += _Outlines.of(seen).runs(rim, most)
    run = np.concatenate(runs)
    if not len(run):
        return np.zeros(0), np.zeros(0)
    # one number per node: runs of rows that follow each other stay apart
    least, columns = int(run[:, 1].min()), int(np.ptp(run[:, 1:])) + 1
    number = _union(run[:, 0] * columns + (run[:, 1] - least), run[:, 0] * columns + (run[:, 2] - least))
    nodes = np.stack([number // columns, number % columns + least], axis=1).astype(np.float64)
    xy = nodes @ turn.T * spacing + shift
    inside = (np.abs(xy) <= reach).all(axis=1)
    return xy[inside, 0], xy[inside, 1]


@dataclass(frozen=True)
class _Outlines:
    """Convex outlines in steps of a lattice, as what lies between two sets of lines.

    Parameters
    ----------
    low, high : (n, 2) bounds, row and column
    left, right : (n, k, 2) lines whose columns ``a + b row`` an outline lies beyond, and before
    at_left, at_right : (n,) rows of the outlines' outermost columns
    """

    low: F64
    high: F64
    left: F64
    right: F64
    at_left: F64
    at_right: F64

    @staticmethod
    def of(seen: Sequence[F64]) -> "_Outlines":
        """Convex hulls of triangles as several antennas see them, each (n, 3, 2) in steps, row and column."""
        ends = 0.5 * (seen[0] + seen[-1])
        if all(np.abs(corners - ends).max(initial=0.0) < 0.5 * RIM for corners in seen[1:-1]):
            seen = (seen[0], seen[-1])
        points = np.concatenate(seen, axis=1)
        rows = np.arange(len(points))
        left, right = _hull_lines(points)
        at_left, at_right = (points[rows, pick(points[..., 1], axis=1), 0] for pick in (np.argmin, np.argmax))
        return _Outlines(points.min(axis=1), points.max(axis=1), left, right, at_left, at_right)

    def runs(self, rim: float, most: float) -> list[NDArray[np.int64]]:
        """Rows with their first and last columns, (n_runs, 3) each, of the nodes within ``rim`` along both axes."""
        first, last = (
            np.clip(v, -most, most).astype(np.int64)
            for v in (np.ceil(self.low[:, 0] - rim), np.floor(self.high[:, 0] + rim))
        )
        count = np.maximum(last - first + 1, 0)
        total = np.cumsum(count)
        out, done = [], 0
        while done < len(count):
            before = int(total[done - 1]) if done else 0
            end = max(done + 1, int(np.searchsorted(total, before + MOST_ROWS, "right")))
            of = slice(done, end)
            owner = np.repeat(np.arange(done, end), count[of])
            row = np.arange(owner.size) - np.repeat(total[of] - count[of] - before, count[of]) + first[owner]
            columns = self._columns(owner, row.astype(np.float64), rim)
            low, high = np.ceil(np.clip(columns[0], -most, most)), np.floor(np.clip(columns[1], -most, most))
            kept = low <= high
            out.append(np.stack([row, low.astype(np.int64), high.astype(np.int64)], axis=1)[kept])
            done = end
        return out

    def _columns(self, owner: NDArray[np.intp], row: F64, rim: float) -> tuple[F64, F64]:
        """Leftmost and rightmost column of outlines within ``rim`` of a row, and ``rim`` beyond."""
        ends = []
        for lines, at, bound, pick in (
            (self.left, self.at_left, self.low[:, 1], np.maximum),
            (self.right, self.at_right, self.high[:, 1], np.minimum),
        ):
            # the columns of a convex outline reach out the farther, the nearer a row is to that of the outermost
            nearest = np.clip(np.clip(at[owner], row - rim, row + rim), self.low[owner, 0], self.high[owner, 0])
            end = bound[owner]
            for k in range(lines.shape[1]):
                a, b = lines[owner, k].T
                end = pick(end, a + b * nearest)
            ends.append(end)
        return ends[0] - rim, ends[1] + rim


def _hull_lines(points: F64) -> tuple[F64, F64]:
    """Lines along the left and the right edges of the convex hulls of points (n, m, 2): columns ``a + b row``.

    Edges shorter than ``SAME`` are left out: what the other lines bound is larger by no more than that.
    """
    n, m, _ = points.shape
    lines: tuple[list[F64], list[F64]] = ([], [])
    for i, j in combinations(range(m), 2):
        step = points[:, j] - points[:, i]
        length = np.linalg.norm(step, axis=1)
        unit = step / np.maximum(length, SAME)[:, None]
        away = points - points[:, i, None]
        # columns beyond the line, where it is walked towards rising rows
        beyond = away[..., 1] * unit[:, None, 0] - away[..., 0] * unit[:, None, 1]
        upwards = np.sign(unit[:, :1])
        beyond *= upwards
        steep = (length > SAME) & (np.abs(unit[:, 0]) > ON_EDGE)
        slope = unit[:, 1] / np.where(steep, unit[:, 0], 1.0)
        start = points[:, i, 1] - slope * points[:, i, 0]
        for side, bounds, none in (
            (0, beyond.min(axis=1) >= -ON_EDGE, -np.inf),
            (1, beyond.max(axis=1) <= ON_EDGE, np.inf),
        ):
            of = steep & bounds
            lines[side].append(np.stack([np.where(of, start, none), np.where(of, slope, 0.0)], axis=1))
    kept = []
    for side, none in zip(lines, (-np.inf, np.inf), strict=True):
        stacked = np.stack(side, axis=1)
        # few of the pairs are edges: those first, the others cut off
        order = np.argsort(np.isinf(stacked[..., 0]), axis=1, kind="stable")
        most = int((stacked[..., 0] != none).sum(axis=1).max(initial=0))
        kept.append(np.take_along_axis(stacked, order[:, :most, None], axis=1))
    return kept[0], kept[1]


def _union(start: NDArray[np.int64], stop: NDArray[np.int64]) -> NDArray[np.int64]:
    """Whole numbers that runs ``start ... stop`` hold, each once, in order."""
    order = np.argsort(start, kind="stable")
    start, reached = start[order], np.maximum.accumulate(stop[order])
    new = np.flatnonzero(np.append(True, start[1:] > reached[:-1]))
    begin, end = start[new], reached[np.append(new[1:], len(start)) - 1]
    count = end - begin + 1
    return np.repeat(begin - np.cumsum(count) + count, count) + np.arange(int(count.sum()))


def outline_area(triangles: F64, antenna: F64, frame: LaunchFrame) -> F64:
    """Area of every triangle as seen in the launch plane, (n,) float64, m^2."""
    xy = project(triangles, antenna, frame)
    a, b = xy[:, 1] - xy[:, 0], xy[:, 2] - xy[:, 0]
    return np.asarray(0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))


def cut(triangles: F64, longest: float) -> F64:
    """Halve triangles across their longest edge until none is longer."""
    done = []
    while triangles.size:
        edges = np.roll(triangles, -1, axis=1) - triangles
        length = np.sqrt(np.einsum("tki,tki->tk", edges, edges))
        long = length.max(axis=1) > longest
        done.append(triangles[~long])
        triangles, k = triangles[long], length[long].argmax(axis=1)
        row = np.arange(k.size)
        a, b, c = (triangles[row, (k + i) % 3] for i in range(3))
        m = 0.5 * (a + b)
        triangles = np.concatenate([np.stack([a, m, c], axis=1), np.stack([m, b, c], axis=1)])
    return np.concatenate(done) if done else triangles


__all__ = ["cut", "nodes_over", "outline_area"]
