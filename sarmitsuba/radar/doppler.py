"""Doppler of a point seen from a track: centroid, rate and effective velocity, pulse by pulse."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track, range_acceleration


@dataclass(frozen=True, eq=False)
class DopplerHistory:
    r"""Slant range R, Doppler frequency, Doppler rate and effective velocity of a point over the pulses.

    .. math::
        f_D = -\frac{2}{\lambda} \dot R, \qquad K = -\frac{2}{\lambda} \ddot R, \qquad
        V_{eff}^2 = \frac{1}{2} \frac{d^2 R^2}{dt^2} = \dot R^2 + R \ddot R

    so that :math:`R^2 = R_0^2 + V_{eff}^2 (t - t_0)^2` about that pulse, and :math:`K = -2 V_{eff}^2 / (\lambda R)` at
    zero Doppler.

    Parameters
    ----------
    slant_range : (n_pulses,) float64, m
    frequency : (n_pulses,) float64, Hz; positive while the antenna comes nearer
    rate : (n_pulses,) float64, Hz/s; negative for a point at rest
    effective_velocity : (n_pulses,) float64, m/s

    References
    ----------
    I. G. Cumming and F. H. Wong, Digital Processing of Synthetic Aperture Radar Data, Artech House, 2005, sections 4.3
    and 4.5.
    """

    slant_range: F64
    frequency: F64
    rate: F64
    effective_velocity: F64


def doppler_history(track: Track, point: ArrayLike, wavelength: float) -> DopplerHistory:
    """Range and Doppler history of a point at rest.

    Parameters
    ----------
    track : in the scene frame; accelerations come from its velocities
    point : (3,) float, m, scene frame
    wavelength : m

    Notes
    -----
    Stop-and-go: ignores the antenna's motion between transmission and reception.
    """
    line = np.asarray(point, dtype=np.float64) - track.position
    distance = np.linalg.norm(line, axis=1)
    closing = np.einsum("ij,ij->i", line, track.velocity) / distance
    half = range_acceleration(track, line)
    return DopplerHistory(
        slant_range=distance,
        frequency=2.0 / wavelength * closing,
        rate=-2.0 / wavelength * (half - closing**2) / distance,
        effective_velocity=np.sqrt(half),
    )


def beam_doppler(radar: Radar) -> F64:
    r"""Doppler centroid of the beam in every pulse, (n_pulses,) Hz, for scatterers at rest on its boresight b.

    .. math:: f_{DC} = \frac{2}{\lambda} v \cdot b
    """
    motion = np.einsum("ij,ij->i", radar.track.velocity, radar.pointing.boresight)
    return np.asarray(2.0 / radar.waveform.wavelength * motion)
