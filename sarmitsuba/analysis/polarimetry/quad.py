"""Scattering matrices of an image's pixels."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import C64
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.units import db_from_power
from sarmitsuba.signal.image.sar_image import SarImage

# relative power of float32 rounding
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class QuadPol:
    """Scattering matrices on a grid, in backscatter alignment; one array per channel, transmit letter first.

    Parameters
    ----------
    hh, hv, vh, vv : (n_azimuth, n_range) complex, in one unit (the program's images have m, the square root of RCS)

    Raises
    ------
    DataError
        The arrays have not one shape of two axes.
    """

    hh: C64
    hv: C64
    vh: C64
    vv: C64

    def __post_init__(self) -> None:
        shapes = {channel.shape for channel in (self.hh, self.hv, self.vh, self.vv)}
        if len(shapes) != 1 or len(self.hh.shape) != 2:
            raise DataError(
                f"polarimetry: channels of shapes {', '.join(map(str, sorted(shapes)))}; four arrays of one shape "
                "(n_azimuth, n_range) are needed"
            )

    @property
    def cross(self) -> C64:
        """Symmetrised cross-polar channel, ``(HV + VH) / 2``; by reciprocity both are equal except for noise."""
        return np.asarray(0.5 * (self.hv + self.vh))

    @property
    def asymmetry_db(self) -> float:
        r"""Energy of ``HV - VH`` over that of both, ``sum |HV - VH|^2 / sum (|HV|^2 + |VH|^2)``, dB.

        0 dB for independent noise; -inf if both are equal; NaN if both are within the rounding of the co-polar
        channels (120 dB below them).
        """
        co_polar = np.sum(
            np.abs(self.hh.astype(np.complex128)) ** 2 + np.abs(self.vv.astype(np.complex128)) ** 2
        )
        difference = np.sum(np.abs(self.hv.astype(np.complex128) - self.vh) ** 2)
        total = np.sum(
            np.abs(self.hv.astype(np.complex128)) ** 2 + np.abs(self.vh.astype(np.complex128)) ** 2
        )
        return float(db_from_power(difference / total)) if total > _ROUNDING * co_polar else float("nan")


def quad_pol(image: SarImage) -> QuadPol:
    """Scattering matrices of an image with HH, VV, and HV or VH; a missing cross-polar channel equals the other one.

    Raises
    ------
    DataError
        A channel is missing.
    """
    there = image.channels
    cross = [name for name in ("HV", "VH") if name in there]
    if not {"HH", "VV"} <= set(there) or not cross:
        raise DataError(
            f"polarimetry: the image has the channels {', '.join(there)}; HH, VV and HV (VH) are needed: set "
            'polarisation to "HH,HV,VH,VV"'
        )
    return QuadPol(image.total("HH"), image.total(cross[0]), image.total(cross[-1]), image.total("VV"))
