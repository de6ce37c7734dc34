"""Antenna patterns: relative one-way power gain over direction, from a few numbers or from tables."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from types import ModuleType

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.registry import Registry
from sarmitsuba.core.samples import Samples

# -3 dB half angle of sinc^2: sinc(pi u) = 1/sqrt(2) at u = 0.442946
SINC_HALF_POWER = 0.442946470689452
# half-power half-widths over which a pattern is measured, and their number; gain of a null
_REACH, _STEPS, _NULL = 8.0, 4000, 1e-3


class Pattern(ABC):
    """Shape of a beam about its boresight.

    A pattern is one module with one registered instance; it may be a user's extension module. It runs in NumPy and in
    the kernels, where its numbers are opaque: one kernel serves all beams of a shape.

    Attributes
    ----------
    name : in scene files
    doc : one phrase
    half_power_sine : sine of the half-power half-angle times the size of the aperture in wavelengths; None: the shape
        belongs to no aperture, and its widths have to be given
    measured : its numbers are those of a :class:`sarmitsuba.radar.pattern_table.PatternTable` read from a file, not
        the half-power widths
    """

    name: str
    doc: str
    half_power_sine: float | None = None
    measured: bool = False

    @abstractmethod
    def gain(
        self,
        sin_azimuth: Samples,
        sin_elevation: Samples,
        numbers: Sequence[Samples | float],
        xp: ModuleType = np,
    ) -> Samples:
        """Relative one-way power gain, which is the relative two-way amplitude; 1 at its peak.

        Parameters
        ----------
        sin_azimuth, sin_elevation : components of the unit direction along the aperture's axes
        numbers : :attr:`sarmitsuba.radar.antenna.Antenna.numbers`: one over the sines of the half-power half-angles in
            azimuth and elevation, or the table's
        xp : ``numpy`` or ``drjit``
        """

    def find_null(self) -> float | None:
        """Sine of the first null over that of the half-power half-angle; None: the gain has none."""
        gain = self._measure()
        least = np.flatnonzero((gain[1:-1] < _NULL) & (gain[1:-1] < gain[:-2]) & (gain[1:-1] <= gain[2:]))
        return float(_REACH * (least[0] + 1) / _STEPS) if least.size else None

    def find_bends(self) -> tuple[float, float]:
        """Largest first and second derivative of the gain over the sine in half-power half-widths."""
        gain, step = self._measure(), _REACH / _STEPS
        slope = np.abs(np.diff(gain)).max() / step
        return float(slope), float(np.abs(np.diff(gain, 2)).max() / step**2)

    def _measure(self) -> F64:
        """Gain of the cut in azimuth over ``_REACH`` half-power half-widths, (_STEPS + 1,)."""
        sine = np.linspace(0.0, _REACH, _STEPS + 1)
        return np.asarray(self.gain(sine, np.zeros_like(sine), (1.0, 1.0)), dtype=np.float64)


PATTERNS: Registry[Pattern] = Registry("antenna pattern", Pattern, "sarmitsuba.radar.patterns")
