"""Warnings about valid values that look like an error of units, one line each."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.swath import Box
from sarmitsuba.radar.track import Track

# a track within the numeric bounds of longitude and latitude, above this height and below this speed, is taken as
# degrees: slow rail-based radars are near the ground
_DEGREES = np.array([180.0, 90.0])
_SLOW, _HIGH = 0.2, 50.0  # m/s, m
# slant ranges below this, m, are those of airborne radars in km
_NEAR = 50.0


def doubtful_angles(given: RadarInput) -> list[str]:
    """Warning about a look or incidence angle that may be in radians."""
    s = given.sensor
    angles = (("look_angle_deg", s.look_angle_deg), ("incidence_angle_deg", s.incidence_angle_deg))
    return [
        f"{given.where}: {name} = {angle:g} deg looks straight down; if it is meant in radians, give "
        f"{np.degrees(angle):.4g}"
        for name, angle in angles
        if angle < 0.5 * np.pi
    ]


def doubtful_distance(given: RadarInput, scene: Box) -> list[str]:
    """Warning about a slant range that may be in kilometres: of less than 50 m to a scene more than twice as wide."""
    distance, width = given.sensor.slant_range, float((scene.high - scene.low)[:2].max())
    if not 0.0 < distance < _NEAR or width < 2.0 * distance:
        return []
    return [
        f"{given.where}: slant_range = {distance:g} m puts the antenna within the scene, which is {width:.4g} m wide; "
        f"if it is meant in km, give {1e3 * distance:g}"
    ]


def doubtful_track(given: RadarInput, track: Track, offset: F64) -> list[str]:
    """Warning about a track whose x and y may be longitude and latitude in degrees."""
    position = track.position + offset
    if track.n_pulses < 2 or (np.abs(position[:, :2]) > _DEGREES).any():
        return []
    steps = np.linalg.norm(np.diff(position[:, :2], axis=0), axis=1)
    speed = float(steps.sum() / (track.time[-1] - track.time[0]))
    if not 0.0 < speed < _SLOW or position[:, 2].min() < _HIGH:
        return []
    return [
        f"{given.sensor.track_file or given.where}: the antenna moves at {speed:.2g} m/s at a height of "
        f"{position[:, 2].mean():.4g} m: are x and y longitude and latitude? give metres in the scene's frame"
    ]


def doubtful_pixels(image: ImageRequest, radar: Radar, where: str) -> list[str]:
    """Warning about pixels wider than a resolution cell.

    Parameters
    ----------
    image : with its pixel spacings
    radar : whose track and bandwidth give the cells
    where : start of every line
    """
    look = np.array([image.center_x, image.center_y, image.height]) - radar.track.center_position
    sine = float(np.linalg.norm(look[:2]) / np.linalg.norm(look))
    range_cell = radar.waveform.range_cell / (max(sine, 1e-9) if image.grid == "ground" else 1.0)
    return [
        f"{where}: {name} = {spacing:g} m is wider than the resolution cell of {cell:.4g} m, so that targets between "
        f"pixels are missing; give at most {cell:.4g} m, or 0 for half of it"
        for name, spacing, cell in (
            ("pixel_spacing_azimuth", image.spacing_azimuth, _azimuth_cell(radar)),
            ("pixel_spacing_range", image.spacing_range, range_cell),
        )
        if spacing > cell * (1.0 + 1e-6)
    ]


def _azimuth_cell(radar: Radar) -> float:
    """Azimuth cell of the aperture of the image's centre, m; infinite for a single pulse."""
    if np.isfinite(radar.half_aperture):
        return radar.waveform.wavelength / (4.0 * radar.half_aperture)
    look = radar.track.position - radar.aim_point
    sine = (look @ radar.track.along) / np.linalg.norm(look, axis=1)
    return radar.waveform.wavelength / (2.0 * max(float(np.ptp(sine)), 1e-30))
