"""Time of a run by stage, s, on any clock."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

# time source: ``time.perf_counter`` (elapsed), ``time.process_time`` (processor seconds of all threads), test clock
Clock = Callable[[], float]


class StageTimer:
    """Timer of seconds by stage.

    Parameters
    ----------
    clock : read at the start and at the end of every stage

    Attributes
    ----------
    seconds : by stage, in the order in which the stages first ended
    """

    def __init__(self, clock: Clock = time.perf_counter) -> None:
        self.clock = clock
        self.seconds: dict[str, float] = {}
        self._begin = self._last = clock()

    def lap(self, stage: str) -> None:
        """Add the time since the end of the last stage to ``stage``."""
        now = self.clock()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last
        self._last = now

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the ``with`` block to a stage."""
        self._last = self.clock()
        try:
            yield
        finally:
            self.lap(name)

    @property
    def total(self) -> float:
        """Seconds since the creation of the timer."""
        return self.clock() - self._begin
