"""Wind waves on water: unified spectrum, dispersion, moments, and a realisation of the long waves."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64

GRAVITY = 9.81  # m/s^2
# surface tension over density of clean water, m^3/s^2, from the wavenumber of least phase speed, 370 rad/m
SLOWEST_WAVENUMBER = 370.0
TENSION = GRAVITY / SLOWEST_WAVENUMBER**2
SLOWEST_SPEED = float(np.sqrt(2.0 * GRAVITY / SLOWEST_WAVENUMBER))  # 0.23 m/s
# inverse wave age of a fully developed sea, and of the youngest sea to which the spectrum was fitted
DEVELOPED, YOUNGEST = 0.84, 5.0
# nodes of an integral over wavenumber, uniform in its logarithm, for moments accurate to 1e-4
_NODES = 1024
# largest wavenumber, rad/m: shorter waves are cut off by the factor exp(-(k/km - 1)^2 / 4)
_LARGEST = 20.0 * SLOWEST_WAVENUMBER
# number of waves in a realisation, and the least share of the height variance of a wave
DRAWN_WAVES = 48
_WORTH = 1e-3
# nodes within the band of one wave
_FINER = 32


def angular_frequency(wavenumber: ArrayLike) -> F64:
    """Angular frequency of waves on deep water with surface tension, rad/s; wavenumber in rad/m."""
    k = np.asarray(wavenumber, dtype=np.float64)
    return np.asarray(np.sqrt(GRAVITY * k + TENSION * k**3))


@dataclass(frozen=True)
class Moments:
    """Integrals of a directional spectrum over a band of wavenumbers, along the wind (u) and across it (c).

    Parameters
    ----------
    height : variance of the height, m^2
    slope_u, slope_c : of the two slopes
    speed_u, speed_c : of the horizontal orbital velocity at the surface, (m/s)^2; the vertical one is their sum
    acceleration : of the vertical orbital acceleration, (m/s^2)^2
    """

    height: float
    slope_u: float
    slope_c: float
    speed_u: float
    speed_c: float
    acceleration: float


@dataclass(frozen=True)
class SeaState:
    r"""Directional height spectrum of wind waves by Elfouhaily, Chapron, Katsaros and Vandemark.

    .. math::
        \Psi(\mathbf k) = \frac{B_l + B_h}{k^4}\,\frac{1 + \Delta(k) \cos 2\varphi}{2\pi}, \qquad
        \int \Psi\, d^2k = \langle \zeta^2 \rangle

    with :math:`\varphi` the angle to the wind, :math:`c(k)` the phase speed and :math:`\Omega` the inverse wave age,

    .. math::
        B_l &= \tfrac12 \alpha_p \frac{c_p}{c} e^{-\frac54 (k_p/k)^2} \gamma^\Gamma
              e^{-\frac{\Omega}{\sqrt{10}} (\sqrt{k/k_p} - 1)}, \quad
        B_h = \tfrac12 \alpha_m \frac{c_m}{c} e^{-\frac54 (k_p/k)^2} e^{-\frac14 (k/k_m - 1)^2} \\
        \Delta &= \tanh\bigl(\tfrac14 \ln 2 + 4 (c/c_p)^{5/2} + 0.13 (u_*/c_m) (c_m/c)^{5/2}\bigr)

    Parameters
    ----------
    wind_speed : U, m/s, at 10 m, neutral
    fetch : m, over which the wind has blown; infinite: a fully developed sea

    Notes
    -----
    Waves against the wind are as high as those with it (an instant's spectrum is symmetric). Ignores swell, drift,
    the bottom (deep water), slicks and breaking. Below 2 to 3 m/s the short waves of the spectrum vanish. A sea younger
    than the spectrum was fitted to (some 100 m of fetch) has its wave age, so that its waves are too high.

    References
    ----------
    J. Geophys. Res. 102 (C7) 1997, 15781-15796: equations 30 to 37, 40, 41, 44, 57; the low-wavenumber cut of B_h as
    McDaniel, Waves in Random Media 11 (2001); friction velocity by the drag coefficient (0.8 + 0.065 U) 1e-3 of Wu,
    J. Geophys. Res. 87 (C12) 1982.
    """

    wind_speed: float
    fetch: float = np.inf

    @property
    def inverse_wave_age(self) -> float:
        """Wind speed over the phase speed of the highest waves."""
        if not np.isfinite(self.fetch):
            return DEVELOPED
        reach = GRAVITY * self.fetch / self.wind_speed**2 / 2.2e4
        return float(min(DEVELOPED * np.tanh(reach**0.4) ** -0.75, YOUNGEST))

    @property
    def friction_velocity(self) -> float:
        """Friction velocity of the wind, m/s."""
        drag = (0.8 + 0.065 * self.wind_speed) * 1e-3
        return self.wind_speed * float(np.sqrt(drag))

    @property
    def peak(self) -> float:
        """Wavenumber of the highest waves, rad/m."""
        return GRAVITY / self.wind_speed**2 * self.inverse_wave_age**2

    def curvature(self, wavenumber: ArrayLike) -> F64:
        """``B_l + B_h``: k^3 times the spectrum over all directions; no unit."""
        k = np.asarray(wavenumber, dtype=np.float64)
        age, c, kp = self.inverse_wave_age, angular_frequency(wavenumber) / k, self.peak
        cp = float(angular_frequency(kp)) / kp
        root = np.sqrt(k / kp) - 1.0
        cut = np.exp(-1.25 * (kp / k) ** 2)
        width = 0.08 * (1.0 + 4.0 / age**3)
        height = 1.7 + (6.0 * float(np.log10(age)) if age > 1.0 else 0.0)
        peaked = height ** np.exp(-0.5 * (root / width) ** 2)
        low = 0.5 * 6e-3 * np.sqrt(age) * cp / c * cut * peaked * np.exp(-age / np.sqrt(10.0) * root)
        ratio = float(np.log(self.friction_velocity / SLOWEST_SPEED))
        level = 1e-2 * max(1.0 + (3.0 if ratio > 0.0 else 1.0) * ratio, 0.0)
        high = 0.5 * level * SLOWEST_SPEED / c * cut * np.exp(-0.25 * (k / SLOWEST_WAVENUMBER - 1.0) ** 2)
        return np.asarray(low + high)

    def spreading(self, wavenumber: ArrayLike) -> F64:
        """``Delta``: waves along the wind over the mean of all directions, minus one."""
        k = np.asarray(wavenumber, dtype=np.float64)
        c, kp = angular_frequency(wavenumber) / k, self.peak
        cp = float(angular_frequency(kp)) / kp
        gain = 0.13 * self.friction_velocity / SLOWEST_SPEED
        return np.asarray(
            np.tanh(0.25 * np.log(2.0) + 4.0 * (c / cp) ** 2.5 + gain * (SLOWEST_SPEED / c) ** 2.5)
        )

    def density(self, wavenumber: ArrayLike, cos_twice: ArrayLike) -> F64:
        """``Psi``, m^4, at wavenumbers (rad/m) and cosines of twice the angle to the wind."""
        k = np.asarray(wavenumber, dtype=np.float64)
        spread = 1.0 + self.spreading(k) * np.asarray(cos_twice, dtype=np.float64)
        return np.asarray(self.curvature(k) / k**4 * spread / (2.0 * np.pi))

    def moments(self, low: float = 0.0, high: float = np.inf) -> Moments:
        """Integrals over the waves between two wavenumbers, rad/m."""
        first, last = max(low, 0.1 * self.peak), min(high, max(_LARGEST, 10.0 * self.peak))
        if last <= first:
            return Moments(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        x = np.linspace(np.log(first), np.log(last), _NODES)
        k = np.exp(x)
        spectrum, spread, omega = self.curvature(k) / k**2, self.spreading(k), angular_frequency(k)

        def integral(weight: F64) -> float:  # dk = k dx
            return float(np.trapezoid(spectrum * weight, x))

        along, across = 0.5 + 0.25 * spread, 0.5 - 0.25 * spread
        one = np.ones_like(k)
        return Moments(
            height=integral(one),
            slope_u=integral(k**2 * along),
            slope_c=integral(k**2 * across),
            speed_u=integral(omega**2 * along),
            speed_c=integral(omega**2 * across),
            acceleration=integral(omega**4),
        )

    def drawn(self, high: float, downwind: F64, seed: int) -> F64:
        """Realisation of the waves up to a wavenumber.

        Each represents a band of the spectrum, of equal width in the wavenumber's logarithm, with exactly its height
        variance; wavenumber within the band, direction and phase are random.

        Parameters
        ----------
        high : rad/m
        downwind : (2,) unit vector towards which the wind blows
        seed : of the realisation

        Returns
        -------
        (n, 5) float64: both components of the wavenumber (rad/m), angular frequency (rad/s), phase (rad) and amplitude
        (m); no rows where the spectrum is empty

        Notes
        -----
        Waves travel into the half plane about the wind's direction, with the density ``1 + Delta cos 2 phi``.
        """
        low = 0.5 * self.peak
        if high <= low:
            return np.zeros((0, 5))
        rng = np.random.default_rng([seed, 0x5EA])
        edges = np.geomspace(low, high, DRAWN_WAVES + 1)
        fine = np.geomspace(low, high, DRAWN_WAVES * _FINER + 1)
        spectrum = self.curvature(fine) / fine**2
        strips = 0.5 * (spectrum[1:] + spectrum[:-1]) * np.diff(np.log(fine))
        height = strips.reshape(DRAWN_WAVES, _FINER).sum(axis=1)
        k = edges[:-1] * (edges[1:] / edges[:-1]) ** rng.random(DRAWN_WAVES)
        angle = _directions(self.spreading(k), rng)
        phase = rng.uniform(0.0, 2.0 * np.pi, DRAWN_WAVES)
        across = np.array([-downwind[1], downwind[0]])
        vector = k[:, None] * (np.cos(angle)[:, None] * downwind + np.sin(angle)[:, None] * across)
        rows = np.column_stack([vector, angular_frequency(k), phase, np.sqrt(2.0 * height)])
        # of the slope variance, which falls off slowest towards short waves and steepest towards long ones
        share = height * k**2
        return np.asarray(rows[share > _WORTH * share.max()] if share.max() > 0.0 else rows[:0])


def _directions(spread: F64, rng: np.random.Generator) -> F64:
    """Angles to the wind, (n,) rad within a quarter turn, of the density ``(1 + spread cos 2 phi) / pi``."""
    grid = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 721)
    below = (grid + 0.5 * np.pi + 0.5 * spread[:, None] * np.sin(2.0 * grid)) / np.pi
    at = rng.random(spread.size)
    return np.array([np.interp(u, row, grid) for u, row in zip(at, below, strict=True)])
