"""Finer ray lattices where a piece of surface is narrower than the ray spacing."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F32, F64, I64, box_corners, box_of_each
from sarmitsuba.core.units import db_from_amplitude
from sarmitsuba.scene.mesh.metal_corners import MOST_RAYS as CORNER_RAYS
from sarmitsuba.tracing.kernel.launch import LatticeLevel, LaunchFrame, LaunchGrid, Purpose, morton, project
from sarmitsuba.tracing.kernel.scene_tables import TraceScene

# largest length of the parts into which triangles are cut, steps of the lattice: the motion between the antenna
# positions differs from end to end of a long triangle
LONGEST = 500.0
# parts of the longest edge at most
MOST_CUTS = 64.0
# margin of a lattice beyond the outline, steps: for rounding, and the motion between the antenna positions
RIM = 0.1
# tolerance for coincident corners and for the convexity of outlines, steps
SAME, ON_EDGE = 1e-3, 1e-6
# least number of rows of the triangles of a stretch to be laid out together, in all and relative to those of its hull
ROWS_TOGETHER, FEWER_ROWS = 2000.0, 4.0
# bound on the rows laid out per allowed node
ROWS_A_NODE = 8.0
# rows of outlines, and triangles, that are processed at once: bounds the temporary arrays
MOST_ROWS, MOST_TRIANGLES = 1_000_000, 100_000


class ManyNodesError(Exception):
    """Raised when a lattice would have more nodes over outlines than allowed, or too many rows."""


@dataclass(frozen=True)
class Lattice:
    """Square lattice in a launch plane.

    Parameters
    ----------
    frame : launch plane
    spacing : m
    turn : rad
    shift : (2,) m
    """

    frame: LaunchFrame
    spacing: float
    turn: float
    shift: F64

    @property
    def axes(self) -> F64:
        """Unit vectors along the rows and the columns of the lattice, as the columns of a (2, 2) array."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        return np.array([[c, -s], [s, c]])

    def steps(self, points: F64, antenna: F64) -> F64:
        """Row and column (..., 2), in steps, of points (..., 3) projected from an antenna."""
        return np.asarray(
            (project(points, antenna, self.frame) - self.shift) @ self.axes / self.spacing, dtype=np.float64
        )

    def places(self, nodes: F64) -> F64:
        """Coordinates (n, 2), m, of nodes given by rows and columns."""
        return np.asarray(nodes @ self.axes.T * self.spacing + self.shift)


def nodes_over(
    triangles: F64,
    antennas: F64,
    lattice: Lattice,
    rim: float = RIM,
    reach: tuple[float, float] = (np.inf, np.inf),
    piece: I64 | None = None,
    most: float = np.inf,
    stretches: float = LONGEST,
    rows: float = ROWS_A_NODE,
) -> tuple[F64, F64]:
    """Nodes of a square lattice that lie over the outlines of triangles, in coordinates of the launch plane.

    Parameters
    ----------
    triangles : (n, 3, 3) float64, m, scene frame
    antennas : (m, 3) float64, m; the outline is the convex hull of the projections from these
    lattice : to which the nodes belong
    rim : margin of the lattice beyond the outlines, steps
    reach : m, largest modulus of x and of y
    piece : (n,) numbers of the pieces of surface to which the triangles belong: long ones are processed as one, stretch
        by stretch, where that takes no more nodes; None: each triangle separately
    most : bound on the number of nodes
    stretches : steps, length of the parts in which long triangles are processed
    rows : bound on the rows laid out per allowed node

    Returns
    -------
    x, y : (n_nodes,) float64, m, each node once, in order of its row and column

    Raises
    ------
    ManyNodesError
        There would be more than ``most`` nodes.
    """
    # bound on rows and columns of the window
    farthest = min(float(np.hypot(*reach)) / lattice.spacing + 2.0, 2.0**30)
    edges = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
    longest = max(stretches * lattice.spacing, float(edges.max(initial=0.0)) / MOST_CUTS)
    runs = [np.zeros((0, 3), dtype=np.int64)]
    margin = (rim + 1.0) * lattice.spacing
    within = (reach[0] + margin, reach[1] + margin)
    corners, owner = cut_triangles(
        triangles, longest, lambda some: _may_reach(some, antennas, lattice.frame, within)
    )
    stretch = None if piece is None else _stretches(corners, piece[owner], longest)
    rows_left = rows * max(most, 1.0)
    for first in range(0, len(corners), MOST_TRIANGLES):
        of = slice(first, first + MOST_TRIANGLES)
        seen = [lattice.steps(corners[of], antenna) for antenna in antennas]
        outlines, alone = [], np.ones(len(seen[0]), dtype=bool)
        if stretch is not None:
            for together, ring in _rings(seen, stretch[of]):
                alone[together] = False
                outlines.append(_Outlines.of_ring(ring))
        if alone.any():
            outlines.append(_Outlines.of([points[alone] for points in seen]))
        for outline in outlines:
            rows_left -= outline.n_rows(rim, farthest)
            if rows_left < 0.0:
                raise ManyNodesError
            runs += outline.runs(rim, farthest)
    run = np.concatenate(runs)
    if not len(run):
        return np.zeros(0), np.zeros(0)
    # one number per node: runs of successive rows stay separate
    least, columns = int(run[:, 1].min()), int(np.ptp(run[:, 1:])) + 1
    number = _union(
        run[:, 0] * columns + (run[:, 1] - least), run[:, 0] * columns + (run[:, 2] - least), most
    )
    nodes = np.stack([number // columns, number % columns + least], axis=1).astype(np.float64)
    xy = lattice.places(nodes)
    inside = (np.abs(xy) <= reach).all(axis=1)
    return xy[inside, 0], xy[inside, 1]


@dataclass(frozen=True)
class _Outlines:
    """Convex outlines in steps of a lattice, bounded by two sets of lines.

    Parameters
    ----------
    low, high : (n, 2) bounds, row and column
    left, right : (n, k, 2) lines, columns ``a + b row``, that bound an outline from below and above
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
        """Convex hulls of triangles projected from several antennas, each (n, 3, 2) in steps, row and column."""
        ends = 0.5 * (seen[0] + seen[-1])
        if all(np.abs(corners - ends).max(initial=0.0) < 0.5 * RIM for corners in seen[1:-1]):
            seen = (seen[0], seen[-1])
        points = np.concatenate(seen, axis=1)
        rows = np.arange(len(points))
        left, right = _hull_lines(points, combinations(range(points.shape[1]), 2))
        at_left, at_right = (points[rows, pick(points[..., 1], axis=1), 0] for pick in (np.argmin, np.argmax))
        return _Outlines(*box_of_each(points), left, right, at_left, at_right)

    @staticmethod
    def of_ring(ring: F64) -> "_Outlines":
        """Outline of a convex polygon with corners (m, 2) in turn, row and column."""
        left, right = _hull_lines(
            ring[None], zip(range(len(ring)), np.roll(range(len(ring)), -1), strict=True)
        )
        ends = (ring[[pick(ring[:, 1])], 0] for pick in (np.argmin, np.argmax))
        return _Outlines(ring.min(axis=0)[None], ring.max(axis=0)[None], left, right, *ends)

    def _rows(self, rim: float, most: float) -> tuple[I64, I64]:
        """First row and number of rows of each outline."""
        first, last = (
            np.clip(v, -most, most).astype(np.int64)
            for v in (np.ceil(self.low[:, 0] - rim), np.floor(self.high[:, 0] + rim))
        )
        return first, np.maximum(last - first + 1, 0)

    def n_rows(self, rim: float, most: float) -> int:
        """Total number of rows of all outlines."""
        return int(self._rows(rim, most)[1].sum())

    def runs(self, rim: float, most: float) -> list[I64]:
        """Rows with their first and last columns, (n_runs, 3) each, of the nodes within ``rim`` along both axes."""
        first, count = self._rows(rim, most)
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
            # the columns of a convex outline extend farthest in the row of its outermost corner
            nearest = np.clip(
                np.clip(at[owner], row - rim, row + rim), self.low[owner, 0], self.high[owner, 0]
            )
            end = bound[owner]
            for k in range(lines.shape[1]):
                a, b = lines[owner, k].T
                end = pick(end, a + b * nearest)
            ends.append(end)
        return ends[0] - rim, ends[1] + rim


def _stretches(corners: F64, piece: I64, longest: float) -> I64:
    """Number of the stretch of surface, no longer than ``longest``, to which each triangle belongs."""
    if not len(corners):
        return np.zeros(0, dtype=np.int64)
    _, number = np.unique(piece, return_inverse=True)
    order = np.argsort(number, kind="stable")
    start = np.flatnonzero(np.diff(number[order], prepend=-1))
    least, most = box_of_each(corners)
    low, high = np.minimum.reduceat(least[order], start), np.maximum.reduceat(most[order], start)
    axis = (high - low).argmax(axis=1)[number]
    row = np.arange(len(corners))
    along = (corners.mean(axis=1)[row, axis] - low[number, axis]) / longest
    _, stretch = np.unique(number * (int(along.max()) + 2) + along.astype(np.int64), return_inverse=True)
    return np.asarray(stretch, dtype=np.int64)


def _rings(seen: Sequence[F64], stretch: I64) -> Iterator[tuple[NDArray[np.intp], F64]]:
    """Triangles that are processed together, and the convex hull (m, 2) of their projections from all antennas.

    Those of a stretch whose hull is no larger than their outlines side by side, and has far fewer rows.
    """
    rows = np.ptp(seen[0][..., 0], axis=1) + 1.0
    order = np.argsort(stretch, kind="stable")
    start = np.flatnonzero(np.diff(stretch[order], prepend=-1))
    many = np.add.reduceat(rows[order], start) > ROWS_TOGETHER
    for first, end in zip(start[many], np.append(start[1:], len(order))[many], strict=True):
        together = order[first:end]
        points = np.concatenate([corners[together].reshape(-1, 2) for corners in seen])
        if FEWER_ROWS * (np.ptp(points[:, 0]) + 1.0) > rows[together].sum():
            continue
        try:
            hull = scipy.spatial.ConvexHull(points)
        except (scipy.spatial.QhullError, ValueError):  # collinear or not finite
            continue
        step = [np.linalg.norm(corners[together] - seen[0][together], axis=2).max() for corners in seen]
        edges = np.roll(seen[0][together], -1, axis=1) - seen[0][together]
        size = 0.5 * np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]).sum()
        length = float(np.linalg.norm(np.ptp(points, axis=0)))
        if hull.volume <= size + length * (
            2.0 * RIM + max(step)
        ):  # for the motion between the antenna positions
            yield together, points[hull.vertices]


def _hull_lines(points: F64, pairs: Iterable[tuple[int, int]]) -> tuple[F64, F64]:
    """Lines along the left and right edges of the convex hulls of points (n, m, 2), as columns ``a + b row``.

    The edges are among the ``pairs`` of points. Edges shorter than ``SAME`` are left out, which enlarges the outline by
    no more than that.
    """
    lines: tuple[list[F64], list[F64]] = ([], [])
    for i, j in pairs:
        step = points[:, j] - points[:, i]
        length = np.linalg.norm(step, axis=1)
        unit = step / np.maximum(length, SAME)[:, None]
        away = points - points[:, i, None]
        # columns beyond the line, traversed towards increasing rows
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
    for side_lines, none in zip(lines, (-np.inf, np.inf), strict=True):
        stacked = np.stack(side_lines, axis=1)
        # few of the pairs are edges: these come first, the others are dropped
        order = np.argsort(np.isinf(stacked[..., 0]), axis=1, kind="stable")
        most = int((stacked[..., 0] != none).sum(axis=1).max(initial=0))
        kept.append(np.take_along_axis(stacked, order[:, :most, None], axis=1))
    return kept[0], kept[1]


def _union(start: I64, stop: I64, most: float) -> I64:
    """Integers within runs ``start ... stop``, each once, in order; at most ``most``."""
    order = np.argsort(start, kind="stable")
    start, reached = start[order], np.maximum.accumulate(stop[order])
    new = np.flatnonzero(np.append(True, start[1:] > reached[:-1]))
    begin, end = start[new], reached[np.append(new[1:], len(start)) - 1]
    count = end - begin + 1
    if count.sum() > most:
        raise ManyNodesError
    return np.repeat(begin - np.cumsum(count) + count, count) + np.arange(int(count.sum()))


def outline_area(triangles: F64, antenna: F64, frame: LaunchFrame) -> F64:
    """Projected area of every triangle in the launch plane, (n,) float64, m^2."""
    xy = project(triangles, antenna, frame)
    a, b = xy[:, 1] - xy[:, 0], xy[:, 2] - xy[:, 0]
    return np.asarray(0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))


def _may_reach(
    triangles: F64, antennas: F64, frame: LaunchFrame, reach: tuple[float, float]
) -> NDArray[np.bool_]:
    """Triangles (n, 3, 3) whose projections from the antennas may lie within ``reach`` of the launch plane's centre."""
    box = box_corners(np.stack([triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))]))
    if all((np.abs(project(box, antenna, frame)) <= reach).all() for antenna in antennas):
        return np.ones(len(triangles), dtype=bool)
    least, most = box_of_each(
        np.concatenate([project(triangles, antenna, frame) for antenna in antennas], axis=1)
    )
    return np.asarray((least <= reach).all(axis=1) & (most >= -np.asarray(reach)).all(axis=1))


def cut_triangles(
    triangles: F64, longest: float, wanted: Callable[[F64], NDArray[np.bool_]] | None = None
) -> tuple[F64, NDArray[np.intp]]:
    """Triangles halved across their longest edge until none is longer than ``longest``; parts, and their triangle.

    Parameters
    ----------
    triangles : (n, 3, 3) float64, m
    longest : m
    wanted : which of some triangles to keep; None: all
    """
    done: list[F64] = []
    owners: list[NDArray[np.intp]] = []
    owner = np.arange(len(triangles))
    while triangles.size:
        if wanted is not None:
            kept = wanted(triangles)
            triangles, owner = triangles[kept], owner[kept]
        edges = np.roll(triangles, -1, axis=1) - triangles
        length = np.sqrt(np.einsum("tki,tki->tk", edges, edges))
        long = length.max(axis=1) > longest
        done.append(triangles[~long])
        owners.append(owner[~long])
        triangles, owner, k = triangles[long], owner[long], length[long].argmax(axis=1)
        row = np.arange(k.size)
        a, b, c = (triangles[row, (k + i) % 3] for i in range(3))
        m = 0.5 * (a + b)
        triangles = np.concatenate([np.stack([a, m, c], axis=1), np.stack([m, b, c], axis=1)])
        owner = np.concatenate([owner, owner])
    if not done:
        return triangles, owner
    return np.concatenate(done), np.concatenate(owners)


# positions of rays in a launch plane; their spacing, and least and largest need of the faces that they sample
Nodes = tuple[F32, F32]
Density = tuple[float, tuple[float, float]]

# bound on the rays of finer lattices: a number, or a share of the plain lattice's rays where that is larger
MOST_RAYS = 600_000
SHARE = 0.15
# rays of lattices with half of the spacing needed, over those with just that spacing
HALVED = 4.0
# factor on that bound for the sum over outlines: where they overlap, they have fewer rays
LOOSE = 4.0
# factor on the spacing of the lattices that estimate the number of rays
SPARSE = 4.0
# halvings of the ray spacing
MOST_LEVELS = 12


@dataclass(frozen=True)
class Shortfall:
    r"""Surface that is too coarsely sampled for one kind of return, because of the bound on rays.

    Parameters
    ----------
    purpose : of the rays
    share : of the projected area of all surface that faces the antenna
    spacing, needed : m, present ray spacing, and spacing that the surface needs (geometric mean)
    corners : the surface needs it for double bounces between metal facets at right angles, whose error is that of the
        edges of their chains
    chains : tubes that meet it after a reflection are too wide (``spacing`` over the largest such need); no ``share``

    Notes
    -----
    A flat facet of area A that is hit by chance by tubes of cross-section :math:`d^2` counts with :math:`d^2 / A`, and
    so does a tube on a curved surface that spans more than the first Fresnel zone :math:`\lambda \rho`.
    """

    purpose: Purpose
    share: float
    spacing: float
    needed: float
    corners: bool = False
    chains: bool = False

    @property
    def bias_db(self) -> float:
        """Estimated upper bound of the bias of coherent power, dB; diffuse power fluctuates, but is unbiased."""
        if self.purpose == "diffuse" or self.corners or self.chains:
            return 0.0
        return float(max(0.0, db_from_amplitude(self.spacing / self.needed) + SERVED_DB))


# power of a tube relative to the largest permitted (two rays across a width, a tenth of a Fresnel zone), dB
SERVED_DB = -10.0


def add_small_parts(
    grid: LaunchGrid, scene: TraceScene, frame: LaunchFrame, antennas: F64, rng: np.random.Generator
) -> tuple[LaunchGrid, Shortfall | None]:
    """Plain lattice with finer levels, each of half the spacing, over the parts of the scene that need them.

    Every face belongs to one level by the ray spacing that it needs; rays that hit a face of another level first end
    there. So each lit piece of surface is counted once.

    Parameters
    ----------
    grid : plain lattice
    frame : its launch plane
    antennas : (n, 3) m, positions that bound the aperture
    rng : shifts the finer levels

    Returns
    -------
    lattice, and the surface for which it is too coarse (None if none)

    Notes
    -----
    Faces that need more rays than the bound allows get the finest lattice: rays that hit a facet narrower than their
    spacing are weighted for the rest of it. Diffuse power is then right on average.
    """
    need = _needs(grid.purpose, scene)
    level = _levels(need, grid.spacing)
    if not level.any():
        return grid, None
    area = outline_area(scene.triangles, antennas[len(antennas) // 2], frame)
    budget = _budget(grid.n_rays, scene)
    finest, finer = _Layout(grid, scene, frame, antennas).finest(level, area, budget, rng)
    short = _shortfall(grid, need, area, finest)
    if finest == 0:
        return grid, short
    plain = ((grid.x, grid.y), (grid.spacing, (grid.spacing * (1.0 - 1e-6), np.inf)))
    rays, levels = zip(plain, *finer, strict=True)
    return _join_levels(grid, rays, levels), short


def coarse_corners(
    grid: LaunchGrid, scene: TraceScene, frame: LaunchFrame, antennas: F64
) -> tuple[Shortfall, ...]:
    """Facets of metal corners whose double bounces need finer rays than those of a lattice; empty where none do.

    Parameters
    ----------
    grid, frame, antennas : as for :func:`add_small_parts`, with the finer levels
    """
    if grid.purpose == "diffuse" or not np.isfinite(scene.corner_needs).any():
        return ()
    need, spacing = _needs(grid.purpose, scene), np.full(scene.n_faces, grid.spacing)
    for level in grid.levels:
        spacing[(need >= level.needs[0]) & (need < level.needs[1])] = level.spacing
    under = scene.corner_needs < spacing * (1.0 - 1e-6)
    if not under.any():
        return ()
    area = outline_area(scene.triangles, antennas[len(antennas) // 2], frame)
    if area[under].sum() <= 0.0:
        return ()
    weight = area[under]
    mean = float(np.exp(np.average(np.log(spacing[under]), weights=weight)))
    needed = float(np.exp(np.average(np.log(scene.corner_needs[under]), weights=weight)))
    return (Shortfall(grid.purpose, float(weight.sum() / area.sum()), mean, needed, corners=True),)


def expected_finer_rays(
    grid: LaunchGrid, n_rays: int, scene: TraceScene, frame: LaunchFrame, antennas: F64
) -> int:
    """Estimated number of rays that :func:`add_small_parts` adds, from lattices ``SPARSE`` times as wide.

    Parameters
    ----------
    grid : plain lattice, without its rays
    n_rays : of the plain lattice
    scene, frame, antennas : as for :func:`add_small_parts`
    """
    need = _needs(grid.purpose, scene)
    level = _levels(need, grid.spacing)
    if not level.any():
        return 0
    area = outline_area(scene.triangles, antennas[len(antennas) // 2], frame)
    budget = _budget(n_rays, scene)
    layout = _Layout(grid, scene, frame, antennas, SPARSE)
    _, found = layout.finest(level, area, budget, np.random.default_rng(0))
    return int(SPARSE**2 * sum(x.size for (x, _), _ in found))


def _budget(n_rays: int, scene: TraceScene) -> float:
    """Bound on the rays of finer lattices; rays for metal corners are added, so that no other face loses rays."""
    corners = np.isfinite(scene.corner_needs).any()
    return max(MOST_RAYS, SHARE * n_rays) + (HALVED * CORNER_RAYS if corners else 0.0)


def _needs(purpose: Purpose, scene: TraceScene) -> F64:
    """Largest permitted ray spacing for one kind of return on each face, m."""
    coherent, diffuse = scene.needs
    return {"coherent": coherent, "diffuse": diffuse, "all": np.minimum(coherent, diffuse)}[purpose]


def _levels(need: F64, spacing: float) -> NDArray[np.int_]:
    """Number of halvings of the ray spacing that each face needs."""
    level = np.ceil(np.log2(spacing / np.maximum(need, 1e-9)) - 1e-6).astype(int)
    return np.asarray(np.clip(level, 0, MOST_LEVELS))


@dataclass(frozen=True, eq=False)
class _Layout:
    """Layout of finer lattices over a scene; with ``sparse`` times the spacing to estimate the number of nodes."""

    grid: LaunchGrid
    scene: TraceScene
    frame: LaunchFrame
    antennas: F64
    sparse: float = 1.0

    def finest(
        self, level: NDArray[np.int_], area: F64, budget: float, rng: np.random.Generator
    ) -> tuple[int, list[tuple[Nodes, Density]]]:
        """Finest level that keeps all finer lattices within a budget of rays, with their nodes and spacings."""
        spacing = self.grid.spacing
        shifts = deepcopy(rng).random((MOST_LEVELS + 1, 2))
        # of the levels that have faces, in turn
        turn = np.cumsum([0, 0, *(np.any(level == k) for k in range(1, MOST_LEVELS + 1))])
        coarser: dict[int, Nodes] = {}
        for finest in range(_finest(level, area, spacing, LOOSE * budget), 0, -1):
            try:
                left, laid = budget / self.sparse**2, []
                # the finest level has the most nodes; those of coarser levels do not depend on it
                for k in range(finest, 0, -1):
                    of = level >= k if k == finest else level == k
                    nodes = coarser.get(k) if k < finest else None
                    if nodes is None:
                        nodes = self._nodes(of, spacing * 2.0**-k, shifts[turn[k]], left)
                    if k < finest:
                        coarser[k] = nodes
                    left -= nodes[0].size
                    if left < 0.0:
                        raise ManyNodesError
                    step = spacing * 2.0**-k
                    needs = (0.0 if k == finest else step * (1.0 - 1e-6), 2.0 * step * (1.0 - 1e-6))
                    laid.append((nodes, (step, needs)))
            except ManyNodesError:
                continue
            rng.random((turn[finest] + 1, 2))
            return finest, [each for each in laid[::-1] if each[0][0].size]
        return 0, []

    def _nodes(self, of: NDArray[np.bool_], spacing: float, shift: F64, most: float) -> Nodes:
        """Nodes of one lattice over some of the faces, in Morton order."""
        grid, sparse = self.grid, self.sparse
        if not of.any():
            return np.zeros(0, np.float32), np.zeros(0, np.float32)
        reach = (grid.half_x + grid.taper, grid.half_y + grid.taper)
        lattice = Lattice(self.frame, sparse * spacing, grid.turn, shift * spacing)
        faces, piece = self.scene.triangles[of], self.scene.piece[of]
        within = (max(reach[0], spacing), max(reach[1], spacing))
        # of the full lattice's rows a sparse one has 1 / sparse, of its nodes 1 / sparse^2
        rows, stretches = ROWS_A_NODE * sparse, LONGEST / sparse
        x, y = nodes_over(faces, self.antennas, lattice, RIM / sparse, within, piece, most, stretches, rows)
        if not x.size and sparse == 1.0:  # smaller than the spacing: the nodes next to it
            x, y = nodes_over(faces, self.antennas, lattice, 1.0, within, piece, most)
        order = np.argsort(morton(x, y, float(np.hypot(*reach))), kind="stable")
        return x[order].astype(np.float32), y[order].astype(np.float32)


def _join_levels(
    grid: LaunchGrid,
    rays: Sequence[Nodes],
    levels: Sequence[Density],
) -> LaunchGrid:
    """Lattice of all levels that have rays: together they need one kernel launch and one grid."""
    kept = [i for i, (x, _) in enumerate(rays) if x.size] or [0]
    first = np.cumsum([0, *(rays[i][0].size for i in kept)])
    return replace(
        grid,
        x=np.concatenate([rays[i][0] for i in kept]),
        y=np.concatenate([rays[i][1] for i in kept]),
        spacing=levels[kept[0]][0],
        levels=tuple(LatticeLevel(int(start), *levels[i]) for start, i in zip(first, kept, strict=False)),
    )


def _shortfall(grid: LaunchGrid, need: F64, area: F64, finest: int) -> Shortfall | None:
    """Surface that needs more than the finest lattice, by projected area (faces turned away included)."""
    spacing = grid.spacing * 2.0**-finest
    under = need < spacing * (1.0 - 1e-6)
    weight = area[under]
    if weight.sum() <= 0.0:
        return None
    needed = float(np.exp(np.average(np.log(np.maximum(need[under], 1e-9)), weights=weight)))
    return Shortfall(grid.purpose, float(weight.sum() / area.sum()), spacing, needed)


def _finest(level: NDArray[np.int_], area: F64, spacing: float, budget: float) -> int:
    """Finest level that keeps all finer lattices together within the budget of rays."""
    for finest in range(int(level.max()), 0, -1):
        step = spacing * 2.0 ** -np.minimum(level, finest)
        fine = level > 0
        # an outline and one step around it
        rays = np.square(np.sqrt(area[fine]) / step[fine] + 1.0).sum()
        if rays <= budget:
            return finest
    return 0
