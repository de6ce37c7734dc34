"""Perfectly conducting sphere: exact Mie series and the physical-optics closed form."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import spherical_jn, spherical_yn

from sarmitsuba.core.arrays import F64


def sphere_mie(ka: ArrayLike) -> F64:
    r"""Return the backscatter cross section of a PEC sphere over pi a^2, exact.

    .. math::
        \frac{\sigma}{\pi a^2} = \frac{1}{x^2}
        \left| \sum_{n\ge1} (-1)^n (2n + 1) (a_n - b_n) \right|^2, \quad
        a_n = \frac{[x j_n(x)]'}{[x h_n^{(2)}(x)]'}, \quad b_n = \frac{j_n(x)}{h_n^{(2)}(x)}, \quad x = k a

    Parameters
    ----------
    ka : circumference over wavelength, > 0, any shape

    Notes
    -----
    Ignores nothing within the classical theory; the series is cut at Wiscombe's number of terms plus 10.

    References
    ----------
    Bohren and Huffman, Absorption and Scattering of Light by Small Particles (1983) in the
    limit of an infinite refractive index.
    """
    x_all = np.atleast_1d(np.asarray(ka, dtype=np.float64))
    result = np.empty_like(x_all)
    for i, x in enumerate(x_all.ravel()):
        last = int(x + 4.05 * x ** (1.0 / 3.0)) + 10
        n = np.arange(1, last + 1)
        j, dj = spherical_jn(n, x), spherical_jn(n, x, derivative=True)
        with np.errstate(over="ignore", invalid="ignore"):
            h = j - 1j * spherical_yn(n, x)
            dh = dj - 1j * spherical_yn(n, x, derivative=True)
            terms = (-1.0) ** n * (2 * n + 1) * ((j + x * dj) / (h + x * dh) - j / h)
        # y_n overflows only where the term has long vanished
        result.flat[i] = np.abs(np.sum(np.where(np.isfinite(terms), terms, 0.0))) ** 2 / x**2
    return result.reshape(np.shape(ka))


def sphere_po(ka: ArrayLike) -> F64:
    r"""Return the backscatter cross section of a PEC sphere over pi a^2 by physical optics of its lit half.

    .. math:: \frac{\sigma}{\pi a^2} = 1 - \frac{\sin 2x}{x} + \frac{\sin^2 x}{x^2}, \quad x = k a

    The two last terms are the false edge return of the sharp shadow boundary.

    Notes
    -----
    Ignores creeping waves and everything behind the shadow boundary.

    References
    ----------
    Ruck et al., Radar Cross Section Handbook (1970); it is |sphere_po_amplitude|^2.
    """
    x = np.asarray(ka, dtype=np.float64)
    s = np.sinc(x / np.pi)
    return np.asarray(1.0 - 2.0 * s * np.cos(x) + s * s)


def sphere_po_amplitude(radius: float, wavelength: float) -> complex:
    r"""Return sqrt(sigma) of a PEC sphere by physical optics, m, with its phase about the sphere's centre.

    .. math:: \frac{2\sqrt{\pi}}{\lambda} \int_0^1 2\pi a^2 u\, e^{j 2 k a u}\, du

    The reference is a plate at the same place, whose amplitude is real and positive.

    Notes
    -----
    Ignores creeping waves, as ``sphere_po``.
    """
    x = 2.0 * np.pi * radius / wavelength
    integral = (np.exp(2j * x) * (1.0 - 2j * x) - 1.0) / (4.0 * x * x)
    return complex(2.0 * np.sqrt(np.pi) / wavelength * 2.0 * np.pi * radius**2 * integral)
