"""How fine a grid over range rates must be for the azimuth pattern to act on it."""

import numpy as np

from sarmitsuba.echo.gridding import SpreadingKernel
from sarmitsuba.radar.radar import Radar

# error of the azimuth pattern at the ends of a block, dB; 5 dB less in the mean over its pulses
_BEAM_DB = -48.0


def step_within_beam(radar: Radar, start: int, stop: int, kernel: SpreadingKernel, s_max: float) -> float:
    r"""Longest cell along the range rate over which the azimuth pattern hardly changes, m/s; infinite without one.

    A path is spread over some cells, each of which gets the pattern's value g of its own. With the kernel's second
    moment :math:`m_2`, the two leading terms of what that leaves at the pulse of phase slope s are

    .. math:: \tfrac12 g'' m_2 \Delta^2, \qquad g' m_2 s \Delta^2

    with the largest derivatives that the pattern has anywhere. Both are kept at ``_BEAM_DB``.
    """
    if radar.antenna.pattern == "isotropic":
        return float(np.inf)
    taps = np.asarray(kernel.taps(np.array(0.5)))
    distance = np.arange(kernel.width) - kernel.lead - 0.5
    second_moment = max(float(taps @ distance**2 / taps.sum()), 0.25)
    speed = float(np.linalg.norm(radar.track.velocity[start:stop], axis=1).min())
    width = float(np.sin(0.5 * radar.antenna.azimuth_beamwidth)) * speed
    slope, bend = radar.antenna.azimuth_bends
    change = 0.5 * bend / width**2 + slope * s_max / width
    return float(np.sqrt(10.0 ** (_BEAM_DB / 20.0) / (change * second_moment)))


__all__ = ["step_within_beam"]
