"""Interferometric phase: its mean from the geometry, and its statistics."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import quad
from scipy.special import gammaln, hyp2f1

from sarmitsuba.core.arrays import F64


def flat_earth_phase(
    first: ArrayLike, second: ArrayLike, point: ArrayLike, wavelength: float, passes: int = 2
) -> F64:
    r"""Interferometric phase of points, first image times the conjugate second, including the carriers, rad.

    .. math:: \phi = -\frac{2 \pi p}{\lambda} (|q - a_1| - |q - a_2|)

    Parameters
    ----------
    first, second : (3,) m; antennas, with one pass the receivers
    point : (..., 3) m
    wavelength : m
    passes : p, 2 or 1

    Notes
    -----
    The difference of the distances is taken as (b . (2 q - a_1 - a_2)) / (sum of them), which loses no digits. Bamler &
    Hartl, Inverse Problems 14 (1998), section 3.
    """
    a, b, q = (np.asarray(v, dtype=np.float64) for v in (first, second, point))
    total = np.linalg.norm(q - a, axis=-1) + np.linalg.norm(q - b, axis=-1)
    difference = ((2.0 * q - a - b) @ (b - a)) / total  # |q - a| - |q - b|
    return np.asarray(-2.0 * np.pi * passes / wavelength * difference)


def height_of_ambiguity(
    wavelength: float, slant_range: float, incidence: float, perpendicular: float, passes: int = 2
) -> float:
    r"""Height of ambiguity, m: :math:`\lambda R \sin\theta / (p B_\perp)`.

    Parameters
    ----------
    wavelength, slant_range, perpendicular : m
    incidence : rad
    passes : p, 2, or 1 with one transmitter and two receivers
    """
    return float(wavelength * slant_range * np.sin(incidence) / (passes * perpendicular))


def critical_baseline(
    wavelength: float,
    slant_range: float,
    incidence: float,
    range_cell: float,
    slope: float = 0.0,
    passes: int = 2,
) -> float:
    r"""Critical perpendicular baseline, from which range spectra do not overlap, m.

    .. math:: B_{crit} = \frac{\lambda R \tan(\theta - \alpha)}{p \delta_r}

    delta_r = c / 2 bandwidth; slope alpha (rad) rises away from the radar. Gatelli et al., IEEE TGRS 32 (1994).
    """
    return float(wavelength * slant_range * np.tan(incidence - slope) / (passes * range_cell))


def baseline_coherence(share: ArrayLike) -> F64:
    """Coherence of rough ground at a fraction of the critical baseline, for flat bands: 1 - share, not below 0.

    Zebker & Villasenor, IEEE TGRS 30 (1992).
    """
    return np.asarray(np.maximum(1.0 - np.abs(np.asarray(share, dtype=np.float64)), 0.0))


def temporal_coherence(days: ArrayLike, long_term: float, decay_days: float) -> F64:
    r"""Temporal coherence of two passes: a permanent part, and the exponential decay of the rest.

    .. math:: \gamma(t) = \gamma_\infty + (1 - \gamma_\infty) e^{-|t| / \tau}

    Parameters
    ----------
    days : t; 0 is one and the same time
    long_term : gamma_inf
    decay_days : tau; 0: at once

    Notes
    -----
    Ignores seasons, rain and tillage. Rocca, IEEE TGRS 45 (2007), for the decay; with a permanent part: Kellndorfer et
    al., Scientific Data 9 (2022). It multiplies the coherences of baseline and noise: Zebker & Villasenor, IEEE TGRS 30
    (1992).
    """
    t = np.abs(np.asarray(days, dtype=np.float64))
    left = np.exp(-t / decay_days) if decay_days > 0.0 else np.where(t > 0.0, 0.0, 1.0)
    return np.asarray(long_term + (1.0 - long_term) * left)


def slope_phase_ramp(
    wavelength: float, slant_range: float, incidence: float, perpendicular: float, slope: float
) -> float:
    r"""Phase per metre of the image plane on ground that rises away from the radar, rad/m, without flat earth.

    .. math:: \frac{d\phi}{dx_g} = k_z \frac{\tan\alpha}{1 - \tan\alpha / \tan\theta}, \qquad
              k_z = -\frac{4 \pi B_\perp}{\lambda R \sin\theta}

    A place x of height z = x tan(alpha) is imaged at x_g = x - z / tan(theta). Two passes, plane waves.

    Parameters
    ----------
    wavelength, slant_range, perpendicular : m
    incidence, slope : theta and alpha, rad
    """
    wavenumber = -4.0 * np.pi * perpendicular / (wavelength * slant_range * np.sin(incidence))
    return float(wavenumber * np.tan(slope) / (1.0 - np.tan(slope) / np.tan(incidence)))


def wall_phase_ramp(wavelength: float, slant_range: float, incidence: float, perpendicular: float) -> float:
    r"""Change of phase per metre of slant range over a laid-over vertical wall, rad/m, flat earth removed.

    .. math:: \frac{d\phi}{dR} = \frac{4 \pi B_\perp}{\lambda R \sin\theta \cos\theta}

    A place z up the wall is imaged z cos(theta) nearer than its foot. Two passes, plane waves.
    """
    return float(
        4.0 * np.pi * perpendicular / (wavelength * slant_range * np.sin(incidence) * np.cos(incidence))
    )


def interferometric_phase_pdf(phase: ArrayLike, coherence: float, looks: float = 1.0) -> F64:
    r"""Probability density of the interferometric phase about its mean, 1/rad.

    .. math:: p(\phi) = \frac{\Gamma(n + 1/2) (1 - \gamma^2)^n \beta}{2 \sqrt\pi\, \Gamma(n) (1 - \beta^2)^{n + 1/2}}
              + \frac{(1 - \gamma^2)^n}{2\pi} {}_2F_1(n, 1; \tfrac12; \beta^2), \qquad \beta = \gamma \cos\phi

    Parameters
    ----------
    phase : rad
    coherence : gamma, 0 <= gamma < 1
    looks : n > 0, independent

    Notes
    -----
    Of Gaussian (fully developed) speckle. Lee, Hoppel, Mango & Miller, IEEE TGRS 32 (1994), eq. 20.
    """
    beta = coherence * np.cos(np.asarray(phase, dtype=np.float64))
    loss = (1.0 - coherence**2) ** looks
    ratio = np.exp(gammaln(looks + 0.5) - gammaln(looks))
    first = ratio * loss * beta / (2.0 * np.sqrt(np.pi) * (1.0 - beta**2) ** (looks + 0.5))
    return np.asarray(first + loss / (2.0 * np.pi) * hyp2f1(looks, 1.0, 0.5, beta**2))


def interferometric_phase_cdf(phase: ArrayLike, coherence: float, looks: float = 1.0) -> F64:
    """Probability that the interferometric phase lies below values in -pi ... pi; integral of its density."""
    axis = np.linspace(-np.pi, np.pi, 8001)
    density = interferometric_phase_pdf(axis, coherence, looks)
    step = axis[1] - axis[0]
    total = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * step)])
    return np.asarray(np.interp(np.asarray(phase, dtype=np.float64), axis, total / total[-1]))


def interferometric_phase_sigma(coherence: float, looks: float = 1.0) -> float:
    """Standard deviation of the interferometric phase, rad, from its density."""
    value, _ = quad(
        lambda phase: phase**2 * float(interferometric_phase_pdf(phase, coherence, looks)),
        -np.pi,
        np.pi,
        points=(0.0,),
        limit=200,
    )
    return float(np.sqrt(value))


def coherence_pdf(sample: ArrayLike, coherence: float, looks: float) -> F64:
    r"""Probability density of the sample coherence d.

    .. math:: p(d) = 2 (n - 1) (1 - \gamma^2)^n d (1 - d^2)^{n - 2} {}_2F_1(n, n; 1; d^2 \gamma^2)

    Touzi, Lopes, Bruniquel & Vachon, IEEE TGRS 37 (1999), eq. 9; looks n > 1.
    """
    d = np.asarray(sample, dtype=np.float64)
    # Euler's transformation: the series' growth taken out, so that many looks do not overflow
    base = 1.0 - (d * coherence) ** 2
    series = hyp2f1(1.0 - looks, 1.0 - looks, 1.0, (d * coherence) ** 2)
    loss = np.exp(looks * np.log1p(-(coherence**2)) + (1.0 - 2.0 * looks) * np.log(base))
    return np.asarray(2.0 * (looks - 1.0) * loss * d * (1.0 - d**2) ** (looks - 2.0) * series)


def expected_coherence(coherence: float, looks: float) -> float:
    """Mean of the sample coherence, biased high for low coherence; from `coherence_pdf`, n > 2."""
    value, _ = quad(
        lambda d: d * float(coherence_pdf(d, coherence, looks)), 0.0, 1.0, points=(coherence,), limit=400
    )
    return float(value)


def rms_coherence(coherence: float, looks: float) -> float:
    r"""Root mean square of the sample coherence, for any number of looks n >= 1.

    .. math:: \langle d^2 \rangle = 1 - \frac{n - 1}{n} (1 - \gamma^2)\, {}_2F_1(1, 1; n + 1; \gamma^2)

    The second moment of `coherence_pdf`; sqrt(1 / n) without any coherence. Touzi et al., IEEE TGRS 37 (1999).
    """
    square = coherence**2
    return float(
        np.sqrt(1.0 - (looks - 1.0) / looks * (1.0 - square) * hyp2f1(1.0, 1.0, looks + 1.0, square))
    )
