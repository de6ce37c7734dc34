"""Heights from interferometric phase: unwrapping, and geolocation of pixels by range, Doppler and phase."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.analysis.interferometry.interferogram import Interferogram
from sarmitsuba.analysis.interferometry.viewpoint import FixedAntennas
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError

# steps of Newton's method; each squares the error
_ROUNDS = 4
# least change of phase per metre of height, rad
_LEAST = 1e-6


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Scene points of all blocks of an interferogram.

    Parameters
    ----------
    points : (n_azimuth, n_range, 3) float64, m, frame of the user's file: x, y, z
    phase : (n_azimuth, n_range) float64, rad, of the points
    sigma : (n_azimuth, n_range) float64, m; standard deviation of z from coherence and looks
    coherence : (n_azimuth, n_range)
    height_of_ambiguity : m, at the grid's middle

    Notes
    -----
    In layover, where several surfaces share range and Doppler, the point lies between them, weighted by their power; in
    shadow it is meaningless, and its coherence low.
    """

    points: F64
    phase: F64
    sigma: F64
    coherence: F64
    height_of_ambiguity: float

    @property
    def z(self) -> F64:
        """Heights of the points, (n_azimuth, n_range) float64, m."""
        return self.points[..., 2]

    def __repr__(self) -> str:
        return f"HeightMap({self.z.shape[0]} x {self.z.shape[1]}, ambiguity {self.height_of_ambiguity:.4g} m)"


def unwrapped_phase(pair: Interferogram, least_coherence: float = 0.3) -> F64:
    """Unwrapped phase, rad; NaN where the coherence is below ``least_coherence``.

    By reliability sorting (Herraez et al., Applied Optics 41, 2002) from scikit-image. The multiple of 2 pi is chosen
    so that the median lies in -pi ... pi: most of the scene is assumed to be near the image plane.

    Raises
    ------
    DataError
        scikit-image is not installed, or all blocks are less coherent.

    Notes
    -----
    Steps of more than half the height of ambiguity between neighbours, such as tall walls, are unwrapped wrongly.
    """
    try:
        from skimage.restoration import unwrap_phase
    except ImportError as error:
        raise DataError(
            "interferogram: unwrapping needs scikit-image; pip install 'sarmitsuba[interferometry]'"
        ) from error
    low = pair.coherence < least_coherence
    if low.all():
        raise DataError(
            f"interferogram: no block has a coherence of {least_coherence:g}; lower the bound or use more looks"
        )
    found = np.ma.filled(unwrap_phase(np.ma.masked_array(pair.phase, mask=low), rng=0), np.nan)
    turns = np.round(np.nanmedian(found) / (2.0 * np.pi))
    return np.asarray(found - 2.0 * np.pi * turns, dtype=np.float64)


def height_map(pair: Interferogram, phase: F64 | None = None, *, lowest: float | None = None) -> HeightMap:
    r"""Position and height of every block: the point q with its range, Doppler and phase.

    .. math:: R_1(q) = R_1(p), \quad f_{D1}(q) = f_{D1}(p), \quad
              R_2(q) = R_2(p) + \frac{\lambda \phi}{4 \pi}

    Parameters
    ----------
    pair : the interferogram
    phase : (n_azimuth, n_range) rad, such as :func:`unwrapped_phase`; None: the wrapped phase, for heights from
        ``lowest`` to one height of ambiguity above it
    lowest : m, frame of the user's file; None: a tenth of the height of ambiguity below the image plane

    Raises
    ------
    DataError
        There is no perpendicular baseline.

    References
    ----------
    Madsen, Zebker & Martin, IEEE TGRS 31 (1993): position from range sphere, Doppler cone and phase cone.
    """
    step = pair.height_step()
    wavenumber = step[..., 2]
    ambiguity = pair.baseline.height_of_ambiguity
    if np.abs(wavenumber).min() < _LEAST or not np.isfinite(ambiguity):
        raise DataError(
            f"interferogram: heights need a perpendicular baseline; it is {pair.baseline.perpendicular:g} m"
        )
    plane = pair.grid.height + float(pair.grid.offset[2])
    if phase is None:
        low = -0.1 * ambiguity if lowest is None else lowest - plane
        turn = np.mod(pair.phase * np.sign(wavenumber) - low * np.abs(wavenumber), 2.0 * np.pi)
        phase = (turn + low * np.abs(wavenumber)) * np.sign(wavenumber)
    points = pair.positions()
    first, second = (view.look(points) for view in pair.views)
    wanted = (
        first.distance(points),
        first.sine(points),
        second.distance(points) + pair.wavelength / (4.0 * np.pi) * phase,
    )
    z = phase / wavenumber
    place = points + np.stack([step[..., 0] * z, step[..., 1] * z, z], axis=-1)
    known = np.isfinite(z)
    place[~known] = points[~known]
    for _ in range(_ROUNDS):
        place = place - _correction(first, second, place, wanted, known)
    place[~known] = np.nan
    coherence = pair.coherence
    return HeightMap(
        points=place,
        phase=phase,
        sigma=phase_sigma(coherence, pair.independent_looks) / np.abs(wavenumber),
        coherence=coherence,
        height_of_ambiguity=ambiguity,
    )


def _correction(
    first: FixedAntennas,
    second: FixedAntennas,
    place: F64,
    wanted: tuple[F64, F64, F64],
    known: NDArray[np.bool_],
) -> F64:
    """Newton step towards points of given range, sine and second range; zero where these are undefined."""
    missed = [
        found - value
        for found, value in zip(
            (first.distance(place), first.sine(place), second.distance(place)), wanted, strict=True
        )
    ]
    rows = (first.gradient(place), first.sine_gradient(place), second.gradient(place))
    # scale the last two rows: the gradient of a sine is of order 1 / range, the gradients of both ranges differ little
    scale = first.distance(place)
    matrix = np.stack([rows[0], rows[1] * scale[..., None], (rows[2] - rows[0]) * scale[..., None]], axis=-2)
    right = np.stack([missed[0], missed[1] * scale, (missed[2] - missed[0]) * scale], axis=-1)
    right[~known] = 0.0
    return np.asarray(np.linalg.solve(matrix, right[..., None])[..., 0])


def phase_sigma(coherence: F64, looks: float) -> F64:
    r"""Standard deviation of the phase, rad: the Cramer-Rao bound, at most that of a uniform phase.

    .. math:: \sigma_\phi = \min\left(\sqrt{\frac{1 - \gamma^2}{2 n \gamma^2}}, \frac{\pi}{\sqrt 3}\right)

    Rodriguez & Martin, IEE Proc. F 139 (1992); valid for more than about four looks.
    """
    square = np.clip(coherence, 1e-6, 1.0) ** 2
    return np.asarray(np.minimum(np.sqrt((1.0 - square) / (2.0 * looks * square)), np.pi / np.sqrt(3.0)))
