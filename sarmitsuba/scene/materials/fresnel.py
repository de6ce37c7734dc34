"""Fresnel reflection coefficients of a smooth half space, in NumPy and safe in every limit."""

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import C128


def refracted_cosine(cos_theta: ArrayLike, permittivity: complex | ArrayLike) -> C128:
    r"""Return the normal wavenumber inside the medium over k, the root that decays away from the surface.

    .. math:: q = \sqrt{\varepsilon - \sin^2\theta}, \quad \mathrm{Im}\, q \le 0

    Parameters
    ----------
    cos_theta : cosine of the incidence angle, 0 to 1
    permittivity : relative, eps' - j eps'' (time convention exp(+jwt))
    """
    c = np.asarray(cos_theta, dtype=np.float64)
    q = np.sqrt(np.asarray(permittivity, dtype=np.complex128) - 1.0 + c * c)
    return np.where(q.imag > 0.0, -q, q)


def fresnel(cos_theta: ArrayLike, permittivity: complex | ArrayLike) -> tuple[C128, C128]:
    r"""Reflection coefficients from vacuum onto a half space, electric field ratios.

    .. math::
        R_{TE} = \frac{1 - \varepsilon}{(\cos\theta + q)^2}, \quad
        R_{TM} = \frac{(\varepsilon - 1) ((\varepsilon + 1) \cos^2\theta - 1)}{(\varepsilon \cos\theta + q)^2}

    These are ``(c - q)/(c + q)`` and ``(eps c - q)/(eps c + q)`` with the difference taken analytically, so
    nothing cancels near the Brewster angle, at grazing incidence or for a permittivity close to one.

    Parameters
    ----------
    cos_theta : cosine of the incidence angle, 0 to 1, any shape
    permittivity : relative, eps' - j eps'', broadcast against ``cos_theta``

    Returns
    -------
    r_te, r_tm : complex128; at normal incidence ``r_te = -r_tm``; a permittivity of exactly one gives zeros

    Notes
    -----
    Ignores magnetic media, layers and roughness.

    References
    ----------
    Ulaby and Long, Microwave Radar and Radiometric Remote Sensing (2014); ITU-R P.2040-3.
    """
    c = np.asarray(cos_theta, dtype=np.float64)
    eps = np.asarray(permittivity, dtype=np.complex128)
    c, eps = np.broadcast_arrays(c, eps)
    empty = eps == 1.0
    eps = np.where(empty, 2.0, eps)  # arbitrary value: the result is replaced below
    q = refracted_cosine(c, eps)
    te_root, tm_root = c + q, eps * c + q
    te = (1.0 - eps) / te_root / te_root
    tm = (eps - 1.0) / tm_root * (((eps + 1.0) * c * c - 1.0) / tm_root)
    return np.where(empty, 0.0, te), np.where(empty, 0.0, tm)
