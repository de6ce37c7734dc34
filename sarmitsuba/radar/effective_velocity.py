"""Effective velocity: rotation rate of the line of sight, on a straight track or from an orbit."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.radar.track import Track


def range_acceleration(track: Track, line: F64) -> F64:
    r"""Squared effective velocity of points at rest, half the second derivative of R^2, (n_pulses,) m^2/s^2.

    .. math:: \frac{1}{2} \frac{d^2 R^2}{dt^2} = |v|^2 - L \cdot \dot v

    Parameters
    ----------
    track : its velocities give the accelerations, by differences
    line : (n_pulses, 3) float64, m, from the antenna to the point
    """
    acceleration = np.zeros_like(track.velocity)
    if track.n_pulses > 1:
        acceleration = np.gradient(track.velocity, track.time, axis=0)
    return np.asarray(np.sum(track.velocity**2, axis=1) - np.einsum("ij,ij->i", line, acceleration))


def effective_velocity_ratio(track: Track, point: F64, pulse: int) -> float:
    r"""Squared ratio of the effective velocity to the antenna's speed.

    .. math:: V_{eff}^2 / V^2

    It is the rate of the sine of a point's direction along the flight over that from a straight track of the same
    speed: 1 on a straight track, and from an orbit about the footprint's speed over the satellite's.

    Parameters
    ----------
    track : in the scene frame
    point : (3,) float64, m, scene frame
    pulse : index

    Notes
    -----
    Exact at zero Doppler; ignores the change of speed elsewhere.
    """
    near = track.of_pulses(slice(max(pulse - 1, 0), pulse + 2))
    here = pulse - max(pulse - 1, 0)
    line = np.asarray(point - near.position)
    half = float(range_acceleration(near, line)[here])
    return half / float(np.sum(near.velocity[here] ** 2))
