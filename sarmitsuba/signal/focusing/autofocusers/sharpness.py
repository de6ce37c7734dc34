"""Autofocus by image sharpness: minimum entropy, or maximum contrast."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.signal.focusing.autofocus import (
    AUTOFOCUSERS,
    Autofocuser,
    AutofocusTask,
    pulse_contributions,
    remove_trend,
)
from sarmitsuba.signal.focusing.autofocusers.phase_gradient import PhaseGradient
from sarmitsuba.signal.focusing.focuser import option

# (pixel, pulse) pairs that are kept: 16 MB
_PAIRS = 1 << 21
# least number of azimuth lines used together
_COLUMNS = 6
# highest polynomial orders of the successive searches, and their steps
_LEVELS = (3, 6, 12, 24, 48)
_STEPS = 40


@dataclass(frozen=True)
class _Sharpness(Autofocuser):
    r"""Range error as the sum of Legendre polynomials over the pulses that gives the sharpest image.

    The orders begin with the second. Pixels are sums of every pulse's contribution,
    :math:`I_p = |\sum_t b_{pt} e^{j \phi_t}|^2` (:func:`sarmitsuba.signal.focusing.autofocus.pulse_contributions`),
    along whole azimuth lines at the brightest range columns. The measure's gradient is exact; the search is
    quasi-Newton (L-BFGS), from low orders to high ones. Sharpness has many local optima once the error passes about a
    radian, so that the search starts from a few rounds of
    :class:`sarmitsuba.signal.focusing.autofocusers.phase_gradient.PhaseGradient`; ``start=0`` starts from the recorded
    track.

    Notes
    -----
    Ignores that the error along the line of sight varies over the scene, and errors of higher order than asked for.
    """

    orders: int = option(16, "highest order of the polynomials over the pulses", within=(2, 1000))
    pixels: int = option(20_000, "largest number of pixels used", within=(1, 10**9))
    start: int = option(
        8, "rounds of phase_gradient before the search; 0: start from the recorded track", within=(0, 1000)
    )

    @abstractmethod
    def measure(self, intensity: F64) -> tuple[float, F64]:
        """Minimised measure, and its derivative with respect to every pixel's intensity (n,)."""

    def estimate(self, task: AutofocusTask) -> F64:
        """See the class."""
        radar = task.raw.radar
        n, wavenumber = radar.track.n_pulses, 4.0 * np.pi / radar.waveform.wavelength
        error = PhaseGradient(rounds=self.start).estimate(task) if self.start else np.zeros(n)
        places = self._lines(task, task.image(error))
        data = task.corrected(error).data[0]
        rows = pulse_contributions(data, radar, places, task.range_window, task.azimuth_window)
        axis = np.linspace(-1.0, 1.0, n)
        basis = np.polynomial.legendre.legvander(axis, self.orders)[:, 2:]
        found = np.zeros(0)
        levels = [order for order in _LEVELS if order < self.orders] + [self.orders]
        for done, order in enumerate(levels):
            start = np.pad(found, (0, order - 1 - found.size))
            columns = basis[:, : order - 1]
            result = scipy.optimize.minimize(
                lambda c, columns=columns: self._value(rows, columns, c),
                start,
                jac=True,
                method="L-BFGS-B",
                options={"maxiter": _STEPS},
            )
            found = result.x
            task.progress("autofocus", done + 1.0, float(len(levels)), {})
        seen = np.asarray(np.sum(np.abs(rows) ** 2, axis=0, dtype=np.float64))
        return remove_trend(radar, error + basis[:, : found.size] @ found / wavenumber, seen)

    def _lines(self, task: AutofocusTask, image: C64) -> F64:
        """Positions (n, 3) of the pixels in the brightest columns."""
        n_rows, n_columns = image.shape
        most = min(self.pixels, _PAIRS // task.raw.radar.track.n_pulses)
        columns = int(np.clip(most // n_rows, min(_COLUMNS, n_columns), n_columns))
        step = max(1, int(np.ceil(n_rows * columns / most)))
        best = np.argsort(np.sum(np.abs(image) ** 4, axis=0))[::-1][:columns]
        rows = np.arange(0, n_rows, step)
        return np.concatenate([task.grid.positions_on_line(int(row))[best] for row in rows])

    def _value(self, rows: C64, columns: F64, coefficients: F64) -> tuple[float, F64]:
        turn = np.exp(1j * (columns @ coefficients)).astype(np.complex64)
        pixel = rows @ turn
        value, slope = self.measure(np.abs(pixel.astype(np.complex128)) ** 2)
        back = (slope * np.conj(pixel)).astype(np.complex64) @ rows
        gradient = -2.0 * np.imag(back * turn).astype(np.float64) @ columns
        return value, gradient


@dataclass(frozen=True)
class MinimumEntropy(_Sharpness):
    r"""Least entropy :math:`-\sum_p q_p \ln q_p`, :math:`q_p = I_p / \sum I`.

    Notes
    -----
    Source: T. J. Kragh, A. A. Kharbouch, Proc. Adaptive Sensor Array Processing Workshop (2006); L. Xi, L. Guosui,
    J. Ni, IEEE Trans. Aerosp. Electron. Syst. 35 (1999), 1240.
    """

    name: ClassVar[str] = "minimum_entropy"
    title: ClassVar[str] = "smooth errors; also scenes without points that stand out"

    def measure(self, intensity: F64) -> tuple[float, F64]:
        """See the base class."""
        total = float(intensity.sum())
        log = np.log(intensity + 1e-30 * total)
        mean = float(intensity @ log) / total
        return float(np.log(total)) - mean, (mean - log) / total


@dataclass(frozen=True)
class MaximumContrast(_Sharpness):
    r"""Most contrast: the largest :math:`n \sum I_p^2 / (\sum I_p)^2`, whose logarithm is searched.

    Notes
    -----
    Source: R. A. Muller, A. Buffington, J. Opt. Soc. Am. 64 (1974), 1200, first sharpness; F. Berizzi, G. Corsini, IEEE
    Trans. Aerosp. Electron. Syst. 32 (1996), 1185.
    """

    name: ClassVar[str] = "maximum_contrast"
    title: ClassVar[str] = "smooth errors; dominated by the brightest points"

    def measure(self, intensity: F64) -> tuple[float, F64]:
        """See the base class."""
        total, square = float(intensity.sum()), float(intensity @ intensity)
        return float(2.0 * np.log(total) - np.log(square)), 2.0 / total - 2.0 * intensity / square


AUTOFOCUSERS.register(MinimumEntropy())
AUTOFOCUSERS.register(MaximumContrast())
