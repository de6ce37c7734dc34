"""Stated error and processor time of the frequency-domain focusers, predicted before the run."""

from dataclasses import replace

import numpy as np

from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import weights_difference
from sarmitsuba.signal.focusing.frequency_domain.aperture_filter import aperture_filter
from sarmitsuba.signal.focusing.frequency_domain.equivalent_track import EquivalentTrack
from sarmitsuba.signal.focusing.frequency_domain.migration import Migration, residual_power
from sarmitsuba.signal.focusing.frequency_domain.track_geometry import (
    TrackGeometry,
    own_apertures,
    range_walk,
    rate_factor,
    slant_grid,
    track_geometry,
    track_period,
    wavenumber,
)
from sarmitsuba.signal.focusing.frequency_domain.turning import TurningBeam, hold_beam, range_blocks, turns
from sarmitsuba.signal.focusing.frequency_domain.weights import filter_gain, pulse_weights
from sarmitsuba.signal.focusing.profiles import plan_spectrum
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import ImageGrid

# common error, dB: ripple of the pulses' ends where the pulse rate is raised, stationary phase
_FLOOR_DB = -58.0
# of stationary phase in pixels' own apertures: this power at a time-bandwidth product of 1, falling with its power of
# 2.5; benchmarks/suite/stated_errors.py holds it over random radars
_OWN, _OWN_POWER = 0.32, -2.5
# of the track's ends where they are the aperture's, likewise: ripple of the filter, which the pulse rate cuts off
_TRACK_ENDS = 0.1
# of beams that turn: ends of apertures between pulses, and margin over the filter's change
_TURNED, _CHANGED = 3e-5, 4.0
# least number of pulses for a stated error
_FEWEST_PULSES = 50
# allowed aliased share of the image's Doppler band over that of the pulses
_FOLDED = 1.0
# places in the aperture and, beyond its ends, as many again on either side, at which the tails are compared
_TAIL_NODES = 2048


def stated_error_db(radar: Radar, grid: ImageGrid, law: Migration | None) -> float:
    """Bound of the error against backprojection, dB; NaN for few pulses, and for images aliased or outside the beam.

    At the worst place of the image. Sum of the powers of the law's residual phase (zero for the exact one), of the
    pulse weights' difference to backprojection's, of stationary phase and the ends of apertures away from the reference
    range where pixels have their own apertures, and of a floor.
    """
    slant, turned = slant_grid(radar, grid), 0.0
    if turns(radar):
        block = range_blocks(radar, slant)[0]
        beam = TurningBeam.of(radar, block)
        turned += 0.0 if radar.track.is_straight else EquivalentTrack.of(radar, block).phase ** 2 / 3.0
        rectangular = parse_window("rectangular")
        corners = slant.positions()[:: max(1, slant.shape[0] // 2), :: max(1, slant.shape[1] // 2)]
        turned += (
            _TURNED
            + _CHANGED * beam.change_power()
            + weights_difference(radar, corners, beam.pulse_weights(corners, rectangular))
        )
        radar, slant = hold_beam(radar, slant)
    geometry = track_geometry(radar, slant)
    if radar.track.n_pulses < _FEWEST_PULSES or rate_factor(radar, slant, geometry)[1] > _FOLDED:
        return float("nan")
    window = parse_window("rectangular")
    rows, columns = (np.unique([0, n // 2, n - 1]) for n in slant.shape)
    points = replace(slant, azimuth=slant.azimuth[rows], range=slant.range[columns]).positions()
    power = power_from_db(_FLOOR_DB) + turned
    power += weights_difference(radar, points, pulse_weights(radar, slant, points, window))
    if own_apertures(radar):
        power += _OWN * _product(radar, slant, radar.half_aperture) ** _OWN_POWER
        power += _tail_change(radar, slant, geometry)
    else:
        ahead = geometry.x_center - geometry.x[[0, -1]]
        half = 0.5 * float(np.ptp(ahead / np.hypot(ahead, geometry.rho_center)))
        power += _TRACK_ENDS * _product(radar, slant, half) ** _OWN_POWER
    if law is not None:
        power += residual_power(radar, slant, law)
    return db_from_power(power) if np.isfinite(power) else float("nan")


def _product(radar: Radar, grid: ImageGrid, half: float) -> float:
    """Time-bandwidth product of an aperture of a given half width in sines, at the image's near edge."""
    return 8.0 * half**2 * float(grid.range[0]) / radar.waveform.wavelength


def _tail_change(radar: Radar, grid: ImageGrid, geometry: TrackGeometry) -> float:
    """Relative power of the change of the aperture's end tails from the reference range to the image's edges."""
    middle = aperture_filter(radar, grid, geometry, parse_window("rectangular"), np.array([-1.0, 1.0]))
    assert middle is not None
    k = 4.0 * np.pi / radar.waveform.wavelength
    center, half = 0.5 * (middle.sines[0] + middle.sines[-1]), 0.5 * (middle.sines[-1] - middle.sines[0])
    sine = np.clip(center + 2.0 * half * np.linspace(-1.0, 1.0, 2 * _TAIL_NODES), -0.999, 0.999)
    kx, ky = k * sine[:, None], k * np.sqrt(1.0 - sine[:, None] ** 2)
    gain = filter_gain(radar, grid, sine)[:, None]
    exact = gain * middle(kx, np.array([k]), ky)
    worst = 0.0
    for rho in (grid.range[0], grid.range[-1]):
        moved = gain * replace(middle, rho=float(rho))(kx, np.array([k]), ky)
        worst = max(worst, float(np.sum(np.abs(moved - exact) ** 2) / np.sum(np.abs(exact) ** 2)))
    return worst


def spectrum_rows(radar: Radar, grid: ImageGrid, geometry: TrackGeometry) -> tuple[float, float]:
    """Rows of the pulses' spectrum, and rows mapped to pixels: more where apertures are wider than the pulse rate."""
    rows = track_period(radar, grid, geometry) / geometry.spacing
    kc = wavenumber(radar)
    return rows, rows * float(np.ptp(geometry.sines(kc))) * kc * geometry.spacing / (2.0 * np.pi)


def spectrum_work(radar: Radar, grid: ImageGrid) -> float:
    """Samples of the two-dimensional spectrum, before and after the transform to pixels over range.

    Samples weighted by the spectrum of their own apertures count twice before it.
    """
    radar, slant = hold_beam(radar, slant_grid(radar, grid))
    geometry = track_geometry(radar, slant)
    factor = rate_factor(radar, slant, geometry)[0]
    dense = replace(geometry, spacing=geometry.spacing / factor)
    rows, mapped = spectrum_rows(radar, slant, dense)
    plan = plan_spectrum(radar, parse_window("rectangular"), extra=range_walk(radar, slant, geometry))
    count = plan.n_fft * radar.waveform.bandwidth / radar.window.sampling_rate
    return rows * count + mapped * (count * own_apertures(radar) + slant.range.size)
