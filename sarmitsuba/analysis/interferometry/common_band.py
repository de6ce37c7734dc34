"""Spectral shift filter: the common band of both images of a pair for level ground."""

import numpy as np
import scipy.fft

from sarmitsuba.analysis.interferometry.baseline import Baseline
from sarmitsuba.analysis.interferometry.viewpoint import Viewpoint
from sarmitsuba.analysis.quality.widths import grid_cells, windows_of
from sarmitsuba.core.arrays import C128
from sarmitsuba.core.errors import DataError
from sarmitsuba.signal.image.sar_image import SarImage


def common_band_pair(
    image: SarImage, pair: tuple[C128, C128], views: tuple[Viewpoint, Viewpoint], baseline: Baseline
) -> tuple[C128, C128, tuple[float, float]]:
    r"""Both images of a pair filtered to the common wavenumbers of level ground.

    The spectrum of an image is centred at the spatial frequency of its carrier 4 pi R_i / lambda. With the mean of both
    carriers removed, the bands are shifted by half the difference to either side of zero, and the common band is
    centred at zero.

    .. math:: \Delta = \frac{4\pi}{\lambda} \nabla (R_2 - R_1), \qquad W_{common} = W - |\Delta|

    Parameters
    ----------
    image : with the grid, cells and windows of both
    pair : (n_azimuth, n_range) complex128 each
    views : phase centres of both
    baseline : for the error message

    Returns
    -------
    both images filtered, and the remaining share of the band in azimuth and range

    Raises
    ------
    DataError
        There is no common band.

    Notes
    -----
    For level ground at the image plane; the largest shift in the image is removed everywhere. The windows' weights over
    the band are not changed, so that a strong window leaves a small decorrelation.

    References
    ----------
    Gatelli et al., The wavenumber shift in SAR interferometry, IEEE TGRS 32 (1994).
    """
    grid = image.grid
    points = grid.positions() + grid.offset
    near, far = (view.distance(points) for view in views)
    carrier = np.exp(2j * np.pi / image.wavelength * (near + far))
    difference = near - far
    cells = grid_cells(image, grid.shape[1] // 2)
    spacings = (grid.azimuth_spacing, grid.range_spacing)
    share, keep = [], []
    for axis, (cell, spacing, window) in enumerate(zip(cells, spacings, windows_of(image), strict=True)):
        plain = cell / window.broadening
        slope = np.diff(difference, axis=axis) / spacing
        # of the band, cycles per metre times the cell: two-way
        shift = 2.0 / image.wavelength * float(np.abs(slope).max()) * plain if slope.size else 0.0
        if shift >= 1.0:
            raise DataError(
                f"interferogram: no common band: perpendicular baseline {baseline.perpendicular:.4g} m, critical "
                f"{baseline.critical:.4g} m; choose a shorter baseline or the full band"
            )
        share.append(1.0 - shift)
        keep.append(np.abs(scipy.fft.fftfreq(grid.shape[axis], spacing)) * plain <= 0.5 * (1.0 - shift))
    mask = keep[0][:, None] & keep[1]
    one, two = (
        np.asarray(scipy.fft.ifft2(scipy.fft.fft2(values * carrier.conj()) * mask) * carrier)
        for values in pair
    )
    return one, two, (share[0], share[1])
