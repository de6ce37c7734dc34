"""Antenna pattern: one-way power gain over direction, the same for transmit and receive."""

from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from sarmitsuba.backend import mi

# the same formula outside and inside a kernel
Samples = TypeVar("Samples", NDArray[np.float64], "mi.Float")

PatternKind = Literal["isotropic", "gaussian", "rectangular"]

# -3 dB half angle of sinc^2: sinc(pi u) = 1/sqrt(2) at u = 0.442946
_SINC_HALF_POWER = 0.442946470689452


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
        if self.pattern == "isotropic":
            return 0.0 * sin_azimuth + 1.0
        # plain floats: a NumPy scalar times a Dr.Jit array would leave the kernel
        sa = float(np.sin(0.5 * self.azimuth_beamwidth))
        se = float(np.sin(0.5 * self.elevation_beamwidth))
        if self.pattern == "gaussian":
            ln2 = float(np.log(2.0))
            gain: Samples = xp.exp(-ln2 * ((sin_azimuth / sa) ** 2 + (sin_elevation / se) ** 2))
            return gain
        # uniform aperture: voltage sinc(pi u) one way, so sinc^2 is the two-way amplitude
        scale = np.pi * _SINC_HALF_POWER
        product: Samples = (
            _sinc(scale / sa * sin_azimuth, xp) ** 2 * _sinc(scale / se * sin_elevation, xp) ** 2
        )
        return product


def _sinc(x: Samples, xp: ModuleType) -> Samples:
    if xp is np:
        return np.sinc(np.asarray(x) / np.pi)
    value: Samples = xp.select(abs(x) > 1e-4, xp.sin(x) / xp.select(abs(x) > 1e-4, x, 1.0), 1.0 - x * x / 6.0)
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


__all__ = ["Antenna", "PatternKind", "Pointing"]
