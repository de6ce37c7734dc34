"""Denser rays where a path meets, after its first reflection, a surface that its ray lattice is too coarse for.

A lattice is as dense as the facet that its rays hit *first* needs. Ground and walls are content with tubes of several
wavelengths, but behind them the same tubes meet posts, tanks and other curved or small bodies. The cells of the lattice
(squares about its rays) from which that happens are therefore divided, as a quadtree, until the tubes are as narrow as
the later hits need. A divided cell keeps its ray for the first hit; the rays of its parts serve all later ones. Parts
tile their cell exactly, so that every order of bounce is counted once.

The cells are found by rays through their middles, and by rays through points of the mirror images of such surfaces in
the large flat facets: a post narrower than a cell hides between the middles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.simulation.planning.sampling.small_parts import Shortfall
from sarmitsuba.tracing.kernel.kernel import trace
from sarmitsuba.tracing.kernel.launch import (
    LatticeLevel,
    LaunchFrame,
    LaunchGrid,
    PulseBatch,
    Serves,
    morton,
    project,
)
from sarmitsuba.tracing.kernel.state import Kernel, KernelSettings
from sarmitsuba.tracing.kernel.table_rows import FaceRow

if TYPE_CHECKING:
    from sarmitsuba.radar.antenna import Antenna
    from sarmitsuba.tracing.kernel.kernel import LaneArrays
    from sarmitsuba.tracing.kernel.scene_tables import TraceScene
    from sarmitsuba.tracing.kernel.state import Contribution, Hit, RayState

# bound on the rays that divided cells add: a number, or a share of the lattice's rays where that is larger
MOST_RAYS, SHARE = 600_000, 0.5
# finest rays behind mirrors, wavelengths, and factor on what a facet needs up to which its rays are left as they are
FINEST, ENOUGH = 1.0 / 9.0, 1.001
# growth of a tube's cross-section from which on its returns count no more: three decades of power
MOST_SPREAD = 1e3
# gains of cells that are divided together, over the largest
TOGETHER = 0.5
# rays of the first search: a lattice with fewer is searched with several rays a cell, as narrow bodies hide between
SEARCHED = 200_000
# most rays through mirror images, and their number per spacing needed; most planes that mirror, alone and in pairs, and
# points by which each is tried
MOST_IMAGES, PER_NEED = 200_000, 0.5
MOST_MIRRORS, MOST_PAIRED, PROBED = 24, 8, 200
# bits of a face's direction and distance, of one, by which faces of one plane are known
PLANE_ROUNDING = 1e-3
# rays up to which all antenna positions search, and lanes of one launch
FEW, MAX_LANES = 300_000, 4_000_000
# bounces that are followed, the same for all depths of runs so that their rays are; halvings of a cell at a time, and
# in all
DEPTH, STEP, MOST_STEPS = 4, 2, 12


def divide_cells(
    grid: LaunchGrid,
    scene: TraceScene,
    frame: LaunchFrame,
    antennas: F64,
    wavelength: float,
    max_depth: int,
    antenna: Antenna,
) -> tuple[LaunchGrid, Shortfall | None]:
    """Lattice whose cells are divided where later hits of their rays need denser ones.

    Parameters
    ----------
    grid : lattice with the finer levels over small parts
    scene : at the time of the pulses
    frame : launch plane of the lattice
    antennas : (n, 3) m, positions that bound the aperture
    wavelength : m
    max_depth : most bounces of the run
    antenna : of the radar; its pattern does not matter

    Returns
    -------
    lattice, and surfaces that are still too coarse because of the bound on rays (None if none)

    Notes
    -----
    Ignores slabs that let waves through (their reflection is followed), and bodies narrower than a cell that are met
    after three mirrors, or after small ones, where every ray of the search misses them.
    """
    need = np.maximum(scene.needs[0], FINEST * wavelength)
    if grid.purpose == "diffuse" or max_depth < 2 or not (need < grid.spacing / ENOUGH).any():
        return grid, None
    search = _Search(grid, scene, frame, antennas, wavelength, antenna)
    roots = _roots(grid)
    lacks = search.of_roots(roots)
    if not any((lack[:, 0] > ENOUGH).any() for lack in lacks):
        return grid, None
    division = _Division(grid, max(MOST_RAYS, SHARE * grid.n_rays))
    open_ = [(cells, cells.spread(lack)) for cells, lack in zip(roots, lacks, strict=True)]
    while open_:
        open_, parts = division.divide(open_)
        found = search.of_cells(parts)
        open_ += [(cells, cells.spread(lack)) for cells, lack in zip(parts, found, strict=True)]
    return division.lattice(), division.shortfall()


class _Division:
    """Cells of a lattice that are divided step by step; all steps together add at most ``left`` rays."""

    def __init__(self, grid: LaunchGrid, left: float) -> None:
        self.grid, self.left, self.short = grid, left, 0.0
        self.done: dict[Serves, list[_Cells]] = {"all": [], "first": [], "later": []}

    def divide(self, open_: Sequence[tuple[_Cells, F64]]) -> tuple[list[tuple[_Cells, F64]], list[_Cells]]:
        """Divide the cells that gain most by it; returns those that wait, and parts that may still lack rays.

        Parameters
        ----------
        open_ : cells, and what they or their neighbours lack (n, 2), see :meth:`_Search.of_cells`
        """
        short = np.concatenate([lack[lack[:, 0] > ENOUGH] for _, lack in open_])
        least = TOGETHER * float(short[:, 1].max(initial=0.0))
        now = short[:, 1] >= least
        most, count = float(short[now, 0].max(initial=0.0)), int(now.sum())
        steps = 1 if most <= 2.0 * ENOUGH else STEP
        while steps and count * 4.0**steps > self.left:
            steps -= 1
        if not steps:
            self.short = max(self.short, most)
        self.left -= count * 4.0**steps if steps else 0.0
        waiting, still = [], []
        for cells, lack in open_:
            waits = (lack[:, 0] > ENOUGH) & (lack[:, 1] < least)
            split = (lack[:, 0] > ENOUGH) & ~waits & (steps > 0) & (cells.depth < MOST_STEPS)
            waiting.append((cells.of(waits), lack[waits]))
            self.done["later" if cells.depth else "all"].append(cells.of(~split & ~waits))
            if not cells.depth:
                self.done["first"].append(cells.of(split))
            parts = cells.of(split).parts(steps, self.grid.turn)
            more = np.repeat(lack[split, 0] / 2.0**steps, 4**steps) > ENOUGH
            self.done["later"].append(parts.of(~more))
            still.append(parts.of(more))
        return [(cells, lack) for cells, lack in waiting if cells.n], [cells for cells in still if cells.n]

    def shortfall(self) -> Shortfall | None:
        """Surfaces that are still too coarse because of the bound on rays."""
        if self.short <= ENOUGH:
            return None
        spacing = min((cells.spacing for cells in self.done["later"] if cells.n), default=self.grid.spacing)
        return Shortfall(self.grid.purpose, 0.0, spacing, spacing / self.short, chains=True)

    def lattice(self) -> LaunchGrid:
        """Lattice of all cells, those of one size and kind together and in Morton order."""
        return _join_cells(self.grid, self.done)


def halve_spacing(grid: LaunchGrid) -> LaunchGrid:
    """Lattice with four rays in the cell of each: the same in all else, at half the spacing."""
    done: dict[Serves, list[_Cells]] = {"all": [], "first": [], "later": []}
    for cells in _roots(grid):
        done[grid.every_level[cells.level].serves].append(cells.parts(1, grid.turn))
    return replace(_join_cells(grid, done), spacing=0.5 * grid.spacing)


@dataclass(frozen=True)
class Draw:
    """Rays drawn of one level of a lattice, in runs of neighbours, and how finer ones take their place.

    Parameters
    ----------
    step, first, run : every ``step``-th run of ``run`` rays, from the ``first`` on
    halvings : of the spacing
    weight : of the drawn rays, one over their chance
    shift : rays by which the runs begin earlier
    only_later : without the echoes of first hits
    """

    step: int = 1
    first: int = 0
    run: int = 64
    halvings: int = 1
    weight: float = 1.0
    shift: int = 0
    only_later: bool = False


def exchange_rays(grid: LaunchGrid, draws: Mapping[int, Draw]) -> LaunchGrid:
    """Finer rays in the cells of drawn ones, and the drawn ones with a negative weight: echoes are their difference.

    Parameters
    ----------
    draws : by the number of the level; none of the rays of others
    """
    finer: dict[Serves, list[_Cells]] = {"all": [], "first": [], "later": []}
    drawn: dict[Serves, list[_Cells]] = {"all": [], "first": [], "later": []}
    levels = grid.every_level
    ends = [*(level.first for level in levels[1:]), grid.n_rays]
    for k, draw in draws.items():
        level = levels[k]
        # neighbours in memory are near in space
        runs = np.arange(draw.first, (ends[k] - level.first + draw.shift) // draw.run + 1, draw.step)
        rows = (runs[:, None] * draw.run + np.arange(draw.run) - draw.shift).ravel()
        rows = level.first + rows[(rows >= 0) & (rows < ends[k] - level.first)]
        xy = np.stack([grid.x[rows], grid.y[rows]], axis=1).astype(np.float64)
        some = _Cells(xy, np.zeros(xy.shape, dtype=np.int64), k, 0, level.spacing, level.needs)
        serves: Serves = "later" if draw.only_later else level.serves
        drawn[serves].append(some)
        parts = [some.parts(draw.halvings, grid.turn)]
        if draw.step == 1 and not grid.taper:
            parts.append(_find_rim(grid, some).parts(draw.halvings, grid.turn))
            inside = [cells.inside(grid) for cells in parts]
            # none in a window smaller than a cell, which has one ray
            parts = inside if any(cells.n for cells in inside) else parts[:1]
        finer[serves] += parts
    if not any(cells.n for every in drawn.values() for cells in every):
        return replace(grid, x=grid.x[:0], y=grid.y[:0], levels=())
    more, less = (
        _join_cells(_weigh_levels(grid, draws, sign), cells) for sign, cells in ((1.0, finer), (-1.0, drawn))
    )
    moved = tuple(replace(level, first=level.first + more.n_rays) for level in less.levels)
    return replace(
        grid, x=np.append(more.x, less.x), y=np.append(more.y, less.y), levels=(*more.levels, *moved)
    )


def _find_rim(grid: LaunchGrid, cells: _Cells) -> _Cells:
    """Cells beside those given whose middles lie outside the window, where no ray starts: parts of them lie inside.

    Without a taper the window ends with the lit body: parts of the cells at its rim miss the body, and those of the
    cells beside them hit it.
    """
    axes = cells.spacing * _turned_axes(grid.turn)
    places = np.rint((cells.xy - cells.xy[:1]) @ np.linalg.inv(axes)).astype(np.int64)
    around = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], indexing="ij"), axis=-1).reshape(-1, 2)
    every = np.unique((places[:, None] + around).reshape(-1, 2), axis=0)
    beside = replace(cells, xy=cells.xy[:1] + every @ axes, ij=np.zeros(every.shape, dtype=np.int64))
    return beside.of(~beside.are_inside(grid))


def _turned_axes(turn: float) -> F64:
    """Unit vectors of the rows and of the columns of a turned lattice, (2, 2)."""
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, s], [-s, c]])


def _weigh_levels(grid: LaunchGrid, draws: Mapping[int, Draw], sign: float) -> LaunchGrid:
    """Lattice whose drawn levels have the weights of their draws times a sign."""
    levels = (
        replace(level, weight=sign * draws[k].weight) if k in draws else level
        for k, level in enumerate(grid.every_level)
    )
    return replace(grid, levels=tuple(levels))


@dataclass(frozen=True, eq=False)
class _Cells:
    """Square cells of one size about rays.

    Parameters
    ----------
    xy : (n, 2) float64, m, middles in the launch plane
    ij : (n, 2) int64, row and column in the lattice of this size
    level : number of the lattice level that they belong to, with its ``needs``
    depth : halvings of that level's spacing
    spacing : m, edge
    needs : see :class:`LatticeLevel`
    """

    xy: F64
    ij: I64
    level: int
    depth: int
    spacing: float
    needs: tuple[float, float]

    @property
    def n(self) -> int:
        """Number of cells."""
        return len(self.xy)

    def of(self, kept: NDArray[np.bool_]) -> _Cells:
        """Some of the cells."""
        return replace(self, xy=self.xy[kept], ij=self.ij[kept])

    def are_inside(self, grid: LaunchGrid) -> NDArray[np.bool_]:
        """Whether the middle (n,) of each cell lies in the window of a lattice."""
        half = np.array([grid.half_x, grid.half_y]) + grid.taper
        return np.asarray((np.abs(self.xy) <= half).all(axis=1))

    def inside(self, grid: LaunchGrid) -> _Cells:
        """The cells whose middles lie in the window of a lattice."""
        return self.of(self.are_inside(grid))

    def parts(self, steps: int, turn: float) -> _Cells:
        """Parts of all cells, halved ``steps`` times along both axes, cell by cell."""
        m = 2**steps
        index = np.stack(np.meshgrid(np.arange(m), np.arange(m), indexing="ij"), axis=-1).reshape(-1, 2)
        offset = ((index + 0.5) / m - 0.5) * self.spacing @ _turned_axes(turn)
        xy = (self.xy[:, None] + offset).reshape(-1, 2)
        ij = (m * self.ij[:, None] + index).reshape(-1, 2)
        return _Cells(xy, ij, self.level, self.depth + steps, self.spacing / m, self.needs)

    def holding(self, points: F64, turn: float) -> I64:
        """Number (n,) of the cell that holds each point (n, 2); -1 for none."""
        if not self.n or not len(points):
            return np.full(len(points), -1, dtype=np.int64)
        c, s = np.cos(turn), np.sin(turn)
        steps = (points - self.xy[0]) @ np.array([[c, -s], [s, c]]) / self.spacing
        wanted = np.rint(steps).astype(np.int64) + self.ij[0]
        low, high = self.ij.min(axis=0), self.ij.max(axis=0)
        columns = int(high[1] - low[1]) + 1
        key = (self.ij[:, 0] - low[0]) * columns + self.ij[:, 1] - low[1]
        order = np.argsort(key, kind="stable")
        known = key[order]
        own = (wanted[:, 0] - low[0]) * columns + wanted[:, 1] - low[1]
        place = np.minimum(np.searchsorted(known, own), known.size - 1)
        there = (known[place] == own) & ((wanted >= low) & (wanted <= high)).all(axis=1)
        return np.where(there, order[place], -1)

    def spread(self, lack: F64) -> F64:
        """Largest lack (n, 2) of each cell and its eight neighbours."""
        out = lack.copy()
        marked = np.flatnonzero(lack[:, 0] > ENOUGH)
        if not marked.size:
            return out
        low = self.ij.min(axis=0) - 1
        columns = int(self.ij[:, 1].max() - low[1]) + 2
        key = (self.ij[:, 0] - low[0]) * columns + self.ij[:, 1] - low[1]
        order = np.argsort(key, kind="stable")
        known = key[order]
        for step in (i * columns + j for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j):
            wanted = key[marked] + step
            place = np.minimum(np.searchsorted(known, wanted), known.size - 1)
            there = known[place] == wanted
            np.maximum.at(out, order[place[there]], lack[marked[there]])
        return out


def _roots(grid: LaunchGrid) -> list[_Cells]:
    """Cells of every level of a lattice."""
    c, s = np.cos(grid.turn), np.sin(grid.turn)
    xy = np.stack([grid.x, grid.y], axis=1).astype(np.float64)
    number, found = grid.level, []
    for k, level in enumerate(grid.every_level):
        own = xy[number == k]
        if not len(own):
            continue
        ij = np.rint((own - own[0]) @ np.array([[c, -s], [s, c]]) / level.spacing).astype(np.int64)
        found.append(_Cells(own, ij, k, 0, level.spacing, level.needs))
    return found


def _join_cells(grid: LaunchGrid, done: Mapping[Serves, Sequence[_Cells]]) -> LaunchGrid:
    """Lattice of cells by the bounces that they serve, those of one size and kind together and in Morton order."""
    radius = float(np.hypot(grid.half_x + grid.taper, grid.half_y + grid.taper)) + grid.spacing
    xy, levels, first = [], [], 0
    for serves, every in done.items():
        for level, depth in sorted({(cells.level, cells.depth) for cells in every if cells.n}):
            alike = [c for c in every if (c.level, c.depth) == (level, depth)]
            points = np.concatenate([c.xy for c in alike])
            points = points[np.argsort(morton(points[:, 0], points[:, 1], radius), kind="stable")]
            weight = grid.every_level[level].weight
            levels.append(LatticeLevel(first, alike[0].spacing, alike[0].needs, serves, weight))
            xy.append(points.astype(np.float32))
            first += len(points)
    x, y = np.ascontiguousarray(np.concatenate(xy).T)
    return replace(grid, x=x, y=y, levels=tuple(levels))


@dataclass(frozen=True, eq=False)
class _Search:
    """Tracing of cells from bounding antenna positions: how much too wide their tubes are at later hits."""

    grid: LaunchGrid
    scene: TraceScene
    frame: LaunchFrame
    antennas: F64
    wavelength: float
    antenna: Antenna
    # points of mirror images by level, (n, 2) m, and the lack there per spacing, 1/m
    images: dict[int, tuple[F64, F64]] = field(default_factory=dict)

    def of_roots(self, roots: list[_Cells]) -> list[F64]:
        """As :meth:`of_cells`, with several rays a cell where there are few cells, and rays through mirror images."""
        n, steps = sum(cells.n for cells in roots), 0
        finest = FINEST * self.wavelength
        while n * 4 ** (steps + 1) <= SEARCHED and self.grid.spacing * 2.0 ** -(steps + 1) >= finest:
            steps += 1
        points = _mirrored_points(self.scene, self.grid, self.frame, self.antennas, finest)
        for cells in roots:
            inside = points[cells.holding(points, self.grid.turn) >= 0]
            if len(inside):
                self.images[cells.level] = inside, self._lack(inside, cells, self.antennas) / cells.spacing
        if not steps:
            return self.of_cells(roots)
        parts = self.of_cells([cells.parts(steps, self.grid.turn) for cells in roots])
        return [2.0**steps * lack.reshape(-1, 4**steps, 2).max(axis=1) for lack in parts]

    def of_cells(self, groups: list[_Cells]) -> list[F64]:
        """Largest width of each cell's tube at hits after the first, over the width that the facet needs; (n, 2) each.

        The second column is that ratio over the growth of the tube's cross-section: what spread tubes lack
        matters as much less as their returns are weaker. Many cells are searched from the middle position alone.
        """
        views = self.antennas
        if sum(cells.n for cells in groups) > FEW:
            views = views[len(views) // 2][None]
        found = []
        for cells in groups:
            step = MAX_LANES // len(views)
            rows = [self._lack(cells.xy[i : i + step], cells, views) for i in range(0, cells.n, step)]
            lack = np.concatenate(rows) if rows else np.zeros((0, 2))
            if cells.level in self.images:
                points, per_spacing = self.images[cells.level]
                owner = cells.holding(points, self.grid.turn)
                np.maximum.at(lack, owner[owner >= 0], cells.spacing * per_spacing[owner >= 0])
            found.append(lack)
        return found

    def _lack(self, xy: F64, cells: _Cells, views: F64) -> F64:
        x, y = np.ascontiguousarray(xy.T.astype(np.float32))
        level = LatticeLevel(0, cells.spacing, cells.needs)
        grid = replace(self.grid, x=x, y=y, spacing=cells.spacing, levels=(level,), pulses=None)
        settings = KernelSettings(self.wavelength, DEPTH, 1.0, 0, 1.0, 1.0)
        batch = PulseBatch(views, np.zeros_like(views), self.frame)
        kernel = Kernel.of(self.scene, grid, batch, _GEOMETRY, settings)
        finder = _LaterHits(self.scene, FINEST * self.wavelength)
        _, (lack, gain, _) = trace(kernel, self.antenna, finder)
        dr.eval(lack, gain)
        of_view = [np.asarray(a.numpy(), dtype=np.float64).reshape(len(views), -1) for a in (lack, gain)]
        return np.stack([a.max(axis=0) for a in of_view], axis=1)


@dataclass(frozen=True, eq=False)
class _Mirrors:
    """Largest planes of flat facets.

    Parameters
    ----------
    unit, distance : (n, 3) normals and (n,) m, distances from the origin
    low, high : (n, 3) m, bounds of the facets in each
    """

    unit: F64
    distance: F64
    low: F64
    high: F64

    @staticmethod
    def of(corners: F64, extent: float, margin: float) -> _Mirrors:
        """The ``MOST_MIRRORS`` largest planes of faces (n, 3, 3), m.

        Parameters
        ----------
        extent : m, of the scene
        margin : m, by which bounds are wider
        """
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(normal, axis=1)
        corners, unit, size = corners[size > 0.0], normal[size > 0.0], size[size > 0.0]
        unit = unit / size[:, None]
        unit *= np.where(unit @ np.array([1e-3, 2e-3, 1.0]) < 0.0, -1.0, 1.0)[
            :, None
        ]  # either side is one plane
        distance = np.einsum("ij,ij->i", unit, corners[:, 0])
        plane = np.rint(np.column_stack([unit, distance / max(extent, 1.0)]) / PLANE_ROUNDING)
        _, first, number = np.unique(plane, axis=0, return_index=True, return_inverse=True)
        number = number.ravel()
        largest = np.argsort(-np.bincount(number, weights=size), kind="stable")[:MOST_MIRRORS]
        boxes = [corners[number == k].reshape(-1, 3) for k in largest]
        low, high = (np.array([f(box, axis=0) for box in boxes]).reshape(-1, 3) for f in (np.min, np.max))
        return _Mirrors(unit[first[largest]], distance[first[largest]], low - margin, high + margin)

    def image(self, k: int, points: F64) -> F64:
        """Mirror images of points (n, 3) in a plane."""
        return np.asarray(points - 2.0 * (points @ self.unit[k] - self.distance[k])[:, None] * self.unit[k])

    def seen(self, chain: tuple[int, ...], antenna: F64, points: F64) -> F64:
        """Images (m, 3) of the points (n, 3) that the antenna sees in a chain of mirrors, the first mirror first.

        Facets of a plane count as far as their bounds; bodies before them do not count.
        """
        images = [antenna[None]]
        for k in chain[:-1]:
            images.append(self.image(k, images[-1]))
        for k, place in zip(chain[::-1], images[::-1], strict=True):
            height, own = points @ self.unit[k] - self.distance[k], place[0] @ self.unit[k] - self.distance[k]
            points, height = points[height * own > 0.0], height[height * own > 0.0]
            points = self.image(k, points)
            met = place + (points - place) * (own / (own + height))[:, None]
            points = points[((met >= self.low[k]) & (met <= self.high[k])).all(axis=1)]
        return points


def _mirrored_points(
    scene: TraceScene, grid: LaunchGrid, frame: LaunchFrame, antennas: F64, finest: float
) -> F64:
    """Points (n, 2) of a launch plane in the mirror images of faces that need denser rays than a lattice has.

    Mirrors are the largest planes of faces that need none, and pairs of the ``MOST_PAIRED`` largest. Points lie evenly
    on each face, ``PER_NEED`` to the spacing that it needs, and fewer where they would be more than ``MOST_IMAGES``.

    Parameters
    ----------
    finest : m, spacing below which no face needs denser rays
    """
    need = np.maximum(scene.needs[0], finest)
    fine = need < grid.spacing / ENOUGH
    faces, antenna = scene.triangles[fine], antennas[len(antennas) // 2]
    mirrors = _Mirrors.of(scene.triangles[~fine], float(np.abs(scene.bounds).max()), grid.spacing)
    n = len(mirrors.unit)
    chains: list[tuple[int, ...]] = [(k,) for k in range(n)]
    chains += [(a, b) for a in range(min(n, MOST_PAIRED)) for b in range(min(n, MOST_PAIRED)) if a != b]
    middle = faces.mean(axis=1)[:: max(1, len(faces) // PROBED)]
    chains = [chain for chain in chains if len(mirrors.seen(chain, antenna, middle))]
    if not chains or not len(faces):
        return np.zeros((0, 2))
    area = 0.5 * np.linalg.norm(np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]), axis=1)
    wanted = area * np.square(PER_NEED / need[fine])
    share = min(1.0, MOST_IMAGES / (len(chains) * float(np.maximum(wanted, 1.0).sum())))
    count = np.maximum(np.rint(share * wanted), 1.0 if share == 1.0 else 0.0).astype(int)
    points = _spread_over(faces, count)
    xy = np.concatenate([project(mirrors.seen(chain, antenna, points), antenna, frame) for chain in chains])
    reach = np.array([grid.half_x + grid.taper, grid.half_y + grid.taper])
    return np.asarray(xy[(np.abs(xy) <= reach).all(axis=1)])


def _spread_over(faces: F64, count: NDArray[np.int_]) -> F64:
    """Points (count.sum(), 3) spread evenly over triangles (n, 3, 3), by an R2 sequence folded into each."""
    owner = np.repeat(np.arange(len(faces)), count)
    turn = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count) + 1.0
    a, b = (0.5 + turn * 0.7548776662466927) % 1.0, (0.5 + turn * 0.5698402909980532) % 1.0
    over = a + b > 1.0
    a, b = (np.where(over, 1.0 - x, x)[:, None] for x in (a, b))
    return np.asarray((1.0 - a - b) * faces[owner, 0] + a * faces[owner, 1] + b * faces[owner, 2])


# paths alone: no returns, every surface a mirror
_GEOMETRY = KernelFlags(
    channels=("HH",),
    fresnel=False,
    roughness=False,
    coherent=False,
    diffuse=False,
    diffuse_double=False,
    speckle=False,
    depolarisation=False,
    polarised_diffuse=False,
    antenna_pattern=False,
    spreading=False,
    tube_phase=False,
    taper=False,
)


class _LaterHits:
    """Accumulator and follower that keeps, for each ray, how much too wide its tube is at hits after the first.

    The second number is the same over the growth of the tube's cross-section since the first hit, the third is that
    section there.
    """

    def __init__(self, scene: TraceScene, finest: float) -> None:
        self.scene, self.finest = scene, finest

    def begin(self) -> LaneArrays:
        """No lack so far."""
        return mi.Float(0.0), mi.Float(0.0), mi.Float(0.0)

    def visit(self, state: LaneArrays, ray: RayState, hit: Hit) -> tuple[LaneArrays, mi.UInt32 | None]:
        """Compare the tube's width with the need of the facet, where the antenna sees the hit."""
        need, _ = FaceRow.of(self.scene.face_info, hit.face, hit.active).needed_spacings
        a, b = ray.edge_a, ray.edge_b
        if ray.spread is not None:
            path = mi.Float(hit.length - ray.spread.start)
            a, b = a + ray.spread.a * path, b + ray.spread.b * path
        section = dr.norm(dr.cross(a, b))
        first = dr.select(hit.active & hit.first, section, state[2])
        growth = dr.maximum(section / dr.maximum(first, 1e-30), 1.0)
        lack = dr.maximum(dr.norm(a), dr.norm(b)) / dr.maximum(need, dr.opaque(mi.Float, self.finest))
        counts = hit.active & ~hit.first & hit.sees & (growth < MOST_SPREAD)
        found = dr.maximum(state[0], lack), dr.maximum(state[1], lack / growth)
        most, gain = (dr.select(counts, new, old) for new, old in zip(found, state, strict=False))
        return (most, gain, first), ray.trail

    def add(self, state: LaneArrays, contribution: Contribution) -> LaneArrays:
        """No returns are recorded."""
        return state
