"""The weights of the pulses in a frequency-domain focuser's pixels, and what calibrates them."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.focusing.aperture import aperture_weights, direction_gain, look_directions
from sarmitsuba.focusing.frequency_domain.geometry import TrackGeometry, aperture_middle, lit_in_turn
from sarmitsuba.focusing.windows import Window
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.radar.radar import Radar

F64 = NDArray[np.float64]


def normalisation(radar: Radar, grid: ImageGrid, geometry: TrackGeometry, window: Window) -> F64:
    """1 / (K sum w g g_filter) per pixel (n_azimuth, n_range); zero where the data hold nothing."""
    if radar.antenna.pattern == "isotropic" and np.isinf(radar.half_aperture):
        total = np.full(grid.shape, window.aperture(radar.track.n_pulses).sum())
    else:  # smooth: summed at a few nodes, linear between them
        columns = np.unique(np.linspace(0, grid.range.size - 1, 33).astype(int))
        rows = np.unique(np.linspace(0, grid.azimuth.size - 1, 65).astype(int))
        nodes = replace(grid, azimuth=grid.azimuth[rows], range=grid.range[columns])
        coarse = np.array(
            [pulse_weights(radar, grid, line, window).sum(axis=-1) for line in nodes.positions()]
        )
        between = np.array([np.interp(np.arange(grid.range.size), columns, line) for line in coarse])
        total = np.array([np.interp(np.arange(grid.azimuth.size), rows, line) for line in between.T]).T
    scale = np.divide(1.0, total, out=np.zeros(grid.shape), where=total > 1e-6 * total.max())
    # pixels that the receive window does not contain in the middle of their aperture hold no data
    middle = aperture_middle(radar, geometry, grid.azimuth[:, None], grid.range)
    start = radar.window.start_range[middle]
    r = np.hypot(grid.azimuth[:, None] - geometry.x[middle], grid.range)
    scale[(r < start) | (r > start + radar.window.extent)] = 0.0
    return np.asarray(scale / radar.amplitude_constant)


def pulse_weights(radar: Radar, grid: ImageGrid, point: ArrayLike, azimuth_window: str | Window) -> F64:
    """Weight w g g_filter of every pulse in the pixel at points (..., 3), giving (..., n_pulses) float64."""
    weights = aperture_weights(radar, point, azimuth_window)
    look = look_directions(radar, point)
    gain = direction_gain(radar, slice(None), look)
    return np.asarray(weights * gain * filter_gain(radar, grid, look @ grid.along))


def filter_gain(radar: Radar, grid: ImageGrid, sin_angle: F64) -> F64:
    """Pattern used as matched weight: that at the image's central range if pixels have own apertures, else 1."""
    if radar.antenna.pattern == "isotropic" or not lit_in_turn(radar):
        return np.ones_like(sin_angle)
    drop = float(grid.origin[2] - grid.height)
    rho = float(grid.range[grid.range.size // 2])
    broadside = np.sqrt(max(rho**2 - drop**2, 0.0)) * grid.across - np.array([0.0, 0.0, drop])
    broadside = broadside / np.linalg.norm(broadside)
    cos_angle = np.sqrt(np.clip(1.0 - sin_angle**2, 0.0, None))
    look = sin_angle[..., None] * grid.along + cos_angle[..., None] * broadside
    return direction_gain(radar, radar.track.center_index, look)


__all__ = ["filter_gain", "normalisation", "pulse_weights"]
