"""Spectra of rough surfaces."""

from typing import Literal

import numpy as np

from sarmitsuba.core.arrays import F64

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
