"""Receiver of bistatic data, on the same platform or another; motion of an antenna until an echo is received."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import RadarError
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.mode import right_of
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.track_errors import check_same_pulses

_OFFSETS = ("receiver_offset_along", "receiver_offset_across", "receiver_offset_up")
# rad, largest tested bistatic angle at the aim point
LARGEST_ANGLE = float(np.radians(30.0))


def receiver_track(given: RadarInput, track: Track, aim: F64, offset: F64) -> Track | None:
    r"""Track of a separate receiver in the scene frame; None for monostatic data.

    .. math:: \mathbf r(t) = \mathbf x(t) + b_a \hat a + b_r \hat r + b_u \hat z

    with :math:`\hat a` the horizontal direction of flight at mid-aperture and :math:`\hat r` to its right.

    Parameters
    ----------
    given : the description
    track : of the transmitter, scene frame
    aim : (3,) m, scene frame; aim point
    offset : (3,) float64, m; scene frame = file frame - offset

    Raises
    ------
    RadarError
        The file cannot be read or does not match the transmitter's pulses, parameters contradict each other, or the
        bistatic angle is too large.
    """
    s = given.sensor
    if s.receiver_track_file:
        beside = sorted(given.sensor_given & set(_OFFSETS))
        if beside:
            raise RadarError(
                f"{given.where}: {beside[0]} has no effect beside receiver_track_file; leave one of them out"
            )
        path = Path(s.receiver_track_file)
        own = Track.from_csv(path if path.is_absolute() else given.folder / path)
        own = replace(own, position=own.position - offset)
        receiver = check_same_pulses(s.receiver_track_file, own, track, "received")
    else:
        baseline = np.array([s.receiver_offset_along, s.receiver_offset_across, s.receiver_offset_up])
        if not baseline.any():
            return None
        axes = np.array([track.along, right_of(track.along), [0.0, 0.0, 1.0]])
        receiver = replace(track, position=track.position + baseline @ axes)
    angle = float(bistatic_angle(track, receiver, aim).max())
    if angle > LARGEST_ANGLE:
        raise RadarError(
            f"{given.where}: the bistatic angle at the aim point is {np.degrees(angle):.3g} deg, more than "
            f"{np.degrees(LARGEST_ANGLE):.0f} deg; bring it nearer"
        )
    return receiver


def bistatic_angle(track: Track, receiver: Track, point: F64) -> F64:
    """Bistatic angle (n_pulses,), rad, between the lines of sight of two tracks to a point (3,), m."""
    a, b = (one.position - point for one in (track, receiver))
    sine = np.linalg.norm(np.cross(a, b), axis=1)
    return np.asarray(np.arctan2(sine, np.einsum("ni,ni->n", a, b)))


# one delay is used for all pulses where that changes slant ranges by less than this share of the wavelength: a straight
# uniform track then stays one at reception, as frequency-domain focusers need
SAME_DELAY = 1e-3
# samples by which ranges may shift within the window's margin; beyond, the window follows them
FREE_SAMPLES = 4


def moving_in_pulse(radar: Radar) -> Radar:
    r"""Radar whose receiving antenna moves on until the echo of the aim point arrives.

    .. math:: \mathbf r(t) = \mathbf x(t + D), \quad D = 2 R_{aim} / c

    The times of the track are those of transmission. Echoes from other ranges arrive earlier or later than D; the
    difference is added to each by its range and range rate (:mod:`sarmitsuba.signal.pulse_motion`).

    Notes
    -----
    Ignores the beam's rotation meanwhile: both legs have the beam of the transmission. The track continues with its
    acceleration at the pulse.
    """
    if radar.delay is not None:
        return radar
    slant_range = radar.slant_range(radar.aim_point)
    delay = 2.0 * slant_range / SPEED_OF_LIGHT
    middle = np.full_like(delay, delay[radar.track.center_index])
    rate = np.abs(radar.range_rate(radar.aim_point)).max()
    if rate * np.abs(delay - middle).max() < SAME_DELAY * radar.waveform.wavelength:
        delay = middle
    moved = replace(radar, receiver=later(radar.tracks[-1], delay), delay=delay)
    window = radar.window
    samples = np.round((moved.slant_range(radar.aim_point) - slant_range) / window.sample_spacing)
    if np.abs(samples).max() > FREE_SAMPLES:
        window = replace(window, start_range=window.start_range + samples * window.sample_spacing)
    return replace(moved, window=window)


def later(track: Track, delay: F64) -> Track:
    """Track of the antenna a delay (n_pulses,), s, after each pulse; times stay those of the pulses."""
    acceleration = np.zeros_like(track.velocity)
    if track.n_pulses > 2:
        acceleration = np.gradient(track.velocity, track.time, axis=0)
    lag = delay[:, None]
    position = track.position + lag * track.velocity + 0.5 * lag**2 * acceleration
    return replace(track, position=position, velocity=track.velocity + lag * acceleration)
