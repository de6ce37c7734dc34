"""Closed forms of textured clutter: the K distribution, and the correlation of gamma textures."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv, gammaln, kv, ndtr, roots_hermitenorm

from sarmitsuba.core.arrays import F64


def k_cdf(intensity: ArrayLike, mean: float, shape: float) -> F64:
    r"""Return the probability that K-distributed intensity of one look stays below a value.

    .. math:: P(I < x) = 1 - \frac{2}{\Gamma(\nu)} \left(\frac{\nu x}{\bar I}\right)^{\nu/2}
              K_\nu\left(2 \sqrt{\nu x / \bar I}\right)

    Parameters
    ----------
    intensity : linear power
    mean : of the intensity
    shape : nu of the gamma texture; infinite: speckle alone

    Notes
    -----
    Ignores correlation, and that a resolution cell averages the texture (see :func:`averaged_shape`).

    References
    ----------
    Jakeman and Pusey, "A model for non-Rayleigh sea echo", IEEE Trans. AP 24 (1976) 806; Oliver and Quegan,
    Understanding Synthetic Aperture Radar Images (2004), section 5.3.
    """
    x = np.maximum(np.asarray(intensity, dtype=np.float64), 0.0) / mean
    if not np.isfinite(shape):
        return np.asarray(-np.expm1(-x))
    z = np.sqrt(shape * x)
    with np.errstate(invalid="ignore", divide="ignore"):
        tail = 2.0 * np.exp(shape * np.log(z) - gammaln(shape)) * kv(shape, 2.0 * z)
    return np.asarray(np.where(z > 1e-9, 1.0 - tail, 0.0))


def k_moment(order: float, shape: float, looks: float = 1.0) -> float:
    r"""Return the normalised moment :math:`\langle I^n \rangle / \langle I \rangle^n` of K-distributed intensity.

    .. math:: \frac{\Gamma(L + n)}{\Gamma(L) L^n} \frac{\Gamma(\nu + n)}{\Gamma(\nu) \nu^n}

    the product of the moments of the speckle of L looks and of the texture. References: as of :func:`k_cdf`,
    equation 5.29 of Oliver and Quegan.
    """
    parts = [gammaln(a + order) - gammaln(a) - order * np.log(a) for a in (looks, shape) if np.isfinite(a)]
    return float(np.exp(sum(parts)))


def texture_correlation(field: ArrayLike, shape: float, nodes: int = 96) -> F64:
    r"""Return the correlation of a gamma texture made from a normal field of a correlation, value by value.

    .. math:: \rho_\tau = \nu \left(\langle \tau(g_1) \tau(g_2) \rangle - 1\right), \quad
              \tau(g) = F_\nu^{-1}(\Phi(g))

    by Gauss-Hermite quadrature over both normal numbers :math:`g_2 = \rho g_1 + \sqrt{1 - \rho^2} h`.

    References
    ----------
    Tough and Ward, J. Phys. D 32 (1999) 3075, equation 7.
    """
    rho = np.atleast_1d(np.asarray(field, dtype=np.float64))
    x, w = roots_hermitenorm(nodes)
    w = w / w.sum()

    def tau(g: F64) -> F64:
        return np.asarray(gammaincinv(shape, np.clip(ndtr(g), 1e-300, 1.0 - 1e-15)) / shape)

    second = rho[:, None, None] * x[:, None] + np.sqrt(1.0 - rho**2)[:, None, None] * x[None, :]
    product = np.einsum("i,j,i,kij->k", w, w, tau(x), tau(second))
    return np.asarray(shape * (product - 1.0))


def asked_correlation(distance: ArrayLike, length: float) -> F64:
    r"""Return the nominal autocorrelation of a texture of a correlation length, :math:`e^{-(r/\ell)^2}`."""
    return np.asarray(np.exp(-np.square(np.asarray(distance, dtype=np.float64) / length)))


def averaged_shape(shape: float, length: float, axes: Sequence[tuple[F64, F64]]) -> float:
    r"""Return the effective shape parameter of a texture after averaging over a resolution cell.

    .. math:: \frac{\nu}{\nu'} = \prod_{axes} \int\!\!\int p(x)\, p(x')\, e^{-(x - x')^2 / \ell^2}\, dx\, dx'

    with the power p of the impulse response, of unit integral, and the correlation of :func:`asked_correlation`.

    Parameters
    ----------
    shape : nu
    length : m
    axes : places (n,), m, equally spaced, and power (n,) of the impulse response on each axis of the ground

    Notes
    -----
    From second-order moments; ignores that an averaged gamma texture is not gamma-distributed.
    """
    left = 1.0
    for place, power in axes:
        share = power / power.sum()
        left *= float(share @ asked_correlation(place[:, None] - place[None, :], length) @ share)
    return shape / left
