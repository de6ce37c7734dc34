"""Footprint of the beam: its half-power outline at a pulse, and the points that it illuminates over the track."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import RadarError
from sarmitsuba.radar.pattern import PATTERNS, SINC_HALF_POWER
from sarmitsuba.radar.radar import Radar

Mask = NDArray[np.bool_]

# pulses that sample the track
_PULSES = 129
# bisection steps, after which the contour is known to float64
_HALVINGS = 55


@dataclass(frozen=True, eq=False)
class Lit:
    """Illumination of points by the half-power beam over the track.

    Parameters
    ----------
    ever : (...,) bool; at least one pulse illuminates the point
    whole : (...,) bool; the point has its whole aperture: every pulse illuminates it, or, where the beam passes over
        the pixels one after the other, the track contains the point's whole aperture
    """

    ever: Mask
    whole: Mask


def outline(radar: Radar, pulse: int, height: float = 0.0, n: int = 97) -> F64:
    r"""One-distance half-power contour of the beam on a horizontal plane, a closed line (n, 3) m.

    The contour is :math:`G(\sin\alpha, \sin\epsilon) = 1/2`, G the one-way power gain over the components of direction
    along the antenna's azimuth and elevation axes, relative to its peak.

    Parameters
    ----------
    radar : with a beam
    pulse : its index
    height : of the plane, m, scene frame
    n : points of the line, the last is the first again; those that look above the plane are NaN

    Raises
    ------
    RadarError
        The antenna is isotropic and has no contour.

    Notes
    -----
    Ignores the Earth's curvature, and the elevation beam's height over terrain.
    """
    _with_beam(radar)
    p, antenna = radar.pointing, radar.antenna
    angle = np.linspace(0.0, 2.0 * np.pi, n)
    across = np.stack([np.cos(angle) / antenna.per_width[0], np.sin(angle) / antenna.per_width[1]])
    low, high = (
        np.zeros(n),
        np.full(n, PATTERNS[antenna.pattern].find_null() or 1.0 / SINC_HALF_POWER),
    )  # searched to the first null, where the pattern has one
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        inside = np.asarray(antenna.two_way_amplitude(*(middle * across))) > 0.5
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    azimuth, elevation = low * across
    ahead = np.sqrt(np.maximum(1.0 - azimuth**2 - elevation**2, 0.0))
    look = np.stack([azimuth, elevation, ahead], axis=1) @ np.stack(
        [p.azimuth_axis[pulse], p.elevation_axis[pulse], p.boresight[pulse]]
    )
    antenna_at = radar.track.position[pulse]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (height - antenna_at[2]) / look[:, 2]
    distance = np.where((distance > 0.0) & np.isfinite(distance), distance, np.nan)
    return np.asarray(antenna_at + distance[:, None] * look)


def lit(radar: Radar, points: ArrayLike) -> Lit:
    """Illumination of points (..., 3), m, scene frame, by the beam over the track.

    Raises
    ------
    RadarError
        The antenna is isotropic and illuminates everything.

    Notes
    -----
    Samples 129 pulses, so that the ends of an aperture are known to a 128th of the track. Ignores shadows.
    """
    _with_beam(radar)
    place = np.asarray(points, dtype=np.float64)
    track, pointing, antenna = radar.track, radar.pointing, radar.antenna
    pick = np.unique(np.linspace(0, track.n_pulses - 1, _PULSES).astype(int))
    line = place[..., None, :] - track.position[pick]
    line /= np.linalg.norm(line, axis=-1, keepdims=True)
    azimuth, elevation, ahead = (
        np.sum(line * axis[pick], axis=-1)
        for axis in (pointing.azimuth_axis, pointing.elevation_axis, pointing.boresight)
    )
    inside = (np.asarray(antenna.two_way_amplitude(azimuth, elevation)) >= 0.5) & (ahead > 0.0)
    ever = inside.any(axis=-1)
    if not radar.mode_law.own_apertures:
        return Lit(ever, inside.all(axis=-1))
    # the point's aperture: processed sines off the boresight, at most the half-power width
    half = min(radar.half_aperture, float(np.sin(0.5 * antenna.azimuth_beamwidth)))
    forward = track.velocity[pick] / np.linalg.norm(track.velocity[pick], axis=1)[:, None]
    offset = np.sum(line * forward, axis=-1) - np.sum(pointing.boresight[pick] * forward, axis=1)
    passed = (offset.max(axis=-1) >= half) & (offset.min(axis=-1) <= -half)
    return Lit(ever, ever & passed)


def _with_beam(radar: Radar) -> None:
    if not radar.antenna.directive:
        raise RadarError(
            "footprint: pattern = isotropic illuminates everything and has no outline; use gaussian or rectangular"
        )
