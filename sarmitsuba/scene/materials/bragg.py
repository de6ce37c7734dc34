"""Polarisation of first-order scattering by a slightly rough half space."""

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
    :func:`sarmitsuba.tracing.kernel.bistatic_dyads.bragg_dyad`.
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
