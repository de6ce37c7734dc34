"""Sea under wind: published spectrum, slopes, backscatter, permittivity, and coherence of the moving surface.

Independent of the simulator's code for the sea. References: [E97] Elfouhaily et al., J. Geophys. Res.
102 (C7) 1997; [CM54] Cox and Munk, J. Opt. Soc. Am. 44 (1954); [H08] Hersbach, CMOD5.N, ECMWF Technical Memorandum 554
(2008); [V78] Valenzuela, Boundary-Layer Meteorol. 13 (1978); [T98] Thompson, Elfouhaily and Chapron, IGARSS 1998.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import simpson

from sarmitsuba.core.arrays import C128, F64

# coefficients of CMOD5.N, c1 to c28 [H08]
_CMOD5N = (
    *(
        -0.6878,
        -0.7957,
        0.3380,
        -0.1728,
        0.0,
        0.0040,
        0.1103,
        0.0159,
        6.7329,
        2.7713,
        -2.2885,
        0.4971,
        -0.7250,
    ),
    *(0.0450, 0.0066, 0.3222, 0.0120, 22.7, 2.0813, 3.0, 8.3659, -3.3428, 1.3236, 6.2437, 2.3893, 0.3249),
    *(4.1590, 1.6930),
)


def phase_speed(wavenumber: ArrayLike) -> F64:
    """Phase speed of waves on deep water, m/s, at wavenumbers in rad/m: gravity and surface tension [E97, eq. 24]."""
    k = np.asarray(wavenumber, dtype=np.float64)
    return np.asarray(np.sqrt(9.81 / k * (1.0 + (k / 370.0) ** 2)))


def wave_spectrum(wavenumber: ArrayLike, wind_speed: float, age: float = 0.84) -> tuple[F64, F64]:
    """Omnidirectional height spectrum S (m^3) and spreading Delta of a sea [E97].

    Parameters
    ----------
    wavenumber : k, rad/m
    wind_speed : at 10 m, m/s
    age : Omega, wind speed over the phase speed of the highest waves, 0.84 to 5

    Notes
    -----
    The drag coefficient is Wu's (1982); the short waves have the Pierson-Moskowitz cut and no peak enhancement.
    """
    k = np.asarray(wavenumber, dtype=np.float64)
    friction = wind_speed * np.sqrt(8e-4 + 6.5e-5 * wind_speed)
    k_p = 9.81 * (age / wind_speed) ** 2
    c, c_p, c_m = phase_speed(k), phase_speed(k_p), phase_speed(370.0)
    pierson_moskowitz = np.exp(-5.0 / 4.0 * (k_p / k) ** 2)  # eq. 2
    sigma = 0.08 * (1.0 + 4.0 * age**-3)  # eq. 3
    gamma = 1.7 if age < 1.0 else 1.7 + 6.0 * np.log10(age)
    enhancement = gamma ** np.exp(-((np.sqrt(k / k_p) - 1.0) ** 2) / (2.0 * sigma**2))
    f_p = pierson_moskowitz * enhancement * np.exp(-age / np.sqrt(10.0) * (np.sqrt(k / k_p) - 1.0))  # eq. 32
    long = 0.003 * np.sqrt(age) * c_p / c * f_p  # eqs. 31, 34
    alpha_m = 0.01 * (1.0 + np.log(friction / c_m) * (1.0 if friction < c_m else 3.0))  # eq. 44
    short = 0.5 * max(alpha_m, 0.0) * c_m / c * np.exp(-0.25 * (k / 370.0 - 1.0) ** 2)  # eqs. 40, 41
    short = short * pierson_moskowitz
    a_m = 0.13 * friction / c_m  # eq. 59
    delta = np.tanh(np.log(2.0) / 4.0 + 4.0 * (c / c_p) ** 2.5 + a_m * (c_m / c) ** 2.5)  # eq. 57
    return np.asarray((long + short) / k**3), np.asarray(delta)


def band_integral(
    wind_speed: float, low: float, high: float, power: float, speed_power: float = 0.0, age: float = 0.84
) -> tuple[float, float]:
    r"""Moments of a sea's spectrum along the wind and across it, over a band of wavenumbers.

    .. math:: \int S(k)\, k^p\, c^q \left(\tfrac12 \pm \tfrac14 \Delta\right) dk

    Slopes have p = 2, q = 0, orbital velocities p = q = 2 (their vertical part is the sum of both).
    """
    x = np.linspace(np.log(low), np.log(high), 6001)
    k = np.exp(x)
    spectrum, delta = wave_spectrum(k, wind_speed, age)
    weight = spectrum * k ** (power + 1.0) * phase_speed(k) ** speed_power
    return (
        float(simpson(weight * (0.5 + 0.25 * delta), x=x)),
        float(simpson(weight * (0.5 - 0.25 * delta), x=x)),
    )


def cox_munk(wind_speed: ArrayLike) -> tuple[F64, F64]:
    """Slope variances upwind and crosswind of a clean sea, +- 0.004 and 0.002 [CM54]; wind in m/s at 12.5 m."""
    wind = np.asarray(wind_speed, dtype=np.float64)
    return np.asarray(3.16e-3 * wind), np.asarray(3e-3 + 1.92e-3 * wind)


def cmod5n(wind_speed: ArrayLike, azimuth: ArrayLike, incidence: ArrayLike) -> F64:
    """C-band vv sigma0 (linear) of the sea by CMOD5.N, fitted to satellite scatterometers [H08].

    Parameters
    ----------
    wind_speed : neutral, at 10 m, m/s
    azimuth : of the look against the wind, rad; 0 is upwind
    incidence : rad, 17 to 65 degrees
    """
    c = (0.0, *_CMOD5N)
    v, phi = np.asarray(wind_speed, dtype=np.float64), np.asarray(azimuth, dtype=np.float64)
    x = (np.degrees(np.asarray(incidence, dtype=np.float64)) - 40.0) / 25.0
    a0, a1 = c[1] + c[2] * x + c[3] * x**2 + c[4] * x**3, c[5] + c[6] * x
    gamma, s0 = c[9] + c[10] * x + c[11] * x**2, c[12] + c[13] * x
    s = (c[7] + c[8] * x) * v
    a3 = 1.0 / (1.0 + np.exp(-np.maximum(s, s0)))
    low = a3 * np.maximum(s / s0, 1e-9) ** (s0 * (1.0 - a3))
    b0 = np.where(s < s0, low, a3) ** gamma * 10.0 ** (a0 + a1 * v)
    b1 = c[14] * (1.0 + x) - c[15] * v * (0.5 + x - np.tanh(4.0 * (x + c[16] + c[17] * v)))
    b1 = b1 / (1.0 + np.exp(0.34 * (v - c[18])))
    y0, n = c[19], c[20]
    a, b = y0 - (y0 - 1.0) / n, 1.0 / (n * (y0 - 1.0) ** (n - 1.0))
    y = v / (c[21] + c[22] * x + c[23] * x**2) + 1.0
    y = np.where(y < y0, a + b * (y - 1.0) ** n, y)
    b2 = (-(c[24] + c[25] * x + c[26] * x**2) + (c[27] + c[28] * x) * y) * np.exp(-y)
    return np.asarray(b0 * (1.0 + b1 * np.cos(phi) + b2 * np.cos(2.0 * phi)) ** 1.6)


def polarisation_ratio(incidence: ArrayLike, alpha: float = 0.6) -> F64:
    """Vv over hh sigma0 of the sea at C band, by a fit to airborne and satellite data [T98]."""
    tan2 = np.tan(np.asarray(incidence, dtype=np.float64)) ** 2
    return np.asarray(((1.0 + 2.0 * tan2) / (1.0 + alpha * tan2)) ** 2)


def two_scale(
    wind_speed: float,
    wavelength: float,
    permittivity: complex,
    incidence: float,
    azimuth: float,
    *,
    longest: float,
    split: float,
    age: float = 0.84,
) -> tuple[float, float]:
    """Sigma0 (hh, vv) of the two-scale model [V78], by a dense sum over facets as vectors.

    Parameters
    ----------
    wind_speed : m/s
    wavelength : m
    permittivity : of the water
    incidence, azimuth : of the look, rad; azimuth 0 is along the wind
    longest, split : rad/m, waves between them tilt the shorter ones
    age : Omega
    """
    k = 2.0 * np.pi / wavelength
    variance_u, variance_c = band_integral(wind_speed, longest, split, 2.0, age=age)
    height = sum(band_integral(wind_speed, split, 2e4, 0.0, age=age))
    radar = np.array(
        [np.sin(incidence) * np.cos(azimuth), np.sin(incidence) * np.sin(azimuth), np.cos(incidence)]
    )
    sideways = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    grid = np.linspace(-5.0, 5.0, 121)
    steps = np.exp(-0.5 * grid**2)
    steps /= steps.sum()
    slope_u, slope_c = np.meshgrid(
        np.sqrt(variance_u) * grid, np.sqrt(variance_c) * grid, indexing="ij"
    )  # x is the wind's
    weight = steps[:, None] * steps
    normal = np.stack([-slope_u, -slope_c, np.ones_like(slope_u)], axis=-1)
    area = np.linalg.norm(normal, axis=-1)
    normal /= area[..., None]
    cosine = normal @ radar
    facing = cosine > 1e-3
    cosine = np.where(facing, cosine, 1.0)
    tangent = radar - cosine[..., None] * normal
    wave = 2.0 * k * np.linalg.norm(tangent, axis=-1)
    wave = np.maximum(wave, 1e-6)
    direction = np.arctan2(tangent[..., 1], tangent[..., 0])
    spectrum, delta = wave_spectrum(wave, wind_speed, age)
    psi = spectrum / wave * (1.0 + delta * np.cos(2.0 * direction)) / (2.0 * np.pi)
    own = np.cross(normal, radar)
    own /= np.maximum(np.linalg.norm(own, axis=-1, keepdims=True), 1e-12)
    kept = (own @ sideways) ** 2
    sine2 = 1.0 - cosine**2
    root = np.sqrt(permittivity - sine2)
    g_h = cosine**2 * (permittivity - 1.0) / (cosine + root) ** 2
    g_v = (
        cosine**2
        * (permittivity - 1.0)
        * (permittivity * (1.0 + sine2) - sine2)
        / (permittivity * cosine + root) ** 2
    )
    level = 16.0 * np.pi * k**4 * psi * area * weight * (facing & (wave > split))
    hh = float(np.sum(level * np.abs(kept * g_h + (1.0 - kept) * g_v) ** 2))
    vv = float(np.sum(level * np.abs(kept * g_v + (1.0 - kept) * g_h) ** 2))
    n = np.sqrt(permittivity)
    slope = np.tan(incidence) * np.array([np.cos(azimuth), np.sin(azimuth)])
    density = np.exp(-0.5 * (slope[0] ** 2 / variance_u + slope[1] ** 2 / variance_c))
    density /= 2.0 * np.pi * np.sqrt(variance_u * variance_c)
    mirrored = np.pi * abs((n - 1.0) / (n + 1.0)) ** 2 * density / np.cos(incidence) ** 4
    mirrored *= np.exp(-4.0 * k**2 * height)
    return hh + float(mirrored), vv + float(mirrored)


def sea_water_permittivity(frequency: float, temperature: float, salinity: float) -> complex:
    """Permittivity of water by Stogryn (IEEE Trans. MTT 19, 1971), a different fit from the simulator's.

    Parameters
    ----------
    frequency : Hz
    temperature : degrees Celsius
    salinity : g of salt per kg
    """
    t, s = temperature, salinity
    normality = s * (1.707e-2 + 1.205e-5 * s + 4.058e-9 * s**2)
    static = 87.74 - 0.40008 * t + 9.398e-4 * t**2 + 1.410e-6 * t**3
    static *= 1.0 - 0.2551 * normality + 5.151e-2 * normality**2 - 6.889e-3 * normality**3
    relaxation = 1.1109e-10 - 3.824e-12 * t + 6.938e-14 * t**2 - 5.096e-16 * t**3  # 2 pi tau
    relaxation *= 1.0 + 0.1463e-2 * normality * t - 0.04896 * normality
    relaxation += relaxation * (-0.02967 * normality**2 + 5.644e-3 * normality**3)
    conductivity = normality * (10.394 - 2.3776 * normality + 0.68258 * normality**2)
    conductivity += normality * (-0.13538 * normality**3 + 1.0086e-2 * normality**4)
    below = 25.0 - t
    change = 1.0 - 1.962e-2 * below + 8.08e-5 * below**2
    change -= below * normality * (3.020e-5 + 3.922e-5 * below)
    change += below * normality**2 * (1.721e-5 - 6.584e-6 * below)
    conductivity *= change
    high = 4.9
    debye = high + (static - high) / (1.0 + 1j * frequency * relaxation)
    return complex(debye - 1j * conductivity / (2.0 * np.pi * frequency * 8.8541878128e-12))


def orbital_velocity(waves: F64, points: F64, time: float) -> F64:
    r"""Velocity of the surface of deep water by linear waves, (n, 3) m/s.

    .. math:: \mathbf u = \sum a \omega (\hat{\mathbf k} \cos\psi + \hat{\mathbf z} \sin\psi), \quad
              \psi = \mathbf k \cdot \mathbf x - \omega t + \phi

    Parameters
    ----------
    waves : (m, 5) wavenumber east and north (rad/m), angular frequency (rad/s), phase (rad), amplitude (m)
    points : (n, 2) or (n, 3) m
    time : t, s
    """
    kx, ky, omega, phase, amplitude = waves.T
    psi = points[:, :1] * kx + points[:, 1:2] * ky - omega * time + phase
    speed, k = amplitude * omega, np.hypot(kx, ky)
    parts = (np.cos(psi) * speed * kx / k, np.cos(psi) * speed * ky / k, np.sin(psi) * speed)
    return np.stack([part.sum(axis=1) for part in parts], axis=1)


def speed_deviation(along: float, across: float, incidence: ArrayLike, azimuth: ArrayLike) -> F64:
    r"""Standard deviation of the range speed of scatterers on moving waves, m/s.

    .. math:: \sigma_v^2 = (\sigma_u^2 + \sigma_c^2) \cos^2\theta
              + (\sigma_u^2 \cos^2\varphi + \sigma_c^2 \sin^2\varphi) \sin^2\theta

    Parameters
    ----------
    along, across : variances of the horizontal orbital velocity along the wind and across it, (m/s)^2
    incidence, azimuth : of the look, rad; azimuth 0 is along the wind
    """
    theta, phi = np.asarray(incidence, dtype=np.float64), np.asarray(azimuth, dtype=np.float64)
    level = along * np.cos(phi) ** 2 + across * np.sin(phi) ** 2
    return np.asarray(np.sqrt((along + across) * np.cos(theta) ** 2 + level * np.sin(theta) ** 2))


def approaching_share(azimuth: ArrayLike) -> F64:
    r"""Share of approaching Bragg waves, :math:`\cos^4(\varphi/2)` over the sum of itself and :math:`\sin^4`.

    ``azimuth`` (rad) is that of the way to the radar against the direction that the wind blows to.
    """
    half = 0.5 * np.asarray(azimuth, dtype=np.float64)
    return np.asarray(np.cos(half) ** 4 / (np.cos(half) ** 4 + np.sin(half) ** 4))


def coherence(
    time: ArrayLike,
    wavelength: float,
    deviation: float,
    bragg_frequency: float = 0.0,
    approaching: float = 0.5,
) -> C128:
    r"""Temporal correlation of an ensemble of scatterers.

    .. math:: \gamma(\tau) = e^{-2 (k \sigma_v \tau)^2} \bigl(p\, e^{j \Omega \tau} + (1 - p)\, e^{-j \Omega \tau}\bigr)

    Parameters
    ----------
    time : tau, s
    wavelength : m
    deviation : sigma_v of the range speed, m/s
    bragg_frequency : Omega, rad/s, of waves half as long as the radar's on the ground
    approaching : p, share that runs to the radar
    """
    t = np.asarray(time, dtype=np.float64)
    decay = np.exp(-2.0 * (2.0 * np.pi / wavelength * deviation * t) ** 2)
    lines = approaching * np.exp(1j * bragg_frequency * t)
    return np.asarray(decay * (lines + (1.0 - approaching) * np.exp(-1j * bragg_frequency * t)))


def coherence_time(wavelength: float, deviation: float) -> float:
    r"""Time in which the coherence falls to 1/e, s: :math:`\lambda / (\sqrt 8\, \pi \sigma_v)`."""
    return float(wavelength / (np.sqrt(8.0) * np.pi * deviation))


def azimuth_spread(slant_range: float, deviation: float, speed: float) -> float:
    r"""Standard deviation of the azimuth displacement of the scatterers at one position, m.

    .. math:: \sigma_x = R \sigma_v / V
    """
    return float(slant_range * deviation / speed)
