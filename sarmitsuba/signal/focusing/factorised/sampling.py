"""Sampling density and interpolation of subimages, and the resulting error."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sarmitsuba.core.arrays import F32, F64
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.signal.gridding import gridding_kernel

TAPS = 8
"""Taps of the interpolation over angle that refines a subimage."""
RATIOS = (8, 4, 2)
"""Ratios of angular spacings of a subimage and the merged one; few, because they are literals of the kernel."""

ROW_BAND = 0.05
"""Widening of the band in range, along rows of the image that are not radial, up to which the last interpolation is in
angle on the rows first and along the rows then."""

UPSAMPLING = (1.5, 4.0)
"""Bounds of the upsampling: below the first, the correction of the last interpolation needs more taps than it has."""
CORRECTION = 6
"""Samples on either side used by the correction of the last interpolation."""

# of range profiles at twice the receiver's rate, as benchmarks/suite/focusers.py measures it, by taps
_PROFILE_ERROR_DB = {4: -66.0, 6: -105.0}
# (upsampling, taps of the last interpolation) in the order of their cost
_CHOICES = ((1.75, 4), (1.9, 4), (2.0, 4), (2.0, 6), (2.5, 6))
# float32 sums and phases
_ROUNDING_DB = -90.0
# margin between the predicted error and the stated one
MARGIN_DB = 3.0
_NODES = 64
# of the polynomials of weights along rows
_DEGREE = 6


@dataclass(frozen=True)
class SubimageSampling:
    """Density of subimages and the interpolations between them.

    Parameters
    ----------
    upsampling : samples per critical sample of all subimages, in angle and in range
    width : taps of the range profiles' and of the last interpolation
    """

    upsampling: float
    width: int

    @property
    def interpolation(self) -> str:
        """Name of the range profiles' interpolation."""
        return f"kernel:{self.width}"

    def error_db(self, merges: int) -> float:
        """Predicted rms error, dB, of an image whose spectrum fills the band, after that many mergers.

        The range profiles', the mergers', that along rows, and twice (angle and range) the last interpolation's error
        add in power.
        """
        return _error_db(self, merges)


@lru_cache(maxsize=64)
def _error_db(sampling: SubimageSampling, merges: int) -> float:
    power = power_from_db(_PROFILE_ERROR_DB[sampling.width]) + power_from_db(_ROUNDING_DB)
    power += merges * refinement_error(sampling.upsampling) ** 2
    power += refinement_error(sampling.upsampling / (1.0 + ROW_BAND)) ** 2
    nu = np.linspace(0.0, 0.5 / sampling.upsampling, _NODES)
    power += 2.0 * float(np.mean(gridding_kernel(sampling.width).aliasing(nu) ** 2))
    return db_from_power(power)


def choose_sampling(error_db: float, upsampling: float, merges: int) -> SubimageSampling:
    """The cheapest sampling with a predicted error ``MARGIN_DB`` below the wanted one; else that of least error."""
    choices = [SubimageSampling(*choice) for choice in _CHOICES]
    if upsampling:
        choices = [SubimageSampling(upsampling, 4), SubimageSampling(upsampling, 6)]
    for choice in choices:
        if choice.error_db(merges) <= error_db - MARGIN_DB:
            return choice
    return choices[-1]


@lru_cache(maxsize=64)
def refinement_weights(upsampling: float, ratio: int) -> tuple[tuple[float, ...], ...]:
    r"""Weights (ratio, TAPS) of a sample's neighbours at the places (j + 1/2) / ratio after the middle left one.

    Of all sets of weights the one with the least mean error over the band :math:`|\nu| < \nu_0 = 1 / 2 u`:

    .. math:: \sum_l \mathrm{sinc}(2 \nu_0 (k - l)) w_l = \mathrm{sinc}(2 \nu_0 (k - x))
    """
    places = (np.arange(ratio) + 0.5) / ratio
    return tuple(tuple(float(w) for w in row) for row in _least_squares(upsampling, places))


def _least_squares(upsampling: float, places: F64) -> F64:
    """Weights (n, TAPS) of :func:`refinement_weights` at places (n,) after the middle left sample, in samples."""
    band = 1.0 / upsampling
    k = np.arange(TAPS) - (TAPS // 2 - 1)
    normal = np.sinc(band * (k[:, None] - k))
    # regularisation: keeps ill-determined weights small
    right = np.sinc(band * (k[:, None] - places))
    return np.asarray(np.linalg.solve(normal + 1e-11 * np.eye(TAPS), right).T)


@lru_cache(maxsize=64)
def row_polynomials(upsampling: float) -> tuple[tuple[tuple[float, ...], tuple[float, ...]], ...]:
    r"""Polynomials of the least-squares weights of neighbours in :math:`t = x - 1/2`, for any place x between samples.

    For each pair of neighbours k and ``TAPS - 1 - k`` the even and the odd coefficients in t: their weights are the sum
    and the difference of the two parts. Errors of the fit are below -110 dB.
    """
    nodes = 0.5 * np.cos(np.pi * (np.arange(64) + 0.5) / 64)
    weights = _least_squares(upsampling / (1.0 + ROW_BAND), nodes + 0.5)
    # in 2 t, for the fit's conditioning
    fit = (
        np.polynomial.polynomial.polyfit(2.0 * nodes, weights, _DEGREE)
        * 2.0 ** np.arange(_DEGREE + 1)[:, None]
    )
    return tuple((tuple(map(float, fit[0::2, k])), tuple(map(float, fit[1::2, k]))) for k in range(TAPS // 2))


@lru_cache(maxsize=64)
def refinement_error(upsampling: float) -> float:
    """Relative rms error of the refinement over band and places."""
    nu = np.linspace(-0.5 / upsampling, 0.5 / upsampling, _NODES)
    ratio = RATIOS[0]
    k = np.arange(TAPS) - (TAPS // 2 - 1)
    x = (np.arange(ratio) + 0.5) / ratio
    value = np.exp(2j * np.pi * np.outer(nu, k)) @ np.transpose(refinement_weights(upsampling, ratio))
    return float(np.sqrt(np.mean(np.abs(value - np.exp(2j * np.pi * np.outer(nu, x))) ** 2)))


def correction(sampling: SubimageSampling, n: int) -> F32:
    """Gains of an FFT's n bins that divide out the last interpolation's transform within the band.

    A filter of ``2 CORRECTION + 1`` taps, so that the ends of a subimage affect no more samples: least-squares fit, in
    the band, to the inverse of the kernel's transform.
    """
    order = np.arange(CORRECTION + 1)
    nu = np.linspace(0.0, 0.5 / sampling.upsampling, 8 * _NODES)
    transform = gridding_kernel(sampling.width).transform(nu)
    terms = np.cos(2.0 * np.pi * np.outer(nu, order)) * transform[:, None]
    taps = np.linalg.lstsq(terms, np.ones_like(nu), rcond=None)[0]
    cosines = np.cos(2.0 * np.pi * np.outer(np.fft.fftfreq(n), order))
    return np.asarray(cosines @ taps, dtype=np.float32)
