"""Chirp scaling focuser: range migration equalised by a chirp multiplication, without interpolation."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.focuser import FOCUSERS, FocusTask, option
from sarmitsuba.signal.focusing.frequency_domain.chirp_z import ChirpZ, VirtualChirp
from sarmitsuba.signal.focusing.frequency_domain.migration import (
    MAX_PHASE,
    PHASES,
    Migration,
    Treatment,
    directions,
    migration_refusal,
    plan_migration,
)
from sarmitsuba.signal.focusing.frequency_domain.row_costs import RowsFocuser
from sarmitsuba.signal.focusing.frequency_domain.rows import RangeLaw, RowsImaging, WavenumberBand
from sarmitsuba.signal.focusing.frequency_domain.stated import stated_error_db
from sarmitsuba.signal.focusing.frequency_domain.track_geometry import slant_grid
from sarmitsuba.signal.gridding import unit_phasor
from sarmitsuba.signal.image import ImageGrid

# largest chirp scaling factor; rows that need more contain no echo of an image within the bound
_LARGEST = 0.5


def _largest(law: Migration, sines: F64) -> float:
    """Largest chirp scaling factor, in magnitude, over a range of k_x / k_c."""
    sine = np.linspace(sines[0], sines[1], 257)
    return float(min(np.abs(law.scaling_factor(law.center_wavenumber * sine)).max(), _LARGEST))


class _ChirpLines(RangeLaw):
    """Evaluation of range lines by chirps and FFTs."""

    def __init__(self, band: WavenumberBand, law: Migration) -> None:
        self.band, self.law = band, law
        self.chirp = VirtualChirp.of(
            _largest(law, band.sines), 2.0 * np.pi / band.step, band.step, band.count
        )
        turn = band.step * law.reference_slope * band.pixel_spacing
        self.points = ChirpZ(
            self.chirp.n_fft, band.rho.size, -(self.chirp.n_fft // 2), -(band.rho.size // 2), turn
        )
        self.at = law.reference_slope * band.away

    def bulk(self, kx: F64, ky: F64, offset: F64) -> F64:
        """Bulk range migration correction and secondary range compression, of the reference range."""
        return self.law.bulk(kx, ky, offset)

    def lines(self, spectrum: C64, kx: F64, ky: F64) -> C64:
        """Chirp scaling and azimuth compression."""
        out = self.chirp(spectrum, self.band.first, self.band.step, self._factor(kx), self.points, self.at)
        out *= unit_phasor(self.law.azimuth(kx, self.band.rho))
        return out

    def adjoint_lines(self, pixels: C64, kx: F64, ky: F64) -> C64:
        """Adjoint of azimuth compression and of chirp scaling."""
        band = self.band
        values = pixels * unit_phasor(-self.law.azimuth(kx, band.rho))
        samples = slice(band.first, band.first + band.count)
        return self.chirp.adjoint(values, samples, band.step, self._factor(kx), self.points, self.at)

    def _factor(self, kx: F64) -> F64:
        """Chirp scaling factor (rows,)."""
        return np.clip(self.law.scaling_factor(kx[:, 0]), -_LARGEST, _LARGEST)


@dataclass(frozen=True)
class ChirpScaling(RowsFocuser):
    r"""Chirp scaling algorithm: FFTs and phase multiplications only.

    In the range-Doppler domain an echo of range :math:`\rho` stands at :math:`\rho / D(f_\eta)`. Multiplying its chirp
    of rate :math:`\kappa` by another, of rate :math:`\kappa C`, moves it so that all ranges migrate as the reference
    range does, by the chirp scaling factor

    .. math:: C(f_\eta) = D(f_{ref}) / D(f_\eta) - 1

    (Cumming & Wong 2005, chapter 7; Raney et al. 1994). Then bulk migration correction and secondary range compression
    by a phase in the two-dimensional spectrum, azimuth compression and the residual phase
    :math:`-\kappa C (1 + C) u^2 / 2` in the range-Doppler domain. The data are range compressed: they are multiplied by
    a virtual chirp, as long as the factor needs (``VirtualChirp``), and the bulk phase, which does not depend on range,
    is taken first; the scaled chirp is compressed by its own rate :math:`\kappa (1 + C)`. The pixels' spacing comes
    from a chirp-z transform.

    Validity: as range-Doppler's, :math:`\phi \approx \pi B^2 \Delta\rho \tan^2\theta / (2 c f_c \cos\theta)`. Without
    scaling the migration of the reference range is corrected for all, which leaves
    :math:`(2 \pi B / c) \Delta\rho (1 / D - 1 / D_{ref})`. A phase past ``bound`` is refused.

    Notes
    -----
    Ignores what :class:`sarmitsuba.signal.focusing.frequency_domain.rows.RowsImaging` ignores, and the change of
    secondary range compression with range.
    """

    name: ClassVar[str] = "chirp_scaling"
    title: ClassVar[str] = (
        "straight, level, uniform track and a grid along it; small squint or a narrow swath; no interpolation"
    )
    sample_seconds: ClassVar[float] = 0.95e-7
    scaling: bool = option(True, "equalise the range migration by chirp scaling")
    bound: float = option(MAX_PHASE, "largest residual phase, rad, before it refuses", within=PHASES)

    @property
    def _treatment(self) -> Treatment:
        return Treatment(correction="pixel" if self.scaling else "reference")

    def refusal(self, radar: Radar, grid: ImageGrid) -> str:
        """Reason why it cannot focus this radar's data on this grid; empty when it can."""
        refusal = migration_refusal(radar, grid, self._treatment, self.bound)
        if refusal:
            return refusal
        factor = self.largest_factor(radar, grid)
        return (
            f"the chirp scaling factor reaches {factor:.3g} (bound {_LARGEST})" if factor > _LARGEST else ""
        )

    def largest_factor(self, radar: Radar, grid: ImageGrid) -> float:
        """Largest chirp scaling factor, in magnitude, of the Doppler frequencies that an image is made from."""
        slant = slant_grid(radar, grid)
        law = plan_migration(radar, slant, self._treatment)
        sine, _, seen = directions(radar, slant)
        return float(np.abs(law.scaling_factor(law.center_wavenumber * sine[seen])).max(initial=0.0))

    def error_db(self, radar: Radar, grid: ImageGrid) -> float:
        """See :func:`sarmitsuba.signal.focusing.frequency_domain.stated.stated_error_db`."""
        return stated_error_db(radar, grid, plan_migration(radar, grid, self._treatment))

    def imaging(self, task: FocusTask) -> RowsImaging:
        """Linear map from data to pixels."""
        radar = task.raw.radar
        law = plan_migration(radar, task.grid, self._treatment)

        def room(sines: F64, extent: float) -> float:
            return 1.2 * VirtualChirp.length(_largest(law, sines), 1.5 * extent, radar.waveform.range_cell)

        return RowsImaging("chirp scaling", task, lambda band: _ChirpLines(band, law), room)


FOCUSERS.register(ChirpScaling())
