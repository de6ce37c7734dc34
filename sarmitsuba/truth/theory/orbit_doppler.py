"""Doppler of a radar in a circular orbit about the rotating Earth, in closed form."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.constants import EARTH_GRAVITY, EARTH_ROTATION


@dataclass(frozen=True)
class OrbitDoppler:
    r"""Doppler quantities of a point at rest in the zero-Doppler plane of a circular orbit.

    Parameters
    ----------
    relative_speed : of the satellite over the turning Earth, m/s
    footprint_speed : m/s; of the zero-Doppler line over the ground at the point, :math:`V_s (\rho / a) \cos\gamma`
    effective_velocity : m/s
    doppler_rate : Hz/s, :math:`-2 V_{eff}^2 / (\lambda R)`
    look_angle : from nadir, rad
    rotation_doppler : Hz; Doppler at that look angle square to the inertial velocity, which yaw steering removes
    yaw : rad; of the velocity over the turning Earth against the inertial one, positive to the left
    """

    relative_speed: float
    footprint_speed: float
    effective_velocity: float
    doppler_rate: float
    look_angle: float
    rotation_doppler: float
    yaw: float


def orbital_speed(radius: float) -> float:
    r"""Inertial speed on a circular orbit of that radius (m), m/s: :math:`\sqrt{\mu / a}`."""
    return float(np.sqrt(EARTH_GRAVITY / radius))


def circular_orbit_doppler(
    radius: float,
    inclination: float,
    argument_of_latitude: float,
    slant_range: float,
    point_radius: float,
    side: float,
    wavelength: float,
) -> OrbitDoppler:
    r"""Doppler of a resting point in the zero-Doppler plane of a circular orbit.

    In the axes r (up), v (along the inertial velocity) and h (to the left), with the orbit's rate
    :math:`n = \sqrt{\mu / a^3}`, the argument of latitude u and inclination i, the Earth turns by

    .. math:: \omega = \omega_E (\sin u \sin i, \cos u \sin i, \cos i)

    so that the velocity over the ground and its yaw are

    .. math::
        v_s = a (0, n - \omega_E \cos i, \omega_E \cos u \sin i), \qquad
        \tan\psi = \frac{\cos u \sin i}{n / \omega_E - \cos i}

    The point p lies in the plane of r and :math:`w = r \times v_s / |v_s|` at the Earth's central angle gamma, and

    .. math::
        V_{eff}^2 = -\frac{d^2}{dt^2} (s \cdot p)
                  = n^2 s \cdot p - 2 \dot s \cdot (\omega \times p) - s \cdot (\omega \times (\omega \times p))

    for the satellite s in inertial axes. Without rotation that is :math:`V_s V_g`, the satellite's speed times that of
    its footprint, :math:`n \rho \cos\gamma`. A beam square to the inertial velocity has the Doppler

    .. math:: f = \pm \frac{2}{\lambda} a \omega_E \sin\eta \sin i \cos u

    at the look angle eta; + to the left.

    Parameters
    ----------
    radius : a, of the orbit, m
    inclination, argument_of_latitude : rad
    slant_range : R, m
    point_radius : rho, of the point from the Earth's centre, m
    side : 1 to the left, -1 to the right
    wavelength : m

    References
    ----------
    R. K. Raney, "Doppler properties of radars in circular orbits", Int. J. Remote Sensing 7 (9), 1986, 1153-1162, for
    the Doppler square to the velocity and the yaw; I. G. Cumming and F. H. Wong, Digital Processing of Synthetic
    Aperture Radar Data, Artech House, 2005, section 4.3, for the effective velocity without rotation.
    """
    rate = orbital_speed(radius) / radius
    sin_i, cos_i = np.sin(inclination), np.cos(inclination)
    turn = EARTH_ROTATION * np.array(
        [np.sin(argument_of_latitude) * sin_i, np.cos(argument_of_latitude) * sin_i, cos_i]
    )
    satellite = np.array([radius, 0.0, 0.0])
    inertial = np.array([0.0, radius * rate, 0.0])
    relative = radius * np.array([0.0, rate - turn[2], turn[1]])
    speed = float(np.linalg.norm(relative))
    cos_gamma = (radius**2 + point_radius**2 - slant_range**2) / (2.0 * radius * point_radius)
    sin_gamma = np.sqrt(1.0 - cos_gamma**2)
    sideways = side * np.array([0.0, -relative[2], relative[1]]) / speed
    point = point_radius * (np.array([cos_gamma, 0.0, 0.0]) + sin_gamma * sideways)
    carried = np.cross(turn, point)
    square = rate**2 * (satellite @ point) - 2.0 * inertial @ carried - satellite @ np.cross(turn, carried)
    sin_look = point_radius * sin_gamma / slant_range
    return OrbitDoppler(
        relative_speed=speed,
        footprint_speed=float(speed * point_radius / radius * cos_gamma),
        effective_velocity=float(np.sqrt(square)),
        doppler_rate=float(-2.0 * square / (wavelength * slant_range)),
        look_angle=float(np.arcsin(sin_look)),
        rotation_doppler=float(2.0 / wavelength * side * radius * turn[1] * sin_look),
        yaw=float(np.arctan2(turn[1], rate - turn[2])),
    )
