"""Polarisation of first-order scattering by a slightly rough half space."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.materials.fresnel import fresnel, refracted_cosine

F64 = NDArray[np.float64]


def bragg_factors(theta: F64, permittivity: complex) -> tuple[F64, F64]:
    r"""Polarisation factors ``cos^4 |alpha|^2`` of backscatter, hh and vv.

    .. math::
        \alpha_{hh} = R_{TE}, \quad
        \alpha_{vv} = (\varepsilon - 1) \frac{\sin^2\theta - \varepsilon (1 + \sin^2\theta)}
        {(\varepsilon \cos\theta + q)^2}

    Source: Ulaby, Moore and Fung, Microwave Remote Sensing, volume II (1982), chapter 12. Between any two directions:
    :func:`sarmitsuba.trace.bistatic.bragg_dyad`.
    """
    c, sin2 = np.cos(theta), np.sin(theta) ** 2
    q = refracted_cosine(c, permittivity)
    alpha_h, _ = fresnel(c, permittivity)
    alpha_v = (permittivity - 1.0) * (sin2 - permittivity * (1.0 + sin2)) / (permittivity * c + q) ** 2
    return np.abs(c**2 * alpha_h) ** 2, np.abs(c**2 * alpha_v) ** 2


__all__ = ["bragg_factors"]
