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
    processor : processor seconds by stage, of all threads of this process
    """

    def __init__(self, clock: Clock = time.perf_counter) -> None:
        self.clock = clock
        self.seconds: dict[str, float] = {}
        self.processor: dict[str, float] = {}
        self._begin = self._last = clock()
        self._last_processor = time.process_time()

    def lap(self, stage: str) -> None:
        """Add the time since the end of the last stage to ``stage``."""
        now, used = self.clock(), time.process_time()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last
        self.processor[stage] = self.processor.get(stage, 0.0) + used - self._last_processor
        self._last, self._last_processor = now, used

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the ``with`` block to a stage."""
        self._last, self._last_processor = self.clock(), time.process_time()
        try:
            yield
        finally:
            self.lap(name)

    @property
    def total(self) -> float:
        """Seconds since the creation of the timer."""
        return self.clock() - self._begin
