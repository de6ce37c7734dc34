"""Pulse intervals: uniform, random, or staggered (a repeated sequence)."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.path import FlightPath
from sarmitsuba.radar.track import Track

_LONGEST_SEQUENCE = 100_000


@dataclass(frozen=True)
class PulseIntervals:
    r"""Intervals between pulses over their mean 1 / prf.

    .. math:: T_i = \frac{c_{i \bmod M}}{f_p} (1 + \sigma e_i)

    Parameters
    ----------
    sequence : c, repeated intervals of mean 1; empty for uniform ones
    jitter : sigma, rms of the Gaussian interval errors
    seed : of e

    Notes
    -----
    Positions and echoes are those at the pulses' own times, which the focuser knows.
    """

    sequence: tuple[float, ...] = ()
    jitter: float = 0.0
    seed: int = 0

    def times(self, prf: float, n_pulses: int) -> F64:
        """(n_pulses,) s; zero is halfway between the first and the last."""
        intervals = np.ones(max(n_pulses - 1, 0))
        if self.sequence:
            intervals = np.resize(np.asarray(self.sequence), intervals.size)
        if self.jitter > 0.0:
            noise = np.random.default_rng(self.seed).standard_normal(intervals.size)
            intervals = intervals * (1.0 + self.jitter * noise)
        time = np.concatenate([[0.0], np.cumsum(intervals)]) / prf
        return np.asarray(time - 0.5 * time[-1])

    def track(self, path: FlightPath, prf: float, n_pulses: int) -> Track:
        """Pulses along a path."""
        if not self.sequence and self.jitter == 0.0:
            return path.track(prf, n_pulses)
        time = self.times(prf, n_pulses)
        return Track(time, *path.states(time))


def pulse_intervals(given: RadarInput) -> PulseIntervals:
    """The intervals between pulses of a description.

    Raises
    ------
    RadarError
        ``pri_sequence`` is no list of intervals, or the seed has no effect.
    """
    s, where = given.sensor, given.where
    if "prf_jitter_seed" in given.sensor_given and s.prf_jitter == 0.0:
        raise RadarError(
            f"{where}: prf_jitter_seed has no effect without prf_jitter; set prf_jitter above 0 or leave it out"
        )
    return PulseIntervals(_sequence(s.pri_sequence, where), s.prf_jitter, s.prf_jitter_seed)


def _sequence(text: str, where: str) -> tuple[float, ...]:
    """Intervals over their mean; empty for an empty text."""
    if not text.strip():
        return ()
    wrong = RadarError(
        f'{where}: pri_sequence = "{one_line(text)}" is not a list of intervals above 0; give for example "0.9,1,1.1", '
        'or "ramp:40:0.3" for 40 intervals that fall evenly by 0.3 of their mean'
    )
    try:
        kind, *numbers = text.strip().split(":")
        if kind == "ramp":
            count, span = int(numbers[0]), float(numbers[1])
            if len(numbers) != 2 or not 2 <= count <= _LONGEST_SEQUENCE or not 0.0 < span < 2.0:
                raise wrong
            steps = np.linspace(1.0 + 0.5 * span, 1.0 - 0.5 * span, count)
        else:
            steps = np.array([float(cell) for cell in text.split(",")])
    except (ValueError, IndexError):
        raise wrong from None
    if steps.size < 2 or not np.isfinite(steps).all() or steps.min() <= 0.0:
        raise wrong
    return tuple(float(step) for step in steps / steps.mean())
