"""Progress of long-running stages, and of a run of several stages."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from sarmitsuba.core.timing import Clock


class Progress(Protocol):
    """Callback of a stage: ``progress(stage, done, total, info)``.

    Called after every batch, at most a few times per second. It may raise (KeyboardInterrupt), after which the stage
    must leave nothing unfinished.

    Parameters
    ----------
    stage : short name of the stage, e.g. ``trace``; a new name ends the previous stage
    done, total : completed and total work, in any unit, ``0 <= done <= total``
    info : values to show beside the bar, by name with unit, e.g. ``{"rays/s": 4.1e6}``
    """

    def __call__(self, stage: str, done: float, total: float, info: Mapping[str, float], /) -> None:
        """Report."""
        ...


def silent(stage: str, done: float, total: float, info: Mapping[str, float], /) -> None:
    """No report."""


@dataclass(frozen=True)
class Standing:
    """Progress of a run.

    Parameters
    ----------
    share : of the whole run, 0 to 1
    elapsed, left : s; the remaining time is infinite until some work is done
    """

    share: float
    elapsed: float
    left: float


class Journey:
    r"""Common progress and remaining time of all stages of a run.

    The expected seconds of the stages are relative weights, scaled by the elapsed time:

    .. math:: t_{left} = t \frac{W - w}{w}

    with W the expected seconds of all stages and w those of the completed work.

    Parameters
    ----------
    expected : seconds by stage, in the order of the run; an unknown stage gets the mean of the others
    clock : time source, s
    """

    def __init__(self, expected: Mapping[str, float] | None = None, clock: Clock = time.perf_counter) -> None:
        self._weight = dict(expected or {})
        self._done: dict[str, float] = {}
        self._clock, self._begin = clock, clock()

    def reached(self, stage: str, share: float) -> Standing:
        """Progress of the run when a stage has completed a share, 0 to 1; earlier stages are complete."""
        if stage not in self._weight:
            self._weight[stage] = sum(self._weight.values()) / len(self._weight) if self._weight else 1.0
        for name in self._weight:
            if name == stage:
                break
            self._done[name] = 1.0
        self._done[stage] = share
        whole = sum(self._weight.values())
        done = sum(self._weight[name] * part for name, part in self._done.items())
        elapsed = self._clock() - self._begin
        left = elapsed * (whole - done) / done if done > 0.0 else float("inf")
        return Standing(done / whole if whole else 1.0, elapsed, left)
