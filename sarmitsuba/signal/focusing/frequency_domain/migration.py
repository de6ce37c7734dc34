"""Range migration correction of the frequency-domain focusers, and its residual phase."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import direction_gain, look_directions
from sarmitsuba.signal.focusing.frequency_domain.track_geometry import (
    slant_grid,
    track_geometry,
    track_refusal,
)
from sarmitsuba.signal.focusing.frequency_domain.turning import hold_beam
from sarmitsuba.signal.image import ImageGrid

# directions with less than this share of the strongest two-way gain are ignored in the residual phase
_WEAK = 0.05
# pulses and frequencies at which the residual phase is sampled
_PULSES, _FREQUENCIES = 65, 9
# default bound on the residual phase, rad: a quadratic phase of this size at the band's ends changes the peak's phase
# by a third of it, 5 degrees
MAX_PHASE = np.pi / 12
PHASES = (0.0, 1e9)
"""Bounds of that bound, rad."""


@dataclass(frozen=True)
class Treatment:
    """Treatment of the parts of the spectrum's phase by an algorithm, see :class:`Migration`.

    Parameters
    ----------
    compression : of the coupling s: ``doppler`` at every Doppler frequency, for the reference range; ``centroid``, the
        one of the Doppler centroid for all (azimuth-independent); ``off``
    correction : of the migration: ``pixel`` for every range, ``reference`` that of the reference range for all, ``off``
    azimuth : azimuth compression for every range (``pixel``) or that of the ``reference`` range for all
    """

    compression: Literal["doppler", "centroid", "off"] = "doppler"
    correction: Literal["pixel", "reference", "off"] = "pixel"
    azimuth: Literal["pixel", "reference"] = "pixel"


@dataclass(frozen=True)
class Migration:
    r"""Migration law: an algorithm's approximation of the spectrum's exact phase.

    A point at closest approach :math:`\rho` has the phase :math:`-\rho k_y`, :math:`k_y = \sqrt{k^2 - k_x^2}`, in the
    two-dimensional spectrum. With :math:`k = k_c + \kappa` and :math:`k_{y0} = k_y(k_c)`,

    .. math:: k_y = k_{y0} + a \kappa + s(\kappa), \quad a = k_c / k_{y0} = 1 / D, \quad
              s \approx -\frac{k_x^2}{2 k_{y0}^3} \kappa^2 :

    azimuth modulation, range migration by the factor 1 / D, and the coupling that secondary range compression undoes
    (Cumming & Wong 2005, section 5.3). Every algorithm multiplies the spectrum by a phase ``bulk``, takes the line over
    u = :math:`slope \cdot (\rho - \rho_{ref})` and multiplies by a phase ``azimuth``; what is left is

    .. math:: \phi = \rho k_y - bulk - \kappa \cdot slope \cdot (\rho - \rho_{ref}) - azimuth.

    Parameters
    ----------
    center_wavenumber : k_c, rad/m
    reference_range : rho_ref, m
    sin_squint : of the image's centre seen from mid-aperture
    treatment : of the phase by the algorithm
    """

    center_wavenumber: float
    reference_range: float
    sin_squint: float
    treatment: Treatment = Treatment()

    @property
    def reference_slope(self) -> float:
        """1 / D of the Doppler centroid."""
        return float(1.0 / np.sqrt(1.0 - self.sin_squint**2))

    def carrier(self, kx: F64) -> F64:
        """k_y at the centre frequency, rad/m."""
        # rows below a thousandth of grazing are empty: the floor keeps them finite
        floor = (1e-3 * self.center_wavenumber) ** 2
        return np.asarray(np.sqrt(np.maximum(self.center_wavenumber**2 - kx**2, floor)))

    def migration(self, kx: F64) -> F64:
        """1 / D at azimuth wavenumbers."""
        return self.center_wavenumber / self.carrier(kx)

    def slope(self, kx: F64) -> F64:
        """Range on the line per closest-approach range."""
        if self.treatment.correction == "pixel":
            return self.migration(kx)
        return np.full(np.shape(kx), self.reference_slope)

    def scaling_factor(self, kx: F64) -> F64:
        """Chirp scaling factor C = D_ref / D - 1 (Cumming & Wong 2005, section 7.2)."""
        return np.asarray(self.slope(kx) / self.reference_slope - 1.0)

    def bulk(self, kx: F64, ky: F64, offset: F64) -> F64:
        """Phase, rad, that multiplies the spectrum.

        Parameters
        ----------
        kx, ky, offset : rad/m, arrays that broadcast together; ``offset`` is kappa
        """
        carrier, slope = self.carrier(kx), self.migration(kx)
        if self.treatment.compression == "doppler":
            out = ky - carrier
            if self.treatment.correction == "off":
                out = out + (self.reference_slope - slope) * offset
            return np.asarray(self.reference_range * out)
        moved = (self.reference_slope if self.treatment.correction == "off" else slope) * offset
        if self.treatment.compression == "centroid":
            kc = self.center_wavenumber
            middle = kc * self.sin_squint
            level = np.sqrt(kc**2 - middle**2)
            moved = moved + (np.sqrt((kc + offset) ** 2 - middle**2) - level - self.reference_slope * offset)
        # without compression and correction it is the same for all rows
        return np.array(np.broadcast_to(self.reference_range * moved, ky.shape))

    def azimuth(self, kx: F64, rho: F64) -> F64:
        """Phase, rad, that multiplies the lines at closest-approach ranges, m."""
        carrier = self.carrier(kx)
        if self.treatment.azimuth == "pixel":
            return np.asarray(rho * carrier)
        # geometry only: the point's own place and carrier
        middle = self.center_wavenumber * self.sin_squint
        tangent = self.sin_squint * self.reference_slope
        straight = self.center_wavenumber / self.reference_slope - (kx - middle) * tangent
        return np.asarray(self.reference_range * carrier + (rho - self.reference_range) * straight)

    def residual(self, kx: F64, offset: F64, rho: F64) -> F64:
        """Residual phase, rad, at points of the spectrum; all arguments broadcast together."""
        ky = np.sqrt((self.center_wavenumber + offset) ** 2 - kx**2)
        moved = offset * self.slope(kx) * (rho - self.reference_range)
        return np.asarray(rho * ky - self.bulk(kx, ky, offset) - moved - self.azimuth(kx, rho))


def plan_migration(radar: Radar, grid: ImageGrid, treatment: Treatment) -> Migration:
    """Migration law of an algorithm for a radar and a slant or ground grid along its track."""
    radar, slant = hold_beam(radar, slant_grid(radar, grid))
    geometry = track_geometry(radar, slant)
    kc = 4.0 * np.pi / radar.waveform.wavelength
    return Migration(kc, geometry.rho_center, geometry.sin_squint, treatment)


def directions(radar: Radar, grid: ImageGrid) -> tuple[F64, F64, NDArray[np.bool_]]:
    """Directions from which the corners, edges and middle of a slant grid are focused.

    Returns
    -------
    (3, 3, n) sines of the angle off broadside, (3,) ranges of closest approach, m, and (3, 3, n) which sines count
    """
    radar, grid = hold_beam(radar, slant_grid(radar, grid))
    rows = grid.azimuth[[0, grid.azimuth.size // 2, -1]]
    columns = grid.range[[0, grid.range.size // 2, -1]]
    points = replace(grid, azimuth=rows, range=columns).positions()
    if np.isfinite(
        radar.half_aperture
    ):  # every pixel has its whole band, independent of its pulses' positions
        middle = float(radar.pointing.boresight[radar.track.center_index] @ grid.along)
        band = np.clip(middle + radar.half_aperture * np.linspace(-1.0, 1.0, _PULSES), -0.999, 0.999)
        sine = np.broadcast_to(band, (*points.shape[:2], band.size))
        return sine, columns, np.ones(sine.shape, dtype=bool)
    pick = slice(None, None, max(1, radar.track.n_pulses // _PULSES))
    look = look_directions(radar, points)[..., pick, :]
    gain = direction_gain(radar, pick, look)
    return look @ grid.along, columns, np.asarray(gain > _WEAK * gain.max(initial=1e-300))


def residual_phase(radar: Radar, grid: ImageGrid, law: Migration) -> float:
    """Largest residual phase, rad, of a law in the spectra of a slant grid's corners and edges."""
    radar, grid = hold_beam(radar, slant_grid(radar, grid))
    sine, rho, seen = directions(radar, grid)
    half = 2.0 * np.pi * radar.waveform.bandwidth / SPEED_OF_LIGHT
    offset = np.linspace(-half, half, _FREQUENCIES)
    kx = sine[..., None] * (law.center_wavenumber + offset)
    phase = np.abs(law.residual(kx, offset, rho[None, :, None, None]))
    return float(phase[seen].max(initial=0.0))


def residual_power(radar: Radar, grid: ImageGrid, law: Migration) -> float:
    """Mean square residual phase, rad^2, of a law in the spectrum of the worst edge or corner."""
    radar, grid = hold_beam(radar, slant_grid(radar, grid))
    sine, rho, seen = directions(radar, grid)
    half = 2.0 * np.pi * radar.waveform.bandwidth / SPEED_OF_LIGHT
    offset = np.linspace(-half, half, _FREQUENCIES)
    kx = sine[..., None] * (law.center_wavenumber + offset)
    square = np.mean(law.residual(kx, offset, rho[None, :, None, None]) ** 2, axis=-1)
    count = np.maximum(seen.sum(axis=-1), 1)
    return float((np.sum(square * seen, axis=-1) / count).max())


def migration_refusal(radar: Radar, grid: ImageGrid, treatment: Treatment, bound: float) -> str:
    """Reason why an algorithm cannot focus a radar's data: track, or residual phase above the bound; empty if none."""
    refusal = track_refusal(radar, grid)
    if refusal:
        return refusal
    slant = slant_grid(radar, grid)
    law = plan_migration(radar, slant, treatment)
    phase = residual_phase(radar, slant, law)
    if phase <= bound:
        return ""
    return (
        f"it leaves a phase of up to {phase:.3g} rad at the image's edge (bound {bound:.3g}): swath "
        f"{np.ptp(slant.range):.4g} m, squint {np.degrees(np.arcsin(law.sin_squint)):.3g} degrees, bandwidth "
        f"{100.0 * radar.waveform.bandwidth / radar.waveform.center_frequency:.3g} % of the carrier"
    )
