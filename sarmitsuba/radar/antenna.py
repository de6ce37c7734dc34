"""Antenna pattern: one-way power gain over direction, the same for transmit and receive."""

from collections.abc import Iterable
from dataclasses import dataclass
from types import ModuleType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.samples import Samples

PatternKind = Literal["isotropic", "gaussian", "rectangular"]

# -3 dB half angle of sinc^2: sinc(pi u) = 1/sqrt(2) at u = 0.442946
SINC_HALF_POWER = 0.442946470689452


@dataclass(frozen=True)
class Antenna:
    """Pattern about a boresight, separable in azimuth and elevation.

    Parameters
    ----------
    pattern : ``isotropic``, ``gaussian`` (of given half-power widths) or ``rectangular`` (uniform aperture, sinc)
    gain : peak one-way power gain, linear
    azimuth_beamwidth, elevation_beamwidth : one-way half-power widths, rad (ignored when isotropic)

    Notes
    -----
    Ignores cross-polar radiation, element factors and back lobes: the pattern is zero behind the aperture.
    """

    pattern: PatternKind = "isotropic"
    gain: float = 1.0
    azimuth_beamwidth: float = np.pi
    elevation_beamwidth: float = np.pi

    def two_way_amplitude(self, sin_azimuth: Samples, sin_elevation: Samples, xp: ModuleType = np) -> Samples:
        """Relative two-way amplitude (= one-way relative power gain), 1 at boresight, without ``gain``.

        ``sin_azimuth`` and ``sin_elevation`` are the components of the unit direction along the aperture's
        azimuth and elevation axes. ``xp`` is ``numpy`` or ``drjit``.
        """
        return self.normalised(sin_azimuth, sin_elevation, self.per_width, xp)

    @property
    def per_width(self) -> tuple[float, float]:
        """One over the sines of the half-power half-angles in azimuth and elevation: the pattern's only numbers."""
        azimuth, elevation = np.sin(0.5 * self.azimuth_beamwidth), np.sin(0.5 * self.elevation_beamwidth)
        return 1.0 / float(azimuth), 1.0 / float(elevation)

    def normalised(
        self,
        sin_azimuth: Samples,
        sin_elevation: Samples,
        per_width: Iterable[Samples | float],
        xp: ModuleType = np,
    ) -> Samples:
        """As :meth:`two_way_amplitude`, with :attr:`per_width` given: opaque in a kernel, which then fits any beam."""
        if self.pattern == "isotropic":
            return 0.0 * sin_azimuth + 1.0
        x, y = (sine * scale for sine, scale in zip((sin_azimuth, sin_elevation), per_width, strict=True))
        if self.pattern == "gaussian":
            ln2 = float(np.log(2.0))
            gain: Samples = xp.exp(-ln2 * (x * x + y * y))
            return gain
        # uniform aperture: voltage sinc(pi u) one way, so sinc^2 is the two-way amplitude
        u, v = (_sinc(np.pi * SINC_HALF_POWER * z, xp) for z in (x, y))
        product: Samples = u * u * v * v
        return product


def _sinc(x: Samples, xp: ModuleType) -> Samples:
    value: Samples
    if xp is np:
        value = xp.sinc(np.asarray(x) / np.pi)
    else:
        value = xp.select(abs(x) > 1e-4, xp.sin(x) / xp.select(abs(x) > 1e-4, x, 1.0), 1.0 - x * x / 6.0)
    return value


@dataclass(frozen=True, eq=False)
class Pointing:
    """Boresight and aperture axes for every pulse, scene frame.

    Parameters
    ----------
    boresight, azimuth_axis, elevation_axis : (n_pulses, 3) float64, orthonormal triads
    """

    boresight: NDArray[np.float64]
    azimuth_axis: NDArray[np.float64]
    elevation_axis: NDArray[np.float64]

    def of_pulses(self, pick: slice | NDArray[np.intp]) -> "Pointing":
        """That of these pulses."""
        return Pointing(self.boresight[pick], self.azimuth_axis[pick], self.elevation_axis[pick])


__all__ = ["SINC_HALF_POWER", "Antenna", "PatternKind", "Pointing"]
