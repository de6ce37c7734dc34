"""Spectra of slightly rough surfaces, and the polarisation of their first-order scattering."""

from typing import Literal

import numpy as np

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.scene.materials.fresnel import fresnel, refracted_cosine


def bragg_factors(theta: F64, permittivity: complex) -> tuple[F64, F64]:
    r"""Polarisation factors ``cos^4 |alpha|^2`` of backscatter, hh and vv.

    .. math::
        \alpha_{hh} = R_{TE}, \quad
        \alpha_{vv} = (\varepsilon - 1) \frac{\sin^2\theta - \varepsilon (1 + \sin^2\theta)}
        {(\varepsilon \cos\theta + q)^2}

    Source: Ulaby, Moore and Fung, Microwave Remote Sensing, volume II (1982), chapter 12. Between any two directions:
    :func:`sarmitsuba.tracing.kernel.scattering_matrix.bragg_dyad`.
    """
    amplitude_h, amplitude_v = bragg_amplitudes(np.cos(theta), permittivity)
    return np.abs(amplitude_h) ** 2, np.abs(amplitude_v) ** 2


def bragg_amplitudes(cos_theta: F64, permittivity: complex) -> tuple[C128, C128]:
    """``cos^2 alpha`` of hh and vv at cosines of the incidence angle; see `bragg_factors`."""
    c, sin2 = cos_theta, 1.0 - cos_theta**2
    q = refracted_cosine(c, permittivity)
    alpha_h, _ = fresnel(c, permittivity)
    alpha_v = (permittivity - 1.0) * (sin2 - permittivity * (1.0 + sin2)) / (permittivity * c + q) ** 2
    return c**2 * alpha_h, c**2 * alpha_v


Correlation = Literal["exponential", "gaussian"]


def roughness_spectrum(order: F64, wavenumber: float | F64, length: float, correlation: Correlation) -> F64:
    r"""Spectrum of the n-th power of the normalised surface correlation, m^2.

    .. math::
        W^{(n)}(K) = \frac{1}{2\pi} \int \rho^n(r)\, e^{jK\cdot r}\, d^2r
        = \frac{(l/n)^2}{(1 + (K l/n)^2)^{3/2}} \text{ (exponential)}, \quad
        \frac{l^2}{2n} e^{-(K l)^2/(4n)} \text{ (Gaussian)}

    Parameters
    ----------
    order : n >= 1, float64
    wavenumber : K, rad/m; an array of the shape of ``order``, or that broadcasts with it
    length : correlation length l, m
    """
    scaled = wavenumber * length
    if correlation == "gaussian":
        return np.asarray(length**2 / (2.0 * order) * np.exp(-(scaled**2) / (4.0 * order)))
    return np.asarray((length / order) ** 2 * (1.0 + (scaled / order) ** 2) ** -1.5)
