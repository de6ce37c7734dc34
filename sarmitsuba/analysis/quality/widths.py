"""Predicted widths of an image's impulse response, from its cells and windows."""

from functools import cache

import numpy as np

from sarmitsuba.analysis.quality.carrier import Lobes
from sarmitsuba.signal.focusing.windows import Window, parse_window
from sarmitsuba.signal.image.sar_image import SarImage

_NODES, _FINE = 1024, 64


@cache
def window_irw(text: str) -> float:
    """Half-power width of the impulse response of a window, cells of the unweighted band (rectangular: 0.886)."""
    window = parse_window(text).aperture(_NODES)
    response = np.abs(np.fft.rfft(window, _NODES * _FINE)[: 4 * _FINE]) ** 2
    i = int(np.flatnonzero(response < 0.5 * response[0])[0])
    part = (response[i - 1] - 0.5 * response[0]) / (response[i - 1] - response[i])
    return float(2.0 * (i - 1 + part) / _FINE)


def windows_of(image: SarImage) -> tuple[Window, Window]:
    """Azimuth and range window of the image; rectangular if not recorded."""
    facts = image.metadata.get("focus", {})
    azimuth, range_ = (
        parse_window(str(facts.get(name, "rectangular"))) for name in ("azimuth_window", "range_window")
    )
    return azimuth, range_


def grid_cells(image: SarImage, column: int) -> tuple[float, float]:
    """Noise-equivalent cells in azimuth and range at a column, in metres of the grid."""
    grid = image.grid
    azimuth, range_ = image.azimuth_resolution_cell, image.range_resolution_cell
    fit = image.metadata.get("focus", {}).get("azimuth_cell_polynomial")
    if fit is not None:
        x = (grid.range[column] - fit["center"]) / fit["scale"]
        azimuth *= float(np.polynomial.polynomial.polyval(x, np.asarray(fit["coefficients"])))
    if grid.kind == "ground":
        range_ /= float(np.sin(image.incidence_angle[column]))
    return azimuth, range_


def predicted_irw(image: SarImage, lobes: Lobes, column: int) -> tuple[float, float]:
    r"""Predicted half-power widths along the azimuth and the range lobe, from cells and windows, m of the grid.

    For a spectrum of the form of a parallelogram: the range cell over the gradient of the slant range and the skew, and
    the area of the impulse response over the range cell,

    .. math:: w_r = \frac{\delta_r}{|\nabla D| s}, \qquad w_a = \frac{A |\nabla D|}{\delta_r}
    """
    azimuth, _ = grid_cells(image, column)
    area = azimuth * image.range_resolution_cell / float(np.sin(image.incidence_angle[column]))
    grid = image.grid
    if grid.kind == "slant":  # range columns are denser than ground metres
        area *= float(grid.across_distance()[column] / grid.range[column])
    radial = image.range_resolution_cell / lobes.slope
    widths = [window_irw(str(window)) / window.broadening for window in windows_of(image)]
    return widths[0] * area / radial, widths[1] * radial / lobes.skew
