"""The grid of one look: slant range and range rate, the coordinates of an image before it is focused."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.echo.gridding import SpreadingKernel, spreading_kernel

F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LookGrid:
    r"""Where the contributions of one look go: a grid over range and range rate, about the look's position.

    A path of slant range h and range rate h' goes to the cell of these two (``zero_doppler`` off; every pixel is seen
    by the same pulses), or to that of its closest approach (on; the beam passes over every pixel in turn):

    .. math:: r_c = h \sqrt{1 - (h' / v)^2}, \quad s = h h' / r_c

    Both are exact for straight paths on a straight track; the range rate of a path is the sine of its angle off the
    zero-Doppler plane times the speed, so s is its azimuth times ``-v^2 / r_c``.

    Parameters
    ----------
    position, velocity : (3,) float64, m and m/s, scene frame; of the antenna at the look's time
    zero_doppler : coordinates of closest approach instead of the look's own
    reference_range : m; range of the origin, subtracted before the phase is formed
    range0, range_step, n_range : range of cell 0 less ``reference_range`` (m), cell (m), number of cells
    range_rate0, range_rate_step, n_range_rate : the same along the range rate, m/s
    width : of the spreading kernel, both axes
    """

    position: F64
    velocity: F64
    zero_doppler: bool
    reference_range: float
    range0: float
    range_step: float
    n_range: int
    range_rate0: float
    range_rate_step: float
    n_range_rate: int
    width: int

    @property
    def kernel(self) -> SpreadingKernel:
        """Spreading kernel of both axes."""
        return spreading_kernel(self.width)

    @property
    def speed(self) -> float:
        """Antenna's speed, m/s."""
        return float(np.linalg.norm(self.velocity))

    def coordinates(self, slant_range: F64, range_rate: F64) -> tuple[F64, F64]:
        """Range and range-rate coordinate of paths, m and m/s, any shape."""
        if not self.zero_doppler:
            return slant_range, range_rate
        sine = range_rate * (1.0 / self.speed)
        cosine = np.sqrt(np.maximum(1.0 - sine * sine, 1e-6))
        return slant_range * cosine, range_rate / cosine

    def cells(self, slant_range: F64, range_rate: F64) -> tuple[F64, F64, F64]:
        """Range less the reference (m), and the position of paths on the two axes in cells."""
        r, s = self.coordinates(slant_range, range_rate)
        offset = r - self.reference_range
        x = (offset - self.range0) * (1.0 / self.range_step)
        y = (s - self.range_rate0) * (1.0 / self.range_rate_step)
        return offset, x, y


__all__ = ["LookGrid"]
