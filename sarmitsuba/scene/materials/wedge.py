"""Fringe currents of the edge of a conducting wedge: upper bound of their return."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C128, F64

# modulus below which the series of a difference of cotangents is used, rad
_SERIES = 0.05
# least sine of the angle between wave and edge, and least angle in a wedge, rad: the formulas are held there
_LEAST = 1e-3
# largest modulus of the factor Q of waves along a sheet
_ALONG = 2.8
# largest fringe amplitude: at rims of sheets in backscatter, S times half the sum of both directions elsewhere
LARGEST_FRINGE = 1.8


def fringe_bound(angle: F64, inward: F64, normal: F64, to_source: F64, to_observer: F64) -> F64:
    """Upper bound of the fringe amplitude S of edges over all polarisations; a length l has the RCS (S l)^2 / pi.

    The largest singular value of the matrix of S over two polarisations of the incoming and of the received wave, with
    S the mean of a path and of the reversed one. At rims of sheets the magnetic part is at most 2.8 times as large by
    the waves along the sheet, and the root of the sum of all squares is taken; or, if less, what these waves change is
    added, which is nothing from directions beyond the rim. At most ``LARGEST_FRINGE`` over half the modulus of the
    sum of both directions.

    Parameters
    ----------
    angle : (n,) exterior angle over pi
    inward, normal : (n, 2, 3) unit vectors into both faces across the edge, and normal to them into the exterior
    to_source, to_observer : (n, 3) unit vectors

    Returns
    -------
    bound : (n,) 0 where a direction lies inside the metal

    Notes
    -----
    :mod:`sarmitsuba.tracing.scatterers.edges.diffraction` has the formula in float32 and
    :mod:`sarmitsuba.truth.theory.diffraction` that of the whole current less physical optics; nothing is shared.

    References
    ----------
    Michaeli, "Elimination of infinities in equivalent edge currents, Part I: fringe current components", IEEE TAP 34
    (7) 1986.
    """
    same = to_source is to_observer
    total: dict[tuple[int, int], C128] = {}
    outside = np.ones(len(angle), dtype=bool)
    for x, up in ((inward[:, 0], normal[:, 0]), (inward[:, 1], normal[:, 1])):
        there, strip = _strip(angle, x, up, to_source, to_observer)
        back, reversed_ = (there, strip) if same else _strip(angle, x, up, to_observer, to_source)
        outside &= there & back
        for e, q in ((0, 0), (0, 1), (1, 0), (1, 1)):
            part = 0.5 * (strip[e, q] + reversed_[q, e])
            total[e, q] = total.get((e, q), 0.0) + part
    square = sum(np.square(np.abs(part)) for part in total.values())
    determinant = np.abs(total[0, 0] * total[1, 1] - total[0, 1] * total[1, 0])
    largest = 0.5 * (square + np.sqrt(np.maximum(np.square(square) - 4.0 * np.square(determinant), 0.0)))
    electric = np.square(np.abs(total[0, 0]))
    magnetic = np.maximum(square - electric, 0.0)
    # what the waves along the sheet change adds to the largest singular value
    turned = _bound_turned(_grazing(inward, normal, to_source), _grazing(inward, normal, to_observer))
    changed = np.sqrt(largest) + turned * np.sqrt(magnetic)
    sheet = np.minimum(np.sqrt(electric + _ALONG**2 * magnetic), changed)
    both = np.linalg.norm(to_source + to_observer, axis=1)
    sheet = np.minimum(sheet, 2.0 * LARGEST_FRINGE / np.maximum(both, 1e-9))
    return np.asarray(np.where(outside, np.where(angle > 2.0 - _LEAST, sheet, np.sqrt(largest)), 0.0))


def _grazing(inward: F64, normal: F64, direction: F64) -> tuple[F64, F64, F64]:
    """Largest T - 1 of a wave over a sheet a wavelength wide or wider, cosine and sine of half its angle."""
    across, off = _dot(direction, inward[:, 0]), _dot(direction, normal[:, 0])
    part = np.clip(across / np.maximum(np.hypot(across, off), _LEAST), -1.0, 1.0)
    # |T - 1| = |2 F(-w)| <= 1 / (sqrt(pi) w)
    share = (0.5 + 0.5 * np.clip(4.0 * part, -1.0, 1.0)) / np.maximum(1.0, np.pi * np.sqrt(2.0 - 2.0 * part))
    cosine, sine = np.sqrt(0.5 + 0.5 * part), np.sqrt(0.5 - 0.5 * part)
    return np.asarray(share), np.maximum(cosine, _LEAST), np.asarray(sine)


def _bound_turned(there: tuple[F64, F64, F64], back: tuple[F64, F64, F64]) -> F64:
    """Largest modulus of Q - 1 of :class:`sarmitsuba.tracing.scatterers.edges.diffraction.FringeCurrents`."""
    (s, c, a), (t, d, b) = there, back
    fringe = 0.5 * (d / (c + b) + c / (d + a))
    return np.asarray((s / d + t / c + s * t) / fringe)


def _strip(
    n: F64, x: F64, up: F64, source: F64, observer: F64
) -> tuple[NDArray[np.bool_], dict[tuple[int, int], C128]]:
    """Whether the wave comes through the exterior, and the amplitude of a face's strip for both polarisations each.

    Polarisation 0 has the electric, 1 the magnetic field in the plane of edge and direction. Both polarisations change
    their signs with the sense of the face's edge vector, and the amplitude does not.
    """
    z = np.cross(x, up)
    across, off, cosine = _dot(source, x), _dot(source, up), -_dot(source, z)
    sine = np.maximum(np.hypot(across, off), _LEAST)
    phi = np.arctan2(off, across)
    phi = np.where(phi < -(1.0 - 0.5 * n) * np.pi, phi + 2.0 * np.pi, phi)
    outside = (phi > -_LEAST) & (phi < n * np.pi + _LEAST)
    phi = np.clip(phi, 0.0, n * np.pi)
    grazing = x * sine[:, None] + z * cosine[:, None]
    w = 0.5 * np.linalg.norm(observer - grazing, axis=1) / sine
    a = np.where(
        w <= 1.0,
        np.clip(2.0 * np.arccos(np.minimum(w, 1.0)), _LEAST, np.pi - _LEAST),
        1j * np.maximum(2.0 * np.arccosh(np.maximum(w, 1.0)), _LEAST),
    )
    lit = phi < np.pi
    plus, minus = _fringe(n, 0.5 * (phi + a), lit), _fringe(n, 0.5 * (phi - a), lit)
    soft, hard = -0.5 * (plus + minus), 0.5 * (plus - minus) / np.sin(a)
    charge = (1.0 - 2.0 * np.square(w)) * hard - 1.0 / n + lit
    # incoming unit fields in the plane of edge and direction, E_z = sine, and across it, H_z = -sine
    electric = soft / sine
    magnetic_z, magnetic_x = -cosine * charge / sine, -hard
    # receiving vectors: in the plane of edge and direction, and across it
    side = np.cross(z, observer)
    length = np.linalg.norm(side, axis=1)
    side = side / np.maximum(length, 1e-300)[:, None]
    plane = np.cross(observer, side)
    out = {}
    for q, vector in enumerate((plane, side)):
        q_z, q_x = _dot(vector, z), _dot(vector, x)
        out[0, q] = electric * q_z
        out[1, q] = magnetic_z * q_z + magnetic_x * q_x
    return outside, out


def _dot(a: F64, b: F64) -> F64:
    return np.asarray(np.einsum("ni,ni->n", a, b))


def _fringe(n: F64, x: C128, lit: NDArray[np.bool_]) -> C128:
    """C(x), with the poles held off."""
    real = np.where(
        lit, np.minimum(x.real, np.pi - _LEAST), np.where(x.imag == 0.0, np.maximum(x.real, _LEAST), x.real)
    )
    x = real + 1j * x.imag
    small = lit & (np.abs(x) < _SERIES)
    safe: C128 = np.where(small, 1.0 + 0.0j, x)
    r2 = 1.0 / np.square(n)
    series = x * ((1.0 - r2) / 3.0 + np.square(x) * (1.0 - np.square(r2)) / 45.0)
    whole = _cot(safe / n) / n - np.where(lit, _cot(safe), 0.0)
    return np.where(small, series, whole)


def _cot(x: C128) -> C128:
    """Cotangent, without overflow far from the real axis."""
    up = np.exp(2j * np.where(x.imag >= 0.0, x, np.conj(x)))
    got = 1j * (up + 1.0) / (up - 1.0)
    return np.where(x.imag >= 0.0, got, np.conj(got))
