"""Bounds of a radar's numbers from sources other than scene files: recordings, results and Python code.

Scene files have the same bounds, in degrees and decibels, beside each parameter of
:class:`sarmitsuba.radar.description.RadarDescription`.
"""

from collections.abc import Iterable
from dataclasses import fields

import numpy as np

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.radar.description import SENSOR
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.polarisation import CHANNELS
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.receive_chain import ReceiveChain, check_chain
from sarmitsuba.radar.track import Track

# name, value, lowest, highest, unit
Bound = tuple[str, float, float, float, str]

# m: a position in a frame on the Earth, at a geostationary orbit or at the Moon
FARTHEST = 1e10
_FASTEST = 1e6  # m/s
_ROUNDING = 1e-9  # of 0 dB
# rad, rotation from pulse to pulse up to which velocities are checked against positions, and allowed relative
# difference
_TURN, _OFF = 0.5, 0.5
# allowed deviation of unit vectors' lengths: files may be in float32
_UNIT = 1e-3


def _check_chain(chain: ReceiveChain, channels: tuple[str, ...]) -> None:
    """Check a receive chain by the bounds of scene files; no clipping is an infinite level there."""
    for param in SENSOR.params:
        if param.name in (f.name for f in fields(chain)):
            value = getattr(chain, param.name)
            unclipped = param.name == "saturation_db" and value == float("inf")
            param.convert(None if unclipped else value, "radar/chain", RadarError)
    check_chain(chain, channels)


def check_radar(radar: Radar) -> None:
    """Raise a RadarError where a number of a radar is out of the bounds of scene files.

    Parameters
    ----------
    radar : of any source

    Raises
    ------
    RadarError
        One line: name, value and bounds.
    """
    wave, antenna, window = radar.waveform, radar.antenna, radar.window
    check_bounds(
        "radar",
        (
            ("center_frequency", wave.center_frequency, 1e6, 1e12, "Hz"),
            ("bandwidth", wave.bandwidth, 1e3, 1e12, "Hz"),
            ("pulse_width", wave.pulse_width, 1e-10, 1.0, "s"),
            ("antenna gain", antenna.gain, 1e-10, 1e10, ""),
            ("azimuth_beamwidth", antenna.azimuth_beamwidth, 1e-9, 2.0 * np.pi, "rad"),
            ("elevation_beamwidth", antenna.elevation_beamwidth, 1e-9, 2.0 * np.pi, "rad"),
            ("transmit_power", radar.transmit_power, 1e-12, 1e12, "W"),
            ("noise_temperature", radar.noise_temperature, 0.0, 1e9, "K"),
            ("losses", radar.losses, 1.0 - _ROUNDING, 1e10, ""),
            ("half_aperture", radar.half_aperture, 1e-9, np.inf, ""),
            ("sample_spacing", window.sample_spacing, 1e-5, 1e6, "m"),
            ("n_samples", window.n_samples, 1, 2**31, ""),
        ),
    )
    if radar.look_side not in ("left", "right"):
        raise RadarError(f'radar: look_side = "{one_line(radar.look_side)}" is neither left nor right')
    unknown = [name for name in radar.channels if name not in CHANNELS]
    if unknown or not radar.channels:
        raise RadarError(f'radar: channel "{one_line(unknown[:1])}" is none of {", ".join(CHANNELS)}')
    _check_places("aim_point", radar.aim_point)
    _check_places("offset", radar.offset)
    _check_places("start_range", window.start_range)
    for name, track in (("track", radar.track), ("receiver", radar.receiver), ("recorded", radar.recorded)):
        if track is not None:
            _check_track(name, track)
    for name, pointing in (("pointing", radar.pointing), ("receiver_pointing", radar.receiver_pointing)):
        if pointing is not None:
            for axis in ("boresight", "azimuth_axis", "elevation_axis"):
                _check_unit(f"{name} {axis}", getattr(pointing, axis))
    check_anchor(radar.anchor)
    if radar.chain is not None:
        _check_chain(radar.chain, radar.channels)


def check_request(request: ImageRequest) -> None:
    """Raise a RadarError where an image request is invalid."""
    if request.grid not in ("slant", "ground"):
        raise RadarError(f'image: grid = "{one_line(request.grid)}" is neither slant nor ground')
    check_bounds(
        "image",
        (
            ("extent_azimuth", request.extent_azimuth, 1e-6, 1e7, "m"),
            ("extent_range", request.extent_range, 1e-6, 1e7, "m"),
            ("spacing_azimuth", request.spacing_azimuth, 0.0, 1e6, "m"),
            ("spacing_range", request.spacing_range, 0.0, 1e6, "m"),
            ("pixels_azimuth", float(request.pixels_azimuth), 0.0, 1e6, ""),
            ("pixels_range", float(request.pixels_range), 0.0, 1e6, ""),
            ("center_x", request.center_x, -FARTHEST, FARTHEST, "m"),
            ("center_y", request.center_y, -FARTHEST, FARTHEST, "m"),
            ("height", request.height, -1e7, 1e7, "m"),
        ),
    )


def check_anchor(anchor: Anchor) -> None:
    """Raise a RadarError where the place on the Earth is invalid."""
    check_bounds(
        "anchor",
        (
            ("latitude", anchor.latitude, -0.5 * np.pi, 0.5 * np.pi, "rad"),
            ("longitude", anchor.longitude, -2.0 * np.pi, 2.0 * np.pi, "rad"),
            ("height", anchor.height, -1e4, 1e6, "m"),
        ),
    )


def check_bounds(where: str, bounds: Iterable[Bound]) -> None:
    """Raise a RadarError at the first number out of its bounds; NaN is always out of bounds."""
    for name, value, low, high, unit in bounds:
        if not low <= value <= high:
            given, bounds_text = f"{value:g} {unit}".rstrip(), f"{low:g} to {high:g} {unit}".rstrip()
            raise RadarError(f"{where}: {name} = {given} is out of bounds ({bounds_text})")


def _check_track(name: str, track: Track) -> None:
    _check_places(f"{name} position", track.position)
    if not np.isfinite(track.time).all() or np.ptp(track.time) > 1e7:
        raise RadarError(
            f"radar: {name} times span {np.ptp(track.time):g} s, or are none; give seconds, at most 1e7"
        )
    speed = np.linalg.norm(track.velocity, axis=1)
    # a single pulse needs no velocity, and a separate receiver may be at rest
    rests = track.n_pulses == 1 or name == "receiver"
    if not (((speed > 0.0) | rests) & (speed <= _FASTEST)).all():
        raise RadarError(
            f"radar: {name} speeds from {speed.min():g} to {speed.max():g} m/s; each must be "
            f"{'at least' if rests else 'above'} 0 and at most {_FASTEST:g}"
        )
    if not rests:
        _check_flight(name, track)


def _check_flight(name: str, track: Track) -> None:
    """Raise a RadarError where velocities contradict the change of the positions."""
    steps = np.diff(track.time)
    forward = unit_rows(track.velocity)
    turns = np.einsum("ni,ni->n", forward[1:], forward[:-1]) < np.cos(_TURN)
    if track.n_pulses < 3 or not (steps > 0.0).all() or turns.any():
        return
    flown = np.gradient(track.position, track.time, axis=0)
    off, given, changed = (
        float(np.median(np.linalg.norm(v, axis=1))) for v in (track.velocity - flown, track.velocity, flown)
    )
    if off > _OFF * max(given, changed):
        raise RadarError(
            f"radar: {name} velocities of {given:.4g} m/s are not those of its positions and times, which change by "
            f"{changed:.4g} m/s and differ by {off:.4g} m/s; give the three of one flight"
        )


def _check_places(name: str, values: F64) -> None:
    if not (np.abs(values) <= FARTHEST).all():  # NaN neither
        raise RadarError(
            f"radar: {name} reaches {np.abs(values).max():g} m; at most {FARTHEST:g} m, and finite"
        )


def _check_unit(name: str, vectors: F64) -> None:
    length = np.linalg.norm(vectors, axis=-1)
    if not (np.abs(length - 1.0) <= _UNIT).all():
        worst = length[np.nanargmax(np.abs(np.nan_to_num(length, nan=1e9) - 1.0))]
        raise RadarError(f"radar: {name} holds a vector of length {worst:g}; give unit vectors")
