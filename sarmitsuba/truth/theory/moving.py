"""Displacement, smearing and phase of moving targets in a radar image, for a straight track and a uniform antenna."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import fresnel

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import db_from_power


def azimuth_displacement(slant_range: ArrayLike, range_speed: ArrayLike, speed: ArrayLike) -> F64:
    r"""Azimuth displacement of a target from its range speed, m, positive ahead along the track.

    .. math:: \Delta x = -\frac{R\, v_r}{v}

    A target at rest that far along the track has the same range and the same Doppler frequency. The form is exact for a
    target at the radar's side and holds to first order in the squint.

    Parameters
    ----------
    slant_range : R at mid-aperture, m
    range_speed : v_r, rate of change of the slant range by the target's motion, m/s
    speed : v of the antenna, m/s

    References
    ----------
    Raney, "Synthetic aperture imaging radar and moving targets", IEEE Trans. AES 7 (1971), 499-505.
    """
    return np.asarray(
        -np.asarray(slant_range) * np.asarray(range_speed) / np.asarray(speed), dtype=np.float64
    )


def apparent_place(antenna: F64, velocity: F64, place: F64, target_velocity: F64, height: float) -> F64:
    r"""Apparent position of a moving target in an image focused on a height, (3,) m.

    It is the point at this height of equal range and Doppler frequency, on the target's side of the track:

    .. math:: |\mathbf p - \mathbf a| = R, \quad
              (\mathbf p - \mathbf a) \cdot \mathbf v = (\mathbf x - \mathbf a) \cdot (\mathbf v - \mathbf w)

    Parameters
    ----------
    antenna, velocity : (3,) m and m/s, level flight at mid-aperture
    place, target_velocity : x and w, (3,) m and m/s, of the target at that time
    height : m, of the image plane

    Notes
    -----
    Ignores the change of the second derivative of the range, which smears, see :func:`range_acceleration`.
    """
    speed = float(np.linalg.norm(velocity))
    ahead = velocity / speed
    leg = place - antenna
    along = float(leg @ (velocity - target_velocity)) / speed
    side = np.cross(ahead, [0.0, 0.0, 1.0])
    side *= np.sign(side @ leg)
    drop = height - float(antenna[2])
    across = np.sqrt(float(leg @ leg) - along**2 - drop**2)
    return np.asarray(antenna + along * ahead + across * side + drop * np.array([0.0, 0.0, 1.0]))


def range_acceleration(
    antenna: F64, velocity: F64, place: F64, target_velocity: F64, acceleration: F64
) -> float:
    r"""Excess range acceleration of a moving target over a target at rest at its apparent position, m/s^2.

    .. math:: \Delta = \frac{|\mathbf v - \mathbf w|^2 - |\mathbf v|^2}{R} + \mathbf a \cdot \mathbf d

    with d the unit vector to the target. To first order an azimuth velocity gives :math:`-2 v w_a / R` and an
    acceleration away from the radar itself.

    Parameters
    ----------
    antenna, velocity : (3,) m and m/s
    place, target_velocity, acceleration : (3,) m, m/s and m/s^2, of the target

    References
    ----------
    Raney (1971); Cumming and Wong, "Digital Processing of Synthetic Aperture Radar Data" (2005).
    """
    leg = place - antenna
    reach = float(np.linalg.norm(leg))
    seen = velocity - target_velocity
    # the part of the relative motion along the line of sight is the same for both, by the choice of the place
    return float((seen @ seen - velocity @ velocity) / reach + acceleration @ leg / reach)


def quadratic_phase(range_acceleration: ArrayLike, time: ArrayLike, wavelength: float) -> F64:
    r"""Phase error at both ends of an aperture of the time T, rad.

    .. math:: \phi = \frac{4\pi}{\lambda}\,\frac{\Delta}{2}\Bigl(\frac T2\Bigr)^2
    """
    return np.asarray(
        np.pi * np.asarray(range_acceleration) * np.square(np.asarray(time)) / (2.0 * wavelength),
        dtype=np.float64,
    )


def smear_length(range_acceleration: ArrayLike, slant_range: float, time: float, speed: float) -> F64:
    r"""Length along the track over which a target smears, beyond its resolution, m.

    .. math:: L = \frac{R\, |\Delta|\, T}{v}

    For an azimuth velocity it is :math:`2 |w_a| T`, twice the way that the target goes.
    """
    return np.asarray(slant_range * np.abs(range_acceleration) * time / speed, dtype=np.float64)


def smear_loss_db(phase: ArrayLike) -> F64:
    r"""Loss of the middle of a target's response by a quadratic phase error of the uniform aperture, dB, 0 or below.

    .. math:: \Bigl|\int_0^1 e^{j \phi u^2}\, du\Bigr|^2 = \frac{C^2(s) + S^2(s)}{s^2}, \quad s = \sqrt{2 |\phi| / \pi}

    with the Fresnel integrals C and S. For :math:`|\phi|` up to about :math:`\pi` the middle is the peak.

    References
    ----------
    Carrara, Goodman and Majewski, "Spotlight Synthetic Aperture Radar" (1995), chapter 5.
    """
    argument = np.sqrt(2.0 * np.abs(np.asarray(phase, dtype=np.float64)) / np.pi)
    argument = np.maximum(argument, 1e-6)
    sine, cosine = fresnel(argument)
    return np.asarray(db_from_power((sine**2 + cosine**2) / argument**2))


def range_walk(range_speed: ArrayLike, time: float) -> F64:
    """Range walk: change of a target's range by its motion during an aperture of ``time`` s, m."""
    return np.asarray(np.asarray(range_speed) * time, dtype=np.float64)


def phase_along_track(range_speed: ArrayLike, lag: float, wavelength: float) -> F64:
    r"""Phase of an along-track interferogram, later look times the conjugate of the earlier one, rad, not wrapped.

    .. math:: \phi = -\frac{4\pi}{\lambda} v_r \tau

    Parameters
    ----------
    range_speed : v_r, m/s, away from the radar
    lag : tau, s, between the looks from one place: B / v for two passes or antennas that transmit in turn, a distance B
        apart; B / (2 v) for one transmitter and two receivers
    wavelength : m

    References
    ----------
    Goldstein and Zebker, "Interferometric radar measurement of ocean surface currents", Nature 328 (1987), 707-709.
    """
    return np.asarray(-4.0 * np.pi / wavelength * np.asarray(range_speed) * lag, dtype=np.float64)


def double_bounce_range_speed(direction: F64, normal: F64, velocity: F64) -> float:
    r"""Range speed of the return by way of a moving wall and level ground at rest, or the other way round, m/s.

    Only the wall's motion along its normal n changes the path, :math:`\mathbf w \cdot (\mathbf d_i - \mathbf d_{i+1})`
    with the way mirrored in the wall:

    .. math:: v_r = (\mathbf w \cdot \mathbf n)(\mathbf d \cdot \mathbf n)

    so that, unlike the return of the roof, it is independent of vertical motion and of motion along the wall.

    Parameters
    ----------
    direction : d, (3,) unit vector from the antenna
    normal : n, (3,) horizontal unit normal of the wall
    velocity : w, (3,) m/s
    """
    return float((velocity @ normal) * (direction @ normal))
