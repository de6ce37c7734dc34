"""Motion of the antenna between transmission and reception of a pulse."""

from dataclasses import replace

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track

# one delay is used for all pulses where that changes slant ranges by less than this share of the wavelength: a straight
# uniform track then stays one at reception, as frequency-domain focusers need
SAME_DELAY = 1e-3
# samples by which ranges may shift within the window's margin; beyond, the window follows them
FREE_SAMPLES = 4


def moving_in_pulse(radar: Radar) -> Radar:
    r"""Radar whose receiving antenna moves on until the echo of the aim point arrives.

    .. math:: \mathbf r(t) = \mathbf x(t + D), \quad D = 2 R_{aim} / c

    The times of the track are those of transmission. Echoes from other ranges arrive earlier or later than D; the
    difference is added to each by its range and range rate (:mod:`sarmitsuba.signal.raw.pulse_motion`).

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
