"""Lattices over small parts of the scene: finer rays where a piece of surface is narrower than the rays are apart."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.trace.launch import LaunchFrame, project

F64 = NDArray[np.float64]

# triangles are cut until they are no longer than so many steps of the lattice: their boxes then hold few extra nodes
LONGEST = 12.0
# steps that a lattice goes on beyond the outline: for what the track does between the antennas, and rounding
RIM = 0.1


def nodes_over(
    triangles: F64,
    antennas: F64,
    frame: LaunchFrame,
    spacing: float,
    rotation: float,
    shift: F64,
    rim: float = RIM,
) -> tuple[F64, F64]:
    """Nodes of a square lattice that lie over the outlines of triangles, in coordinates of the launch plane.

    Parameters
    ----------
    triangles : (n, 3, 3) float64, m, scene frame
    antennas : (m, 3) float64, m; the outline is what any of these and what lies between them sees
    frame : launch plane
    spacing, rotation, shift : of the lattice, m, rad and (2,) m
    rim : steps that the lattice goes on beyond the outlines

    Returns
    -------
    x, y : (n_nodes,) float64, m, each node once, in order of its row and column
    """
    pieces = cut(triangles, LONGEST * spacing)
    c, s = np.cos(rotation), np.sin(rotation)
    turn = np.array([[c, -s], [s, c]])
    seen = [(project(pieces, antenna, frame) - shift) @ turn / spacing for antenna in antennas]
    low, high = np.min([n.min(axis=1) for n in seen], axis=0), np.max([n.max(axis=1) for n in seen], axis=0)
    start, stop = _runs(low, high, seen, rim)
    if not start.size:
        return np.zeros(0), np.zeros(0)
    # one number per node: runs of rows that follow each other stay apart
    least, columns = int(start[:, 1].min()), int(np.ptp(np.concatenate([start[:, 1], stop]))) + 1
    number = _union(start[:, 0] * columns + (start[:, 1] - least), start[:, 0] * columns + (stop - least))
    nodes = np.stack([number // columns, number % columns + least], axis=1).astype(np.float64)
    xy = nodes @ turn.T * spacing + shift
    return xy[:, 0], xy[:, 1]


def _runs(low: F64, high: F64, seen: list[F64], rim: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Runs of nodes within ``rim`` of a triangle, (n, 3, 2) in steps, as any of the antennas sees it.

    Parameters
    ----------
    low, high : (n, 2) bounds of each triangle, whichever antenna sees it

    Returns
    -------
    start, stop : (n_runs, 2) row and column of the first node, and column of the last
    """
    middle = seen[len(seen) // 2]
    walk = np.max([np.linalg.norm(n - middle, axis=2).max(axis=1) for n in seen], axis=0)
    along = np.roll(middle, -1, axis=1) - middle
    length = np.linalg.norm(along, axis=2)
    along /= np.maximum(length, 1e-300)[:, :, None]
    outward = np.stack([along[..., 1], -along[..., 0]], axis=2)
    # wound the other way, the normals point inward
    facing = np.sign(np.einsum("ti,ti->t", outward[:, 0], middle[:, 0] - middle[:, 2]))
    outward *= np.where(facing == 0.0, 1.0, facing)[:, None, None]
    limit = np.einsum("tki,tki->tk", outward, middle) + (walk + rim)[:, None]

    first = np.ceil(low - rim).astype(np.int64)
    last = np.floor(high + rim).astype(np.int64)
    count = np.maximum(last[:, 0] - first[:, 0] + 1, 0)
    owner = np.repeat(np.arange(len(low)), count)
    row = np.arange(owner.size) - np.repeat(np.cumsum(count) - count, count) + first[owner, 0]
    left, right = first[owner, 1].astype(np.float64), last[owner, 1].astype(np.float64)
    for k in range(3):
        across, slope = outward[owner, k, 0], outward[owner, k, 1]
        left_over = limit[owner, k] - row * across
        steep = np.abs(slope) > 1e-9
        end = left_over / np.where(steep, slope, 1.0)
        # a side along the row has all of it on one side
        right = np.where(steep & (slope > 0.0), np.minimum(right, end), right)
        left = np.where(steep & (slope < 0.0), np.maximum(left, end), left)
        left = np.where(~steep & (left_over < 0.0), np.inf, left)
    kept = np.ceil(left) <= np.floor(right)
    column = np.ceil(left[kept]).astype(np.int64)
    return np.stack([row[kept], column], axis=1), np.floor(right[kept]).astype(np.int64)


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
