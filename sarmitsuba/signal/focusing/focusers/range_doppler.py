"""Range-Doppler focuser: range migration corrected by interpolation in the range-Doppler domain."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import scipy.fft

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.focuser import FOCUSERS, FocusTask, option
from sarmitsuba.signal.focusing.frequency_domain.chirp_z import interpolate, kernel_transform, spread
from sarmitsuba.signal.focusing.frequency_domain.migration import (
    MAX_PHASE,
    PHASES,
    Migration,
    Treatment,
    migration_refusal,
    plan_migration,
)
from sarmitsuba.signal.focusing.frequency_domain.row_costs import RowsFocuser
from sarmitsuba.signal.focusing.frequency_domain.rows import RangeLaw, RowsImaging, WavenumberBand
from sarmitsuba.signal.focusing.frequency_domain.stated import stated_error_db
from sarmitsuba.signal.gridding import unit_phasor
from sarmitsuba.signal.image import ImageGrid

_COMPRESSION: dict[str, Treatment] = {
    "doppler": Treatment(),
    "centroid": Treatment(compression="centroid"),
    "off": Treatment(compression="off"),
}


class _InterpolatedLines(RangeLaw):
    """Evaluation of range lines by a twofold oversampled inverse FFT, interpolated at every pixel's migrated range."""

    def __init__(self, band: WavenumberBand, law: Migration) -> None:
        self.band, self.law = band, law
        self.n = int(scipy.fft.next_fast_len(2 * band.count + 8))
        self.index = (band.first + np.arange(band.count)) % self.n
        cycles = (band.first + np.arange(band.count)) / self.n
        self.gain = (self.n / kernel_transform(cycles)).astype(np.float32)

    def bulk(self, kx: F64, ky: F64, offset: F64) -> F64:
        """Secondary range compression, and the migration of the reference range."""
        return self.law.bulk(kx, ky, offset)

    def lines(self, spectrum: C64, kx: F64, ky: F64) -> C64:
        """Range migration correction and azimuth compression."""
        wide = np.zeros((spectrum.shape[0], self.n), dtype=np.complex64)
        wide[:, self.index] = spectrum * self.gain
        line = scipy.fft.ifft(wide, axis=1, overwrite_x=True)
        cell = 2.0 * np.pi / (self.n * self.band.step)
        out = interpolate(line, self.law.slope(kx) * (self.band.away / cell))
        out *= unit_phasor(self.law.azimuth(kx, self.band.rho))
        return out

    def adjoint_lines(self, pixels: C64, kx: F64, ky: F64) -> C64:
        """Adjoint of azimuth compression and of range migration correction."""
        cell = 2.0 * np.pi / (self.n * self.band.step)
        values = pixels * unit_phasor(-self.law.azimuth(kx, self.band.rho))
        line = spread(values, self.law.slope(kx) * (self.band.away / cell), self.n)
        wide = scipy.fft.fft(line, axis=1, norm="forward")
        return np.asarray(wide[:, self.index] * self.gain)


@dataclass(frozen=True)
class RangeDoppler(RowsFocuser):
    r"""Range-Doppler algorithm with range migration correction and secondary range compression, each switchable.

    Range FFT, azimuth FFT, secondary range compression in the two-dimensional spectrum, back to range; then, for every
    Doppler frequency, the echo of range :math:`\rho` is taken from :math:`\rho / D(f_\eta)`, and azimuth is compressed
    by :math:`e^{j 4 \pi f_c \rho D / c}`, with :math:`D = \sqrt{1 - (c f_\eta / 2 V f_c)^2} = \cos\theta` (Cumming &
    Wong 2005, chapter 6). The interpolation is the gridding kernel of six taps on lines oversampled twice: -103 dB rms.

    Validity: secondary range compression is exact at the reference range, the image's middle. At :math:`\Delta\rho`
    from it, the phase left at the band's edges is

    .. math:: \phi = \Delta\rho \, (k_y - k_{y0} - \kappa / D)
              \approx -\frac{\pi B^2 \Delta\rho \tan^2\theta}{2 c f_c \cos\theta},

    :math:`\theta` the angle off broadside (squint and half the beam). With ``src=off`` it is the same of all of
    :math:`\rho`; with ``src=centroid`` (azimuth-independent) :math:`\rho` times the difference to that of the Doppler
    centroid; with ``rcmc=off`` it gains :math:`(2 \pi B / c) \rho (1 / D - 1 / D_c)`. A phase past ``bound`` is
    refused.

    Notes
    -----
    Ignores what :class:`sarmitsuba.signal.focusing.frequency_domain.rows.RowsImaging` ignores, and the change of
    secondary range compression with range.
    """

    name: ClassVar[str] = "range_doppler"
    title: ClassVar[str] = (
        "straight, level, uniform track and a grid along it; small squint or a narrow swath"
    )
    sample_seconds: ClassVar[float] = 1.15e-7
    rcmc: bool = option(True, "range cell migration correction, by interpolation")
    src: str = option(
        "doppler",
        "secondary range compression: doppler, centroid (azimuth-independent) or off",
        choices=tuple(_COMPRESSION),
    )
    bound: float = option(MAX_PHASE, "largest residual phase, rad, before it refuses", within=PHASES)

    @property
    def _treatment(self) -> Treatment:
        treatment = _COMPRESSION[self.src]
        return treatment if self.rcmc else replace(treatment, correction="off")

    def refusal(self, radar: Radar, grid: ImageGrid) -> str:
        """Reason why it cannot focus this radar's data on this grid; empty when it can."""
        return migration_refusal(radar, grid, self._treatment, self.bound)

    def error_db(self, radar: Radar, grid: ImageGrid) -> float:
        """See :func:`sarmitsuba.signal.focusing.frequency_domain.stated.stated_error_db`."""
        return stated_error_db(radar, grid, plan_migration(radar, grid, self._treatment))

    def imaging(self, task: FocusTask) -> RowsImaging:
        """Linear map from data to pixels."""
        law = plan_migration(task.raw.radar, task.grid, self._treatment)
        return RowsImaging("range-Doppler", task, lambda band: _InterpolatedLines(band, law))


FOCUSERS.register(RangeDoppler())
