"""Autofocus records: a provider's corrections of range and phase, pulse by pulse, delivered with the data."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError


@dataclass(frozen=True, eq=False)
class AutofocusRecords:
    r"""Corrections of range and phase that a data provider's autofocus found.

    Corrected samples over frequency are

    .. math:: F'_{kn} = F_{kn} e^{j \phi_n} e^{-j 4 \pi f_{kn} \rho_n / c}

    so that an echo of the range R in the data stands at :math:`R + \rho_n` after the correction.

    Parameters
    ----------
    range_correction : (n_pulses,) float64, m; :math:`\rho_n`
    phase_correction : (n_pulses,) float64, rad; :math:`\phi_n`, of all samples of the pulse

    Raises
    ------
    DataError
        The two differ in length, or hold NaN or infinite numbers.
    """

    range_correction: F64
    phase_correction: F64

    def __post_init__(self) -> None:
        shapes = self.range_correction.shape, self.phase_correction.shape
        if shapes[0] != shapes[1] or len(shapes[0]) != 1:
            raise DataError(
                f"autofocus records: {shapes[0]} range and {shapes[1]} phase corrections; give one for each pulse"
            )
        if not (np.isfinite(self.range_correction).all() and np.isfinite(self.phase_correction).all()):
            raise DataError("autofocus records: corrections must be finite numbers")

    def of_pulses(self, pick: NDArray[np.intp]) -> "AutofocusRecords":
        """Records of the pulses of these numbers."""
        return AutofocusRecords(self.range_correction[pick], self.phase_correction[pick])

    def range_error(self, wavelength: float) -> F64:
        r"""Range error (n_pulses,), m, with the same phase at the carrier: :math:`\lambda \phi / 4 \pi - \rho`.

        The sign is that of `sarmitsuba.signal.focusing.autofocus.Autofocuser.estimate`: true minus recorded range. As
        the
        phase repeats itself every half wavelength, the range corrections of measured data (AFRL's Gotcha set) jump by
        multiples of it from pulse to pulse. The result does not: it changes by a quarter of a wavelength at most
        from pulse to pulse, and its mean is as close as such multiples allow to that of :math:`-\rho`.
        """
        half = 0.5 * wavelength
        error = np.unwrap(self.phase_correction * half / (2.0 * np.pi) - self.range_correction, period=half)
        return np.asarray(error - half * np.round(np.mean(error + self.range_correction) / half))
