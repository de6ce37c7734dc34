"""Azimuth resolution cells over an image, which convert radar cross sections into sigma0."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, TypedDict

import numpy as np

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import ground_cell_area, incidence_angle
from sarmitsuba.signal.focusing.windows import Window, parse_window
from sarmitsuba.signal.image import ImageGrid

# rows and columns at which a varying azimuth cell is computed
_ROW_NODES, _COLUMN_NODES = 65, 9
# least change of the cell over rows that is kept, log10: 0.01 dB
_LEAST_CHANGE = 1e-3
# azimuth cell over the middle row's above which rows are named in a warning
_LONG_CELL = 1.1


class CellPolynomial(TypedDict):
    """Azimuth cell over range, relative: a polynomial in ``(r - center) / scale``, constant first and 1.

    ``center`` and ``scale`` are in m of the grid's range coordinate.
    """

    center: float
    scale: float
    coefficients: list[float]


class CellTable(TypedDict):
    """Azimuth cell over rows: ratio to the middle row's, linear between nodes.

    ``azimuth`` and ``range`` are the nodes in m of the grid's coordinates; ``ratio`` is a list of rows.
    """

    azimuth: list[float]
    range: list[float]
    ratio: list[list[float]]


@dataclass(frozen=True)
class AzimuthCells:
    """Noise-equivalent azimuth cells of an image.

    Parameters
    ----------
    center : m, at the grid's centre
    polynomial : variation over range columns
    rows : variation over rows; None where it is constant
    """

    center: float
    polynomial: CellPolynomial
    rows: CellTable | None = None

    @property
    def facts(self) -> dict[str, Any]:
        """Entries of an image's ``focus`` metadata, from which :class:`SarImage` makes its cell area."""
        facts: dict[str, Any] = {"azimuth_cell_polynomial": self.polynomial}
        return facts if self.rows is None else facts | {"azimuth_cell_rows": self.rows}

    @property
    def warning(self) -> str:
        """Warning about rows with a much longer cell than the middle one; empty when there are none."""
        if self.rows is None:
            return ""
        azimuth, worst = np.array(self.rows["azimuth"]), np.max(self.rows["ratio"], axis=1)
        long = worst > _LONG_CELL
        if not long.any():
            return ""
        middle = azimuth.size // 2
        parts = [azimuth[half][long[half]] for half in (slice(0, middle), slice(middle, None))]
        spans = " and ".join(f"{part[0]:.4g} to {part[-1]:.4g} m" for part in parts if part.size)
        return (
            f"the rows at azimuth {spans} lack part of their aperture, because the track is too short or the beam "
            f"leaves them: their azimuth cell is up to {worst.max():.3g} times the middle row's, which sigma0 allows "
            "for; lengthen the track (n_pulses = 0 makes it fit the image) or shrink image_extent_azimuth"
        )


def azimuth_cells(
    radar: Radar,
    grid: ImageGrid,
    pulse_weights: Callable[[F64], F64],
    range_window: str | Window,
    *,
    rows: bool = True,
    lit_alike: bool = False,
) -> AzimuthCells:
    """Noise-equivalent azimuth cells of an image.

    Defined by the area of the impulse response on the ground, so that they hold with squint and wide bands too.

    Parameters
    ----------
    radar : gives track and waveform
    grid : the image's
    pulse_weights : weight of every pulse at a point, see :class:`sarmitsuba.signal.focusing.focuser.Focused`
    range_window : over the band
    rows : False takes all rows for the middle one
    lit_alike : see :func:`sarmitsuba.signal.focusing.aperture_weights.ground_cell_area`
    """
    area_of = partial(ground_cell_area, radar, range_window=range_window, lit_alike=lit_alike)
    line = grid.positions_on_line(grid.azimuth.size // 2)
    incidence = incidence_angle(radar, line)
    range_cell = radar.waveform.range_cell * parse_window(range_window).broadening
    columns = np.unique(np.linspace(0, grid.range.size - 1, _COLUMN_NODES).round().astype(int))
    area = np.array([area_of(line[i], pulse_weights(line[i])) for i in columns])
    center, polynomial = fit_columns(grid, columns, area * np.sin(incidence[columns]) / range_cell)
    return AzimuthCells(center, polynomial, _cell_rows(grid, pulse_weights, area_of) if rows else None)


def fit_columns(grid: ImageGrid, columns: I64, cell: F64) -> tuple[float, CellPolynomial]:
    """Cell at the grid's central column, and its change over range, from its value (m) at some columns."""
    center = float(grid.range[grid.range.size // 2])
    scale = max(float(np.abs(grid.range - center).max()), 1.0)
    x = (grid.range[columns] - center) / scale
    for degree in range(min(3, columns.size - 1), -1, -1):
        fit = np.polynomial.polynomial.polyfit(x, cell, degree)
        if (np.polynomial.polynomial.polyval(x, fit) > 0.0).all():  # not where columns leave the beam
            break
    middle = float(fit[0])
    return middle, {"center": center, "scale": scale, "coefficients": [float(c / middle) for c in fit]}


def _cell_rows(
    grid: ImageGrid, pulse_weights: Callable[[F64], F64], area_of: Callable[[F64, F64], float]
) -> CellTable | None:
    """Azimuth cell over rows; None where it varies by less than 0.01 dB.

    It varies where the track or the beam gives some rows less than the whole aperture. Rows that no pulse illuminates
    have the cell of the nearest illuminated row.

    Parameters
    ----------
    grid : the image's
    pulse_weights : as for :func:`azimuth_cells`
    area_of : noise-equivalent area (m^2) of a place and the weights there
    """

    def ratios(n_rows: int, n_columns: int) -> tuple[I64, I64, F64]:
        rows, columns = (
            np.unique(np.linspace(0, size - 1, n).round().astype(np.int64))
            for size, n in zip(grid.shape, (n_rows, n_columns), strict=True)
        )
        lines = np.array(
            [grid.positions_on_line(int(row))[columns] for row in (grid.azimuth.size // 2, *rows)]
        )
        area = np.full(lines.shape[:2], np.nan)
        for index in np.ndindex(area.shape):
            with suppress(DataError):  # not illuminated
                area[index] = area_of(lines[index], pulse_weights(lines[index]))
        return rows, columns, area[1:] / area[0]

    rows, columns, ratio = ratios(5, 3)
    if np.isfinite(ratio).all() and np.abs(np.log10(ratio)).max() < _LEAST_CHANGE:
        return None
    rows, columns, ratio = ratios(_ROW_NODES, _COLUMN_NODES)
    for column in ratio.T:
        seen = np.isfinite(column)
        column[~seen] = np.interp(rows[~seen], rows[seen], column[seen]) if seen.any() else 1.0
    return {
        "azimuth": grid.azimuth[rows].tolist(),
        "range": grid.range[columns].tolist(),
        "ratio": ratio.tolist(),
    }
