"""Integral-equation model of a rough surface: co-polar backscatter, single scattering."""

import numpy as np
import scipy
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.scene.materials.diffuse_law import (
    LAWS,
    DiffuseLaw,
    Sigma0,
    Surface,
    correlation_length_of,
    permittivity_of,
)
from sarmitsuba.scene.materials.fresnel import refracted_cosine
from sarmitsuba.scene.materials.laws.small_slope import small_slope_spectrum
from sarmitsuba.scene.materials.rough_surface import Correlation, roughness_spectrum

# largest k s of the series; its length grows with (k s)^2, and the model is valid up to about 3
_LARGEST_ROUGHNESS = 100.0
# Poisson weights further than this many standard deviations from the mean are below float64 rounding
_SERIES_WIDTH = 10.0


def iem_backscatter(
    theta: ArrayLike,
    permittivity: complex,
    wavenumber: float,
    rms_height: float,
    correlation_length: float,
    correlation: Correlation = "exponential",
) -> tuple[F64, F64]:
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
    log_poisson = n * np.log(4.0 * x) - scipy.special.gammaln(n + 1.0)

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
    n: F64,
    log_poisson: F64,
    spectrum: F64,
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


class IntegralEquation(DiffuseLaw):
    """Integral-equation model, exponential correlation; from slightly rough to very rough surfaces."""

    name = "iem"
    title = "integral-equation model, from slightly to very rough"
    needs = ("rms_height", "correlation_length")
    bistatic = "spectrum"

    def spectrum(
        self,
        surface: Surface,
        wavelength: float,
        sine: F64,
        cosine: F64,
    ) -> F64:
        """See `small_slope_spectrum`: it and this law agree for small heights and about the mirror direction."""
        k, s = 2.0 * np.pi / wavelength, surface.rms_height
        if k * s < 1e-12:
            return np.zeros((cosine.size, sine.size))
        return small_slope_spectrum(sine, cosine, k, s, correlation_length_of(surface, self.name))

    def sigma0(self, surface: Surface, wavelength: float, theta: F64) -> Sigma0:
        """See `iem_backscatter`."""
        length = correlation_length_of(surface, self.name)
        k, s = 2.0 * np.pi / wavelength, surface.rms_height
        if k * s < 1e-12:  # returns less than -240 dB
            return Sigma0.none(theta)
        if k * s > _LARGEST_ROUGHNESS:
            raise SceneError(
                f'material "{surface.name}": rms_height = {s:g} m is k s = {k * s:.3g}, above '
                f"{_LARGEST_ROUGHNESS:g}, where the integral-equation model is invalid; set diffuse_law to kirchhoff "
                "or lambert"
            )
        notes = []
        if k * s > 3.0:
            notes.append(f"k s = {k * s:.3g} is above 3; use kirchhoff or lambert")
        if s / length > 0.4:
            notes.append(
                f"s / l = {s / length:.3g} is above 0.4, multiple scattering matters; lengthen correlation_length"
            )
        grazing = theta > np.radians(89.99)  # a removable 0/0 at 90 degrees, where sigma0 is zero
        sigma_h, sigma_v = np.zeros_like(theta), np.zeros_like(theta)
        h, v = iem_backscatter(theta[~grazing], permittivity_of(surface), k, s, length)
        sigma_h[~grazing], sigma_v[~grazing] = h, v
        return Sigma0(sigma_h, sigma_v, 0.0, np.radians(70.0), tuple(notes))


LAWS.register(IntegralEquation())
