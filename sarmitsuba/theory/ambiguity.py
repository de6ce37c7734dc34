"""Ambiguities: echoes from where the pulse repetition frequency cannot tell them from the wanted ones."""

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.theory.beam import Gain, off_boresight

F64 = NDArray[np.float64]
_NODES = 4001


def azimuth_ghost(
    wavelength: float, slant_range: float, prf: float, speed: float, order: int = 1, sin_squint: float = 0.0
) -> tuple[float, float]:
    r"""Where a point's azimuth ambiguity of an order appears, from the point: along the track and in closest range, m.

    The ghost has the point's range R when it is in the beam's centre, and a Doppler frequency that is higher by k PRF:

    .. math:: \Delta x = \frac{k \lambda R f_p}{2 v}, \quad
              \Delta\rho = R (\sqrt{1 - s_g^2} - \sqrt{1 - s^2}), \quad s = s_g - \frac{k \lambda f_p}{2 v}

    Parameters
    ----------
    wavelength, slant_range : lambda, R, m; the range is that at the pulse where the ghost is in the beam's centre
    prf, speed : Hz and m/s along a straight track
    order : k, any whole number but 0
    sin_squint : s_g, sine of the beam's centre along the flight

    References
    ----------
    J. Curlander, R. McDonough, Synthetic Aperture Radar, Wiley 1991, sec. 6.5.1.
    """
    step = order * wavelength * prf / (2.0 * speed)
    closer = np.sqrt(1.0 - sin_squint**2) - np.sqrt(1.0 - (sin_squint - step) ** 2)
    return slant_range * step, slant_range * float(closer)


def azimuth_ghost_level(
    gain: Gain,
    wavelength: float,
    slant_range: float,
    prf: float,
    speed: float,
    bandwidth: float,
    order: int = 1,
    *,
    range_cell: float = np.inf,
    squint: float = 0.0,
    pointing_error: float = 0.0,
) -> float:
    r"""Power of a point's azimuth ambiguity in a stripmap image over the point's own, at the ghost's centre.

    .. math:: \left| \frac{\int g(s) g'(s - k \lambda f_p / 2 v) \,\mathrm{sinc}(D / \delta_r)
              e^{-j 4 \pi (D - D' x) / \lambda} dx}{\int g(s) g'(s) dx} \right|^2

    over the positions x along the track whose direction s to the ghost lies in the processed band: g the nominal and g'
    the true relative one-way power gain, D the difference of the ranges to point and ghost, 0 in the middle. Where D
    stays within the range cell this is the textbooks' ratio of two-way patterns.

    Parameters
    ----------
    gain : over the sine off boresight
    wavelength, slant_range, prf, speed, order : as for :func:`azimuth_ghost`
    bandwidth : processed Doppler bandwidth, Hz
    range_cell : delta_r, of a flat spectrum, m
    squint : of the nominal boresight, rad
    pointing_error : true less nominal boresight in azimuth, rad

    Notes
    -----
    Ignores windows, and how gain in elevation differs between point and ghost.
    """
    step = order * wavelength * prf / (2.0 * speed)
    half = 0.25 * wavelength * bandwidth / speed
    center = float(np.sin(squint))
    edges = np.clip(center + half * np.array([-1.0, 1.0]), -0.999, 0.999)
    ahead, closest = slant_range * center, slant_range * np.sqrt(1.0 - center**2)
    # antenna's place along the track, 0 where the ghost is in the beam's centre
    ends = ahead - closest * np.tan(np.arcsin(edges))
    x = np.linspace(ends[0], ends[1], _NODES)
    to_ghost = np.hypot(ahead - x, closest)
    seen = center - step
    to_point = np.hypot(slant_range * seen - x, slant_range * np.sqrt(1.0 - seen**2))
    nominal = gain(off_boresight((ahead - x) / to_ghost, squint))
    true = gain(off_boresight((slant_range * seen - x) / to_point, squint + pointing_error))
    own = gain(off_boresight((ahead - x) / to_ghost, squint + pointing_error))
    apart = to_point - to_ghost
    turn = np.exp(-4j * np.pi / wavelength * (apart - step * x))
    ghost = np.sum(nominal * true * np.sinc(apart / range_cell) * turn)
    return float(abs(ghost) ** 2 / np.sum(nominal * own) ** 2)


def azimuth_ambiguity_ratio(
    gain: Gain,
    wavelength: float,
    prf: float,
    speed: float,
    bandwidth: float,
    *,
    weighting: Literal["uniform", "matched"] = "uniform",
    squint: float = 0.0,
    pointing_error: float = 0.0,
    orders: int = 20,
) -> float:
    r"""Azimuth ambiguity-to-signal ratio of evenly bright ground in stripmap, power.

    .. math:: \frac{\sum_{m \ne 0} \int_{-B/2}^{B/2} W(f) G^2(f + m f_p) df}{\int_{-B/2}^{B/2} W(f) G^2(f) df}

    with G the one-way power gain over Doppler frequency and W the processor's weights in power: 1, or G^2 of the
    nominal beam for one that sums pulses with the pattern's own weights, as this program's backprojection does.

    Parameters
    ----------
    gain : over the sine off boresight
    wavelength, prf, speed : m, Hz, m/s
    bandwidth : B, processed Doppler bandwidth, Hz
    weighting : W
    squint : of the nominal boresight, rad
    pointing_error : true less nominal boresight in azimuth, rad
    orders : highest m; directions behind the aperture's plane do not exist

    References
    ----------
    J. Curlander, R. McDonough, Synthetic Aperture Radar, Wiley 1991, sec. 6.5.1.
    """
    half = 0.25 * wavelength * bandwidth / speed
    sine = np.sin(squint) + np.linspace(-half, half, _NODES)
    weight = gain(off_boresight(sine, squint)) ** 2 if weighting == "matched" else np.ones(_NODES)

    def energy(order: int) -> float:
        seen = sine + order * wavelength * prf / (2.0 * speed)
        visible = np.abs(seen) < 1.0
        return float(np.sum(weight * visible * gain(off_boresight(seen, squint + pointing_error)) ** 2))

    return sum(energy(m) for m in range(-orders, orders + 1) if m) / energy(0)


def range_ambiguity_ratio(
    gain: Gain,
    slant_range: float,
    height: float,
    prf: float,
    look_angle: float,
    *,
    earth_radius: float = np.inf,
    sigma0: Callable[[F64], F64] | None = None,
    orders: int = 50,
) -> float:
    r"""Range ambiguity-to-signal ratio of evenly bright ground, power.

    .. math:: \frac{\sum_{j \ne 0} P(R_j)}{P(R)}, \quad
              P(R) = \frac{\sigma^0(\theta) G^2(\gamma - \gamma_0)}{R^3 \sin\theta}, \quad
              R_j = R + \frac{j c}{2 f_p}

    over the orders whose range lies between nadir and the horizon.

    Parameters
    ----------
    gain : in elevation, over the sine of the angle off boresight
    slant_range, height : R, and of the antenna above the ground, m
    prf : Hz
    look_angle : gamma_0 of the boresight, from nadir, rad
    earth_radius : m; infinite for flat ground
    sigma0 : over the incidence angle theta, rad; None: the same everywhere
    orders : highest j, where no horizon ends the sum before

    Notes
    -----
    Ignores ground on the other side of the track, and nadir's own mirror-like echo.

    References
    ----------
    J. Curlander, R. McDonough, Synthetic Aperture Radar, Wiley 1991, sec. 6.5.1.
    """
    horizon = np.inf if np.isinf(earth_radius) else np.sqrt(height * (2.0 * earth_radius + height))

    def power(distance: F64) -> F64:
        bulge = 0.0 if np.isinf(earth_radius) else (distance**2 - height**2) / (2.0 * earth_radius)
        # cosine of the incidence angle, and of the look angle, by the law of cosines without its cancellation
        cos_incidence = np.clip((height - bulge) / distance, 0.0, 1.0)
        ratio = 1.0 if np.isinf(earth_radius) else earth_radius / (earth_radius + height)
        sin_incidence = np.sqrt(1.0 - cos_incidence**2)
        look = np.arcsin(ratio * sin_incidence)
        level = sigma0(np.arcsin(sin_incidence)) if sigma0 is not None else 1.0
        return np.asarray(level * gain(np.sin(look - look_angle)) ** 2 / (distance**3 * sin_incidence))

    order = np.arange(-orders, orders + 1)
    distance = slant_range + order * SPEED_OF_LIGHT / (2.0 * prf)
    seen = (order != 0) & (distance > height * (1.0 + 1e-9)) & (distance < horizon)
    return float(power(distance[seen]).sum() / power(np.array([slant_range]))[0])


__all__ = ["azimuth_ambiguity_ratio", "azimuth_ghost", "azimuth_ghost_level", "range_ambiguity_ratio"]
