"""Spectral shift filter: the common band of both images of a pair for level ground."""

import numpy as np
import scipy.fft

from sarmitsuba.analysis.interferometry.baseline import Baseline
from sarmitsuba.analysis.interferometry.viewpoint import Viewpoint
from sarmitsuba.analysis.quality.widths import grid_cells, windows_of
from sarmitsuba.arrays import C128
from sarmitsuba.errors import DataError
from sarmitsuba.image.sar_image import SarImage


def common_band_pair(
    image: SarImage, pair: tuple[C128, C128], views: tuple[Viewpoint, Viewpoint], baseline: Baseline
) -> tuple[C128, C128, tuple[float, float]]:
    r"""Both images of a pair cut to the wavenumbers of level ground that both have.

    An image's spectrum is centred where its carrier 4 pi R_i / lambda turns. With the mean of both carriers removed
    the two bands lie half the shift to either side of zero, and the part that both have lies about zero on both.

    .. math:: \Delta = \frac{4\pi}{\lambda} \nabla (R_2 - R_1), \qquad W_{common} = W - |\Delta|

    Parameters
    ----------
    image : gives grid, cells and windows of both
    pair : (n_azimuth, n_range) complex128 each
    views : where they were seen from
    baseline : named in the error

    Returns
    -------
    both filtered, and the part of the band that is left in azimuth and range

    Raises
    ------
    DataError
        No common band is left.

    Notes
    -----
    For level ground at the image plane; the largest shift in the image is removed everywhere. Weights of the windows
    over the band stay as they are, so that of a strong window a little decorrelation stays too.

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
                f"interferogram: no common band is left: perpendicular baseline {baseline.perpendicular:.4g} m, "
                f"critical {baseline.critical:.4g} m; take a shorter baseline or the full band"
            )
        share.append(1.0 - shift)
        keep.append(np.abs(scipy.fft.fftfreq(grid.shape[axis], spacing)) * plain <= 0.5 * (1.0 - shift))
    mask = keep[0][:, None] & keep[1]
    one, two = (
        np.asarray(scipy.fft.ifft2(scipy.fft.fft2(values * carrier.conj()) * mask) * carrier)
        for values in pair
    )
    return one, two, (share[0], share[1])
