"""Azimuth resolution of the radar modes, and the response of a point in a circular image."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import j0

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT

Taper = Callable[[F64], F64]

# nodes of the integrals: the band of a point, or of the waveform
_NODES = 256


def aperture_cell(wavelength: float, slant_range: float, length: float, squint_angle: float = 0.0) -> float:
    r"""Azimuth cell of an aperture common to all pixels (spotlight), m.

    .. math:: \delta = \frac{\lambda R}{2 L \cos\psi}

    Parameters
    ----------
    wavelength, slant_range, length : m; length of the straight track L
    squint_angle : psi, rad; the cell is across the line of sight

    Notes
    -----
    For L small against R.
    """
    return wavelength * slant_range / (2.0 * length * float(np.cos(squint_angle)))


def beam_cell(antenna_length: float, sliding_factor: float = 1.0) -> float:
    r"""Azimuth cell of the beam of a uniform aperture of length D that moves over the ground, m.

    .. math:: \delta = A D / 2

    with the sliding factor A, the speed of the footprint over the antenna's: 1 in stripmap.
    """
    return 0.5 * sliding_factor * antenna_length


def beam_taper(antenna_length: float, wavelength: float) -> Taper:
    r"""Weight of a pulse in the image of a point by a uniform aperture's beam, over the sine s off boresight.

    .. math:: w(s) = \mathrm{sinc}^4(D s / \lambda), \quad \mathrm{sinc} x = \sin \pi x / \pi x

    The one-way power enters twice: as the amplitude of the echo, and as that of the matched filter.
    """
    return lambda sine: np.asarray(np.sinc(antenna_length * sine / wavelength) ** 4)


def half_power_width(wavelength: float, half: float, taper: Taper | None = None) -> float:
    r"""Half-power width of a point for an aperture of +- ``half`` in sines, m.

    .. math:: h(x) = \int_{-s_t}^{s_t} w(s) e^{j 4 \pi s x / \lambda} ds, \quad |h(\pm b / 2)|^2 = |h(0)|^2 / 2

    Parameters
    ----------
    wavelength : m
    half : s_t, sine; with the azimuth cell delta it is lambda / (4 delta)
    taper : w; default 1, where b is 0.8859 cells
    """
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    sine = half * node
    weight = weight * (np.ones_like(sine) if taper is None else taper(sine))

    def above_half(x: float) -> float:
        level = np.sum(weight * np.cos(4.0 * np.pi / wavelength * sine * x)) / weight.sum()
        return float(level - np.sqrt(0.5))

    # the half-power point of any taper that falls to its ends lies between a uniform band's and four times that
    cell = wavelength / (4.0 * half)
    return 2.0 * float(brentq(above_half, 0.2 * cell, 2.0 * cell))


def circular_response(
    distance: ArrayLike, look_angle: float, wavelength: float, relative_bandwidth: float = 0.0
) -> F64:
    r"""Response of a point to a full circle about it, by horizontal distance from it in the plane of focus, 1 at 0.

    .. math:: h(r) = \frac{1}{B} \int_{f_c - B/2}^{f_c + B/2} J_0\left(\frac{4 \pi f}{c} r \sin\theta\right) df

    Parameters
    ----------
    distance : r, any shape, m
    look_angle : theta, from nadir, rad
    wavelength : m, at f_c
    relative_bandwidth : B / f_c; 0 is the narrow band

    Notes
    -----
    Ignores the near field: r small against the slant range. Half power lies at r = 0.0896 lambda / sin(theta), the
    first null at 0.1914, the first side lobe is -7.9 dB high.

    References
    ----------
    M. Soumekh, Synthetic Aperture Radar Signal Processing with MATLAB Algorithms, Wiley, 1999, chapter 7.
    """
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    frequency = SPEED_OF_LIGHT / wavelength * (1.0 + 0.5 * relative_bandwidth * node)
    wavenumber = 4.0 * np.pi / SPEED_OF_LIGHT * np.sin(look_angle) * frequency
    return np.asarray(j0(np.asarray(distance)[..., None] * wavenumber) @ weight / 2.0)
