"""From the parameters of sensor and film to a radar that sees the scene."""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.errors import RadarError, SarmitsubaWarning
from sarmitsuba.loader.image_request import build_image_request, image_box
from sarmitsuba.loader.parameters import one_line
from sarmitsuba.radar.antenna import Antenna, Pointing
from sarmitsuba.radar.coverage import ambiguities, check_coverage
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.swath import Box, beam_bandwidth, bounds_in_axes, doppler_bandwidth, receive_window
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.waveform import Waveform
from sarmitsuba.scene.settings import ImageRequest
from sarmitsuba.units import power_from_db

F64 = NDArray[np.float64]

CHANNELS = ("HH", "HV", "VH", "VV")
PRF_MARGIN = 1.25  # automatic prf over the Doppler bandwidth
SAMPLING_MARGIN = 1.2  # automatic sampling rate over the bandwidth
MAX_PULSES = 10_000_000
MAX_APERTURE = 4.0  # length over slant range: looks turn by 127 degrees
MAX_SAMPLES = 2**36  # samples of raw data: 0.5 TiB
_REPLACED_BY_TRACK = (
    "slant_range",
    "look_angle_deg",
    "heading_deg",
    "squint_angle_deg",
    "speed",
    "prf",
    "n_pulses",
    "azimuth_resolution",
)
_HALF_POWER = 0.442946470689452  # sinc^2(u) = 1/2


@dataclass(frozen=True, eq=False)
class RadarInput:
    """Validated parameters of sensor and film.

    Parameters
    ----------
    sensor, film : every parameter of `tables.SENSOR` and `tables.FILM`
    sensor_given, film_given : names that the file sets
    where, film_where : start of every error
    folder : that a relative ``track_file`` is read from
    """

    sensor: Mapping[str, Any]
    film: Mapping[str, Any]
    sensor_given: frozenset[str] = frozenset()
    film_given: frozenset[str] = frozenset()
    where: str = "sar_antenna"
    film_where: str = "range_film"
    folder: Path = Path()


@dataclass(frozen=True, eq=False)
class _View:
    """Straight-track geometry about the aim point: mid-aperture position and horizontal axes."""

    aim: F64
    center: F64
    along: F64
    across: F64

    @property
    def slant_range(self) -> float:
        return float(np.linalg.norm(self.center - self.aim))

    @property
    def cos_squint(self) -> float:
        sine = float((self.aim - self.center) @ self.along) / self.slant_range
        return float(np.sqrt(max(1.0 - sine * sine, 1e-12)))

    @property
    def axes(self) -> F64:
        return np.stack([self.along, self.across, np.array([0.0, 0.0, 1.0])])


def build_radar(
    given: RadarInput, bounds: F64, offset: F64 | None = None
) -> tuple[Radar, ImageRequest, tuple[str, ...]]:
    """Build the radar and the image request, and check that they see the scene.

    Parameters
    ----------
    given : parameters
    bounds : (2, 3) float64, m, scene frame; of all geometry and points
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
        The prf is below the Doppler bandwidth, the window cuts the image, or echoes of two pulses overlap.

    Notes
    -----
    Ignores the Earth's curvature and rotation and the refraction of the atmosphere.
    """
    shift = np.zeros(3) if offset is None else offset
    s = given.sensor
    waveform = Waveform(s["center_frequency"], s["bandwidth"], s["pulse_width"])
    channels = read_channels(s["polarisation"], given.where)
    antenna = _antenna(given, waveform.wavelength)
    aim = np.array([s["aim_x"], s["aim_y"], s["aim_z"]]) - shift

    track = _track_from_file(given, shift) if s["track_file"] else None
    view = _view(given, aim) if track is None else _view_of_track(given, track, aim)
    scene = Box(view.aim, view.axes, *bounds_in_axes(bounds, view.aim, view.axes))
    cells = (_azimuth_cell(given, view, waveform, track), waveform.range_cell)
    image, notes = build_image_request(
        given.film, given.film_given, given.film_where, scene, view.center, cells, shift
    )
    box = image_box(image, scene)
    if track is None:
        track = _straight_track(given, view, box, waveform, antenna)
    _check_height(given, track, scene, image, shift)
    pointing = _pointing(given, track, view)
    window = _window(given, track, view, box, waveform)
    radar = Radar(
        mode=s["mode"],
        track=track,
        waveform=waveform,
        antenna=antenna,
        pointing=pointing,
        window=window,
        channels=channels,
        look_side="right" if view.across @ _right(view.along) > 0 else "left",
        aim_point=aim,
        transmit_power=s["transmit_power"],
        noise_temperature=s["noise_temperature"],
        losses=float(power_from_db(s["losses_db"])),
    )
    seen = check_coverage(radar, scene, box, given.where, given.film_where)
    derived = not s["prf"] and not s["track_file"]
    for text in ambiguities(radar, seen, given.where, derived=derived):
        _warn(text)
    return radar, image, notes


def read_channels(text: str, where: str) -> tuple[str, ...]:
    """Channels of a list such as ``HH,HV``."""
    names = tuple(text.replace(",", " ").upper().split())
    bad = [name for name in names if name not in CHANNELS]
    if bad or not names or len(set(names)) < len(names):
        raise RadarError(
            f'{where}: polarisation = "{one_line(text)}" is no list of channels out of {", ".join(CHANNELS)}; '
            'give for example "HH,HV"'
        )
    return names


def _right(along: F64) -> F64:
    return np.array([along[1], -along[0], 0.0])


def _antenna(given: RadarInput, wavelength: float) -> Antenna:
    s = given.sensor
    gain = float(power_from_db(s["gain_db"]))
    names = (("azimuth_beamwidth_deg", "antenna_length"), ("elevation_beamwidth_deg", "antenna_height"))
    if s["pattern"] == "isotropic":
        for name in (name for pair in names for name in pair):
            if s[name] > 0.0:
                raise RadarError(
                    f"{given.where}: {name} = {s[name]:g} has no effect with pattern = isotropic; "
                    "take gaussian or rectangular"
                )
        return Antenna("isotropic", gain)
    widths = []
    for width_name, size_name in names:
        width, size = s[width_name], s[size_name]
        if (width > 0.0) == (size > 0.0):
            raise RadarError(
                f"{given.where}: pattern = {s['pattern']} needs one of {width_name} = {width:g} deg and "
                f"{size_name} = {size:g} m above 0; give exactly one"
            )
        if size > 0.0:
            sine = _HALF_POWER * wavelength / size
            if sine >= 1.0:
                raise RadarError(
                    f"{given.where}: {size_name} = {size:g} m is below {_HALF_POWER:.3f} wavelengths "
                    f"({_HALF_POWER * wavelength:g} m); enlarge it or give {width_name}"
                )
            widths.append(2.0 * float(np.arcsin(sine)))
        else:
            widths.append(float(np.radians(width)))
    return Antenna(s["pattern"], gain, widths[0], widths[1])


def _view(given: RadarInput, aim: F64) -> _View:
    s = given.sensor
    heading, look, squint = np.radians([s["heading_deg"], s["look_angle_deg"], s["squint_angle_deg"]])
    along = np.array([np.sin(heading), np.cos(heading), 0.0])
    across = _right(along) if s["look_side"] == "right" else -_right(along)
    side_square = np.sin(look) ** 2 - np.sin(squint) ** 2
    if side_square <= 0.0:
        raise RadarError(
            f"{given.where}: squint_angle_deg = {s['squint_angle_deg']:g} deg is not smaller than "
            f"look_angle_deg = {s['look_angle_deg']:g} deg, so that no line of sight has both; lower the "
            "squint or raise the look angle"
        )
    sight = np.sin(squint) * along + np.sqrt(side_square) * across - np.cos(look) * np.array([0.0, 0.0, 1.0])
    return _View(aim, aim - s["slant_range"] * sight, along, across)


def _track_from_file(given: RadarInput, offset: F64) -> Track:
    for name in _REPLACED_BY_TRACK:
        if name in given.sensor_given:
            raise RadarError(f"{given.where}: {name} has no effect beside track_file; leave one of them out")
    path = Path(given.sensor["track_file"])
    track = Track.from_csv(path if path.is_absolute() else given.folder / path)
    if track.n_pulses > MAX_PULSES:
        raise RadarError(f"{path}: {track.n_pulses} pulses are more than {MAX_PULSES}; split the track")
    return replace(track, position=track.position - offset)


def _view_of_track(given: RadarInput, track: Track, aim: F64) -> _View:
    right = _right(track.along)
    side = float((aim - track.center_position) @ right)
    if side == 0.0:
        raise RadarError(
            f"{given.where}: the aim point lies straight below or ahead of the track; move aim_x, aim_y"
        )
    if "look_side" in given.sensor_given and (side > 0) != (given.sensor["look_side"] == "right"):
        raise RadarError(
            f"{given.where}: look_side = {given.sensor['look_side']}, but the aim point lies {abs(side):g} m "
            "to the other side of the track; change look_side or the aim point"
        )
    return _View(aim, track.center_position, track.along, right * np.sign(side))


def _azimuth_cell(given: RadarInput, view: _View, waveform: Waveform, track: Track | None) -> float:
    """Azimuth cell as far as it is known before the track is, m."""
    s = given.sensor
    if s["azimuth_resolution"] > 0.0:
        return float(s["azimuth_resolution"])
    if track is not None and track.n_pulses > 1:
        length = float(np.linalg.norm(np.ptp(track.position, axis=0)))
    elif s["n_pulses"] > 1 and s["prf"] > 0.0:
        length = s["n_pulses"] * s["speed"] / s["prf"]
    else:
        return waveform.range_cell
    return waveform.wavelength * view.slant_range / (2.0 * max(length, 1e-9) * view.cos_squint)


def _straight_track(given: RadarInput, view: _View, box: Box, waveform: Waveform, antenna: Antenna) -> Track:
    """Straight track whose aperture, prf and number of pulses agree."""
    s = given.sensor
    speed, n, prf = s["speed"], s["n_pulses"], s["prf"]
    if n and prf and s["azimuth_resolution"] > 0.0:
        raise RadarError(
            f"{given.where}: n_pulses = {n}, prf = {prf:g} Hz and azimuth_resolution = "
            f"{s['azimuth_resolution']:g} m describe the aperture twice; leave one at 0"
        )
    cell = s["azimuth_resolution"] or waveform.range_cell
    length = waveform.wavelength * view.slant_range / (2.0 * cell * view.cos_squint)
    longest = MAX_APERTURE * view.slant_range
    if length > longest and not (n and s["azimuth_resolution"] == 0.0):
        raise RadarError(
            f"{given.where}: azimuth_resolution = {cell:g} m needs an aperture of {length:g} m, more than four "
            f"slant ranges; give at least {waveform.wavelength / (2.0 * MAX_APERTURE * view.cos_squint):g} m"
        )

    def needed(aperture: float) -> float:
        ends = view.center + np.array([-0.5, 0.0, 0.5])[:, None] * aperture * view.along
        velocity = np.broadcast_to(speed * view.along, ends.shape)
        # the spotlight follows the aim point, and so may the focuser: what is seen at one instant counts
        held = s["mode"] == "spotlight"
        spread = doppler_bandwidth(ends, velocity, box, waveform.wavelength, instantaneous=held)
        beam = beam_bandwidth(antenna, speed, waveform.wavelength)
        return PRF_MARGIN * min(spread, beam)

    if n and s["azimuth_resolution"] > 0.0:
        prf = n * speed / length
    elif n and not prf:
        prf = _prf_for_pulses(needed, n, speed, n * speed / longest)
    elif not prf:
        prf = max(needed(length), speed / length)
    if not n:
        n = max(1, round(length * prf / speed))
    if n > MAX_PULSES:
        raise RadarError(
            f"{given.where}: an aperture of {length:g} m at prf = {prf:g} Hz needs {n} pulses, more than "
            f"{MAX_PULSES}; coarsen azimuth_resolution, shrink the image or narrow the beam"
        )
    if n > 1 and n * speed / prf > longest * (1.0 + 1e-9):
        raise RadarError(
            f"{given.where}: {n} pulses at prf = {prf:g} Hz and speed = {speed:g} m/s make an aperture of "
            f"{n * speed / prf:g} m, more than four slant ranges ({longest:g} m); raise prf or take fewer pulses"
        )
    return Track.straight(view.center, speed * view.along, prf, n)


def _prf_for_pulses(needed: Callable[[float], float], n: int, speed: float, lowest: float) -> float:
    """Lowest prf that samples the Doppler bandwidth of its own aperture n speed / prf (bisection), Hz."""
    low, high = lowest, 1e6 * lowest + 1e9
    for _ in range(100):
        prf = float(np.sqrt(low * high))
        if needed(n * speed / prf) > prf:
            low = prf
        else:
            high = prf
    return high


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


def _pointing(given: RadarInput, track: Track, view: _View) -> Pointing:
    """Triads that follow the aim point (spotlight) or stay fixed to the track's own axes (stripmap)."""
    up = np.array([0.0, 0.0, 1.0])
    speed = np.linalg.norm(track.velocity, axis=1, keepdims=True)
    forward = np.where(speed > 0.0, track.velocity / np.maximum(speed, 1e-300), view.along)
    right = np.cross(forward, up)
    size = np.linalg.norm(right, axis=1, keepdims=True)
    right = np.where(size > 1e-9, right / np.maximum(size, 1e-9), _right(view.along))
    over = np.cross(right, forward)
    if given.sensor["mode"] == "spotlight":
        boresight = view.aim - track.position
        boresight /= np.maximum(np.linalg.norm(boresight, axis=1, keepdims=True), 1e-300)
    else:
        sight = (view.aim - view.center) / view.slant_range
        middle = track.center_index
        parts = [float(sight @ axis[middle]) for axis in (forward, right, over)]
        boresight = parts[0] * forward + parts[1] * right + parts[2] * over
    azimuth = forward - np.einsum("ij,ij->i", forward, boresight)[:, None] * boresight
    size = np.linalg.norm(azimuth, axis=1, keepdims=True)
    azimuth = np.where(size > 1e-9, azimuth / np.maximum(size, 1e-9), np.cross(boresight, right))
    elevation = np.cross(azimuth, boresight)
    elevation *= np.where(elevation[:, 2:] < 0.0, -1.0, 1.0)
    return Pointing(boresight, azimuth, elevation)


def _window(given: RadarInput, track: Track, view: _View, box: Box, waveform: Waveform) -> ReceiveWindow:
    film, where = given.film, given.film_where
    rate = film["sampling_rate"] or SAMPLING_MARGIN * waveform.bandwidth
    if rate < waveform.bandwidth:
        raise RadarError(
            f"{where}: sampling_rate = {rate:g} Hz is below the bandwidth {waveform.bandwidth:g} Hz; "
            "raise it or give 0 for 1.2 times the bandwidth"
        )
    near, far = film["near_range"], film["far_range"]
    if near and far and near >= far:
        raise RadarError(
            f"{where}: near_range = {near:g} m is not below far_range = {far:g} m; swap or widen them"
        )
    spacing = SPEED_OF_LIGHT / (2.0 * rate)
    low, high = box.slant_ranges(view.center[None])
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
    window = receive_window(track.position, view.center, box, waveform.range_cell, spacing, near, far)
    if window.n_samples * track.n_pulses > MAX_SAMPLES:
        raise RadarError(
            f"{where}: {track.n_pulses} pulses of {window.n_samples} samples are more than {MAX_SAMPLES} "
            "samples; shrink the image, the window or the aperture"
        )
    return window


def _warn(text: str) -> None:
    warnings.warn(text, SarmitsubaWarning, stacklevel=3)


__all__ = ["RadarInput", "build_radar", "read_channels"]
