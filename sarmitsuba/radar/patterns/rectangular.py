"""Beam of a uniformly illuminated rectangular aperture."""

from collections.abc import Sequence
from types import ModuleType

import numpy as np

from sarmitsuba.core.arrays import Samples
from sarmitsuba.radar.pattern import PATTERNS, SINC_HALF_POWER, Pattern


class Rectangular(Pattern):
    """Square of a sinc in azimuth and elevation, with its side lobes of -13 dB."""

    name = "rectangular"
    doc = "uniformly illuminated rectangle, with the side lobes of its sinc"
    half_power_sine = SINC_HALF_POWER

    def gain(
        self,
        sin_azimuth: Samples,
        sin_elevation: Samples,
        numbers: Sequence[Samples | float],
        xp: ModuleType = np,
    ) -> Samples:
        """Return sinc^2: the voltage is sinc(pi u) one way."""
        x, y = (sine * scale for sine, scale in zip((sin_azimuth, sin_elevation), numbers, strict=True))
        u, v = (_sinc(np.pi * SINC_HALF_POWER * z, xp) for z in (x, y))
        product: Samples = u * u * v * v
        return product

    def find_null(self) -> float:
        """That of the sinc."""
        return 1.0 / SINC_HALF_POWER

    def find_bends(self) -> tuple[float, float]:
        """Those of the Gaussian of these widths; the sinc has 0.75 and 1.29."""
        return 0.72, 1.39


def _sinc(x: Samples, xp: ModuleType) -> Samples:
    value: Samples
    if xp is np:
        value = xp.sinc(np.asarray(x) / np.pi)
    else:
        value = xp.select(abs(x) > 1e-4, xp.sin(x) / xp.select(abs(x) > 1e-4, x, 1.0), 1.0 - x * x / 6.0)
    return value


PATTERNS.register(Rectangular())
