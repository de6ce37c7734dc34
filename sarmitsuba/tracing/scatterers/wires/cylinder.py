"""Scattering by a long round wire: series of the infinite circular cylinder, tabulated over tilt and azimuth."""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C128, F32, F64
from sarmitsuba.core.errors import SceneError

# nodes over the tilt, and additional ones per unit of k a; for conductors only up to the k a at which creeping waves
# become negligible
TILTS, TILTS_PER_KA, LAST_CREEPING, TILTS_BEYOND = 65, 8.0, 30.0, 0.5
# azimuth nodes for each order of the series: four-point interpolation is then within 1e-3 of the largest value
NODES_PER_ORDER, LEAST_NODES = 10, 48
# circumference over wavelength up to which wires are tabulated: conductors, and others
LARGEST_KA, LARGEST_KA_INSIDE = 200.0, 100.0
# numbers per node: TM, TE and TE to TM, each re and im, and two of padding
NUMBERS = 8
# modulus of k a times the refractive index beyond which the field inside is a plane wave into the surface
_DEEP = 2e3


@dataclass(frozen=True, eq=False)
class CylinderTable:
    r"""Far-field series of a wire without the phase of its specular line.

    .. math:: T(\psi, \phi)\, e^{-2 j k a \cos\psi \sin(\phi / 2)}

    Parameters
    ----------
    values : (n_tilts, n_azimuths + 2, NUMBERS) float32; tilt psi uniform from 0 to 90 degrees, azimuth phi from
        forward (0) to backward (180 degrees), with one node beyond each end; TE to TM is over the sine of the tilt
    ka : circumference over wavelength
    """

    values: F32
    ka: float

    @property
    def n_tilts(self) -> int:
        """Nodes over the tilt."""
        return int(self.values.shape[0])

    @property
    def n_azimuths(self) -> int:
        """Nodes over the azimuth, without those beyond the ends."""
        return int(self.values.shape[1]) - 2


def largest_ka(permittivity: complex | None) -> float:
    """Circumference over wavelength up to which wires of a permittivity (None: conductor) are tabulated."""
    return LARGEST_KA if permittivity is None else LARGEST_KA_INSIDE


def table_size(ka: float, permittivity: complex | None) -> tuple[int, int, int]:
    """Nodes over the tilt, steps over the azimuth, and the highest order of a wire's table."""
    dense = ka if permittivity is not None else min(ka, LAST_CREEPING)
    orders = int(np.ceil(ka + 4.05 * ka ** (1.0 / 3.0))) + 3
    return (
        TILTS + int(TILTS_PER_KA * dense + TILTS_BEYOND * (ka - dense)),
        LEAST_NODES + NODES_PER_ORDER * orders,
        orders,
    )


def cylinder_table(ka: float, permittivity: complex | None) -> CylinderTable:
    """Table of the series of a wire.

    Parameters
    ----------
    ka : circumference over wavelength, up to ``largest_ka``
    permittivity : relative, eps' - j eps''; None is a perfect conductor

    Raises
    ------
    SceneError : the wire is too thick

    Notes
    -----
    Ignores magnetic wires, layers (insulation, bark, ice) and roughness.
    """
    if ka > largest_ka(permittivity):
        raise SceneError(
            f"a radar_wire is {ka:.0f} wavelengths around, above the bound {largest_ka(permittivity):g}; make it a mesh"
        )
    tilts, azimuths, orders = table_size(ka, permittivity)
    psi, step = np.linspace(0.0, 0.5 * np.pi, tilts), np.pi / azimuths
    phi = np.arange(-1, round(np.pi / step) + 2) * step
    # at end-on incidence the series is undefined, and the return zero
    cosine = np.maximum(np.cos(psi), 1e-4)
    tm, te, cross = coefficients(ka * cosine, np.sin(psi), cosine, orders, permittivity)
    n = np.arange(orders + 1)
    even = np.cos(np.outer(n, phi)) * np.where(n == 0, 1.0, 2.0)[:, None]
    odd = 2.0j * np.sin(np.outer(n, phi))
    specular = np.exp(-2.0j * ka * np.outer(cosine, np.abs(np.sin(0.5 * phi))))
    parts = [(tm @ even) * specular, (te @ even) * specular, (cross @ odd) * specular]
    values = np.zeros((psi.size, phi.size, NUMBERS), dtype=np.float32)
    for i, part in enumerate(parts):
        values[..., 2 * i], values[..., 2 * i + 1] = part.real, part.imag
    return CylinderTable(values, ka)


def coefficients(
    x: F64, sine: F64, cosine: F64, last: int, permittivity: complex | None
) -> tuple[C128, C128, C128]:
    r"""Series coefficients of orders 0 to ``last`` for waves along a cone: TM, TE, and TE to TM over the sine.

    For a conductor :math:`J_n(x) / H_n^{(2)}(x)` and the ratio of the derivatives; else, with
    :math:`x = k a \cos\psi, y = k a \sqrt{\varepsilon - \sin^2\psi}`,

    .. math:: b_n = \frac{W_n B_n + j D_n C_n}{W_n V_n + j D_n^2}, \quad
        a_n = -\frac{A_n V_n - j C_n D_n}{W_n V_n + j D_n^2}

    Parameters
    ----------
    x : (n,) circumference over wavelength times cosine of the tilt
    sine, cosine : (n,) of the tilt
    last : highest order
    permittivity : relative; None is a perfect conductor

    Returns
    -------
    three (n, last + 1) complex128

    References
    ----------
    Bohren and Huffman, Absorption and Scattering of Light by Small Particles (1983), section 8.4, conjugated for
    exp(+j w t).
    """
    n = np.arange(last + 2)
    with np.errstate(all="ignore"):
        j, h = scipy.special.jv(n, x[:, None]), scipy.special.hankel1(n, x[:, None])
        slope_j, slope_h = (_slope(v, n, x[:, None])[:, :-1] for v in (j, h))
    j, h, n = j[:, :-1], h[:, :-1], n[:-1]
    none = np.zeros(j.shape, dtype=np.complex128)
    with np.errstate(all="ignore"):
        if permittivity is None:
            return _finite(j / h), _finite(slope_j / slope_h), none
        index2 = complex(np.conj(permittivity))
        y = (np.sqrt(index2 - sine**2) / cosine * x)[:, None]
        xi, inside = x[:, None], _log_derivative(n, y)
        twist = n * sine[:, None] * (xi**2 / y - y)
        a = 1j * xi * (xi * inside * j - y * slope_j)
        b = xi * (index2 * xi * inside * j - y * slope_j)
        c, d = twist * j, twist * h
        v = xi * (index2 * xi * inside * h - y * slope_h)
        w = 1j * xi * (y * slope_h - xi * inside * h)
        under = w * v + 1j * d * d
        tm = (w * b + 1j * d * c) / under
        te = -(a * v - 1j * c * d) / under
        mixed = (b * d - c * v) / under / np.maximum(sine[:, None], 1e-12)
    return _finite(tm), _finite(te), _finite(mixed)


def _slope(values: F64 | C128, n: NDArray[np.intp], x: F64) -> C128:
    """Derivatives of cylinder functions of orders n from the next order; the last one is invalid."""
    following = np.roll(values, -1, axis=1)
    return np.asarray(n / x * values - following, dtype=np.complex128)


def _log_derivative(n: NDArray[np.intp], y: C128) -> C128:
    """(len(y), len(n)) J_n'(y) / J_n(y) for Im y >= 0; deep inside a good conductor that of an inward wave."""
    ratio = scipy.special.jve(n + 1, y) / scipy.special.jve(n, y)
    # beyond the turning point the functions underflow: first term of the series of their ratio
    series = y / (2.0 * (n + 1))
    ratio = np.where(np.isfinite(ratio) & (np.abs(series) > 1e-3), ratio, series)
    deep = (y.imag > 20.0) & (np.abs(y) > _DEEP)
    return np.asarray(np.where(deep, -1j, n / y - ratio))


def _finite(values: C128) -> C128:
    """Complex conjugate, zero where orders have decayed to NaN."""
    return np.asarray(np.conj(np.where(np.isfinite(values), values, 0.0)))
