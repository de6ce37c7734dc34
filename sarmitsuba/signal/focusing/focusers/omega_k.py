"""Wavenumber-domain focusing (omega-K) of a straight, uniformly sampled track, by non-uniform FFT."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.fft

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.focuser import FOCUSERS, FocusTask, option
from sarmitsuba.signal.focusing.frequency_domain.chirp_z import (
    WIDTH,
    ChirpZ,
    interpolate,
    kernel_transform,
    spread,
)
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
from sarmitsuba.signal.focusing.frequency_domain.track_geometry import track_refusal
from sarmitsuba.signal.focusing.windows import Window, parse_window
from sarmitsuba.signal.gridding import unit_phasor
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.raw_data import RawData


class _Stolt(RangeLaw):
    """Exact sum over k: a type-1 non-uniform FFT from the curved k_y samples to the range pixels."""

    def __init__(self, band: WavenumberBand) -> None:
        self.band = band
        self.n = int(scipy.fft.next_fast_len(2 * band.rho.size + 2 * WIDTH))
        self.cells = self.n * band.pixel_spacing / (2.0 * np.pi)  # grid cells per rad/m of k_y
        self.center = band.center_wavenumber * band.geometry.cosine
        self.pixels = np.arange(band.rho.size) - band.rho.size // 2
        self.carrier = unit_phasor(self.center * band.away)
        self.carrier *= (self.n / kernel_transform(self.pixels / self.n)).astype(np.float32)

    def bulk(self, kx: F64, ky: F64, offset: F64) -> F64:
        """Focus the reference range."""
        return self.band.geometry.rho_center * ky

    def lines(self, spectrum: C64, kx: F64, ky: F64) -> C64:
        """Stolt mapping."""
        gridded = spread(spectrum, (ky - self.center) * self.cells, self.n)
        line = scipy.fft.ifft(gridded, axis=1)
        return np.asarray(line[:, self.pixels % self.n] * self.carrier)

    def adjoint_lines(self, pixels: C64, kx: F64, ky: F64) -> C64:
        """Adjoint of Stolt's mapping."""
        line = np.zeros((pixels.shape[0], self.n), dtype=np.complex64)
        line[:, self.pixels % self.n] = pixels * self.carrier.conj()
        gridded = scipy.fft.fft(line, axis=1, overwrite_x=True, norm="forward")
        return interpolate(gridded, (ky - self.center) * self.cells)


class _WithoutStolt(RangeLaw):
    """Bulk compression by the reference function; pixels by a chirp-z transform, residual phases by multiplication."""

    def __init__(self, band: WavenumberBand, law: Migration) -> None:
        self.band, self.law = band, law
        turn = band.step * law.reference_slope * band.pixel_spacing
        self.points = ChirpZ(band.count, band.rho.size, band.first, -(band.rho.size // 2), turn)

    def bulk(self, kx: F64, ky: F64, offset: F64) -> F64:
        """Focus the reference range."""
        return self.law.bulk(kx, ky, offset)

    def lines(self, spectrum: C64, kx: F64, ky: F64) -> C64:
        """Pixels with the azimuth phase of the migration law."""
        out = self.points(spectrum)
        out *= unit_phasor(self.law.azimuth(kx, self.band.rho))
        return out

    def adjoint_lines(self, pixels: C64, kx: F64, ky: F64) -> C64:
        """Adjoint of the phase and of the chirp-z transform."""
        return self.points.adjoint(pixels * unit_phasor(-self.law.azimuth(kx, self.band.rho)))


def omega_k(
    raw: RawData,
    grid: ImageGrid,
    *,
    range_window: str | Window = "rectangular",
    azimuth_window: str | Window = "rectangular",
    progress: Progress = silent,
) -> C64:
    """Focus range-compressed data of a straight track onto its slant grid, or onto a ground grid along the track.

    Parameters
    ----------
    raw : range-compressed data of a straight, level, uniformly sampled track
    grid : slant grid of that track, or a ground grid along it, which is interpolated from the slant grid of its ranges
    range_window, azimuth_window : as in ``backproject``; azimuth weights are over the pulse index
    progress : called after every layer

    Returns
    -------
    (n_layers, n_azimuth, n_range) complex64, m (square root of RCS)

    Raises
    ------
    DataError
        Curved, climbing or non-uniform track, or a grid that does not lie along it.

    Notes
    -----
    The formula is in :mod:`sarmitsuba.signal.focusing.frequency_domain.rows`; its limits, at ``RowsImaging``
    there.
    """
    task = FocusTask(raw, grid, parse_window(range_window), parse_window(azimuth_window), progress)
    return OmegaK().focus(task).pixels


_WITHOUT: dict[str, Treatment] = {
    "phase": Treatment(correction="reference"),
    "off": Treatment(correction="reference", azimuth="reference"),
}


@dataclass(frozen=True)
class OmegaK(RowsFocuser):
    r"""Wavenumber-domain focusing: fast, for straight tracks and grids along them.

    The reference function multiplication focuses the reference range, the image's middle:
    :math:`S e^{j \rho_{ref} k_y}`. Stolt's mapping :math:`k \to k_y = \sqrt{k^2 - k_x^2}` then focuses all others
    (Cumming & Wong 2005, chapter 8). Here it is a non-uniform FFT: the kernel of six taps on a twofold oversampled
    grid, -103 dB rms.

    ``stolt=phase`` is the approximate algorithm (Cumming, Neo & Wong 2003): the mapping is replaced by the phase
    :math:`(\rho - \rho_{ref}) k_{y0}` in the range-Doppler domain, residual azimuth compression. With ``stolt=off``
    there is the reference function alone, which focuses at the reference range only.

    Validity: the accurate form is exact except for the stationary phase of the track's transform, for any squint with
    :math:`k_x < k`, any bandwidth and swath. Without the mapping, at :math:`\Delta\rho` from the reference range,

    .. math:: \phi_{phase} \approx \frac{2 \pi B}{c} \Delta\rho
              \left(\frac{1}{\cos\theta} - \frac{1}{\cos\psi}\right), \quad
              \phi_{off} \approx \phi_{phase} + k_c \Delta\rho
              \left(\cos\theta - \cos\psi + \tan\psi (\sin\theta - \sin\psi)\right)

    with squint :math:`\psi` and angle off broadside :math:`\theta`. A phase past ``bound`` is refused.

    Notes
    -----
    Has the limits of :class:`sarmitsuba.signal.focusing.frequency_domain.rows.RowsImaging`.
    """

    name: ClassVar[str] = "omega_k"
    title: ClassVar[str] = "straight, level, uniform track and a grid along it; fast for large images"
    sample_seconds: ClassVar[float] = 1.0e-7
    stolt: str = option(
        "on",
        "Stolt's mapping: on, phase (residual azimuth compression instead) or off",
        choices=("on", *_WITHOUT),
    )
    bound: float = option(
        MAX_PHASE, "largest residual phase, rad, before phase and off refuse", within=PHASES
    )

    @property
    def _treatment(self) -> Treatment | None:
        return _WITHOUT.get(self.stolt)

    def refusal(self, radar: Radar, grid: ImageGrid) -> str:
        """Reason why it cannot focus this radar's data on this grid; empty when it can."""
        treatment = self._treatment
        if treatment is None:
            return track_refusal(radar, grid)
        refusal = migration_refusal(radar, grid, treatment, self.bound)
        return (
            f"{refusal}; stolt=on has no such limit"
            if refusal and not track_refusal(radar, grid)
            else refusal
        )

    def error_db(self, radar: Radar, grid: ImageGrid) -> float:
        """See :func:`sarmitsuba.signal.focusing.frequency_domain.stated.stated_error_db`."""
        treatment = self._treatment
        law = None if treatment is None else plan_migration(radar, grid, treatment)
        return stated_error_db(radar, grid, law)

    def imaging(self, task: FocusTask) -> RowsImaging:
        """Linear map from data to pixels."""
        treatment = self._treatment
        if treatment is None:
            return RowsImaging("omega-K", task, _Stolt)
        law = plan_migration(task.raw.radar, task.grid, treatment)
        return RowsImaging("omega-K", task, lambda band: _WithoutStolt(band, law))


FOCUSERS.register(OmegaK())
