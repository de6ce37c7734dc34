"""Bistatic echoes of ideal points, conducting facets and dihedral corner lines."""

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import C128, F64


def bistatic_range(transmitter: ArrayLike, point: ArrayLike, receiver: ArrayLike) -> F64:
    """Half the path from transmitters over points to receivers (..., 3), m."""
    p = np.asarray(point, dtype=np.float64)
    legs = [np.linalg.norm(p - np.asarray(at, dtype=np.float64), axis=-1) for at in (transmitter, receiver)]
    return np.asarray(0.5 * (legs[0] + legs[1]))


def bistatic_po(
    points: F64,
    normals: F64,
    areas: F64,
    transmitter: F64,
    receiver: F64,
    wavelength: float,
    channel: str = "VV",
) -> C128:
    r"""Echo of every small conducting facet by physical optics, (n,) complex128: :math:`\sqrt\sigma / (R_t R_r)`, 1/m.

    .. math::
        \frac{2 \sqrt \pi}{\lambda} \frac{\mathrm d S}{R_t R_r} \,
        [\hat n \times (\hat d \times \hat e)] \cdot \hat q \; e^{-j k (R_t + R_r)}

    with the transmitted polarisation e along d, from the transmitter, and the received one q, both in backscatter
    alignment: horizontal across the line of sight, vertical across both. Facets hidden from either antenna are dark.

    Parameters
    ----------
    points, normals : (n, 3) float64, m and unit vectors; middles of facets much smaller than the wavelength
    areas : (n,) m^2
    transmitter, receiver : (3,) m
    wavelength : m
    channel : transmit letter first

    Notes
    -----
    Ignores shadows of one facet on another, and everything beyond one bounce.

    References
    ----------
    Ruck, Barrick, Stuart and Krichbaum, Radar Cross Section Handbook (1970), section 2.2.2.
    """
    out, back = points - transmitter, points - receiver
    r_t, r_r = np.linalg.norm(out, axis=1), np.linalg.norm(back, axis=1)
    d, u = out / r_t[:, None], back / r_r[:, None]
    e, q = _polarisation(d, channel[0]), _polarisation(u, channel[1])
    lit = (np.einsum("ni,ni->n", d, normals) < 0.0) & (np.einsum("ni,ni->n", u, normals) < 0.0)
    current = np.einsum("ni,ni->n", np.cross(normals, np.cross(d, e)), q)
    phase = np.exp(-2j * np.pi / wavelength * (r_t + r_r))
    return np.asarray(2.0 * np.sqrt(np.pi) / wavelength * lit * areas * current * phase / (r_t * r_r))


def _polarisation(direction: F64, letter: str) -> F64:
    h = np.cross(direction, [0.0, 0.0, 1.0])
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    return h if letter == "H" else np.cross(h, direction)


def corner_line(transmitter: F64, receiver: F64, start: F64, end: F64, wavelength: float) -> complex:
    r"""Mean of :math:`e^{-j k (R_t + R_r)}` along the corner line of a dihedral.

    The path over both faces is as long as that over the corner line, wherever the bounces are (to second order in the
    faces' size over the range): this mean gives the dependence of a dihedral's echo on the positions of the antennas.
    """
    # midpoints: exact enough at a hundred per wavelength of change
    n = 4000
    s = (np.arange(n) + 0.5) / n
    line = start + s[:, None] * (end - start)
    path = 2.0 * bistatic_range(transmitter, line, receiver)
    return complex(np.exp(-2j * np.pi / wavelength * path).mean())
