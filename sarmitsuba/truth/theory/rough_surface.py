r"""Diffuse backscatter of rough surfaces, in the form of the publications: sums term by term, integrals by quadrature.

Slow and direct on purpose: the simulator's tables use closed spectra and rearranged coefficients, here nothing is
rearranged, so that an error in either becomes visible.
"""

from math import exp, factorial

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import quad
from scipy.special import j0

from sarmitsuba.core.arrays import F64
from sarmitsuba.truth.theory.half_space import fresnel, normal_wavenumber

# terms of the integral-equation series: (2 k s)^2 n / n! is below rounding there for k s up to 1.5
_TERMS = 60
# the correlation has fallen to exp(-40), below rounding, at this many correlation lengths
_FAR = 40.0


def height_spectrum(power: int, wavenumber: float, correlation_length: float) -> float:
    r"""Return the spectrum of the n-th power of an exponential correlation, m^2, by quadrature.

    .. math:: W^{(n)}(K) = \int_0^\infty e^{-n r / l} J_0(K r)\, r\, dr

    Parameters
    ----------
    power : n >= 1
    wavenumber : K, rad/m
    correlation_length : l, m
    """
    k_l = wavenumber * correlation_length / power
    value = quad(lambda x: np.exp(-x) * j0(k_l * x) * x, 0.0, _FAR, limit=400, epsabs=1e-13)[0]
    return float(value * (correlation_length / power) ** 2)


def small_perturbation_sigma0(
    incidence_angle: ArrayLike,
    permittivity: complex,
    wavenumber: float,
    rms_height: float,
    correlation_length: float,
) -> tuple[F64, F64]:
    r"""Return sigma0 of a slightly rough surface to first order, hh and vv; exponential correlation.

    .. math::
        \sigma^0_{pp} = 8 k^4 s^2 \cos^4\theta |\alpha_{pp}|^2 W(2 k \sin\theta), \quad
        \alpha_{hh} = \frac{\cos\theta - q}{\cos\theta + q}, \quad
        \alpha_{vv} = (\varepsilon - 1) \frac{\sin^2\theta - \varepsilon (1 + \sin^2\theta)}
        {(\varepsilon \cos\theta + q)^2}

    Parameters
    ----------
    incidence_angle : (n,) rad
    permittivity : relative, eps' - j eps''
    wavenumber : k, rad/m
    rms_height, correlation_length : s and l, m

    Notes
    -----
    Ignores everything beyond first order in k s: the specular lobe and cross polarisation.

    References
    ----------
    Ulaby, Moore and Fung, Microwave Remote Sensing, volume II (1982), chapter 12.
    """
    theta = np.atleast_1d(np.asarray(incidence_angle, dtype=np.float64))
    c, s2 = np.cos(theta), np.sin(theta) ** 2
    q = normal_wavenumber(c, permittivity)
    spectrum = np.array([height_spectrum(1, 2.0 * wavenumber * np.sin(t), correlation_length) for t in theta])
    common = 8.0 * wavenumber**4 * rms_height**2 * c**4 * spectrum
    alpha_h = (c - q) / (c + q)
    alpha_v = (permittivity - 1.0) * (s2 - permittivity * (1.0 + s2)) / (permittivity * c + q) ** 2
    return np.asarray(common * np.abs(alpha_h) ** 2), np.asarray(common * np.abs(alpha_v) ** 2)


def small_slope_sigma0(
    incidence_angle: ArrayLike,
    permittivity: complex,
    wavenumber: float,
    rms_height: float,
    correlation_length: float,
) -> tuple[F64, F64]:
    r"""Return sigma0 of the first small-slope approximation, hh and vv; exponential correlation, by quadrature.

    .. math::
        \sigma^0_{pp} = 8 k^4 \cos^4\theta |\alpha_{pp}|^2 \frac{e^{-Q^2 s^2}}{Q^2}
        \int_0^\infty (e^{Q^2 s^2 e^{-r/l}} - 1) J_0(2 k r \sin\theta)\, r\, dr, \quad Q = 2 k \cos\theta

    Parameters
    ----------
    incidence_angle : (n,) rad
    permittivity : relative, eps' - j eps''
    wavenumber : k, rad/m
    rms_height, correlation_length : s and l, m

    Notes
    -----
    Ignores the second order in the slopes, and with it cross polarisation in backscatter.

    References
    ----------
    Voronovich, Wave Scattering from Rough Surfaces (1999), chapter 6.
    """
    theta = np.atleast_1d(np.asarray(incidence_angle, dtype=np.float64))
    height2 = rms_height**2
    hh, vv = small_perturbation_sigma0(theta, permittivity, wavenumber, rms_height, correlation_length)
    for i, t in enumerate(theta):
        q2 = (2.0 * wavenumber * np.cos(t)) ** 2
        k_l = 2.0 * wavenumber * np.sin(t) * correlation_length

        def integrand(x: float, q2: float = q2, k_l: float = k_l) -> float:
            return float(np.expm1(q2 * height2 * np.exp(-x)) * j0(k_l * x) * x)

        whole = quad(integrand, 0.0, _FAR, limit=800, epsabs=1e-13)[0] * correlation_length**2
        first = height_spectrum(1, 2.0 * wavenumber * np.sin(t), correlation_length)
        ratio = np.exp(-q2 * height2) * whole / (q2 * height2 * first)
        hh[i], vv[i] = hh[i] * ratio, vv[i] * ratio
    return hh, vv


def integral_equation_sigma0(
    incidence_angle: ArrayLike,
    permittivity: complex,
    wavenumber: float,
    rms_height: float,
    correlation_length: float,
) -> tuple[F64, F64]:
    r"""Return sigma0 of the integral-equation model, hh and vv; exponential correlation.

    .. math::
        \sigma^0_{pp} = \tfrac{k^2}{2} e^{-2 k_z^2 s^2} \sum_{n \ge 1} \frac{s^{2n}}{n!}
        \left|(2 k_z)^n f_{pp} e^{-k_z^2 s^2} + \tfrac{k_z^n}{2} F_{pp}\right|^2 W^{(n)}(2 k \sin\theta)

    with ``f_vv = 2 R_v / cos``, ``f_hh = -2 R_h / cos``, the complementary ``F_pp`` of the reference, and in
    ``f`` the reflection coefficients of the transition model between the incidence angle and the normal.

    Parameters
    ----------
    incidence_angle : (n,) rad, below pi/2
    permittivity : relative, eps' - j eps''
    wavenumber : k, rad/m
    rms_height, correlation_length : s and l, m; k s up to 1.5

    Notes
    -----
    Ignores multiple scattering, shadowing and the phase terms of the improved model (I2EM).

    References
    ----------
    Fung, Li and Chen, IEEE TGRS 30 (2) 1992 (series and F_pp); Wu, Chen, Shi and Fung, IEEE TGRS 39 (9) 2001
    (transition).
    """
    theta = np.atleast_1d(np.asarray(incidence_angle, dtype=np.float64))
    pairs = [
        _integral_equation(float(t), permittivity, wavenumber, rms_height, correlation_length) for t in theta
    ]
    hh, vv = np.asarray(pairs, dtype=np.float64).T
    return hh, vv


def _integral_equation(theta: float, eps: complex, k: float, s: float, length: float) -> tuple[float, float]:
    sin2, cos2, c = float(np.sin(theta) ** 2), float(np.cos(theta) ** 2), float(np.cos(theta))
    k_z = k * c
    te, tm = (complex(r) for r in fresnel(c, eps))
    normal = complex(fresnel(1.0, eps)[1])
    spectra = [height_spectrum(n, 2.0 * k * float(np.sin(theta)), length) for n in range(1, _TERMS + 1)]
    rough = _transition(k_z * s, eps, c, sin2, normal, spectra)
    f_v = 2.0 * (tm + (normal - tm) * rough) / c
    f_h = -2.0 * (te + (-normal - te) * rough) / c
    big_v = 2.0 * sin2 * (1.0 + tm) ** 2 / c
    big_v *= (1.0 - 1.0 / eps) + (eps - sin2 - eps * cos2) / (eps * eps * cos2)
    big_h = -2.0 * sin2 * (1.0 + te) ** 2 / c * (eps - sin2 - cos2) / cos2
    sums = []
    for f, big in ((f_h, big_h), (f_v, big_v)):
        total = 0.0
        for n, spectrum in enumerate(spectra, 1):
            kirchhoff = (2.0 * k_z * s) ** n * f * exp(-((k_z * s) ** 2))
            total += abs(kirchhoff + (k_z * s) ** n * big / 2.0) ** 2 / factorial(n) * spectrum
        sums.append(0.5 * k * k * exp(-2.0 * (k_z * s) ** 2) * total)
    return sums[0], sums[1]


def _transition(
    phase: float, eps: complex, c: float, sin2: float, normal: complex, spectra: list[float]
) -> float:
    """Share of the normal-incidence coefficient, 1 - S / S_0 of the reference; ``phase`` is k_z s."""
    q = complex(normal_wavenumber(c, eps))
    slope = 8.0 * normal**2 * sin2 * (c + q) / (c * q)
    if slope == 0.0:  # at normal incidence both coefficients are the same
        return 0.0
    upper = lower = 0.0
    for n, spectrum in enumerate(spectra, 1):
        weight = phase ** (2 * n) / factorial(n) * spectrum
        upper += weight * abs(slope) ** 2 / 4.0
        lower += weight * abs(slope / 2.0 + 2.0 ** (n + 1) * normal / c * exp(-(phase**2))) ** 2
    share = 1.0 - upper / lower * abs(1.0 + 8.0 * normal / (c * slope)) ** 2
    return min(1.0, max(0.0, share))  # near the normal it falls below zero, which is meaningless


def shared_energy_sigma0(
    incidence_angle: ArrayLike, permittivity: complex, rms_phase: float
) -> tuple[F64, F64]:
    r"""Return sigma0 of a surface that scatters the power lost by its specular reflection into all directions.

    .. math::
        \sigma^0 = \frac{4 \cos^2\theta A(\theta)^2}{2 \int_0^1 A\, \mu\, d\mu}, \quad
        A = |R|^2 (1 - e^{-4 (k s \cos\theta)^2}), \quad \mu = \cos\theta

    Parameters
    ----------
    incidence_angle : (n,) rad
    permittivity : relative, eps' - j eps''
    rms_phase : k s

    Returns
    -------
    hh, vv : (n,) float64, with the TE and the TM reflectivity

    Notes
    -----
    Ignores the direction in which a rough surface prefers to scatter. Not a published law: it follows from
    reciprocity, conservation of energy at every angle, and dependence on one angle at a time.
    """
    theta = np.atleast_1d(np.asarray(incidence_angle, dtype=np.float64))

    def taken(cosine: ArrayLike, i: int) -> F64:
        mu = np.asarray(cosine, dtype=np.float64)
        reflectivity = np.abs(fresnel(mu, permittivity)[i]) ** 2
        return np.asarray(reflectivity * (1.0 - np.exp(-4.0 * (rms_phase * mu) ** 2)))

    pair = []
    for i in (0, 1):
        mean = 2.0 * quad(lambda mu, i=i: float(taken(mu, i)) * mu, 0.0, 1.0, limit=200)[0]
        pair.append(np.asarray(4.0 * (np.cos(theta) * taken(np.cos(theta), i)) ** 2 / mean))
    return pair[0], pair[1]
