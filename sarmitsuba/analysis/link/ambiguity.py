"""Ambiguity-to-signal ratios of homogeneous ground, from the antenna pattern."""

from collections.abc import Callable
from typing import Literal

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT

# relative one-way power gain over the sine of the angle off boresight, in the plane of one of the aperture's axes
Gain = Callable[[F64], F64]
_NODES = 4001


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
    r"""Azimuth ambiguity-to-signal ratio of homogeneous ground in stripmap, power.

    .. math:: \frac{\sum_{m \ne 0} \int_{-B/2}^{B/2} W(f) G^2(f + m f_p) df}{\int_{-B/2}^{B/2} W(f) G^2(f) df}

    with G the one-way power gain over Doppler frequency and W the power weights of the processor: 1, or G^2 of the
    nominal beam if pulses are weighted by the antenna pattern, as in this program's backprojection.

    Parameters
    ----------
    gain : over the sine of the angle off boresight
    wavelength, prf, speed : m, Hz, m/s
    bandwidth : B, processed Doppler bandwidth, Hz
    weighting : W
    squint : of the nominal boresight, rad
    pointing_error : true minus nominal boresight in azimuth, rad
    orders : highest m; directions behind the aperture plane do not count

    References
    ----------
    J. Curlander, R. McDonough, Synthetic Aperture Radar, Wiley 1991, sec. 6.5.1.
    """
    half = 0.25 * wavelength * bandwidth / speed
    sine = np.sin(squint) + np.linspace(-half, half, _NODES)
    weight = gain(_off_boresight(sine, squint)) ** 2 if weighting == "matched" else np.ones(_NODES)

    def energy(order: int) -> float:
        seen = sine + order * wavelength * prf / (2.0 * speed)
        visible = np.abs(seen) < 1.0
        return float(np.sum(weight * visible * gain(_off_boresight(seen, squint + pointing_error)) ** 2))

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
    r"""Range ambiguity-to-signal ratio of homogeneous ground, power.

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
    sigma0 : over the incidence angle theta, rad; None: constant
    orders : highest j, if the sum does not end at the horizon

    Notes
    -----
    Ignores ground on the other side of the track, and the specular nadir echo.

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


def _off_boresight(sine: F64, squint: float) -> F64:
    """Sine of the angle off a boresight at ``squint`` (rad) of directions whose sine along the flight is ``sine``."""
    clipped = np.clip(sine, -1.0, 1.0)
    return np.asarray(clipped * np.cos(squint) - np.sqrt(1.0 - clipped**2) * np.sin(squint))
