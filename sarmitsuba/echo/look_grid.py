"""The grid of one look: slant range and range rate, the coordinates of an image before it is focused."""

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from sarmitsuba.echo.gridding import SpreadingKernel, spreading_kernel
from sarmitsuba.echo.sub_bands import RangeFilter

F64 = NDArray[np.float64]
C64 = NDArray[np.complex64]


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

    def filtered(self, cells: C64, share: RangeFilter | None) -> C64:
        """Cells (n_layers, n_range, n_range_rate) with a factor on their spectrum along range; None leaves them.

        In coordinates of closest approach range turns by the squint of the grid's middle.
        """
        if share is None:
            return cells
        cycles = scipy.fft.fftfreq(self.n_range) / self.range_step
        if self.zero_doppler:
            middle = self.range_rate0 + 0.5 * (self.n_range_rate - 1) * self.range_rate_step
            cycles = cycles * np.hypot(1.0, middle / self.speed)
        spectrum = scipy.fft.fft(cells, axis=1, workers=-1)
        spectrum *= share(cycles).astype(np.float32)[:, None]
        return np.asarray(scipy.fft.ifft(spectrum, axis=1, workers=-1, overwrite_x=True))


__all__ = ["LookGrid"]
