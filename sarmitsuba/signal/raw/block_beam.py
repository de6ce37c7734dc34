"""Azimuth pattern of every pulse on a grid over range rates, and the cell size that it needs."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.raw.gridding import GriddingKernel

# error of the azimuth pattern at the ends of a block, dB; 5 dB less in the mean over its pulses
_BEAM_DB = -48.0


def step_within_beam(radar: Radar, start: int, stop: int, kernel: GriddingKernel, s_max: float) -> float:
    r"""Largest cell along the range rate for the azimuth pattern, m/s; infinite without a pattern.

    A path is spread over several cells, each of which is weighted by its own value g of the pattern. With the kernel's
    second moment :math:`m_2`, the two leading error terms at the pulse of phase slope s are

    .. math:: \tfrac12 g'' m_2 \Delta^2, \qquad g' m_2 s \Delta^2

    with the largest derivatives of the pattern. Both are kept at ``_BEAM_DB``.
    """
    if not radar.antenna.directive:
        return float(np.inf)
    taps = np.asarray(kernel.taps(np.array(0.5)))
    distance = np.arange(kernel.width) - kernel.lead - 0.5
    second_moment = max(float(taps @ distance**2 / taps.sum()), 0.25)
    speed = float(np.linalg.norm(radar.track.velocity[start:stop], axis=1).min())
    width = float(np.sin(0.5 * radar.antenna.azimuth_beamwidth)) * speed
    slope, bend = radar.antenna.azimuth_bends
    change = 0.5 * bend / width**2 + slope * s_max / width
    return float(np.sqrt(10.0 ** (_BEAM_DB / 20.0) / (change * second_moment)))


def azimuth_gain(radar: Radar, pulses: slice, reference: F64, range_rate: F64) -> F64:
    r"""Two-way azimuth pattern of pulses over range rates, (n_range_rate, n_pulses) float64.

    The range rate is the speed times the sine of a path's angle off the zero-Doppler plane, so it gives the direction
    of the path at every pulse: along the unit vector

    .. math:: u = -\frac{\dot R}{v} \hat v + \sqrt{1 - (\dot R / v)^2}\, \hat b_\perp

    with :math:`\hat b_\perp` the boresight's direction across the velocity. With two antennas each contributes the root
    of its pattern, at its own speed and boresight.

    Parameters
    ----------
    radar : with its antennas
    pulses : of a block
    reference : (3,) m, scene frame
    range_rate : (n,) m/s, less that of ``reference``

    Notes
    -----
    Ignores the elevation within the azimuth pattern. For paths whose first and last leg have different directions the
    pattern is that at their mean; the rays carry the correction. For two antennas it ignores that the range rates of
    their legs, relative to ``reference``, differ by about the bistatic angle times the scene's angular size.
    """
    gains = [
        _leg_gain(radar, track, pointing, pulses, reference, range_rate)
        for track, pointing in zip(radar.tracks, radar.pointings, strict=True)
    ]
    return gains[0] if len(gains) == 1 else np.sqrt(gains[0] * gains[1])


def _leg_gain(
    radar: Radar, track: Track, pointing: Pointing, pulses: slice, reference: F64, rate: F64
) -> F64:
    """Two-way pattern (squared) of one antenna."""
    position, velocity = track.position[pulses], track.velocity[pulses]
    speed = np.linalg.norm(velocity, axis=1)
    ahead = velocity / speed[:, None]
    leg = reference - position
    reference_rate = -np.einsum("ki,ki->k", leg, velocity) / np.linalg.norm(leg, axis=1)
    sine = np.clip(-(rate[:, None] + reference_rate) / speed, -1.0, 1.0)
    boresight = pointing.boresight[pulses]
    across = boresight - np.einsum("ki,ki->k", boresight, ahead)[:, None] * ahead
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    cosine = np.sqrt(1.0 - sine * sine)

    def component(axis: F64) -> F64:
        along, beside = np.einsum("ki,ki->k", ahead, axis), np.einsum("ki,ki->k", across, axis)
        return np.asarray(sine * along + cosine * beside)

    azimuth = component(pointing.azimuth_axis[pulses])
    gain = radar.antenna.two_way_amplitude(azimuth, np.zeros_like(azimuth))
    return np.asarray(np.where(component(boresight) > 0.0, gain, 0.0))
