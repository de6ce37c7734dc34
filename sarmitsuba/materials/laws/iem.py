"""Integral-equation model of a rough surface: co-polar backscatter, single scattering."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaln

from sarmitsuba.materials.fresnel import refracted_cosine

Correlation = Literal["exponential", "gaussian"]

# Poisson weights further than this many standard deviations from the mean are below float64 rounding
_SERIES_WIDTH = 10.0


def roughness_spectrum(
    order: NDArray[np.float64], wavenumber: float, length: float, correlation: Correlation
) -> NDArray[np.float64]:
    r"""Spectrum of the n-th power of the normalised surface correlation, m^2.

    .. math::
        W^{(n)}(K) = \frac{1}{2\pi} \int \rho^n(r)\, e^{jK\cdot r}\, d^2r
        = \frac{(l/n)^2}{(1 + (K l/n)^2)^{3/2}} \text{ (exponential)}, \quad
        \frac{l^2}{2n} e^{-(K l)^2/(4n)} \text{ (Gaussian)}

    Parameters
    ----------
    order : n >= 1, float64
    wavenumber : K, rad/m
    length : correlation length l, m
    """
    scaled = wavenumber * length
    if correlation == "gaussian":
        return np.asarray(length**2 / (2.0 * order) * np.exp(-(scaled**2) / (4.0 * order)))
    return np.asarray((length / order) ** 2 * (1.0 + (scaled / order) ** 2) ** -1.5)


def iem_backscatter(
    theta: ArrayLike,
    permittivity: complex,
    wavenumber: float,
    rms_height: float,
    correlation_length: float,
    correlation: Correlation = "exponential",
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""Return sigma0 (linear) for hh and vv by the integral-equation model with transition reflectivity.

    .. math::
        \sigma^0_{pp} = \tfrac{k^2}{2} e^{-2 k_z^2 s^2} \sum_{n\ge1} \frac{s^{2n}}{n!} |I^n_{pp}|^2
        W^{(n)}(2 k \sin\theta), \qquad
        I^n_{pp} = (2 k_z)^n f_{pp} e^{-k_z^2 s^2} + \tfrac{k_z^n}{2} F_{pp}

    with ``f_vv = 2 R_v / cos``, ``f_hh = -2 R_h / cos`` and the complementary terms ``F_pp`` of the
    reference. The reflection coefficients in ``f_pp`` go from Fresnel at the incidence angle (smooth) to
    Fresnel at normal incidence (rough) by the transition function of Wu et al.

    Parameters
    ----------
    theta : (n,) incidence angle, rad, 0 <= theta < pi/2
    permittivity : relative, eps' - j eps''
    wavenumber : k, rad/m
    rms_height, correlation_length : s and l, m

    Notes
    -----
    Ignores multiple scattering (so gives no cross polarisation), shadowing and the phase terms that the
    improved model (I2EM, 2002) adds: with those the small-perturbation limit is the same, but the
    geometrical-optics limit is missed (by 0.9 dB at 30 degrees for a slope of 0.2), whereas this form meets
    both.

    References
    ----------
    Fung, Li and Chen, IEEE TGRS 30 (2) 1992; Wu, Chen, Shi and Fung, IEEE TGRS 39 (9)
    2001 (transition function); Fung and Chen, Microwave Scattering and Emission Models for Users (2010).
    """
    angles = np.atleast_1d(np.asarray(theta, dtype=np.float64))
    sigma_h, sigma_v = np.empty_like(angles), np.empty_like(angles)
    for i, angle in enumerate(angles):
        sigma_h[i], sigma_v[i] = _one_angle(
            float(angle), permittivity, wavenumber, rms_height, correlation_length, correlation
        )
    return sigma_h, sigma_v


def _one_angle(
    theta: float, eps: complex, k: float, s: float, length: float, correlation: Correlation
) -> tuple[float, float]:
    sin2, c = float(np.sin(theta) ** 2), float(np.cos(theta))
    q = complex(refracted_cosine(c, eps))
    r_h = (1.0 - eps) / (c + q) ** 2
    r_v = (eps - 1.0) * ((eps + 1.0) * c * c - 1.0) / (eps * c + q) ** 2
    x = (k * s * c) ** 2  # (k_z s)^2; the series is Poisson-like with means from x to 4 x
    first = max(1, int(x - _SERIES_WIDTH * np.sqrt(x)))
    last = int(4.0 * x + 2.0 * _SERIES_WIDTH * np.sqrt(x)) + 30
    n = np.arange(first, last + 1, dtype=np.float64)
    spectrum = roughness_spectrum(n, 2.0 * k * float(np.sin(theta)), length, correlation)
    log_poisson = n * np.log(4.0 * x) - gammaln(n + 1.0)

    transition = _transition(n, log_poisson, spectrum, x, eps, sin2, c, q)
    r_0 = (eps - 1.0) / (np.sqrt(complex(eps)) + 1.0) ** 2
    f_v = 2.0 * (r_v + (r_0 - r_v) * transition) / c
    f_h = -2.0 * (r_h + (-r_0 - r_h) * transition) / c
    t_h = 2.0 * c / (c + q)  # 1 + R_h
    t_v = 2.0 * eps * c / (eps * c + q)  # 1 + R_v
    # complementary terms at backscatter, magnetic permeability one; eps - sin^2 - eps cos^2 = (eps - 1) sin^2
    big_v = 2.0 * sin2 * t_v**2 / c * (1.0 - 1.0 / eps) * (1.0 + sin2 / (eps * c * c))
    big_h = -2.0 * sin2 * t_h**2 / c * (eps - 1.0) / (c * c)
    sigma = []
    for f, big in ((f_h, big_h), (f_v, big_v)):
        # |(2 k_z s)^n (f e^-x + 2^-n F/2)|^2 e^-2x / n!, exponents gathered so that nothing overflows
        term = f * np.exp(0.5 * log_poisson - 2.0 * x) + 0.5 * big * np.exp(
            0.5 * log_poisson - x - n * np.log(2.0)
        )
        sigma.append(0.5 * k * k * float(np.sum(np.abs(term) ** 2 * spectrum)))
    return sigma[0], sigma[1]


def _transition(
    n: NDArray[np.float64],
    log_poisson: NDArray[np.float64],
    spectrum: NDArray[np.float64],
    x: float,
    eps: complex,
    sin2: float,
    c: float,
    q: complex,
) -> float:
    """Weight of the normal-incidence reflection coefficient: 0 smooth, 1 rough (Wu et al. 2001)."""
    r_0 = (eps - 1.0) / (np.sqrt(complex(eps)) + 1.0) ** 2
    slope_term = 8.0 * r_0**2 * sin2 * (c + q) / (c * q)
    if abs(slope_term) == 0.0:  # normal incidence: both coefficients are the same
        return 0.0
    # weights x^n / n! and (2^n e^-x)^2 x^n / n!; only their ratio matters: the top is taken out
    half = 0.5 * (log_poisson - n * np.log(4.0))
    boost = (n + 1.0) * np.log(2.0) - x
    top = float(np.max(half + np.maximum(boost, 0.0)))
    smooth, rough = np.exp(half - top), np.exp(half + boost - top)
    weight = smooth**2 * spectrum
    lower = float(np.sum(np.abs(0.5 * slope_term * smooth + r_0 / c * rough) ** 2 * spectrum))
    if lower == 0.0:
        return 0.0
    ratio = 0.25 * abs(slope_term) ** 2 * float(np.sum(weight)) / lower
    ratio_smooth = 1.0 / abs(1.0 + 8.0 * r_0 / (c * slope_term)) ** 2
    return float(np.clip(1.0 - ratio / ratio_smooth, 0.0, 1.0))


__all__ = ["Correlation", "iem_backscatter", "roughness_spectrum"]
