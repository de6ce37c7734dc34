"""Backscatter of the edge of a conducting wedge beyond physical optics."""

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.arrays import F64

# modulus below which the series of a difference of cotangents is used, rad
_SERIES = 0.01


def fringe_backscatter(n: ArrayLike, phi: ArrayLike) -> tuple[F64, F64]:
    r"""Fringe coefficients of a perfectly conducting wedge for backscatter across its edge, soft and hard.

    .. math::
        D_{s,h} = -\tfrac1N \cot\tfrac{\pi}{2 N} \mp \tfrac12 [C(\phi - \tfrac\pi2) + C(N \pi - \phi - \tfrac\pi2)],
        \quad C(x) = \tfrac1N \cot\tfrac xN - U \cot x

    with U = 1 for a face that the wave lights, else 0: Ufimtsev's :math:`f - f_0` and :math:`g - g_0` at equal angles
    of source and observer. The poles of both cotangents at x = 0, off the normal of a face, cancel.

    Parameters
    ----------
    n : N, exterior angle over pi, above 1
    phi : angle of the direction from one face, across the exterior, 0 to N pi, rad

    Returns
    -------
    soft, hard : for the electric and the magnetic field along the edge; a length l has the RCS (D l)^2 / pi

    Notes
    -----
    Ignores waves oblique to the edge, other edges and faces of finite width. :mod:`sarmitsuba.theory.diffraction` takes
    the difference of both coefficients numerically, for any two directions; nothing is shared.

    References
    ----------
    Ufimtsev, Method of Edge Waves in the Physical Theory of Diffraction (1962), equations 4.14 and 4.15.
    """
    n, phi = np.broadcast_arrays(np.asarray(n, dtype=np.float64), np.asarray(phi, dtype=np.float64))
    half = 0.5 * np.pi
    own = -1.0 / (n * np.tan(half / n))
    faces = 0.5 * (_fringe(n, phi - half) + _fringe(n, n * np.pi - phi - half))
    return np.asarray(own - faces), np.asarray(own + faces)


def _fringe(n: F64, x: F64) -> F64:
    """C(x)."""
    lit = x < 0.5 * np.pi
    small = lit & (np.abs(x) < _SERIES)
    safe = np.where(small, 1.0, x)
    r2 = 1.0 / np.square(n)
    series = x * ((1.0 - r2) / 3.0 + np.square(x) * (1.0 - np.square(r2)) / 45.0)
    whole = 1.0 / (n * np.tan(safe / n)) - np.where(lit, 1.0 / np.tan(safe), 0.0)
    return np.asarray(np.where(small, series, whole))
