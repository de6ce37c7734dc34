"""Flight path of the antenna as a function of time; automatic tracks are samples of it at the pulse times."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.radar.track import Track


class FlightPath(ABC):
    """Position and velocity at any time; time zero is mid-aperture."""

    @abstractmethod
    def states(self, time: F64) -> tuple[F64, F64]:
        """Position (m) and velocity (m/s), two (n, 3) float64 in the scene frame, at (n,) times in s."""

    @property
    def speed(self) -> float:
        """Speed at mid-aperture, m/s."""
        return float(np.linalg.norm(self.states(np.zeros(1))[1]))

    def track(self, prf: float, n_pulses: int) -> Track:
        """Uniformly timed pulses with mid-aperture in their middle.

        Parameters
        ----------
        prf : pulse repetition frequency, Hz
        n_pulses : number of pulses
        """
        time = np.asarray((np.arange(n_pulses) - 0.5 * (n_pulses - 1)) / prf, dtype=np.float64)
        return Track(time, *self.states(time))


@dataclass(frozen=True, eq=False)
class StraightPath(FlightPath):
    """Straight path at constant speed.

    Parameters
    ----------
    center : (3,) float64, m, scene frame; mid-aperture
    flight : (3,) float64, m/s, velocity
    """

    center: F64
    flight: F64

    def states(self, time: F64) -> tuple[F64, F64]:
        """See the class."""
        position = np.asarray(self.center + time[:, None] * self.flight)
        return position, np.broadcast_to(self.flight, position.shape).copy()
