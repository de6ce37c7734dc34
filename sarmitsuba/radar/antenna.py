"""Antenna pattern: one-way power gain over direction, the same for transmit and receive."""

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import cast

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, Samples
from sarmitsuba.radar.pattern import PATTERNS, SINC_HALF_POWER, PatternTable

# offset of the first null of a uniform aperture over its half-power half angle, in sines
_NULL_OVER_HALF_POWER = 1.0 / SINC_HALF_POWER


@dataclass(frozen=True)
class Antenna:
    """Pattern about a boresight, separable in azimuth and elevation.

    Parameters
    ----------
    pattern : name of its shape, one of `sarmitsuba.radar.pattern.PATTERNS`
    gain : peak one-way power gain, linear
    azimuth_beamwidth, elevation_beamwidth : one-way half-power widths, rad (ignored when isotropic; those of the table)
    table : of a measured pattern, else None

    Notes
    -----
    Ignores cross-polar radiation, element factors and back lobes: the pattern is zero behind the aperture.
    """

    pattern: str = "isotropic"
    gain: float = 1.0
    azimuth_beamwidth: float = np.pi
    elevation_beamwidth: float = np.pi
    table: PatternTable | None = None

    def two_way_amplitude(self, sin_azimuth: Samples, sin_elevation: Samples, xp: ModuleType = np) -> Samples:
        """Relative two-way amplitude (= one-way relative power gain), 1 at the peak, without ``gain``.

        ``sin_azimuth`` and ``sin_elevation`` are the components of the unit direction along the aperture's
        azimuth and elevation axes. ``xp`` is ``numpy`` or ``drjit``.
        """
        numbers = cast(
            "Sequence[Samples | float]", self.numbers
        )  # a table's numbers are NumPy's, as the sines are
        return self.normalise(sin_azimuth, sin_elevation, numbers, xp)

    @property
    def directive(self) -> bool:
        """Whether there is a beam."""
        return self.pattern != "isotropic"

    @property
    def per_width(self) -> tuple[float, float]:
        """Inverse sines of the half-power half-angles in azimuth and elevation."""
        azimuth, elevation = np.sin(0.5 * self.azimuth_beamwidth), np.sin(0.5 * self.elevation_beamwidth)
        return 1.0 / float(azimuth), 1.0 / float(elevation)

    @property
    def numbers(self) -> tuple[float | F64, ...]:
        """Numbers that define the pattern: :attr:`per_width`, or the table's."""
        return self.per_width if self.table is None else self.table.numbers

    def normalise(
        self,
        sin_azimuth: Samples,
        sin_elevation: Samples,
        numbers: Sequence[Samples | float],
        xp: ModuleType = np,
    ) -> Samples:
        """As :meth:`two_way_amplitude`, with :attr:`numbers` given: opaque in a kernel, which then serves any beam."""
        return PATTERNS[self.pattern].gain(sin_azimuth, sin_elevation, numbers, xp)

    @property
    def nulls(self) -> tuple[float, float]:
        """Sines to the first nulls in azimuth and elevation.

        Notes
        -----
        Those of a uniform aperture of that half-power width where the pattern has none: the Gaussian's two-way gain is
        -31 dB there.
        """
        factor = None if self.table else PATTERNS[self.pattern].find_null()
        found: tuple[float | None, ...] = (None, None)
        if self.table is not None:
            found = tuple(cut.null for cut in self.table.cuts)
        widths = (self.azimuth_beamwidth, self.elevation_beamwidth)
        azimuth, elevation = (
            sine_to_null(width, factor) if null is None else null
            for null, width in zip(found, widths, strict=True)
        )
        return azimuth, elevation

    @property
    def azimuth_bends(self) -> tuple[float, float]:
        """Largest first and second derivative of the two-way amplitude over the sine in azimuth in half-widths."""
        if self.table is None:
            return PATTERNS[self.pattern].find_bends()
        slope, bend = PATTERNS["gaussian"].find_bends()
        measured = self.table.cuts[0].bends(float(np.sin(0.5 * self.azimuth_beamwidth)))
        return max(slope, measured[0]), max(bend, measured[1])


def sine_to_null(beamwidth: float, factor: float | None = None) -> float:
    """Sine of the angle to the first null of a beam of that half-power width (rad).

    ``factor`` : over the sine of the half-power half-angle; None: of a uniform aperture.
    """
    return float(min(1.0, np.sin(0.5 * beamwidth) * (factor or _NULL_OVER_HALF_POWER)))


@dataclass(frozen=True, eq=False)
class Pointing:
    """Boresight and aperture axes for every pulse, scene frame.

    Parameters
    ----------
    boresight, azimuth_axis, elevation_axis : (n_pulses, 3) float64, orthonormal triads
    """

    boresight: F64
    azimuth_axis: F64
    elevation_axis: F64

    def of_pulses(self, pick: NDArray[np.intp]) -> "Pointing":
        """Pointing of selected pulses."""
        return Pointing(self.boresight[pick], self.azimuth_axis[pick], self.elevation_axis[pick])


__all__ = ["SINC_HALF_POWER", "Antenna", "Pointing", "sine_to_null"]
