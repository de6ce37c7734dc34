"""The ray paths behind the pixels of an image, few enough to travel inside a page."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.page.localise import on_plane
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.path_table import PathTable, joined, trace_paths

F64 = NDArray[np.float64]

# paths kept in all, and of one bounce order in one cell of the image
MOST_PATHS, MOST_PER_ORDER = 24_000, 3
# cells weaker than the strongest by more than this are left out, dB
FLOOR_DB = 70.0
# orders that shares are given for; those above count with the last
ORDERS = 6


@dataclass(frozen=True, eq=False)
class PagePaths:
    """Paths sorted into the resolution cells of an image's plane.

    Parameters
    ----------
    pulses : numbers of the pulses that were traced
    cell_size : (2,) edges of a cell in pixels, azimuth and range
    shape : cells in azimuth and range
    cell : (n_cells,) int32 number of every cell that has paths, row after row, increasing
    first : (n_cells + 1,) int32; cell i has the paths ``first[i]:first[i + 1]``
    found : (n_cells,) int32 paths that the cell has in all, kept or not
    by_order : (n_cells, ORDERS) uint8 share of the cell's amplitudes per bounce order, in 1/255
    table : the kept paths, cell after cell, strongest first in a cell
    share : (n,) float32 share of the path's amplitude in the sum of the amplitudes of its cell
    """

    pulses: tuple[int, ...]
    cell_size: tuple[int, int]
    shape: tuple[int, int]
    cell: NDArray[np.int32]
    first: NDArray[np.int32]
    found: NDArray[np.int32]
    by_order: NDArray[np.uint8]
    table: PathTable
    share: NDArray[np.float32]


def page_paths(
    scene: Scene,
    grid: ImageGrid,
    cell: tuple[float, float],
    channel: str,
    *,
    seed: int | None = None,
    most: int = MOST_PATHS,
) -> PagePaths:
    """Trace the paths of single pulses and sort them into the cells of an image.

    Parameters
    ----------
    scene : that the image is of, in the frame of ``grid``
    grid : of the image
    cell : edges of the resolution cells that paths are sorted into, m along the axes of ``grid``
    channel : whose amplitudes count
    seed : of the run
    most : paths kept; the brightest cells come first

    Notes
    -----
    A path stands in the image where its length and its range rate put it, as for
    :func:`sarmitsuba.simulation.path_table.trace_paths` with ``near``. One pulse serves every pixel, except where the
    beam passes over the image: there each part of it takes the pulse whose beam is on it.
    """
    size = cell_pixels(grid, cell)
    shape = (-(-grid.shape[0] // size[0]), -(-grid.shape[1] // size[1]))
    row_of_pulse = _served_rows(scene, grid)
    parts, numbers = [], []
    for pulse, low, high in row_of_pulse:
        table = trace_paths(scene, pulse, seed=seed)
        row, column = pixels_of(table, scene, grid, pulse)
        inside = (row >= low) & (row < high) & (column >= -0.5) & (column < grid.shape[1] - 0.5)
        keep = np.flatnonzero(inside)
        i = np.floor((row[keep] + 0.5) / size[0]).astype(np.int64)
        j = np.floor((column[keep] + 0.5) / size[1]).astype(np.int64)
        parts.append(table[keep])
        numbers.append(i * shape[1] + j)
    table, number = joined(parts), np.concatenate(numbers)
    amplitude: F64 = np.abs(table.amplitude[:, table.channels.index(channel)]).astype(np.float64)
    order = np.minimum(table.order, ORDERS) - 1
    n_cells = shape[0] * shape[1]
    total = np.bincount(number, weights=amplitude, minlength=n_cells)
    power = np.bincount(number, weights=amplitude**2, minlength=n_cells)
    found = np.bincount(number, minlength=n_cells)
    by_order = np.bincount(number * ORDERS + order, weights=amplitude, minlength=n_cells * ORDERS)
    rows = _chosen(number, order, amplitude, power, most)
    cells, counts = np.unique(number[rows], return_counts=True)
    divisor = np.maximum(total[cells], 1e-300)
    return PagePaths(
        pulses=tuple(pulse for pulse, _, _ in row_of_pulse),
        cell_size=size,
        shape=shape,
        cell=cells.astype(np.int32),
        first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        found=found[cells].astype(np.int32),
        by_order=np.round(255.0 * by_order.reshape(n_cells, ORDERS)[cells] / divisor[:, None]).astype(
            np.uint8
        ),
        table=table[rows],
        share=(amplitude[rows] / np.maximum(total[number[rows]], 1e-300)).astype(np.float32),
    )


def cell_pixels(grid: ImageGrid, cell: tuple[float, float]) -> tuple[int, int]:
    """Pixels along the edges of a resolution cell, at least one."""
    return max(1, round(cell[0] / grid.azimuth_spacing)), max(1, round(cell[1] / grid.range_spacing))


def pixels_of(table: PathTable, scene: Scene, grid: ImageGrid, pulse: int) -> tuple[F64, F64]:
    """Row and column, as fractions, where paths of a pulse stand in an image; NaN where they do not."""
    track = scene.radar.track
    spot = on_plane(
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


def _served_rows(scene: Scene, grid: ImageGrid) -> list[tuple[int, float, float]]:
    """Pulses to trace, each with the rows of the image that it serves."""
    radar = scene.radar
    track, n_rows = radar.track, grid.shape[0]
    whole = [(track.center_index, -0.5, n_rows - 0.5)]
    if not (np.isfinite(radar.half_aperture) and radar.mode_law.own_apertures):
        return whole
    middle = grid.positions_on_line(n_rows // 2).mean(axis=0)
    distance = float(np.linalg.norm(track.center_position - middle))
    reach = distance * radar.half_aperture  # half of what a pulse serves along the flight, m
    count = int(np.ceil(n_rows * grid.azimuth_spacing / reach))
    if count <= 1:
        return whole
    edges = np.linspace(-0.5, n_rows - 0.5, count + 1)
    served = []
    for low, high in pairwise(edges):
        spot = grid.positions_on_line(round(0.5 * (low + high)))[grid.shape[1] // 2]
        line = spot - track.position
        line /= np.linalg.norm(line, axis=1, keepdims=True)
        # the pulse whose beam meets that row
        pulse = int(np.argmin(np.abs(np.einsum("ni,ni->n", line, radar.pointing.azimuth_axis))))
        served.append((pulse, float(low), float(high)))
    return served


def _chosen(
    number: NDArray[np.int64], order: NDArray[np.integer], amplitude: F64, power: F64, most: int
) -> NDArray[np.int64]:
    """Rows to keep: the strongest few of each order in the brightest cells; cell after cell, strongest first."""
    rows = np.lexsort((-amplitude, order, number))
    group = number[rows] * ORDERS + order[rows]
    starts = np.flatnonzero(np.concatenate([[True], group[1:] != group[:-1]])) if rows.size else rows
    rank = np.arange(rows.size) - np.repeat(starts, np.diff(np.append(starts, rows.size)))
    bright = power[number[rows]] > power.max(initial=0.0) * 10.0 ** (-0.1 * FLOOR_DB)
    rows = rows[(rank < MOST_PER_ORDER) & bright]
    brightest = np.argsort(-power, kind="stable")
    place = np.empty(brightest.size, dtype=np.int64)
    place[brightest] = np.arange(brightest.size)
    rows = rows[np.argsort(place[number[rows]], kind="stable")]
    if rows.size > most:  # whole cells only
        last = number[rows[most]]
        rows = rows[:most]
        rows = rows[number[rows] != last]
    return np.asarray(rows[np.lexsort((-amplitude[rows], number[rows]))])


__all__ = [
    "FLOOR_DB",
    "MOST_PATHS",
    "MOST_PER_ORDER",
    "ORDERS",
    "PagePaths",
    "cell_pixels",
    "page_paths",
    "pixels_of",
]
