"""Sums of echoes by group of paths: by the shape and material that they belong to, and by the kind of their bounces.

A path belongs to the last shape on it that is not ground, from the antenna to the facet where it turns back, and to the
ground where it meets nothing else: of the two directions of a path over two shapes each belongs to another one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, U32
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.kernel.accumulators import ImageAccumulator, grid_cells, grid_numbers
from sarmitsuba.tracing.kernel.device_arrays import device_array
from sarmitsuba.tracing.kernel.scene_tables import MATERIAL_MASK
from sarmitsuba.tracing.kernel.state import COHERENT, NO_HIT, SCATTERER

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from sarmitsuba.signal.look_grid import LookGrid
    from sarmitsuba.tracing.kernel.source import Launch
    from sarmitsuba.tracing.kernel.state import Contribution, Hit, RayState

    GroupState = tuple[mi.UInt32, mi.Float, mi.Float, mi.UInt32]

# kinds of echoes, by number; of the last five the launch decides
MECHANISMS = (
    "single bounce",
    "diffuse",
    "wall and ground",
    "double bounce",
    "triple bounce",
    "multiple bounces",
    "diffuse after mirror",
    "volume",
    "edge",
    "wire",
    "diffuse pair",
    "scatterer",
    "point",
)
SINGLE, DIFFUSE_ONCE, WALL_GROUND, DOUBLE, TRIPLE, MULTIPLE, DIFFUSE_MIRRORED = range(7)
# those whose amplitudes are random numbers of the scene's seed
RANDOM = tuple(
    MECHANISMS.index(name) for name in ("diffuse", "diffuse after mirror", "volume", "diffuse pair")
)
# bits of a trail: owner and one, then what the path met
_OWNER, _LEVEL, _UPRIGHT, _ONLY_GROUND = (1 << 20) - 1, 1 << 20, 1 << 21, 1 << 22
MOST_OWNERS = _OWNER - 1
# of the owner table: the owner is ground
IS_GROUND = 1 << 31
# cosine of the largest angle between the normal of a level facet and the vertical; of an upright one the sine
_ALIGNED = float(np.cos(np.radians(30.0)))
_NONE = 0xFFFFFFFF


@dataclass(frozen=True, eq=False)
class PathOwners:
    """Owners of echoes: a shape and a material.

    Parameters
    ----------
    of_row : (n_rows n_materials,) uint32, owner by row of the scene's tables and material, with ``IS_GROUND``
    n_materials : of the tables; 1 where every row has one material
    n : number of owners
    of_launch : function from a launch of scatterers to the number of its mechanism and the owner of each scatterer
    """

    of_row: U32
    n_materials: int
    n: int
    of_launch: Callable[[Launch], tuple[int, U32]]

    @property
    def n_groups(self) -> int:
        """Number of groups: an owner and a mechanism each."""
        return self.n * len(MECHANISMS)


class GroupAccumulator(ImageAccumulator):
    """Accumulator of looks that follows every ray and tells the group of every echo; a ``Follower``.

    Parameters
    ----------
    grid, n_slots, n_channels, max_order, wavelength : as for :class:`ImageAccumulator`
    owners : of the echoes
    """

    def __init__(
        self,
        grid: LookGrid,
        n_slots: int,
        n_channels: int,
        max_order: int,
        wavelength: float,
        owners: PathOwners,
    ) -> None:
        super().__init__(grid, n_slots, n_channels, max_order, wavelength)
        self.owners = owners
        self.of_row = device_array(mi.UInt32, owners.of_row)
        self.mechanism: mi.UInt32 | None = None
        self.lanes: tuple[mi.UInt32, int, int] | None = None

    def before(self, launch: Launch, n_pulses: int) -> None:
        """Owners of the scatterers of a launch; rays find theirs by the facets that they meet."""
        if launch.part.rays:
            self.mechanism = self.lanes = None
            return
        mechanism, owner = self.owners.of_launch(launch)
        self.mechanism = dr.opaque(mi.UInt32, mechanism)
        self.lanes = (device_array(mi.UInt32, owner), launch.part.count, n_pulses)

    def begin(self) -> GroupState:  # type: ignore[override]
        """Counts of this lane, and its trail."""
        trail = mi.UInt32(NO_HIT)
        if self.lanes is not None:
            table, count, n_pulses = self.lanes
            lane = dr.arange(mi.UInt32, count * n_pulses)
            trail = dr.gather(mi.UInt32, table, lane % dr.opaque(mi.UInt32, count)) + 1
        return (*super().begin(), trail)

    def visit(self, state: GroupState, ray: RayState, hit: Hit) -> tuple[GroupState, mi.UInt32]:
        """Owner of the path up to a hit; see :class:`sarmitsuba.tracing.kernel.kernel.Follower`."""
        u32 = mi.UInt32
        assert ray.trail is not None
        before = dr.select(ray.trail == NO_HIT, u32(0), ray.trail)
        # one material a row stands for all
        n = dr.opaque(u32, self.owners.n_materials)
        number = hit.face * n + dr.minimum(hit.material & MATERIAL_MASK, n - 1)
        word = dr.gather(u32, self.of_row, number, hit.active)
        ground = (word & IS_GROUND) != 0
        here = (word & _OWNER) + 1
        stays = ground & ((before & _OWNER) != 0) & ((before & _ONLY_GROUND) == 0)
        owner = dr.select(stays, before & _OWNER, here)
        met = before & (_LEVEL | _UPRIGHT)
        up = hit.normal.z
        met = met | dr.select(ground | (up > _ALIGNED), u32(_LEVEL), u32(0))
        upright = ~ground & (dr.square(up) < 1.0 - _ALIGNED**2)
        met = met | dr.select(upright, u32(_UPRIGHT), u32(0))
        met = met | dr.select(ground & ~stays, u32(_ONLY_GROUND), u32(0))
        trail = owner | met
        return (*state[:3], trail), trail

    def group(self, contribution: Contribution, trail: mi.UInt32) -> mi.UInt32:
        """Number of the group of an echo."""
        u32, kind, order = mi.UInt32, contribution.kind, contribution.order
        both = ((trail & _LEVEL) != 0) & ((trail & _UPRIGHT) != 0)
        two = dr.select(both, u32(WALL_GROUND), u32(DOUBLE))
        more = dr.select(order == 3, u32(TRIPLE), u32(MULTIPLE))
        bounces = dr.select(order == 1, u32(SINGLE), dr.select(order == 2, two, more))
        diffuse = dr.select(order == 1, u32(DIFFUSE_ONCE), u32(DIFFUSE_MIRRORED))
        mechanism = dr.select(kind == COHERENT, bounces, diffuse)
        if self.mechanism is not None:
            mechanism = dr.select(kind == SCATTERER, self.mechanism, mechanism)
        return ((trail & _OWNER) - 1) * len(MECHANISMS) + mechanism


@dataclass(frozen=True)
class Tiling:
    """Square tiles of a grid, each with the cells beyond it into which its echoes are spread.

    Parameters
    ----------
    n_range, n_azimuth : cells of the grid
    edge : cells, a power of two
    width : of the gridding kernel
    """

    n_range: int
    n_azimuth: int
    edge: int
    width: int

    @property
    def shape(self) -> tuple[int, int]:
        """Number of tiles in range and azimuth."""
        return -(-self.n_range // self.edge), -(-self.n_azimuth // self.edge)

    @property
    def n(self) -> int:
        """Number of tiles."""
        return self.shape[0] * self.shape[1]

    @property
    def padded(self) -> int:
        """Cells along the edge of a tile's memory."""
        return self.edge + self.width - 1

    def number(self, ix: mi.UInt32, iy: mi.UInt32) -> mi.UInt32:
        """Tile of a first cell."""
        edge = dr.opaque(mi.UInt32, self.edge)
        return (ix // edge) * dr.opaque(mi.UInt32, self.shape[1]) + iy // edge


class MarkingPowers(GroupAccumulator):
    """Mean powers of random echoes on a grid of half the cells, and the tiles in which each group has echoes.

    Powers are sums of squares of amplitudes; slots are the mechanisms ``RANDOM`` that are wanted.

    Parameters
    ----------
    grid : for the powers
    coarse : grid of the tiles; None: none are marked
    tiling : of it
    owners, n_channels : as for :class:`GroupAccumulator`
    slots : mechanisms whose powers are wanted; one at least
    """

    def __init__(
        self,
        grid: LookGrid,
        coarse: LookGrid,
        tiling: Tiling | None,
        owners: PathOwners,
        n_channels: int,
        slots: Sequence[int],
    ) -> None:
        # powers have no phase: the wavelength is infinite
        super().__init__(grid, len(slots), n_channels, 0, np.inf, owners)
        self.coarse, self.tiling = coarse, tiling
        number = np.full(len(MECHANISMS), _NONE, dtype=np.uint32)
        number[list(slots)] = np.arange(len(slots))
        self.slot_of = device_array(mi.UInt32, number)
        self.marks = dr.zeros(mi.UInt32, 1 if tiling is None else owners.n_groups * tiling.n)

    @property
    def written(self) -> Sequence[mi.Float]:
        """Arrays to which a launch writes."""
        return [self.memory, self.marks]

    def look_weight(self, share: mi.Float) -> mi.Float:
        """Two neighbouring looks see the same scatterer: their powers, not their amplitudes, add up to its power."""
        return dr.sqrt(share)

    def add(self, state: GroupState, contribution: Contribution) -> GroupState:  # type: ignore[override]
        """Mark the tile of an echo, and spread its power if it is random."""
        group = self.group(contribution, state[3])
        placed, offset, (x, y) = self.placed(contribution)
        if self.tiling is not None:
            # cells of half the size have the same origin
            kernel = self.coarse.kernel
            ix, _, in_x = grid_cells(0.5 * x, kernel, self.coarse.n_range)
            iy, _, in_y = grid_cells(0.5 * y, kernel, self.coarse.n_azimuth)
            tile = group * dr.opaque(mi.UInt32, self.tiling.n) + self.tiling.number(ix, iy)
            dr.scatter(self.marks, mi.UInt32(1), tile, placed.active & in_x & in_y)
        slot = dr.gather(mi.UInt32, self.slot_of, group % len(MECHANISMS), placed.active)
        squares = tuple(mi.Complex2f(dr.squared_norm(a), 0.0) for a in placed.amplitudes)
        power = replace(placed, amplitudes=squares, active=placed.active & (slot != _NONE))
        self.spread(power, offset, (x, y), (self.look.kernel, self.look.kernel), slot)
        return (*self.counted(state[:3], contribution, mi.Bool(False)), state[3])


class GroupSums(GroupAccumulator):
    """Complex sums of the echoes of groups, in those tiles only in which a group has any.

    Parameters
    ----------
    grid, n_channels, wavelength, owners : as for :class:`GroupAccumulator`
    tiling : of the grid
    wanted : (n,) numbers of the tiles of groups (group after group) that have memory
    """

    def __init__(
        self,
        grid: LookGrid,
        n_channels: int,
        wavelength: float,
        owners: PathOwners,
        tiling: Tiling,
        wanted: NDArray[np.integer],
    ) -> None:
        super().__init__(grid, 1, n_channels, 0, wavelength, owners)
        self.tiling, self.wanted = tiling, wanted
        cells = (len(wanted), tiling.padded, tiling.padded)
        self.memory = dr.zeros(mi.Float64, grid_numbers(cells, n_channels))
        slot = np.full(owners.n_groups * tiling.n, _NONE, dtype=np.uint32)
        slot[wanted] = np.arange(len(wanted))
        self.slots = device_array(mi.UInt32, slot)

    def add(self, state: GroupState, contribution: Contribution) -> GroupState:  # type: ignore[override]
        """Spread on the tile of the echo's group."""
        group = self.group(contribution, state[3])
        placed, offset, cells = self.placed(contribution)
        self.spread(placed, offset, cells, (self.look.kernel, self.look.kernel), group)
        return (*self.counted(state[:3], contribution, mi.Bool(False)), state[3])

    def first_cell(
        self, slot: mi.UInt32, ix: mi.UInt32, iy: mi.UInt32, inside: mi.Bool
    ) -> tuple[mi.UInt32, mi.UInt32, mi.Bool]:
        """See :class:`sarmitsuba.tracing.kernel.accumulators.GridAccumulator`; ``slot`` is the group."""
        u32, tiling = mi.UInt32, self.tiling
        number = slot * dr.opaque(u32, tiling.n) + tiling.number(ix, iy)
        entry = dr.gather(u32, self.slots, number, inside)
        edge, padded = dr.opaque(u32, tiling.edge), dr.opaque(u32, tiling.padded)
        place = (entry * padded + ix % edge) * padded + iy % edge
        return place, padded, inside & (entry != _NONE)

    def tiles(self) -> C64:
        """(n, n_channels, edge, edge) complex64, the tiles in the order wanted, after the launches."""
        n, edge = len(self.wanted), self.tiling.padded
        used = self.memory.numpy()[: 2 * self.padded * n * edge * edge].view(np.complex128)
        cells = used.reshape(n, edge, edge, self.padded)[..., : self.n_channels]
        return np.asarray(np.moveaxis(cells, -1, 1), dtype=np.complex64)
