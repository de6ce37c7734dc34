"""Spectral multilooking: mean power of sub-apertures and sub-bands."""

from dataclasses import dataclass

import numpy as np
import scipy.fft

from sarmitsuba.analysis.quality.carrier import Carrier
from sarmitsuba.analysis.quality.widths import grid_cells, windows_of
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.units import db_from_power
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.image.sar_image import SarImage

# least relative weight of the image's window that is divided out, so that the ends of hann do not amplify noise
_FLOOR = 0.1
# largest share of the sampled spectrum for the image's band
_NYQUIST = 1.0 + 1e-6


@dataclass(frozen=True, eq=False)
class Looks:
    """Mean sigma0 of several looks.

    Parameters
    ----------
    sigma0 : (n_azimuth, n_range) float64, linear, on the image's pixels
    looks : (azimuth, range)
    predicted_enl : equivalent number of looks of homogeneous ground, from the overlap of the looks' bands
    azimuth_cell, range_cell : m of the grid, noise-equivalent, of one look at the image's centre
    """

    sigma0: F64
    looks: tuple[int, int]
    predicted_enl: float
    azimuth_cell: float
    range_cell: float

    def __repr__(self) -> str:
        return (
            f"Looks({self.looks[0]} x {self.looks[1]}: ENL {self.predicted_enl:.3g}, cell {self.azimuth_cell:.3g} m x "
            f"{self.range_cell:.3g} m)"
        )

    def to_db(self) -> F64:
        """Decibels; zero is -inf."""
        return db_from_power(self.sigma0)


def spectral_looks(
    image: SarImage,
    azimuth: int = 1,
    range: int = 1,
    *,
    overlap: float = 0.0,
    channel: str | None = None,
) -> Looks:
    r"""Mean power of sub-apertures (azimuth) and sub-bands (range).

    Without its carrier the processed band of the image is centred at zero; it is divided into parts, each weighted by
    the image's window over the part instead of the section of the whole window. Averaging pixels of one look
    (:meth:`sarmitsuba.SarImage.multilook`) reduces speckle less, since neighbouring pixels are correlated.

    .. math:: \mathrm{ENL} = \frac{n^2}{\sum_{ij} |\rho_{ij}|^2}, \qquad
              \rho_{ij} = \frac{\int W_i W_j}{\sqrt{\int W_i^2 \int W_j^2}}

    Parameters
    ----------
    image : focused
    azimuth, range : numbers of looks
    overlap : share of a look's band common with the next, 0 to 0.9
    channel : default: the first

    Returns
    -------
    Looks; the mean sigma0 of homogeneous ground is preserved, a point is wider and lower

    Raises
    ------
    DataError
        Fewer than one look, an overlap out of bounds, pixels too coarse for the image's band, or more looks than
        resolution cells.

    Notes
    -----
    The band is that of the image's centre; where the cell changes over a wide swath the outermost looks lose a small
    part of theirs. On a ground grid the range band likewise changes with the incidence angle.

    References
    ----------
    Cumming & Wong, Digital Processing of Synthetic Aperture Radar Data, 2005, section 6.5.
    """
    if azimuth < 1 or range < 1 or not 0.0 <= overlap <= 0.9:
        raise DataError(
            f"looks: {azimuth} x {range} with an overlap of {overlap:g}; give at least 1 x 1, and 0 to 0.9"
        )
    grid = image.grid
    cells = grid_cells(image, grid.range.size // 2)
    data = Carrier.of(image).removed(image.total(channel), slice(None), slice(None))
    sets, widths, enl = [], [], 1.0
    windows = windows_of(image)
    parts = (
        ("azimuth", azimuth, grid.azimuth_spacing, data.shape[0], cells[0], windows[0]),
        ("range", range, grid.range_spacing, data.shape[1], cells[1], windows[1]),
    )
    for name, n, spacing, size, cell, window in parts:
        plain = cell / window.broadening
        if n > size * spacing / plain:
            raise DataError(
                f"looks: {n} looks in {name} exceed the {size * spacing / plain:.3g} cells of the image"
            )
        if n > 1 and spacing / plain > _NYQUIST:
            raise DataError(
                f"looks: pixels of {spacing:g} m in {name} are too coarse for cells of {plain:.3g} m; focus with a "
                "finer --spacing"
            )
        weights, share = _bands(n, scipy.fft.fftfreq(size, spacing) * plain, window, overlap)
        enl *= _enl(weights * window(scipy.fft.fftfreq(size, spacing) * plain)) if n > 1 else 1.0
        sets.append(weights)
        widths.append(cell / share)
    spectrum = scipy.fft.fft2(data, workers=-1)
    total = np.zeros(data.shape)
    for row in sets[0]:
        for column in sets[1]:
            look = scipy.fft.ifft2(spectrum * row[:, None] * column, workers=-1)
            total += look.real**2 + look.imag**2
    n_looks = azimuth * range
    return Looks(
        total / (n_looks * image.cell_area),
        (azimuth, range),
        enl,
        widths[0],
        widths[1],
    )


def _bands(n: int, u: F64, window: Window, overlap: float) -> tuple[F64, float]:
    """Weights of each look over the FFT bins, (n, size), and a look's share of the band.

    Scaled so that the mean power of clutter is preserved.

    Parameters
    ----------
    n : looks
    u : (size,) frequencies of the bins, -1/2 ... 1/2 over the band
    window : of the image
    overlap : share of a look's band common with the next
    """
    if n == 1:
        return np.ones((1, u.size)), 1.0
    share = 1.0 / (n - (n - 1) * overlap)
    centers = -0.5 + share * (0.5 + (1.0 - overlap) * np.arange(n))
    whole = window(u)
    inverse = np.where(np.abs(u) <= 0.5, 1.0 / np.maximum(whole, _FLOOR * float(window(0.0))), 0.0)
    weights = window((u - centers[:, None]) / share) * inverse
    level = np.sum((weights * whole) ** 2, axis=1, keepdims=True)
    if not level.min() > 0.0:
        raise DataError(f"looks: {n} looks exceed the bins of the image's spectrum; give fewer")
    return np.asarray(weights * np.sqrt(np.sum(whole**2) / level)), share


def _enl(bands: F64) -> float:
    """Equivalent number of looks of bands, (n, size), for a white spectrum."""
    cross = bands @ bands.T
    norm = np.sqrt(np.outer(np.diag(cross), np.diag(cross)))
    return float(bands.shape[0] ** 2 / np.sum((cross / norm) ** 2))
