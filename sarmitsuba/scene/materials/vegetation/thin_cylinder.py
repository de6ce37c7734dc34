r"""Polarisation of a thin dielectric rod by a plane wave: its integral equation in Legendre polynomials along the axis.

The field within is taken as even over the cross-section. Along the axis it obeys

.. math:: e = e_{inc} + (\epsilon - 1)\, S * e, \quad
    S_l(h) = -1 - j \pi J_1(\kappa a) H_1^{(2)}(\kappa a), \quad
    S_t(h) = \Big(\frac{k^2}{\kappa^2} - \tfrac12\Big) S_l - \tfrac12, \quad \kappa^2 = k^2 - h^2

along and across, with the operator's transform S over the wavenumber h: the mean, over two discs, of the Green
function's. Its static limits are the depolarisation of an endless needle, 0 and -1/2, and that of a short wave, -1 and
0; the imaginary part is the radiated power, so that the optical theorem holds.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy

from sarmitsuba.core.arrays import C128, F64

# number of polynomials, plus one per unit of half the length times the wavenumber; k l above which the rod is taken as
# endless
LEAST_ORDERS, LONGEST = 8, 60.0
# of the integrals over half length times wavenumber: step and least end of the even grid, nodes of the one beyond
_STEP, _EVEN, _BEYOND = 0.1, 200.0, 300


@dataclass(frozen=True, eq=False)
class ThinRod:
    """Mean polarisation of a rod over its volume and (eps - 1) E of the wave, along and across the axis.

    Parameters
    ----------
    half : k l / 2
    along, across : (orders, orders) matrices from moments of the incident field to the response
    endless : radius (m), wavenumber (rad/m) and permittivity
    """

    half: float
    along: C128
    across: C128
    endless: tuple[float, float, complex]

    def response(self, incident: F64, scattered: F64) -> tuple[C128, C128]:
        """Response along and across, (...,) complex, at cosines of the incident and scattered wave to the axis."""
        if not self.along.size:
            return self.of_endless(incident, scattered)
        incident, scattered = np.broadcast_arrays(incident, scattered)
        places = np.stack(
            [(incident / self._step + self._side).ravel(), (scattered / self._step + self._side).ravel()]
        )
        along, across = (
            (
                scipy.ndimage.map_coordinates(table.real, places, mode="nearest", prefilter=False)
                + 1j * scipy.ndimage.map_coordinates(table.imag, places, mode="nearest", prefilter=False)
            ).reshape(incident.shape)
            for table in self._tables
        )
        return along, across

    def of_endless(self, incident: F64, scattered: F64) -> tuple[C128, C128]:
        """Response with the field of an infinite rod, cut to the length."""
        radius, k, permittivity = self.endless
        form = np.sinc(self.half * (incident - scattered) / np.pi)
        along, across = symbols(k * incident, k, radius)
        chi = permittivity - 1.0
        return form / (1.0 - chi * along), form / (1.0 - chi * across)

    @property
    def _step(self) -> float:
        """Step of the tables in the cosine: at most a sixth of a radian of phase at the rod's ends."""
        return 1.0 / (32.0 + 6.0 * self.half)

    @property
    def _side(self) -> int:
        """Nodes from the middle of a table to its end, some beyond a cosine of 1."""
        return int(1.0 / self._step) + 8

    @cached_property
    def _tables(self) -> tuple[C128, C128]:
        """Spline coefficients of the response, along and across, over the incident and the scattered cosine."""
        moments = self._moments(
            np.asarray(self._step * np.arange(-self._side, self._side + 1), dtype=np.float64)
        )
        first, second = (
            scipy.ndimage.spline_filter(
                0.5 * (moments @ solved.T @ np.conj(moments.T)), mode="nearest", output=np.complex128
            )
            for solved in (self.along, self.across)
        )
        return first, second

    def _moments(self, cosine: F64) -> C128:
        """(..., orders) integrals of the wave's phase along the rod times Legendre polynomials."""
        n = np.arange(len(self.along))
        u = np.asarray(self.half * cosine)[..., None]
        return np.asarray(2.0 * (-1j) ** n * np.sign(u) ** n * scipy.special.spherical_jn(n, np.abs(u)))


@lru_cache(maxsize=32)
def thin_rod(radius: float, length: float, wavenumber: float, permittivity: complex) -> ThinRod:
    """Solution of the integral equation of a thin rod, for waves from all directions.

    Parameters
    ----------
    radius, length : m
    wavenumber : rad/m
    permittivity : relative, eps' - j eps''

    Notes
    -----
    Ignores how the field changes over the cross-section, which comes into the amplitude in second order only, as the
    operator's mean is taken over both cross-sections (Galerkin), and currents that circle in the magnetic field. Up to
    ``k a sqrt(eps) = 0.5`` the extinction of an endless rod, wave in the plane of the axis, is within 0.3 dB of the
    series, and across it up to 1.1 dB below: `Stick` takes only the difference that the ends make.
    """
    half, chi = 0.5 * wavenumber * length, permittivity - 1.0
    none = np.zeros((0, 0), dtype=np.complex128)
    if 2.0 * half > LONGEST:
        return ThinRod(half, none, none, (radius, wavenumber, permittivity))
    orders = LEAST_ORDERS + int(half)
    n = np.arange(orders)
    # K_nm = (2 / pi) int j^n (-j)^m j_n(u) j_m(u) S(2 u / l) du, even in u; zero where n + m is odd
    end = max(_EVEN, 2.0 * orders**2)
    u: F64 = np.asarray((np.arange(int(end / _STEP)) + 0.5) * _STEP, dtype=np.float64)
    far = u[-1] + 0.5 * _STEP
    bessel = scipy.special.spherical_jn(n[:, None], u)
    weights = np.stack(symbols(2.0 * u / length, wavenumber, radius)) * _STEP
    # beyond, j_n j_m is (-1)^((n - m) / 2) / 2 u^2 on average
    t: F64 = np.asarray(
        np.geomspace(far, far * 1e4 * max(1.0, length / radius / far), _BEYOND), dtype=np.float64
    )
    rest_of = np.stack(symbols(2.0 * t / length, wavenumber, radius)) * 0.5 / t
    tail = [complex(np.trapezoid(row, np.log(t))) for row in rest_of]
    turn = np.real(1j ** (n[:, None] - n))
    same = np.abs(turn) > 0.5
    unity = np.diag(2.0 / (2.0 * n + 1.0))
    solved = []
    for weight, rest in zip(weights, tail, strict=True):
        operator = (4.0 / np.pi) * (turn * ((bessel * weight) @ bessel.T) + same * rest)
        solved.append(np.linalg.inv(unity - chi * operator))
    return ThinRod(half, solved[0], solved[1], (radius, wavenumber, permittivity))


def symbols(h: F64, wavenumber: float, radius: float) -> tuple[C128, C128]:
    """Transforms of the operator over the wavenumber h along the axis, along and across; see the module."""
    kappa = np.sqrt(wavenumber**2 - np.square(h) + 0j)
    x = np.where(kappa.imag > 0.0, -kappa, kappa) * radius
    x = np.where(np.abs(x) < 1e-7, 1e-7, x)
    with np.errstate(all="ignore"):
        along = -1.0 - 1j * np.pi * scipy.special.jv(1, x) * scipy.special.hankel2(1, x)
    deep = (np.abs(x.imag) > 50.0) | ~np.isfinite(along)
    along = np.where(deep, -1.0 + 1.0 / np.maximum(np.abs(x), 1.0), along)
    across = ((wavenumber * radius / x) ** 2 - 0.5) * along - 0.5
    return np.asarray(along), np.asarray(across)
