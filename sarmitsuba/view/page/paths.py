"""Ray paths that contribute to the pixels of an image, few enough to be embedded in a page.

An echo of given range and Doppler is placed on the image plane.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F32, F64, I32, I64, U8, unit_rows
from sarmitsuba.core.units import power_from_db
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.simulation.execution.path_table import PathTable, PathTracer, join_tables
from sarmitsuba.simulation.planning.sampling.density_plan import azimuth_cell


def locate_on_plane(
    position: F64, velocity: F64, slant_range: F64, range_rate: F64, height: float, across: F64
) -> F64:
    r"""Point of a horizontal plane that has a range and a range rate from a moving antenna.

    With P the antenna, v its velocity and X the point,

    .. math:: |P - X| = R, \qquad (P - X) \cdot v = \dot R R, \qquad X_z = h

    The second is a line in the plane, the first a circle; of their two intersections the one on the look side is
    returned.

    Parameters
    ----------
    position, velocity : (3,) float64, m and m/s; the antenna
    slant_range, range_rate : (n,) float64, m and m/s
    height : m, of the plane
    across : (3,) float64 horizontal unit vector to the look side

    Returns
    -------
    (n, 3) float64, m; NaN where circle and line do not intersect (the range is too short)
    """
    drop = position[2] - height
    level = velocity[:2]
    speed = float(np.hypot(*level))
    unit = level / speed
    # (P - X) = (-a unit - b side, drop): along and across in the plane
    along = (velocity[2] * drop - range_rate * slant_range) / speed
    side = across[:2] - (across[:2] @ unit) * unit
    side = side / np.hypot(*side)
    square = slant_range**2 - drop**2 - along**2
    with np.errstate(invalid="ignore"):
        beside = np.sqrt(np.where(square >= 0.0, square, np.nan))
    level_xy = position[:2] + along[:, None] * unit + beside[:, None] * side
    return np.column_stack([level_xy, np.full(len(level_xy), height)])


# largest number of paths in total, and of one bounce order in one cell of the image
MOST_PATHS, MOST_PER_ORDER = 48_000, 3
# cells along the edge of a part of the image traced at once
TILE = 256
# cells weaker than the strongest by more than this are omitted, dB
FLOOR_DB = 70.0
# number of bounce orders with their own share; higher orders count with the last
ORDERS = 6


@dataclass(frozen=True, eq=False)
class PagePaths:
    """Paths sorted into the resolution cells of an image's plane.

    Parameters
    ----------
    pulses : numbers of the traced pulses
    cell_size : (2,) edges of a cell in pixels, azimuth and range
    shape : cells in azimuth and range
    cell : (n_cells,) int32 number of every cell with paths, row by row, increasing
    first : (n_cells + 1,) int32; cell i has the paths ``first[i]:first[i + 1]``
    found : (n_cells,) int32 number of all paths of the cell, kept or not
    by_order : (n_cells, ORDERS) uint8 share of the cell's amplitudes per bounce order, in 1/255
    table : kept paths, cell by cell, strongest first in a cell
    share : (n,) float32 share of the path's amplitude in the sum of the amplitudes of its cell
    """

    pulses: tuple[int, ...]
    cell_size: tuple[int, int]
    shape: tuple[int, int]
    cell: I32
    first: I32
    found: I32
    by_order: U8
    table: PathTable
    share: F32


def page_paths(
    scene: Scene,
    grid: ImageGrid,
    cell: tuple[float, float],
    channel: str,
    *,
    seed: int | None = None,
    most: int = MOST_PATHS,
    tile: int = TILE,
) -> PagePaths:
    """Trace the paths of single pulses and sort them into the cells of an image.

    Parameters
    ----------
    scene : scene of the image, in the frame of ``grid``
    grid : of the image
    cell : edges of the resolution cells, m along the axes of ``grid``
    channel : polarisation of the amplitudes
    seed : of the run
    most : largest number of paths kept; the brightest cells come first
    tile : cells along the edge of a part of the image traced at once; affects memory only

    Notes
    -----
    The position of a path in the image follows from its length and its range rate, as for
    :func:`sarmitsuba.simulation.execution.path_table.trace_paths` with ``near``. One pulse is traced for all pixels,
    except where the beam moves across the image: there each part of it takes the pulse whose beam illuminates it.
    """
    size = cell_pixels(grid, cell)
    shape = (-(-grid.shape[0] // size[0]), -(-grid.shape[1] // size[1]))
    tracer = PathTracer(scene, seed=seed)
    parts = [
        _trace_tile(tracer, scene, grid, channel, size, shape, part)
        for part in _tiles(shape, _served_rows(scene, grid, size[0]), tile)
    ]
    table = join_tables([part.table for part in parts])
    number, amplitude = (
        np.concatenate([getattr(p, name) for p in parts]) for name in ("number", "amplitude")
    )
    n_cells = shape[0] * shape[1]
    total, power = sum(part.total for part in parts), sum(part.power for part in parts)
    rows = _brightest(number, amplitude, np.asarray(power), most)
    cells, counts = np.unique(number[rows], return_counts=True)
    divisor = np.maximum(np.asarray(total)[cells], 1e-300)
    by_order = np.asarray(sum(part.by_order for part in parts)).reshape(n_cells, ORDERS)
    return PagePaths(
        pulses=tuple(np.unique(table.pulse).tolist()),
        cell_size=size,
        shape=shape,
        cell=cells.astype(np.int32),
        first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        found=np.asarray(sum(part.found for part in parts))[cells].astype(np.int32),
        by_order=np.round(255.0 * by_order[cells] / divisor[:, None]).astype(np.uint8),
        table=table[rows],
        share=(amplitude[rows] / np.repeat(divisor, counts)).astype(np.float32),
    )


@dataclass(frozen=True, eq=False)
class _PathTile:
    """Paths of a part of the image: the strongest few of every order and cell, and the sums over all.

    Parameters
    ----------
    table : kept paths
    number, amplitude : cell in the image and absolute value of the kept paths
    total, power, found, by_order : per cell of the whole image: sum of amplitudes, sum of powers, number of paths, sum
        per order
    """

    table: PathTable
    number: I64
    amplitude: F64
    total: F64
    power: F64
    found: I64
    by_order: F64


def _tiles(
    shape: tuple[int, int], served: list[tuple[int, int, int]], edge: int
) -> list[tuple[int, int, int, int, int]]:
    """Parts of the image whose paths fit into memory: pulse, first and last row and column of cells."""
    found = []
    for pulse, top, bottom in served:
        rows = np.linspace(top, bottom, -(-(bottom - top) // edge) + 1).round().astype(int).tolist()
        columns = np.linspace(0, shape[1], -(-shape[1] // edge) + 1).round().astype(int).tolist()
        found += [(pulse, i, k, j, n) for i, k in pairwise(rows) for j, n in pairwise(columns)]
    return found


def _trace_tile(
    tracer: PathTracer,
    scene: Scene,
    grid: ImageGrid,
    channel: str,
    size: tuple[int, int],
    shape: tuple[int, int],
    tile: tuple[int, int, int, int, int],
) -> _PathTile:
    """Trace the paths of one part of the image."""
    pulse, top, bottom, left, right = tile
    rows = np.clip(
        [top * size[0], 0.5 * (top + bottom) * size[0], bottom * size[0] - 1], 0, grid.shape[0] - 1
    )
    columns = np.clip(
        [left * size[1], 0.5 * (left + right) * size[1], right * size[1] - 1], 0, grid.shape[1] - 1
    )
    spots = np.array([grid.positions_on_line(int(r))[columns.astype(int)] for r in rows])
    reach = _reach(scene, pulse, spots)
    table = tracer.trace(pulse, near=spots[1, 1], cells=reach)
    row, column = pixels_of(table, scene, grid, pulse)
    with np.errstate(invalid="ignore"):
        i, j = np.floor((row + 0.5) / size[0]), np.floor((column + 0.5) / size[1])
        keep = np.flatnonzero((i >= top) & (i < bottom) & (j >= left) & (j < right))
    table, number = table[keep], (i[keep] * shape[1] + j[keep]).astype(np.int64)
    amplitude: F64 = np.abs(table.amplitude[:, table.channels.index(channel)]).astype(np.float64)
    order = np.minimum(table.order, ORDERS) - 1
    n_cells = shape[0] * shape[1]

    def sums(weights: F64 | None, of: NDArray[np.integer] = number, n: int = n_cells) -> F64:
        return np.asarray(np.bincount(of, weights=weights, minlength=n))

    few = _few(number, order, amplitude)
    return _PathTile(
        table=table[few],
        number=number[few],
        amplitude=amplitude[few],
        total=sums(amplitude),
        power=sums(amplitude**2),
        found=np.bincount(number, minlength=n_cells),
        by_order=sums(amplitude, number * ORDERS + order, n_cells * ORDERS),
    )


def _reach(scene: Scene, pulse: int, spots: F64) -> float:
    """Radius in resolution cells of the gate around the middle of a part of the image, whose points are (3, 3, 3) m."""
    track, cell = scene.radar.track, scene.radar.waveform.range_cell
    leg = track.position[pulse] - spots.reshape(-1, 3)
    distance = np.linalg.norm(leg, axis=1)
    ahead = leg @ track.velocity[pulse] / np.linalg.norm(track.velocity[pulse])
    in_range = np.abs(distance - distance[4]).max() / cell
    in_azimuth = np.abs(ahead - ahead[4]).max() / azimuth_cell(scene)
    # the gate is a rectangle in range and range rate, a part of the image only approximately
    return float(1.1 * max(in_range, in_azimuth) + 4.0)


def cell_pixels(grid: ImageGrid, cell: tuple[float, float]) -> tuple[int, int]:
    """Number of pixels along the edges of a resolution cell, at least one."""
    return max(1, round(cell[0] / grid.azimuth_spacing)), max(1, round(cell[1] / grid.range_spacing))


def pixels_of(table: PathTable, scene: Scene, grid: ImageGrid, pulse: int) -> tuple[F64, F64]:
    """Fractional row and column of the paths of a pulse in an image; NaN outside it."""
    track = scene.radar.track
    spot = locate_on_plane(
        track.position[pulse],
        track.velocity[pulse],
        table.slant_range,
        table.range_rate,
        grid.height,
        grid.across,
    )
    away = spot - grid.origin
    azimuth, across = away @ grid.along, away @ grid.across
    if grid.kind == "slant":
        across = np.hypot(across, grid.origin[2] - grid.height)
    row = (azimuth - grid.azimuth[0]) / grid.azimuth_spacing
    column = (across - grid.range[0]) / grid.range_spacing
    return row, column


def _served_rows(scene: Scene, grid: ImageGrid, size: int) -> list[tuple[int, int, int]]:
    """Pulses to trace, each with its first and last row of cells."""
    radar = scene.radar
    track, n_rows = radar.track, -(-grid.shape[0] // size)
    reach = np.inf
    if np.isfinite(radar.half_aperture) and radar.mode_law.own_apertures:
        middle = grid.positions_on_line(grid.shape[0] // 2).mean(axis=0)
        # half of the length along the flight for which a pulse is traced, m
        reach = float(np.linalg.norm(track.center_position - middle)) * radar.half_aperture
    count = max(1, int(np.ceil(grid.shape[0] * grid.azimuth_spacing / reach)))
    if count == 1:
        return [(track.center_index, 0, n_rows)]
    served = []
    for top, bottom in pairwise(np.linspace(0, n_rows, count + 1).round().astype(int).tolist()):
        row = min((top + bottom) * size // 2, grid.shape[0] - 1)
        line = grid.positions_on_line(row)[grid.shape[1] // 2] - track.position
        line = unit_rows(line)
        # the pulse whose beam illuminates that row
        pulse = int(np.argmin(np.abs(np.einsum("ni,ni->n", line, radar.pointing.azimuth_axis))))
        served.append((pulse, top, bottom))
    return served


def _few(number: I64, order: NDArray[np.integer], amplitude: F64) -> I64:
    """Rows of the strongest few paths of every order and cell."""
    rows = np.lexsort((-amplitude, order, number))
    group = number[rows] * ORDERS + order[rows]
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    rank = np.arange(rows.size) - np.repeat(starts, np.diff(np.append(starts, rows.size)))
    return np.asarray(rows[rank < MOST_PER_ORDER])


def _brightest(number: I64, amplitude: F64, power: F64, most: int) -> I64:
    """Rows of the brightest cells, as many whole cells as fit; cell by cell, strongest first."""
    rows = np.flatnonzero(power[number] > power.max(initial=0.0) * power_from_db(-FLOOR_DB))
    place = np.empty(power.size, dtype=np.int64)
    place[np.argsort(-power, kind="stable")] = np.arange(power.size)
    rows = rows[np.argsort(place[number[rows]], kind="stable")]
    if rows.size > most:
        last = number[rows[most]]
        rows = rows[:most]
        rows = rows[number[rows] != last]
    return np.asarray(rows[np.lexsort((-amplitude[rows], number[rows]))])
