"""Gaussian beam: gain in dB falls with the square of the sine off boresight."""

from collections.abc import Sequence
from types import ModuleType

import numpy as np

from sarmitsuba.core.arrays import Samples
from sarmitsuba.radar.pattern import PATTERNS, SINC_HALF_POWER, Pattern


class Gaussian(Pattern):
    """Main lobe of the given half-power widths, without side lobes."""

    name = "gaussian"
    doc = "main lobe of the given half-power widths, no side lobes"
    half_power_sine = SINC_HALF_POWER  # of the uniform aperture whose main lobe it stands for

    def gain(
        self,
        sin_azimuth: Samples,
        sin_elevation: Samples,
        numbers: Sequence[Samples | float],
        xp: ModuleType = np,
    ) -> Samples:
        """Return half the power at the half-power angles."""
        x, y = (sine * scale for sine, scale in zip((sin_azimuth, sin_elevation), numbers, strict=True))
        ln2 = float(np.log(2.0))
        gain: Samples = xp.exp(-ln2 * (x * x + y * y))
        return gain

    def find_bends(self) -> tuple[float, float]:
        """Those of 2^-(x^2)."""
        return 0.72, 1.39


PATTERNS.register(Gaussian())
