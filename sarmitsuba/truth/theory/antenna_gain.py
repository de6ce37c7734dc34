"""One-way power gain of textbook antennas, and the effect of mispointing on focused points."""

from collections.abc import Callable

import numpy as np

from sarmitsuba.core.arrays import F64

# relative one-way power gain over the sine of the angle off boresight, in the plane of one of the aperture's axes
Gain = Callable[[F64], F64]
_NODES = 20001


def gaussian_gain(beamwidth: float) -> Gain:
    r"""Gain of a Gaussian beam, :math:`2^{-(s / \sin(\theta / 2))^2}`.

    Parameters
    ----------
    beamwidth : theta, one-way half-power width, rad
    """
    half = float(np.sin(0.5 * beamwidth))
    return lambda sine: np.asarray(2.0 ** -((np.asarray(sine) / half) ** 2))


def uniform_aperture_gain(length: float, wavelength: float) -> Gain:
    r"""Gain of a uniformly lit aperture, :math:`(\sin x / x)^2, x = \pi D s / \lambda`.

    Parameters
    ----------
    length, wavelength : D and lambda, m
    """
    return lambda sine: np.asarray(np.sinc(np.asarray(sine) * length / wavelength) ** 2)


def off_boresight(sine: F64, squint: float) -> F64:
    """Sine of the angle off a boresight at ``squint`` (rad) of directions whose sine along the flight is ``sine``."""
    clipped = np.clip(sine, -1.0, 1.0)
    return np.asarray(clipped * np.cos(squint) - np.sqrt(1.0 - clipped**2) * np.sin(squint))


def doppler_centroid(speed: float, wavelength: float, angle: float) -> float:
    r"""Doppler frequency of a beam's centre, :math:`2 v \sin\psi / \lambda`, Hz.

    Parameters
    ----------
    speed, wavelength : m/s and m
    angle : psi, between boresight and the plane across the track, rad, positive forward
    """
    return 2.0 * speed / wavelength * float(np.sin(angle))


def mispointed_level(gain: Gain, half_aperture: float, error: float, squint: float = 0.0) -> float:
    r"""Loss of a focused point in stripmap by a pointing error in azimuth, power relative to that without error.

    .. math:: \left| \frac{\int g(s) g'(s) x' ds}{\int g^2(s) x' ds} \right|^2, \quad
              x' = (1 - s^2)^{-3/2}

    over the processed band of sines s about the nominal boresight; g the nominal and g' the true relative one-way power
    gain (two-way amplitude). The processor weighs and calibrates by the nominal pattern; x' is the track flown per
    sine.

    Parameters
    ----------
    gain : over the sine off boresight
    half_aperture : half the processed band, in sines along the flight
    error : true less nominal boresight in azimuth, rad
    squint : nominal, rad
    """
    sine = np.sin(squint) + np.linspace(-half_aperture, half_aperture, _NODES)
    track = (1.0 - sine**2) ** -1.5
    nominal = gain(off_boresight(sine, squint))
    true = gain(off_boresight(sine, squint + error))
    return float((np.sum(nominal * true * track) / np.sum(nominal**2 * track)) ** 2)
