"""Progress of long-running stages, and of a run of several stages."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from sarmitsuba.timing import Clock


class Progress(Protocol):
    """Callback of a stage: ``progress(stage, done, total, info)``.

    Call it whenever a batch is done, a few times per second at most. It may raise (KeyboardInterrupt), and the
    stage must then leave nothing half done behind.

    Parameters
    ----------
    stage : short name of the stage, e.g. ``trace``; a new name ends the stage before
    done, total : work done and all work, in any unit of the stage's own, ``0 <= done <= total``
    info : figures to show beside the bar, by name with unit, e.g. ``{"rays/s": 4.1e6}``
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
    elapsed, left : s; the time left is infinite as long as nothing is done
    """

    share: float
    elapsed: float
    left: float


class Journey:
    r"""Common progress and remaining time of all stages of a run.

    The expected seconds of the stages are relative weights; the speed of the machine follows from the elapsed time:

    .. math:: t_{left} = t \frac{W - w}{w}

    with W the expected seconds of all stages and w of what is done of them.

    Parameters
    ----------
    expected : seconds by stage, in the order of the run; a stage that is not among them joins with what the others
        have on average, or alone
    clock : time source, s
    """

    def __init__(self, expected: Mapping[str, float] | None = None, clock: Clock = time.perf_counter) -> None:
        self._weight = dict(expected or {})
        self._done: dict[str, float] = {}
        self._clock, self._begin = clock, clock()

    def reached(self, stage: str, share: float) -> Standing:
        """Progress of the run when a stage has reached a share of it, 0 to 1; earlier stages are done."""
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
