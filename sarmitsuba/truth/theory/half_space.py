r"""Reflection of a plane wave by a smooth half space, from the wave admittances on both sides.

A wave whose wave vector makes the cosine c with the normal meets the surface as a current meets a line's
termination: tangential E over tangential H is its wave impedance, and the power that the second medium does not take is
reflected. The package's coefficients are written otherwise (``materials``, ``trace``); nothing is shared.
"""

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import C128, F64


def normal_wavenumber(cos_theta: ArrayLike, permittivity: complex | ArrayLike) -> C128:
    r"""Return the normal wavenumber of the refracted wave over k.

    .. math:: q = \sqrt{\varepsilon - \sin^2\theta}, \quad \mathrm{Im}\, q \le 0

    so that with exp(+jwt) the wave decays away from the surface.

    Parameters
    ----------
    cos_theta : cosine of the incidence angle in vacuum, 0 to 1
    permittivity : relative, eps' - j eps''
    """
    c = np.asarray(cos_theta, dtype=np.float64)
    eps = np.asarray(permittivity, dtype=np.complex128)
    q = np.sqrt((eps - 1.0) + c * c)  # phase matching along the surface
    return np.asarray(np.where(q.imag > 0.0, -q, q))


def fresnel(cos_theta: ArrayLike, permittivity: complex | ArrayLike) -> tuple[C128, C128]:
    r"""Return the TE and TM reflection coefficients of a half space, seen from vacuum.

    .. math::
        R_{TE} = \frac{Y_1 - Y_2}{Y_1 + Y_2}, \; Y_1 = \cos\theta, \; Y_2 = q; \qquad
        R_{TM} = \frac{Z_1 - Z_2}{Z_1 + Z_2}, \; Z_1 = \cos\theta, \; Z_2 = q / \varepsilon

    with admittances over and impedances by that of free space. TE is the ratio of the electric, TM of the
    magnetic fields: a conductor gives -1 and +1.

    Parameters
    ----------
    cos_theta : cosine of the incidence angle, 0 to 1, any shape
    permittivity : relative, eps' - j eps'', not zero; broadcast against ``cos_theta``

    Notes
    -----
    Ignores magnetic media, layers and roughness. The differences are taken as they stand: for a permittivity
    within 1e-12 of one only four digits are left.

    References
    ----------
    Ramo, Whinnery and Van Duzer, Fields and Waves in Communication Electronics (1994), section 6.10: wave
    impedances at oblique incidence.
    """
    c, eps = np.broadcast_arrays(
        np.asarray(cos_theta, dtype=np.float64), np.asarray(permittivity, dtype=np.complex128)
    )
    q = normal_wavenumber(c, eps)
    return _mismatch(c, q), _mismatch(c, q / eps)


def _mismatch(first: F64, second: C128) -> C128:
    """(first - second) / (first + second), zero where both vanish: no surface, at grazing incidence."""
    total = first + second
    none = total == 0.0
    return np.asarray(np.where(none, 0.0, (first - second) / np.where(none, 1.0, total)))
