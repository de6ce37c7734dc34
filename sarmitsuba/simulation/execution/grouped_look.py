"""Echoes of a look in groups of paths, whose images add up to that of method ``image``."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F32, F64, I64
from sarmitsuba.scene.scatterers import targets_by_kind
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing.look import adjoint_cells, form_image
from sarmitsuba.signal.focusing.look_parts import GridPart, PartImages, PowerResponse
from sarmitsuba.signal.sub_bands import RangeFilter
from sarmitsuba.simulation.execution.image import Imager
from sarmitsuba.simulation.execution.tracing import MAX_GRID_BYTES
from sarmitsuba.tracing.kernel.launch import LaunchGrid
from sarmitsuba.tracing.kernel.path_groups import (
    MECHANISMS,
    RANDOM,
    GroupSums,
    MarkingPowers,
    PathOwners,
    Tiling,
)
from sarmitsuba.tracing.kernel.source import DrawnSource, Launch
from sarmitsuba.tracing.kernel.state import RANDOM_TERMS

# entries of the table of tiles by group, at most; larger tiles beyond
MOST_ENTRIES = 1 << 24
SMALLEST_TILE = 16
POINT = MECHANISMS.index("point")


@dataclass(frozen=True, eq=False)
class EchoBlocks:
    """Sums of echoes in square parts of the looks' grid, at one frequency.

    Parameters
    ----------
    group : (n,) number of the group, increasing
    row, column : (n,) first cell in range and azimuth
    values : (n, n_channels, edge, edge) complex64
    share : of the band
    """

    group: I64
    row: I64
    column: I64
    values: C64
    share: RangeFilter | None

    def of(self, wanted: NDArray[np.bool_]) -> Iterator[tuple[slice, slice, C64]]:
        """Rows, columns and values of the blocks of wanted groups (n_groups,)."""
        edge = self.values.shape[-1]
        for i in np.flatnonzero(wanted[self.group]).tolist():
            row, column = int(self.row[i]), int(self.column[i])
            yield slice(row, row + edge), slice(column, column + edge), self.values[i]


class GroupedLook:
    """Traced look, its echoes in groups.

    Parameters
    ----------
    imager : of method ``image``
    owners : of the echoes
    point_owner : owner of each ideal point of the run

    Attributes
    ----------
    blocks : sums of echoes
    powers : mean power of each random mechanism that occurs, (n_channels, n_azimuth, n_range) float32, m^2

    Notes
    -----
    Rays are traced once for each independent random number of diffuse scatterers (one, or three with depolarisation or
    volumes) and random mechanism held at once, for the tiles of groups and the mean powers; and then once for every
    ``MAX_GRID_BYTES`` of sums.
    """

    def __init__(self, imager: Imager, owners: PathOwners, point_owner: I64) -> None:
        self.imager, self.owners, self.look = imager, owners, imager.look
        self.radar = imager.run.scene.radar
        self.parts = PartImages(self.look)
        self.blocks: list[EchoBlocks] = []
        self.powers: dict[int, F32] = {}
        if imager.sampling is not None:
            self._trace()
        if imager.run.scene.points:
            self._add_points(point_owner)

    @property
    def channels(self) -> tuple[str, ...]:
        """Polarisation channels."""
        return self.radar.channels

    def _trace(self) -> None:
        grid, flags, run = self.look.grid, self.imager.run.plan.flags, self.imager.run
        edge = SMALLEST_TILE
        while (
            self.owners.n_groups * Tiling(grid.n_range, grid.n_azimuth, edge, grid.width).n > MOST_ENTRIES
            and edge < grid.n_range + grid.n_azimuth
        ):
            edge *= 2
        tiling = Tiling(grid.n_range, grid.n_azimuth, edge, grid.width)
        (rays,) = self.imager.rays(0)
        response = PowerResponse(self.look)
        n_channels, fine = len(self.channels), response.grid
        present = self._random_mechanisms()
        each = 16 * fine.n_range * fine.n_azimuth * (1 << (n_channels - 1).bit_length())
        together = max(1, int(MAX_GRID_BYTES // each))
        terms = RANDOM_TERMS if flags.depolarisation or _random_kinds(run.scene) else 1
        marked = np.zeros(self.owners.n_groups * tiling.n, dtype=bool)
        groups_of_slots = [present[i : i + together] for i in range(0, len(present), together)] or [()]
        for slots in groups_of_slots:
            total = np.zeros((len(slots) * n_channels, fine.n_range, fine.n_azimuth), dtype=np.float32)
            for term in range(terms if slots else 1):
                marks = tiling if term == 0 and slots == groups_of_slots[0] else None

                def empty(marks: Tiling | None = marks, slots: tuple[int, ...] = slots) -> MarkingPowers:
                    return MarkingPowers(
                        fine, self.look.grid, marks, self.owners, n_channels, slots or (RANDOM[0],)
                    )

                done = list(self.imager.launched(rays, empty, term, _first_term_of_drawn(term)))
                for accumulator, _ in done:
                    if slots:
                        total += accumulator.grid().real / len(done)
                    if marks is not None:
                        marked |= accumulator.marks.numpy()[: marked.size] > 0
            for i, mechanism in enumerate(slots):
                power = total[i * n_channels : (i + 1) * n_channels]
                if power.any():
                    self.powers[mechanism] = response.image(power)
        self._sum(rays, tiling, np.flatnonzero(marked))

    def _random_mechanisms(self) -> tuple[int, ...]:
        """Mechanisms of random echoes that the run may have."""
        plan, scene = self.imager.run.plan, self.imager.run.scene
        drawn = [source.mechanism for source in drawn_sources(self.imager)]
        there = dict.fromkeys([*_random_kinds(scene), *drawn], True) | {
            "diffuse": plan.flags.diffuse,
            "diffuse after mirror": plan.flags.diffuse and plan.flags.multi_bounce,
        }
        return tuple(i for i in RANDOM if there.get(MECHANISMS[i], False))

    def _sum(self, rays: tuple[LaunchGrid, ...], tiling: Tiling, wanted: NDArray[np.intp]) -> None:
        """Trace the sums of the wanted tiles of groups."""
        grid, n_channels = self.look.grid, len(self.channels)
        each = 16 * tiling.padded**2 * (1 << (n_channels - 1).bit_length())
        step = max(1, MAX_GRID_BYTES // each)
        wavelength = self.radar.waveform.wavelength
        for first in range(0, len(wanted), step):
            some = wanted[first : first + step]

            def empty(some: NDArray[np.intp] = some) -> GroupSums:
                return GroupSums(grid, n_channels, wavelength, self.owners, tiling, some)

            for accumulator, share in self.imager.launched(rays, empty):
                group, tile = some // tiling.n, some % tiling.n
                row, column = tile // tiling.shape[1], tile % tiling.shape[1]
                values = accumulator.tiles()
                used = values.any(axis=(1, 2, 3))
                self.blocks.append(
                    EchoBlocks(
                        group[used],
                        row[used] * tiling.edge,
                        column[used] * tiling.edge,
                        values[used],
                        share,
                    )
                )

    def _add_points(self, owner: I64) -> None:
        for taps, share in self.imager.point_taps(self.channels):
            values = np.moveaxis(taps.values, 0, 1).astype(np.complex64)
            group = owner[taps.point] * len(MECHANISMS) + POINT
            order = np.argsort(group, kind="stable")
            self.blocks.append(
                EchoBlocks(group[order], taps.row[order], taps.column[order], values[order], share)
            )

    @property
    def present(self) -> I64:
        """Groups that have echoes, increasing."""
        found = [np.unique(block.group) for block in self.blocks]
        return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *found]))

    def cells(self, wanted: NDArray[np.bool_], part: GridPart | None = None) -> C64:
        """Echoes of wanted groups (n_groups,) on the looks' grid, (n_channels, n_range, n_azimuth) complex64.

        Parameters
        ----------
        part : of the grid, that holds all of them; None: the whole
        """
        grid = self.look.grid
        part = part or GridPart(0, 0, grid.n_range, grid.n_azimuth)
        own = part.of(grid)
        out = np.zeros((len(self.channels), part.rows, part.columns), dtype=np.complex64)
        for share, blocks in self._divide_by_share():
            edge = max(block.values.shape[-1] for block in blocks)
            # the last tiles reach beyond the grid, tiles at the rim of a part beyond that
            plane = np.zeros((len(self.channels), part.rows + edge, part.columns + edge), dtype=np.complex64)
            for block in blocks:
                for rows, columns, values in block.of(wanted):
                    row, column = rows.start - part.row, columns.start - part.column
                    n = values.shape[-1]
                    plane[:, row : row + n, column : column + n] += values
            inner = plane[:, : part.rows, : part.columns]
            out += own.filter_cells(inner, share, self.radar.waveform.wavelength)
        return out

    def powers_of(
        self, wanted: NDArray[np.bool_], down: float
    ) -> tuple[tuple[slice, slice], F32, NDArray[np.bool_]]:
        """Pixels about the echoes of wanted groups (n_groups,), their power (m^2) there, and which are their place.

        Parameters
        ----------
        down : share of the power of the strongest sum of echoes down to which they count

        Returns
        -------
        where : rows and columns of the image
        power : float32, summed over channels
        near : pixels within a resolution cell of echoes
        """
        ends = []
        for block in self.blocks:
            mine = wanted[block.group]
            if mine.any():
                n = block.values.shape[-1]
                row, column = block.row[mine], block.column[mine]
                ends.append((row.min(), row.max() + n, column.min(), column.max() + n))
        if not ends:
            return (slice(0, 0), slice(0, 0)), np.zeros((0, 0), np.float32), np.zeros((0, 0), dtype=bool)
        all_ends = np.array(ends)
        low, high = all_ends.min(axis=0), all_ends.max(axis=0)
        grid = self.look.grid
        part = self.parts.part(
            int(low[0]), min(int(high[1]), grid.n_range), int(low[2]), min(int(high[3]), grid.n_azimuth)
        )
        cells = self.cells(wanted, part)
        where, power = self.parts.power(cells, part)
        strength = np.square(np.abs(cells)).sum(axis=0)
        there = strength > down * float(strength.max(initial=0.0))
        row, column = (
            np.clip(np.round(x[where]).astype(np.int64) - first, 0, count - 1)
            for x, first, count in (
                (self.look.x, part.row, part.rows),
                (self.look.y, part.column, part.columns),
            )
        )
        return where, power, there[row, column] & (power > 0.0)

    def image(self, cells: C64) -> C64:
        """Image (n_channels, n_azimuth, n_range) complex64 of :meth:`cells`."""
        return form_image(cells, self.look, self.radar)

    def _divide_by_share(self) -> list[tuple[RangeFilter | None, list[EchoBlocks]]]:
        """EchoBlocks of every share of the band; frequency after frequency in the order of tracing."""
        shares: list[RangeFilter | None] = []
        for block in self.blocks:
            if not any(_same(block.share, other) for other in shares):
                shares.append(block.share)
        return [(share, [b for b in self.blocks if _same(b.share, share)]) for share in shares]

    def energies(self, image: C64) -> F64:
        r"""Energy of every group, (n_groups,), m^2, in an image (n_channels, n_azimuth, n_range), that of all groups.

        .. math:: E_g = \sum \mathrm{Re}(s_g s^*), \quad \sum_g E_g = \sum |s|^2

        over pixels and channels: interference is divided equally between two groups, and a group that another one
        weakens may have a negative energy.
        """
        grid = self.look.grid
        out = np.zeros(self.owners.n_groups)
        back = adjoint_cells(image, self.look, self.radar)
        for share, blocks in self._divide_by_share():
            edge = max(block.values.shape[-1] for block in blocks)
            part = grid.filter_cells(back, share, self.radar.waveform.wavelength)
            part = np.pad(part, ((0, 0), (0, edge), (0, edge)))
            for block in blocks:
                n = block.values.shape[-1]
                for i in range(len(block.group)):
                    row, column = int(block.row[i]), int(block.column[i])
                    there = part[:, row : row + n, column : column + n]
                    out[block.group[i]] += np.vdot(there, block.values[i]).real
        return out


def _same(a: RangeFilter | None, b: RangeFilter | None) -> bool:
    if isinstance(a, partial) and isinstance(b, partial):
        return a.func == b.func and a.args == b.args and a.keywords == b.keywords
    return a is b


def _first_term_of_drawn(term: int) -> Callable[[Launch], bool]:
    """Sources with the numbers that were drawn, whatever the term, are traced once."""

    def wanted(launch: Launch) -> bool:
        if term == 0:
            return True
        return not isinstance(launch.source, DrawnSource)

    return wanted


def drawn_sources(imager: Imager) -> list[DrawnSource]:
    """Sources of an imager whose random numbers were drawn when they were made."""
    sources = imager.tracer.sources if imager.sampling is not None else ()
    return [source for source in sources if isinstance(source, DrawnSource)]


def _random_kinds(scene: Scene) -> set[str]:
    """Mechanisms of the scatterers of a scene whose amplitudes are random."""
    return {kind.mechanism for kind in targets_by_kind(scene.scatterers) if kind.random}
