"""Radar and image request from the description of sensor and film."""

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import RadarError, SarmitsubaWarning
from sarmitsuba.core.units import power_from_db
from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.aperture import (
    automatic_track,
    geometry_from_angles,
    geometry_of_track,
    given_track,
    known_azimuth_cell,
    spare_pulses,
)
from sarmitsuba.radar.attitude import pointing_error
from sarmitsuba.radar.beam import antenna_of
from sarmitsuba.radar.coverage import ambiguities, check_coverage
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.ephemeris import EphemerisPath
from sarmitsuba.radar.extent import Extent
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.image_request import ImageRequest, build_image_request, faded_box, image_box
from sarmitsuba.radar.mode import MODES, AimGeometry, right_of
from sarmitsuba.radar.orbit import orbit_of
from sarmitsuba.radar.parallel_pass import parallel_pass
from sarmitsuba.radar.path import FlightPath
from sarmitsuba.radar.plausibility import doubtful_angles, doubtful_distance, doubtful_pixels, doubtful_track
from sarmitsuba.radar.polarisation import read_channels
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.receiver import receiver_track
from sarmitsuba.radar.recorded import recorded_track
from sarmitsuba.radar.swath import Box, receive_window
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.utc import DEFAULT_EPOCH, utc_after, utc_of
from sarmitsuba.radar.waveform import Waveform

SAMPLING_MARGIN = 1.2  # automatic sampling rate over the bandwidth
MAX_SAMPLES = 2**36  # most samples of raw data: 0.5 TiB


def build_radar(
    given: RadarInput, extent: Extent, offset: F64 | None = None
) -> tuple[Radar, ImageRequest, tuple[str, ...]]:
    """Radar and image request of a description, checked against the scene.

    Parameters
    ----------
    given : parameters
    extent : of all geometry and points, scene frame
    offset : (3,) float64, m; scene frame = file frame - offset

    Returns
    -------
    radar, image request, notes

    Raises
    ------
    RadarError
        The description is inconsistent, or the scene lies outside the swath, the beam or the image.

    Warns
    -----
    SarmitsubaWarning
        The prf is below the Doppler bandwidth, the window cuts the image, echoes of two pulses overlap, or a value
        looks like one in another unit.

    Notes
    -----
    The ground is flat, the tangent plane at the anchor, also under a satellite; ignores refraction by the atmosphere.
    """
    shift = np.zeros(3) if offset is None else offset
    s = given.sensor
    waveform = Waveform(s.center_frequency, s.bandwidth, s.pulse_width)
    film = _film(given)
    channels = read_channels(s.polarisation, given.where)
    antenna = antenna_of(given, waveform.wavelength)
    aim = np.array(
        [
            middle if value is None else value - moved
            for value, moved, middle in zip((s.aim_x, s.aim_y, s.aim_z), shift, extent.middle, strict=True)
        ]
    )

    track = given_track(given, shift)
    doubts = doubtful_angles(given) + (doubtful_track(given, track, shift) if track is not None else [])
    prf_derived = track is None and not s.prf
    anchor = Anchor.of_degrees(s.latitude_deg, s.longitude_deg, s.height)
    orbit = None if track is not None else orbit_of(given, anchor, aim, shift)
    if track is not None:
        geometry = geometry_of_track(given, track, aim)
    else:
        geometry = geometry_from_angles(given, aim) if orbit is None else orbit[0]
    scene = Box(geometry.aim, geometry.axes, *extent.in_axes(geometry.aim, geometry.axes))
    if track is None and orbit is None:
        doubts += doubtful_distance(given, scene)
    speed = s.speed if orbit is None else orbit[1].speed
    cells = (known_azimuth_cell(given, geometry, waveform, track, speed), waveform.range_cell)
    image, notes = build_image_request(film, given.film_where, scene, geometry.center, cells, shift)
    if all(value is None for value in (s.aim_x, s.aim_y, film.image_center_x, film.image_center_y)):
        sides = image.extent_azimuth, image.extent_range
        if extent.is_empty(np.array([image.center_x, image.center_y]), 0.5 * float(np.hypot(*sides))):
            extent = extent.densest(min(sides))
            radar, image, notes = build_radar(given, extent, offset)
            x, y = extent.middle[:2] + shift[:2]
            note = f"{given.where}: nothing but ground lies in the middle of the scene; the radar is aimed at its "
            return radar, image, (f"{note}densest part, aim_x = {x:.6g} m, aim_y = {y:.6g} m", *notes)
    box = image_box(image, scene)
    half_aperture = np.inf
    path: FlightPath | None = None
    if track is None:
        width, all_round = image.fade_out(max(cells)), MODES[s.mode].all_round
        lit = Box(geometry.aim, geometry.axes, *extent.lit_in_axes(geometry.aim, geometry.axes))
        faded = faded_box(box, lit, width, cells[0], all_round=all_round)
        path = MODES[s.mode].path(geometry, s.speed) if orbit is None else orbit[1]
        track, half_aperture = automatic_track(given, geometry, box, faded, waveform, antenna, path)
        boxes, pulses = (box, faded), track.n_pulses
        notes += spare_pulses(given, geometry, boxes, waveform, antenna, path, pulses, image.extent_azimuth)
    track, geometry = parallel_pass(given, _dated(given, track, path), geometry)
    _check_height(given, track, scene, image, shift)
    receiver = receiver_track(given, track, aim, shift)
    tracks = [track] if receiver is None else [track, receiver]
    nominal, error = MODES[s.mode].pointing(track, geometry, s.mode_parameters), pointing_error(given)
    radar = Radar(
        mode=s.mode,
        track=track,
        waveform=waveform,
        antenna=antenna,
        pointing=nominal if error.is_none else error.flown(nominal, track.time),
        window=_window(given, tracks, geometry, box, waveform),
        channels=channels,
        look_side="right" if geometry.across @ right_of(geometry.along) > 0 else "left",
        aim_point=aim,
        transmit_power=s.transmit_power,
        noise_temperature=s.noise_temperature,
        losses=float(power_from_db(s.losses_db)),
        half_aperture=half_aperture,
        offset=shift,
        recorded=recorded_track(given, track, shift),
        anchor=anchor,
        recorded_pointing=None if error.is_none else nominal,
        receiver=receiver,
        receiver_pointing=None if receiver is None else _follower_pointing(given, receiver, geometry),
    )
    seen = check_coverage(radar, scene, box, given.where, given.film_where)
    doubts += doubtful_pixels(image, radar, given.film_where)
    doubts += ambiguities(radar, seen, box, given.where, derived=prf_derived)
    for text in doubts:
        _warn(text)
    return radar, image, notes


def _dated(given: RadarInput, track: Track, path: FlightPath | None) -> Track:
    """The track with the UTC of its time zero."""
    dated = path.epoch if isinstance(path, EphemerisPath) and path.vectors.dated else track.epoch
    if dated != DEFAULT_EPOCH:
        if given.sensor.epoch:
            raise RadarError(
                f"{given.where}: epoch has no effect beside dates of the track's file; leave it out"
            )
        return replace(track, epoch=dated)
    if not given.sensor.epoch:
        return track
    try:
        epoch = utc_of(given.sensor.epoch)
    except ValueError as error:
        raise RadarError(f"{given.where}: epoch = {error}") from None
    # vectors by seconds: the epoch is of their time zero, the track's is at mid-aperture
    late = path.since_default if isinstance(path, EphemerisPath) else 0.0
    return replace(track, epoch=utc_after(epoch, late))


def _film(given: RadarInput) -> FilmDescription:
    """Film parameters with the defaults of the mode.

    Raises
    ------
    RadarError
        The mode has no squint, or no slant range axis.
    """
    s, law = given.sensor, MODES[given.sensor.mode]
    if s.squint_angle_deg != 0.0 and not law.squints:
        raise RadarError(
            f"{given.where}: squint_angle_deg = {s.squint_angle_deg:g} deg, but mode = {law.name} has no "
            "squint; leave it out"
        )
    if not law.all_round:
        return given.film
    if "image_grid" in given.film_given and given.film.image_grid == "slant":
        raise RadarError(
            f"{given.film_where}: image_grid = slant, but mode = {law.name} looks from all sides and has no "
            "slant-range axis; take ground"
        )
    return replace(given.film, image_grid="ground")


def _follower_pointing(given: RadarInput, receiver: Track, geometry: AimGeometry) -> Pointing:
    """Pointing of a separate receiver: steered by the same mode, from its own track to the same aim point."""
    s = given.sensor
    follower = replace(geometry, center=receiver.center_position)
    return MODES[s.mode].pointing(receiver, follower, s.mode_parameters)


def _check_height(given: RadarInput, track: Track, scene: Box, image: ImageRequest, offset: F64) -> None:
    pulse = int(np.argmin(track.position[:, 2]))
    lowest = float(track.position[pulse, 2])
    if lowest <= image.height:
        raise RadarError(
            f"{given.where}: the antenna is at {lowest + offset[2]:g} m in pulse {pulse}, not above the "
            f"image plane at {image.height + offset[2]:g} m; raise the track or lower image_height"
        )
    bottom = float(scene.origin[2] + scene.low[2])
    if lowest <= bottom:
        raise RadarError(
            f"{given.where}: the antenna at {lowest + offset[2]:g} m lies below the whole scene, which "
            f"begins at {bottom + offset[2]:g} m; raise the antenna"
        )


def _window(
    given: RadarInput, tracks: Sequence[Track], geometry: AimGeometry, box: Box, waveform: Waveform
) -> ReceiveWindow:
    film, where = given.film, given.film_where
    rate = film.sampling_rate or SAMPLING_MARGIN * waveform.bandwidth
    if rate < waveform.bandwidth:
        raise RadarError(
            f"{where}: sampling_rate = {rate:g} Hz is below the bandwidth {waveform.bandwidth:g} Hz; "
            "raise it or give 0 for 1.2 times the bandwidth"
        )
    near, far = film.near_range, film.far_range
    if near and far and near >= far:
        raise RadarError(
            f"{where}: near_range = {near:g} m is not below far_range = {far:g} m; swap or widen them"
        )
    spacing = SPEED_OF_LIGHT / (2.0 * rate)
    low, high = box.slant_ranges(geometry.center[None])
    if (near and near > high[0]) or (far and far < low[0]):
        raise RadarError(
            f"{where}: the window near_range = {near:g} m to far_range = {far:g} m (0 = automatic) does not "
            f"hold the scene, whose slant ranges are {low[0]:.6g} m to {high[0]:.6g} m; widen it or give 0"
        )
    if (near and near > low[0]) or (far and far < high[0]):
        _warn(
            f"{where}: the window near_range = {near:g} m to far_range = {far:g} m (0 = automatic) cuts the "
            f"image, whose slant ranges are {low[0]:.6g} m to {high[0]:.6g} m; widen it or give 0"
        )
    positions = [track.position for track in tracks]
    window = receive_window(positions, geometry.center, box, waveform.range_cell, spacing, near, far)
    n_pulses = tracks[0].n_pulses
    if window.n_samples * n_pulses > MAX_SAMPLES:
        raise RadarError(
            f"{where}: {n_pulses} pulses of {window.n_samples} samples are more than {MAX_SAMPLES} "
            "samples; shrink the image, the window or the aperture"
        )
    return window


def _warn(text: str) -> None:
    warnings.warn(text, SarmitsubaWarning, stacklevel=3)
