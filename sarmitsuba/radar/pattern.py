"""Antenna patterns: relative one-way power gain over direction, from a few numbers or from tables."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from types import ModuleType

import numpy as np

from sarmitsuba.registry import Registry
from sarmitsuba.samples import Samples

# -3 dB half angle of sinc^2: sinc(pi u) = 1/sqrt(2) at u = 0.442946
SINC_HALF_POWER = 0.442946470689452


class Pattern(ABC):
    """Shape of a beam about its boresight.

    A pattern is one module with one registered instance; it may be a user's extension module. It runs in NumPy and in
    the kernels, where its numbers are opaque: one kernel serves all beams of a shape.

    Attributes
    ----------
    name : in scene files
    doc : one phrase
    measured : its numbers are those of a :class:`sarmitsuba.radar.pattern_table.PatternTable` read from a file, not
        the half-power widths
    """

    name: str
    doc: str
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


PATTERNS: Registry[Pattern] = Registry("antenna pattern", Pattern, "sarmitsuba.radar.patterns")
