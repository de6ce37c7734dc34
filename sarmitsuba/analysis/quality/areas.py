"""Quality of areas: speckle, contrast, entropy, and noise level."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.analysis.quality.widths import grid_cells
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.signal.image.averaging import block_means
from sarmitsuba.signal.image.metrics import equivalent_number_of_looks, windows_over
from sarmitsuba.signal.image.sar_image import ImageGrid, SarImage

# cells along the edge of an automatic area, and of the pieces by which it is chosen
_EDGE, _PIECE = 24.0, 6.0


@dataclass(frozen=True)
class Area:
    """Rectangle in the image's coordinates.

    Parameters
    ----------
    azimuth, range : first and last, m of the grid
    name : for tables
    """

    azimuth: tuple[float, float]
    range: tuple[float, float]
    name: str = ""

    def pixels(self, grid: ImageGrid) -> tuple[slice, slice]:
        """Rows and columns of the pixels inside.

        Raises
        ------
        DataError
            There are fewer than 2 x 2 pixels.
        """
        found = []
        for axis, (first, last) in ((grid.azimuth, self.azimuth), (grid.range, self.range)):
            low, high = np.searchsorted(axis, (first, last), side="left")
            found.append(slice(int(low), int(high) + int(high < axis.size and axis[high] == last)))
        if min(part.stop - part.start for part in found) < 2:
            raise DataError(
                f"area {self.name or ''} azimuth {self.azimuth[0]:g} ... {self.azimuth[1]:g} m, range "
                f"{self.range[0]:g} ... {self.range[1]:g} m: holds fewer than 2 x 2 pixels of the image, which spans "
                f"{grid.azimuth[0]:g} ... {grid.azimuth[-1]:g} m and {grid.range[0]:g} ... {grid.range[-1]:g} m"
            )
        return found[0], found[1]


@dataclass(frozen=True)
class AreaQuality:
    r"""Measured quality of an area.

    Parameters
    ----------
    name : of the area
    azimuth, range : first and last, m of the grid
    pixels : their number
    cells : resolution cells in it
    sigma0_db : of the mean
    enl : :math:`\langle I \rangle^2 / \mathrm{var} I`; 1 for fully developed speckle of one look
    enl_sigma : standard deviation of that estimate, :math:`\mathrm{ENL} \sqrt{2 (1 + 1 / \mathrm{ENL}) / n}`, n cells,
        for gamma-distributed intensity
    predicted_enl : of the averaged looks, 1 without
    contrast : standard deviation over mean of the intensity
    entropy : :math:`-\sum p \ln p`, :math:`p = I / \sum I`
    entropy_deficit : :math:`\ln N - \mathrm{entropy}`; 0 for equal pixels, 0.423 for single-look speckle
    """

    name: str
    azimuth: tuple[float, float]
    range: tuple[float, float]
    pixels: int
    cells: float
    sigma0_db: float
    enl: float
    enl_sigma: float
    predicted_enl: float
    contrast: float
    entropy: float
    entropy_deficit: float


def contrast(intensity: NDArray[np.floating]) -> float:
    """Contrast: standard deviation over mean of the intensity."""
    values = np.asarray(intensity, dtype=np.float64)
    mean = float(values.mean())
    return float(values.std()) / mean if mean > 0.0 else 0.0


def entropy(intensity: NDArray[np.floating]) -> float:
    """Entropy of the intensity as a distribution, nats."""
    values = np.asarray(intensity, dtype=np.float64).ravel()
    total = float(values.sum())
    if not total > 0.0:
        return 0.0
    p = values[values > 0.0] / total
    return float(-np.sum(p * np.log(p)))


def measure_area(
    image: SarImage, area: Area, sigma0: F64, predicted_enl: float = 1.0, cells: float = 1.0
) -> AreaQuality:
    """Measure an area.

    Parameters
    ----------
    image : of the area
    area : the rectangle
    sigma0 : (n_azimuth, n_range) float64, of the image or of its looks
    predicted_enl : of the looks in ``sigma0``
    cells : ratio of the cell areas of ``sigma0`` and of the image
    """
    grid = image.grid
    rows, columns = area.pixels(grid)
    part = sigma0[rows, columns]
    cell = grid_cells(image, (columns.start + columns.stop) // 2)
    size = part.size * grid.azimuth_spacing * grid.range_spacing
    count = max(size / (cell[0] * cell[1] * cells), 1.0)
    looks = equivalent_number_of_looks(part)
    mean, spread = float(part.mean()), entropy(part)
    return AreaQuality(
        name=area.name,
        azimuth=(float(grid.azimuth[rows.start]), float(grid.azimuth[rows.stop - 1])),
        range=(float(grid.range[columns.start]), float(grid.range[columns.stop - 1])),
        pixels=part.size,
        cells=count,
        sigma0_db=10.0 * math.log10(mean) if mean > 0.0 else -math.inf,
        enl=looks,
        enl_sigma=looks * math.sqrt(2.0 * (1.0 + 1.0 / looks) / count) if looks > 0.0 else math.nan,
        predicted_enl=predicted_enl,
        contrast=contrast(part),
        entropy=spread,
        entropy_deficit=math.log(part.size) - spread,
    )


def automatic_areas(
    image: SarImage, channel: str | None = None, points: Sequence[tuple[float, float]] = ()
) -> tuple[Area, ...]:
    """Most homogeneous and darkest square of 24 cells, as ``even`` and ``dark``; empty if no square is free.

    The homogeneous square has the least variation of means over pieces of 6 cells, in the brighter half of the image.
    These means are nearly independent of the speckle within pieces, so that the choice hardly biases ENL.

    Parameters
    ----------
    image, channel : to search
    points : azimuth and range of targets to be excluded, m of the grid
    """
    grid, sigma0 = image.grid, image.sigma0(channel)
    cells = grid_cells(image, grid.range.size // 2)
    piece = [
        max(1, round(_PIECE * cell / step))
        for cell, step in zip(cells, (grid.azimuth_spacing, grid.range_spacing), strict=True)
    ]
    rows, columns = (n // p for n, p in zip(grid.shape, piece, strict=True))
    n = round(_EDGE / _PIECE)
    if min(rows, columns) < n:
        return ()
    means = block_means(sigma0, (piece[0], piece[1]))
    middle = float(np.median(means))
    taken = np.zeros(means.shape, dtype=bool)
    for azimuth, range_ in points:
        row = round((azimuth - float(grid.azimuth[0])) / grid.azimuth_spacing) // piece[0]
        column = round((range_ - float(grid.range[0])) / grid.range_spacing) // piece[1]
        taken[min(row, rows - 1), min(column, columns - 1)] = True
    best: dict[str, tuple[float, tuple[slice, slice]]] = {}
    for block in windows_over((rows, columns), n):
        part = means[block]
        level = float(part.mean())
        if taken[block].any() or not level > 0.0:
            continue
        for name, score in (("even", float(part.std()) / level), ("dark", level)):
            if name == "even" and level < middle:
                continue
            if name not in best or score < best[name][0]:
                best[name] = (score, block)
    return tuple(
        Area(
            (float(grid.azimuth[b[0].start * piece[0]]), float(grid.azimuth[b[0].stop * piece[0] - 1])),
            (float(grid.range[b[1].start * piece[1]]), float(grid.range[b[1].stop * piece[1] - 1])),
            name,
        )
        for name, b in ((name, best[name][1]) for name in ("even", "dark") if name in best)
    )
