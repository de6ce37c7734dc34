"""Azimuth and range ambiguity-to-signal ratios of the image, by closed forms."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.analysis.link.ambiguity import azimuth_ambiguity_ratio, range_ambiguity_ratio
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import EARTH_RADIUS
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import flight, incidence_angle


@dataclass(frozen=True)
class Vantage:
    """Height and look angle of the antenna for a point on spherical or flat ground.

    Parameters
    ----------
    height : m over the ground
    look_angle : of the line of sight to the place, from the antenna's nadir, rad
    """

    height: float
    look_angle: float


def earth_radius(given: RadarInput | None) -> float:
    """Radius of the ground under the antenna, m; infinite for a flight along the scene's plane, not in an orbit."""
    if given is None:
        return float("inf")
    orbits = given.sensor.orbit_altitude > 0.0 or bool(given.sensor.state_vectors_file)
    return EARTH_RADIUS if orbits else float("inf")


def vantage(slant_range: float, incidence: float, radius: float) -> Vantage:
    r"""Height and look angle of an antenna at a slant range and incidence, by the law of cosines.

    .. math:: h = \frac{R^2 + 2 R R_e \cos\theta}{R_e + \sqrt{R_e^2 + R^2 + 2 R_e R \cos\theta}}, \qquad
              \sin\gamma = \frac{R_e}{R_e + h} \sin\theta

    Parameters
    ----------
    slant_range : R, m
    incidence : theta, rad
    radius : R_e of the ground, m; infinite for a plane
    """
    if np.isinf(radius):
        return Vantage(slant_range * float(np.cos(incidence)), incidence)
    square = slant_range**2 + 2.0 * slant_range * radius * float(np.cos(incidence))
    height = square / (radius + float(np.sqrt(radius**2 + square)))
    return Vantage(height, float(np.arcsin(radius / (radius + height) * np.sin(incidence))))


def vantage_of(radar: Radar, point: F64, radius: float) -> Vantage:
    """Height and look angle of mid-aperture for a point (3,), m, scene frame."""
    slant = float(np.linalg.norm(point - radar.track.center_position))
    return vantage(slant, float(incidence_angle(radar, point)), radius)


def azimuth_ambiguity(radar: Radar, prf: float, processed_bandwidth: float) -> float:
    """Azimuth ambiguity-to-signal ratio of homogeneous ground, power; NaN for an isotropic antenna.

    Parameters
    ----------
    radar : of the beam
    prf : Hz
    processed_bandwidth : of the aperture of a pixel, Hz; for a steered beam at its centre

    Notes
    -----
    Weights of backprojection, without a window. For a steered beam the ratio holds at its centre.
    """
    antenna, wavelength = radar.antenna, radar.waveform.wavelength
    if not antenna.directive:
        return float("nan")
    middle = radar.track.center_index

    def gain(sine: F64) -> F64:
        return np.asarray(antenna.two_way_amplitude(np.asarray(sine), np.zeros_like(sine)))

    return azimuth_ambiguity_ratio(
        gain,
        wavelength,
        prf,
        float(np.linalg.norm(radar.track.velocity[middle])),
        processed_bandwidth if np.isfinite(radar.half_aperture) else 0.0,
        weighting="matched",
        squint=float(np.arcsin(flight(radar)[1][middle])),
    )


def range_ambiguity(radar: Radar, prf: float, point: F64, radius: float) -> float:
    """Range ambiguity-to-signal ratio of homogeneous ground at a point (3,), power; NaN for an isotropic antenna.

    Parameters
    ----------
    radar : of the beam; its boresight looks at the aim point
    prf : Hz
    point : m, scene frame
    radius : of the ground, m, see :func:`earth_radius`

    Notes
    -----
    Ignores the other side of the track. The simulator itself adds no echoes of other pulses.
    """
    antenna = radar.antenna
    if not antenna.directive:
        return float("nan")

    def gain(sine: F64) -> F64:
        return np.asarray(antenna.two_way_amplitude(np.zeros_like(sine), np.asarray(sine)))

    slant = float(np.linalg.norm(point - radar.track.center_position))
    boresight = vantage_of(radar, radar.aim_point, radius)
    return range_ambiguity_ratio(
        gain, slant, boresight.height, prf, boresight.look_angle, earth_radius=radius
    )
