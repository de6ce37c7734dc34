"""Backscatter of metal strips in two dimensions by the method of moments, exact for bent plates."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lu_factor, lu_solve
from scipy.special import hankel2, jv

from sarmitsuba.core.arrays import C128, F64, I64

# Gauss points on each segment, for testing and for sources; the logarithm is integrated in closed form
POINTS = 4
# segments at the ends of a straight piece over those in its middle: currents are infinite at edges
FINEST = 0.08
EULER = 0.5772156649015329


def _segments(strips: Sequence[ArrayLike], step: float) -> tuple[F64, F64, list[I64]]:
    """Ends (n, 2) of all segments and chains of their numbers; a closed chain has its first segment last again."""
    starts, ends, chains, count = [], [], [], 0
    for strip in strips:
        corners = np.asarray(strip, dtype=np.float64)
        points = [corners[:1]]
        for a, b in pairwise(corners):
            n = max(1, int(np.ceil(np.linalg.norm(b - a) / step)))
            t = np.arange(1, n + 1) / n
            if n > 4:
                t = t - (1.0 - FINEST) * np.sin(2.0 * np.pi * t) / (2.0 * np.pi)
            points.append(a + t[:, None] * (b - a))
        line = np.concatenate(points)
        starts.append(line[:-1])
        ends.append(line[1:])
        numbers = count + np.arange(line.shape[0] - 1)
        count = int(numbers[-1]) + 1
        chains.append(np.append(numbers, numbers[0]) if np.allclose(line[0], line[-1]) else numbers)
    return np.concatenate(starts), np.concatenate(ends), chains


def _log_moments(point: F64, start: F64, end: F64) -> F64:
    """(n, m, 2) integrals of ln R over segments times the falling and the rising hat, seen from points (n, 2)."""
    step = end - start
    length = np.linalg.norm(step, axis=1)
    along = step / length[:, None]
    off = point[:, None] - start
    x = np.einsum("nmc,mc->nm", off, along)
    y = np.abs(off[..., 0] * along[:, 1] - off[..., 1] * along[:, 0])
    a, b = -x, length - x  # the segment's ends, from the foot of the point

    def square(t: F64) -> F64:
        return np.asarray(np.log(np.maximum(t * t + y * y, 1e-300)))

    turn = np.arctan2(b, y) - np.arctan2(a, y)
    whole = 0.5 * (b * square(b) - a * square(a)) - (b - a) + y * turn
    first = 0.25 * ((b * b + y * y) * (square(b) - 1.0) - (a * a + y * y) * (square(a) - 1.0))
    rising = (first + x * whole) / length
    return np.stack([whole - rising, rising], axis=-1)


def _green_moments(start: F64, end: F64, k: float) -> C128:
    """(n, n, 2, 2) integrals of ``-j/4 H0(k R)`` between two segments times the hats of both."""
    length = np.linalg.norm(end - start, axis=1)
    node, weight = np.polynomial.legendre.leggauss(POINTS)
    node, weight = 0.5 * (node + 1.0), 0.5 * weight
    hats = np.stack([1.0 - node, node])
    place = start[:, None] + node[:, None] * (end - start)[:, None]
    n = start.shape[0]
    out = np.zeros((n, n, 2, 2), dtype=np.complex128)
    limit = -0.25j - (np.log(0.5 * k) + EULER) / (2.0 * np.pi)  # G + ln(R) / 2 pi at R = 0
    for i in range(POINTS):
        values = np.zeros((n, n, 2), dtype=np.complex128)
        for j in range(POINTS):
            r = np.linalg.norm(place[:, i, None] - place[None, :, j], axis=2)
            safe = np.where(r > 0.0, r, 1.0)
            smooth = np.where(
                r > 1e-9 / k, -0.25j * hankel2(0, k * safe) + np.log(safe) / (2.0 * np.pi), limit
            )
            values += weight[j] * length[:, None] * smooth[..., None] * hats[:, j]
        values -= _log_moments(place[:, i], start, end) / (2.0 * np.pi)
        out += (weight[i] * length)[:, None, None, None] * hats[:, i][:, None] * values[:, :, None, :]
    return out


def _wave_moments(start: F64, end: F64, k: float, to: F64) -> C128:
    """(n, directions, 2) integrals of ``exp(j k s . r)`` over segments times their hats."""
    length = np.linalg.norm(end - start, axis=1)
    node, weight = np.polynomial.legendre.leggauss(POINTS)
    node, weight = 0.5 * (node + 1.0), 0.5 * weight
    out = np.zeros((start.shape[0], to.shape[0], 2), dtype=np.complex128)
    for t, w in zip(node, weight, strict=True):
        wave = np.exp(1j * k * ((start + t * (end - start)) @ to.T)) * (w * length)[:, None]
        out += wave[..., None] * np.array([1.0 - t, t])
    return out


def strips_by_moments(
    strips: Sequence[ArrayLike], wavelength: float, azimuth: ArrayLike, *, step: float = 1.0 / 20.0
) -> tuple[C128, C128]:
    r"""Return the backscatter amplitudes of infinitely long thin metal strips, :math:`\sqrt m`.

    The electric field integral equation

    .. math::
        \mathbf{\hat t} \cdot \mathbf E^i = \mathbf{\hat t} \cdot j k \eta \left(1 + \tfrac1{k^2} \nabla \nabla \cdot
        \right) \int \mathbf J\, \tfrac{-j}4 H_0^{(2)}(k R)\, dl'

    by Galerkin's method: constant currents for the electric field along the axis, continuous piecewise linear ones for
    the field across it. The modulus squared is the scattering width :math:`2 \pi r |E^s|^2`; a body of the length b,
    seen squarely to its axis, has :math:`\sigma = 2 b^2 / \lambda` times it.

    Parameters
    ----------
    strips : of (n, 2) corners each, m; a strip whose last corner is its first is closed. They may not cross or branch
    wavelength : m
    azimuth : (m,) directions to the antenna in their plane, rad
    step : longest segment, wavelengths

    Returns
    -------
    along, across : (m,) complex128, electric field along and across the axis; a strip that is looked at squarely
        from the origin returns a positive number in both

    Notes
    -----
    Ignores thickness. Closed strips have resonances, at which the equation has no single solution: they may not be
    near one.

    References
    ----------
    Harrington, Field Computation by Moment Methods (1968), chapter 3; Peterson, Ray and Mittra, Computational Methods
    for Electromagnetics (1998), sections 2.1 and 2.4.
    """
    k = 2.0 * np.pi / wavelength
    azimuth = np.atleast_1d(np.asarray(azimuth, dtype=np.float64))
    to = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    start, end, chains = _segments(strips, step * wavelength)
    length = np.linalg.norm(end - start, axis=1)
    unit = (end - start) / length[:, None]
    green, wave = _green_moments(start, end, k), _wave_moments(start, end, k, to)

    # fields and currents times eta; amplitude = sqrt(k) / 2 times the current's radiation integral
    matrix, source = 1j * k * green.sum(axis=(2, 3)), wave.sum(axis=2)
    along = np.einsum("nd,nd->d", source, lu_solve(lu_factor(matrix), source))

    # rooftops rise on the one and fall on the other segment
    rise = np.concatenate([chain[:-1] for chain in chains])
    fall = np.concatenate([chain[1:] for chain in chains])
    halves = ((rise, 1, 1.0), (fall, 0, -1.0))
    matrix = np.zeros((rise.size, rise.size), dtype=np.complex128)
    source = np.zeros((rise.size, to.shape[0]), dtype=np.complex128)
    across_to = np.stack([-to[:, 1], to[:, 0]])  # electric field of a wave from there
    for i, p, up in halves:
        source += wave[i, :, p] * (unit[i] @ across_to)
        for j, q, down in halves:
            pair = green[np.ix_(i, j)]
            charge = up * down / (length[i][:, None] * length[j]) * pair.sum(axis=(2, 3))
            matrix += 1j * k * ((unit[i] @ unit[j].T) * pair[:, :, p, q] - charge / k**2)
    across = np.einsum("nd,nd->d", source, lu_solve(lu_factor(matrix), source))
    scale = 0.5 * np.sqrt(k)
    return np.asarray(scale * along), np.asarray(scale * across)


def circular_cylinder(radius: float, wavelength: float) -> tuple[complex, complex]:
    r"""Return the backscatter amplitudes of a circular metal cylinder, as :func:`strips_by_moments` has them.

    .. math::
        -\frac{2}{\sqrt k} \sum_n (-1)^n \frac{J_n(k a)}{H_n^{(2)}(k a)}, \quad
        \frac{2}{\sqrt k} \sum_n (-1)^n \frac{J_n'(k a)}{H_n^{(2)\prime}(k a)}

    for the electric field along and across its axis, about the axis.

    References
    ----------
    Balanis, Advanced Engineering Electromagnetics, equations 11-102 and 11-117.
    """
    k = 2.0 * np.pi / wavelength
    x = k * radius
    n = np.arange(-int(x + 5.0 * x ** (1.0 / 3.0)) - 10, int(x + 5.0 * x ** (1.0 / 3.0)) + 11)
    sign = (-1.0) ** n
    soft = np.sum(sign * jv(n, x) / hankel2(n, x))
    hard = np.sum(sign * (jv(n - 1, x) - jv(n + 1, x)) / (hankel2(n - 1, x) - hankel2(n + 1, x)))
    return complex(2.0 / np.sqrt(k) * soft), complex(-2.0 / np.sqrt(k) * hard)
