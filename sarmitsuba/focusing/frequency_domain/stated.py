"""What a frequency-domain focuser states of itself before it runs: its error, and the processor time it takes."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.focusing.aperture import weights_difference
from sarmitsuba.focusing.frequency_domain.aperture_filter import aperture_filter
from sarmitsuba.focusing.frequency_domain.geometry import (
    TrackGeometry,
    range_walk,
    rate_factor,
    slant_grid,
    track_geometry,
    track_period,
)
from sarmitsuba.focusing.frequency_domain.migration import Migration, residual_power
from sarmitsuba.focusing.frequency_domain.weights import filter_gain, pulse_weights
from sarmitsuba.focusing.profiles import plan_spectrum
from sarmitsuba.focusing.windows import parse_window
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.radar.radar import Radar

F64 = NDArray[np.float64]

# what all have, dB: ripple of the pulses' ends where the pulse rate is raised, stationary phase
_FLOOR_DB = -58.0
# of stationary phase in pixels' own apertures: this power at a time-bandwidth product of 1, falling with its power of
# 2.5; tests/physics/test_stated_errors.py holds it over random radars
_OWN, _OWN_POWER = 0.32, -2.5
# fewer pulses leave more than that
_FEWEST_PULSES = 50
# the Doppler band of the image that may pass that of the pulses, and fold, over the latter
_FOLDED = 1.0
# places in the aperture and, beyond its ends, as many again on either side, at which the tails are compared
_TAIL_NODES = 2048


def stated_error_db(radar: Radar, grid: ImageGrid, law: Migration | None) -> float:
    """Bound of the error against backprojection, dB; NaN for few pulses, and images that fold over or leave the beam.

    The worst place of the image stands for all of it. Powers add up of what the algorithm's law leaves (nothing for the
    exact one), of pulses weighed otherwise than backprojection weighs them, of stationary phase and the ends of
    apertures away from the reference range where pixels have apertures of their own, and of a floor.
    """
    slant = slant_grid(radar, grid)
    geometry = track_geometry(radar, slant)
    if radar.track.n_pulses < _FEWEST_PULSES or rate_factor(radar, slant, geometry)[1] > _FOLDED:
        return float("nan")
    window = parse_window("rectangular")
    rows, columns = (np.unique([0, n // 2, n - 1]) for n in slant.shape)
    points = replace(slant, azimuth=slant.azimuth[rows], range=slant.range[columns]).positions()
    power = 10.0 ** (0.1 * _FLOOR_DB)
    power += weights_difference(radar, points, pulse_weights(radar, slant, points, window))
    if np.isfinite(radar.half_aperture):
        product = 8.0 * radar.half_aperture**2 * float(slant.range[0]) / radar.waveform.wavelength
        power += _OWN * product**_OWN_POWER + _tail_change(radar, slant, geometry)
    if law is not None:
        power += residual_power(radar, slant, law)
    return float(10.0 * np.log10(power)) if np.isfinite(power) else float("nan")


def _tail_change(radar: Radar, grid: ImageGrid, geometry: TrackGeometry) -> float:
    """Power of the change of the aperture's ends from the reference range to the image's ends, over the echo's."""
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


def spectrum_work(radar: Radar, grid: ImageGrid) -> float:
    """Samples of the two-dimensional spectrum, before and after the transform to pixels over range.

    Those that are weighed by the spectrum of their own apertures count twice before it.
    """
    slant = slant_grid(radar, grid)
    geometry = track_geometry(radar, slant)
    factor = rate_factor(radar, slant, geometry)[0]
    dense = replace(geometry, spacing=geometry.spacing / factor)
    rows = track_period(radar, slant, dense) / dense.spacing
    plan = plan_spectrum(radar, parse_window("rectangular"), extra=range_walk(radar, slant, geometry))
    count = plan.n_fft * radar.waveform.bandwidth / radar.window.sampling_rate
    return rows * (count * (2.0 if np.isfinite(radar.half_aperture) else 1.0) + slant.range.size)


__all__ = ["spectrum_work", "stated_error_db"]
