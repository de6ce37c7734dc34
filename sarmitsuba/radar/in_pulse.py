"""The antenna's motion within a pulse: where it is when the echo arrives."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track

F64 = NDArray[np.float64]

# one delay serves all pulses where that changes slant ranges by less than this share of the wavelength: a straight
# uniform track is one at reception too, as focusers in the frequency domain want it
SAME_DELAY = 1e-3
# samples that ranges may move by within the window's margin; it follows them beyond
FREE_SAMPLES = 4


def moving_in_pulse(radar: Radar) -> Radar:
    r"""The radar whose receiver, or whose own antenna, moves on until the echo of the aim point is back.

    .. math:: \mathbf r(t) = \mathbf x(t + D), \quad D = 2 R_{aim} / c

    The times of the track are those of transmission. Echoes from other ranges come back earlier or later than D; what
    that changes is added to each by its own range and range rate (:mod:`sarmitsuba.echo.pulse_motion`).

    Notes
    -----
    Ignores that the beam turns meanwhile: both ways have the beam of the transmission. The track goes on with the
    acceleration that it has in the pulse.
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
    """Where the antenna is a delay (n_pulses,), s, after each pulse; times stay those of the pulses."""
    acceleration = np.zeros_like(track.velocity)
    if track.n_pulses > 2:
        acceleration = np.gradient(track.velocity, track.time, axis=0)
    lag = delay[:, None]
    position = track.position + lag * track.velocity + 0.5 * lag**2 * acceleration
    return Track(track.time, position, track.velocity + lag * acceleration)


__all__ = ["later", "moving_in_pulse"]
