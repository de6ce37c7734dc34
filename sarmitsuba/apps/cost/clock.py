"""Clocks of a cost study: processor seconds of this machine, or computed from the work for a machine of given speed."""

import time
from collections.abc import Mapping
from typing import Protocol

from sarmitsuba.core.timing import Clock
from sarmitsuba.simulation.planning.prediction.speed import USUAL_CORE, SpeedModel, Work


class StudyClock(Protocol):
    """Clock of a cost study.

    Attributes
    ----------
    source : of the seconds that the stages of a run measure
    """

    source: Clock

    def now(self) -> float:
        """Seconds since a fixed moment, without compiling."""
        ...

    def stages(
        self, measured: Mapping[str, float], work: Work, compile_seconds: float = 0.0
    ) -> dict[str, float]:
        """Seconds by stage of a run that took ``measured`` seconds here to do ``work``, and others for compiling."""
        ...


class MeasuredClock:
    """Seconds of this machine's processors, of all threads of the process, which other programs change little.

    Parameters
    ----------
    source : ``time.perf_counter`` measures elapsed seconds instead
    """

    def __init__(self, source: Clock = time.process_time) -> None:
        self.source = source
        self._compiling = 0.0

    def now(self) -> float:
        """Seconds since a fixed moment, without those of compiling in the runs so far."""
        return self.source() - self._compiling

    def stages(
        self, measured: Mapping[str, float], work: Work, compile_seconds: float = 0.0
    ) -> dict[str, float]:
        """As measured."""
        self._compiling += compile_seconds
        return dict(measured)


class WorkClock:
    """Time computed from the work for a machine of given speed: the same budget allows the same runs everywhere.

    Parameters
    ----------
    speed : of that machine
    stage_seconds : s, additional time of every stage
    """

    def __init__(self, speed: SpeedModel = USUAL_CORE, stage_seconds: float = 5e-3) -> None:
        self.speed, self.stage_seconds = speed, stage_seconds
        self.source: Clock = time.perf_counter
        self._elapsed = 0.0

    def now(self) -> float:
        """Total seconds of all runs so far."""
        return self._elapsed

    def stages(
        self, measured: Mapping[str, float], work: Work, compile_seconds: float = 0.0
    ) -> dict[str, float]:
        """Seconds by stage from the work; one of the stages ``trace`` and ``raster`` has the rays."""
        counted = self.speed.stages(work)
        counted["raster"] = counted["trace"]
        out = {stage: self.stage_seconds + counted.get(stage, 0.0) for stage in measured}
        self._elapsed += sum(out.values())
        return out
