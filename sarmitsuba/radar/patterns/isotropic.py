"""Isotropic antenna: equal gain in all directions."""

from collections.abc import Sequence
from types import ModuleType

import numpy as np

from sarmitsuba.core.arrays import Samples
from sarmitsuba.radar.pattern import PATTERNS, Pattern


class Isotropic(Pattern):
    """Isotropic pattern; beam effects are skipped."""

    name = "isotropic"
    doc = "the same gain in all directions"

    def gain(
        self,
        sin_azimuth: Samples,
        sin_elevation: Samples,
        numbers: Sequence[Samples | float],
        xp: ModuleType = np,
    ) -> Samples:
        """Return 1."""
        return 0.0 * sin_azimuth + 1.0


PATTERNS.register(Isotropic())
