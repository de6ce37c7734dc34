"""Finer ray lattices over parts of a scene for which the plain lattice is too coarse."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F32, F64
from sarmitsuba.core.units import db_from_amplitude
from sarmitsuba.scene.mesh.metal_corners import MOST_RAYS as CORNER_RAYS
from sarmitsuba.simulation.planning.sampling.small_lattice import (
    LONGEST,
    RIM,
    ROWS_A_NODE,
    Lattice,
    ManyNodesError,
    nodes_over,
    outline_area,
)
from sarmitsuba.tracing.kernel.launch import LatticeLevel, LaunchFrame, LaunchGrid, Purpose, morton
from sarmitsuba.tracing.kernel.scene_tables import TraceScene

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
    """Bound on the rays of finer lattices; rays for metal corners are added, so that no other face loses its own."""
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
