"""Radar and image request from the description of sensor and film.

The antenna has a pattern with its beamwidths, or a measured one. Valid values that look like an error of units are
warned of, one line each. The second pass of an interferometric pair is the track shifted by a constant baseline.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import RadarError, SarmitsubaWarning
from sarmitsuba.core.parameters import Value
from sarmitsuba.core.units import power_from_db
from sarmitsuba.machine.regular_files import read_rows
from sarmitsuba.radar.antenna import Antenna, Pointing
from sarmitsuba.radar.aperture import (
    automatic_track,
    burst_track,
    geometry_from_angles,
    geometry_of_track,
    given_track,
    known_azimuth_cell,
    spare_pulses,
)
from sarmitsuba.radar.bursts import BurstPlan, plan_burst
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.image_request import Extent, ImageRequest, build_image_request, faded_box, image_box
from sarmitsuba.radar.interference import emitters_of
from sarmitsuba.radar.mode import MODES, AimGeometry, FlightPath, right_of
from sarmitsuba.radar.orbit import EphemerisPath, orbit_of
from sarmitsuba.radar.pattern import PATTERNS, PatternTable
from sarmitsuba.radar.polarisation import read_channels
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.receive_chain import receive_chain_of
from sarmitsuba.radar.receiver import receiver_track
from sarmitsuba.radar.swath import Box, ambiguities, check_coverage, receive_window
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.track_errors import pointing_error, recorded_track
from sarmitsuba.radar.utc import DEFAULT_EPOCH, utc_after, utc_of
from sarmitsuba.radar.waveform import MOST_CHIPS, Waveform


def antenna_of(given: RadarInput, wavelength: float) -> Antenna:
    """The antenna of a description.

    Parameters
    ----------
    given : parameters
    wavelength : at the centre frequency, m; converts aperture sizes to beamwidths

    Raises
    ------
    RadarError
        Parameters are missing or contradict each other, or the file of a measured pattern is invalid.
    """
    s = given.sensor
    gain = float(power_from_db(s.gain_db))
    azimuth = (("azimuth_beamwidth_deg", s.azimuth_beamwidth_deg), ("antenna_length", s.antenna_length))
    elevation = (("elevation_beamwidth_deg", s.elevation_beamwidth_deg), ("antenna_height", s.antenna_height))
    measured = PATTERNS[s.pattern].measured
    if s.pattern == "isotropic" or measured:
        for name, value in (*azimuth, *elevation):
            if value > 0.0:
                raise RadarError(
                    f"{given.where}: {name} = {value:g} has no effect with pattern = {s.pattern}; "
                    f"{'the table has its own widths' if measured else 'set pattern to gaussian or rectangular'}"
                )
    if s.pattern_file and not measured:
        raise RadarError(
            f"{given.where}: pattern_file has no effect with pattern = {s.pattern}; set pattern to table or leave "
            "it out"
        )
    if measured:
        if not s.pattern_file:
            raise RadarError(f"{given.where}: pattern = {s.pattern} needs a pattern_file; give its path")
        path = Path(s.pattern_file)
        table = PatternTable.from_csv(path if path.is_absolute() else given.folder / path)
        widths = [cut.beamwidth for cut in table.cuts]
        return Antenna(s.pattern, gain, widths[0], widths[1], table)
    if s.pattern == "isotropic":
        return Antenna("isotropic", gain)
    widths = [_width_of(given, *axis, wavelength) for axis in (azimuth, elevation)]
    return Antenna(s.pattern, gain, widths[0], widths[1])


def _width_of(
    given: RadarInput, width: tuple[str, float], size: tuple[str, float], wavelength: float
) -> float:
    """Half-power width along an axis, rad, as given or of the pattern's aperture of the given size."""
    pattern = PATTERNS[given.sensor.pattern]
    if (width[1] > 0.0) == (size[1] > 0.0):
        raise RadarError(
            f"{given.where}: pattern = {pattern.name} needs one of {width[0]} = {width[1]:g} deg and "
            f"{size[0]} = {size[1]:g} m above 0; give exactly one"
        )
    if width[1] > 0.0:
        return float(np.radians(width[1]))
    half = pattern.half_power_sine
    if half is None:
        raise RadarError(
            f"{given.where}: {size[0]} = {size[1]:g} m: pattern {pattern.name} belongs to no aperture; give "
            f"{width[0]}, or half_power_sine to the pattern"
        )
    sine = half * wavelength / size[1]
    if sine >= 1.0:
        raise RadarError(
            f"{given.where}: {size[0]} = {size[1]:g} m is below {half:.3f} wavelengths ({half * wavelength:g} m); "
            f"enlarge it or give {width[0]}"
        )
    return 2.0 * float(np.arcsin(sine))


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


def parallel_pass(given: RadarInput, track: Track, geometry: AimGeometry) -> tuple[Track, AimGeometry]:
    """Track and geometry of the parallel pass of ``pass_offset_...``; unchanged without offsets.

    Pulses, their rate and the image stay those of the track without the offset. The beam points at the aim point from
    the shifted track; an offset along the track shifts the footprint of a beam fixed to the track.

    Parameters
    ----------
    given : the description
    track : without the offset, scene frame
    geometry : of that track
    """
    s = given.sensor
    if not (s.pass_offset_along or s.pass_offset_across or s.pass_offset_up):
        return track, geometry
    along = track.along
    sideways = s.pass_offset_across * right_of(along) + s.pass_offset_up * np.array([0.0, 0.0, 1.0])
    moved = track.moved(sideways + s.pass_offset_along * along)
    return moved, replace(geometry, center=geometry.center + sideways)


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
    waveform = _waveform(given)
    film = _film(given)
    channels = read_channels(s.polarisation, given.where)
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
    path = None if track is not None else orbit[1] if orbit else MODES[s.mode].path(geometry, s.speed)
    burst = _burst_of(given, geometry, path, anchor, shift)
    if burst is not None:
        given, geometry, s = burst.given, burst.geometry, burst.given.sensor
        waveform = _waveform(given)
    antenna = antenna_of(given, waveform.wavelength)
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
    values = s.mode_parameters if burst is None else burst.values
    if track is None:
        assert path is not None
        width, all_round = image.fade_out(max(cells)), MODES[s.mode].all_round
        lit = Box(geometry.aim, geometry.axes, *extent.lit_in_axes(geometry.aim, geometry.axes))
        boxes = (box, faded_box(box, lit, width, cells[0], all_round=all_round))
        if burst is not None:
            track, half_aperture = burst_track(burst, *boxes, waveform, antenna, path)
        else:
            track, half_aperture = automatic_track(given, geometry, *boxes, waveform, antenna, path)
            pulses = track.n_pulses
            notes += spare_pulses(
                given, geometry, boxes, waveform, antenna, path, pulses, image.extent_azimuth
            )
    track, geometry = parallel_pass(given, _date_track(given, track, path), geometry)
    _check_height(given, track, scene, image, shift)
    receiver = receiver_track(given, track, aim, shift)
    tracks = [track] if receiver is None else [track, receiver]
    nominal, error = MODES[s.mode].pointing(track, geometry, values), pointing_error(given)
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
        burst=None if burst is None else burst.burst,
        chain=receive_chain_of(given, channels),
        emitters=emitters_of(given, waveform, shift),
        recorded_pointing=None if error.is_none else nominal,
        receiver=receiver,
        receiver_pointing=None
        if receiver is None
        else _follower_pointing(s.mode, receiver, geometry, values),
    )
    _check_chips(radar, given)
    seen = check_coverage(radar, scene, box, given.where, given.film_where)
    doubts += doubtful_pixels(image, radar, given.film_where)
    doubts += ambiguities(radar, seen, box, given.where, derived=prf_derived)
    for text in doubts:
        _warn(text)
    return radar, image, notes if burst is None else (*notes, burst.note)


def _check_chips(radar: Radar, given: RadarInput) -> None:
    """Raise a RadarError where a mismatched filter meets chips that are no whole number of samples."""
    chips = radar.waveform.chips
    if radar.chain is None or radar.chain.pulse_filter != "mismatched" or chips is None:
        return
    per_second = chips.size / radar.waveform.pulse_width
    samples = radar.window.sampling_rate / per_second
    if abs(samples - round(samples)) > 1e-6 * samples:
        raise RadarError(
            f"{given.where}: pulse_filter = mismatched needs whole samples a chip, and there are {samples:.4g}; give "
            f"the range_film sampling_rate = {np.ceil(samples) * per_second:.9g} Hz"
        )


def _waveform(given: RadarInput) -> Waveform:
    """Waveform of a description.

    Raises
    ------
    RadarError
        The code is unknown or does not fit into the band, or its file cannot be read.
    """
    s = given.sensor
    usual = s.center_frequency, s.bandwidth, s.pulse_width
    if s.pulse_form == "up":
        return Waveform(*usual)
    if s.pulse_form == "down":
        return Waveform(*usual, sweep="down")
    kind, _, name = s.pulse_form.partition(":")
    code = s.pulse_form
    if kind == "file":
        path = Path(name) if Path(name).is_absolute() else given.folder / name
        rows = read_rows(path, "chips", (), {"phase_deg": None}, RadarError)
        if len(rows) > MOST_CHIPS:
            raise RadarError(f"{path}: {len(rows)} chips are more than {MOST_CHIPS}")
        code = "chips:" + ",".join(f"{row['phase_deg']:g}" for row in rows)
    try:
        return Waveform(*usual, code=code)
    except RadarError as error:
        raise RadarError(f"{given.where}: pulse_form: {error}") from None


def _burst_of(
    given: RadarInput, geometry: AimGeometry, path: FlightPath | None, anchor: Anchor, offset: F64
) -> BurstPlan | None:
    """The burst of a mode with bursts; None for others."""
    if not MODES[given.sensor.mode].bursts:
        return None
    if path is None:
        raise RadarError(
            f"{given.where}: mode = {given.sensor.mode} sets the times of its pulses; leave the track out"
        )
    return plan_burst(given, geometry, path, anchor, offset)


def _date_track(given: RadarInput, track: Track, path: FlightPath | None) -> Track:
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


def _follower_pointing(
    mode: str, receiver: Track, geometry: AimGeometry, values: Mapping[str, Value]
) -> Pointing:
    """Pointing of a separate receiver: steered by the same mode, from its own track to the same aim point."""
    follower = replace(geometry, center=receiver.center_position)
    return MODES[mode].pointing(receiver, follower, values)


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
