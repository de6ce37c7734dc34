"""Focusing: raw data in, calibrated complex image out."""

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.echo.raw import RawData
from sarmitsuba.errors import DataError
from sarmitsuba.focusing.aperture import ground_cell_area, incidence_angle, matched_weights
from sarmitsuba.focusing.backprojection import backproject, backproject_numpy
from sarmitsuba.focusing.grid import default_grid
from sarmitsuba.focusing.omega_k import omega_k, pulse_weights
from sarmitsuba.focusing.range_compression import range_compress
from sarmitsuba.focusing.windows import parse_window
from sarmitsuba.image.sar_image import ImageGrid, SarImage
from sarmitsuba.progress import Progress, silent
from sarmitsuba.radar.radar import Radar

METHODS = ("backprojection", "omega_k")


def focus(
    raw: RawData,
    grid: ImageGrid | None = None,
    *,
    method: Literal["backprojection", "omega_k"] = "backprojection",
    range_window: str = "rectangular",
    azimuth_window: str = "rectangular",
    compression: str = "flat",
    interpolation: str = "kernel",
    oversampling: int = 0,
    request: Any = None,
    progress: Progress = silent,
) -> SarImage:
    """Focus raw data into a calibrated image; layers stay apart.

    Parameters
    ----------
    raw : chirped (compressed here first) or range-compressed data
    grid : where to focus; default: :func:`default_grid` of ``request`` or of what the data's metadata ask for
    method : ``backprojection`` (any track and grid) or ``omega_k`` (straight uniform track, its slant grid)
    range_window, azimuth_window : ``rectangular``, ``hamming``, ``hann``, ``taylor:4:-35``, ``kaiser:2.5``, ...; over
        the bandwidth and over the pulse index
    compression : of chirped data: ``flat`` or ``matched``, see :func:`compression_filter`
    interpolation, oversampling : of backprojection's range profiles, see :func:`backproject`
    request : image request for the default grid
    progress : called after every batch

    Returns
    -------
    SarImage : |pixel|^2 is the RCS at a point's peak; ``sigma0`` refers to flat ground

    Raises
    ------
    DataError
        Unknown method or window, or data that the method cannot focus.
    """
    if method not in METHODS:
        raise DataError(f"focusing method {method!r}: unknown; choose one of {', '.join(METHODS)}")
    windows = {
        "range_window": str(parse_window(range_window)),
        "azimuth_window": str(parse_window(azimuth_window)),
    }
    raw = range_compress(raw, method=compression)
    if grid is None:
        grid = default_grid(raw, request)
    facts: dict[str, Any] = {"method": method, **windows}
    if method == "omega_k":
        data = omega_k(raw, grid, progress=progress, **windows)
    else:
        facts |= {"interpolation": interpolation, "oversampling": oversampling}
        data = backproject(
            raw, grid, interpolation=interpolation, oversampling=oversampling, progress=progress, **windows
        )

    def weights(point: NDArray[np.float64]) -> NDArray[np.float64]:
        if method == "omega_k":
            window = parse_window(azimuth_window).aperture(raw.radar.track.n_pulses)
            return pulse_weights(raw.radar, grid, point, window)
        return matched_weights(raw.radar, point, azimuth_window)

    middle = grid.positions_on_line(grid.azimuth.size // 2)
    incidence = incidence_angle(raw.radar, middle)
    range_cell = raw.radar.waveform.range_cell * parse_window(range_window).broadening
    cell, polynomial = azimuth_cell(raw.radar, grid, middle, incidence, weights, range_window, range_cell)
    facts |= {
        "azimuth_cell_polynomial": polynomial,
        "center_position": [float(v) for v in raw.radar.track.center_position],
        "range_compression": raw.metadata.get("range_compression", "none"),
    }
    return SarImage(
        data=data,
        layers=raw.layers,
        grid=grid,
        wavelength=raw.radar.waveform.wavelength,
        azimuth_resolution_cell=cell,
        range_resolution_cell=range_cell,
        incidence_angle=incidence,
        metadata={**raw.metadata, "focus": facts},
    )


def azimuth_cell(
    radar: Radar,
    grid: ImageGrid,
    line: NDArray[np.float64],
    incidence: NDArray[np.float64],
    weights: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    range_window: str,
    range_cell: float,
) -> tuple[float, dict[str, Any]]:
    """Noise-equivalent azimuth cell at the grid's centre, m, and how it varies over the range columns.

    Defined by the area of the impulse response on the ground, so that it holds with squint and wide bands too.
    """
    columns = np.unique(np.linspace(0, grid.range.size - 1, 9).round().astype(int))
    area = np.array([ground_cell_area(radar, line[i], weights(line[i]), range_window) for i in columns])
    cell = area * np.sin(incidence[columns]) / range_cell
    center = float(grid.range[grid.range.size // 2])
    scale = max(float(np.abs(grid.range - center).max()), 1.0)
    x = (grid.range[columns] - center) / scale
    fit = np.polynomial.polynomial.polyfit(x, cell, min(3, columns.size - 1))
    middle = float(fit[0])
    return middle, {"center": center, "scale": scale, "coefficients": [float(c / middle) for c in fit]}


__all__ = [
    "METHODS",
    "azimuth_cell",
    "backproject",
    "backproject_numpy",
    "default_grid",
    "focus",
    "omega_k",
    "range_compress",
]
