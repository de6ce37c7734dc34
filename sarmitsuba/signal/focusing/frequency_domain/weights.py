"""Pulse weights and calibration of the frequency-domain focusers' pixels."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import aperture_weights, direction_gain, look_directions
from sarmitsuba.signal.focusing.frequency_domain.track_geometry import (
    TrackGeometry,
    aperture_middle,
    lit_in_turn,
    own_apertures,
    serving_pulses,
)
from sarmitsuba.signal.focusing.summed_weights import sum_at_nodes
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.image import ImageGrid

# rows, where only the sampling of the aperture varies along azimuth, and columns at which own apertures are summed
_OWN_ROWS, _COLUMNS = 9, 33
NODES = 65 * 33
"""Number of places at which weights are summed at least, by the first nodes and places halfway."""
# and at most, where they vary steeply
_MOST = 4 * NODES
# sines over an aperture at which its weight is summed, and the smallest part within the track used as divisor
_SINES, _HELD = 4097, 0.02


def normalisation(radar: Radar, grid: ImageGrid, geometry: TrackGeometry, window: Window) -> F64:
    """Calibration factor 1 / (K sum w g g_filter) per pixel (n_azimuth, n_range); zero without data."""
    if own_apertures(radar):
        total = _own_sums(radar, grid, geometry, window)
    elif not radar.antenna.directive:
        total = np.full(grid.shape, window.aperture(radar.track.n_pulses).sum())
    else:

        def sums(nodes: ImageGrid) -> F64:
            return np.array(
                [pulse_weights(radar, grid, line, window).sum(axis=-1) for line in nodes.positions()]
            )

        total = sum_at_nodes(grid, sums, most=_MOST).at(grid).astype(np.float64)
    scale = np.divide(1.0, total, out=np.zeros(grid.shape), where=total > 1e-6 * total.max())
    # pixels that the receive window does not contain in the middle of their aperture hold no data
    middle = aperture_middle(radar, geometry, grid.azimuth[:, None], grid.range)
    start = radar.window.start_range[middle]
    r = np.hypot(grid.azimuth[:, None] - geometry.x[middle], grid.range)
    scale[(r < start) | (r > start + radar.window.extent)] = 0.0
    return np.asarray(scale / radar.amplitude_constant)


def _nodes(n: int, most: int) -> I64:
    """At most a given number of n places, both ends included."""
    return np.unique(np.linspace(0, n - 1, most).astype(np.int64))


def _interpolate_coarse(coarse: F64, rows: I64, columns: I64, shape: tuple[int, int]) -> F64:
    """Values at rows and columns, linear between them."""
    lines = np.array([np.interp(np.arange(shape[1]), columns, line) for line in coarse])
    return np.array([np.interp(np.arange(shape[0]), rows, line) for line in lines.T]).T


def _own_sums(radar: Radar, grid: ImageGrid, geometry: TrackGeometry, window: Window) -> F64:
    """Sum w g g_filter over the part of the pixels' apertures within the track, (n_azimuth, n_range).

    The part within the track changes abruptly where apertures begin to leave it and is computed at every pixel; the
    rest varies slowly and is summed at a few nodes.
    """
    rows, columns = _nodes(grid.azimuth.size, _OWN_ROWS), _nodes(grid.range.size, _COLUMNS)
    nodes = replace(grid, azimuth=grid.azimuth[rows], range=grid.range[columns])
    held = _held_part(radar, nodes, geometry, window)
    coarse = np.zeros(nodes.shape)
    for i, line in enumerate(nodes.positions()):
        first, last = serving_pulses(radar, replace(nodes, azimuth=nodes.azimuth[[i]]), geometry)
        pulses = slice(max(first - 2, 0), last + 3)
        coarse[i] = pulse_weights(radar, grid, line, window, pulses).sum(axis=-1)
    known = held > _HELD
    if not known.any():
        return np.zeros(grid.shape)
    whole = np.divide(coarse, held, out=np.full(held.shape, coarse[known].max()), where=known)
    total = _interpolate_coarse(whole, rows, columns, grid.shape)
    return total if held.min() >= 1.0 - 1e-9 else total * _held_part(radar, grid, geometry, window)


def _held_part(radar: Radar, grid: ImageGrid, geometry: TrackGeometry, window: Window) -> F64:
    """Part of the weight of every pixel's aperture that lies within the track, (n_azimuth, n_range)."""
    half = radar.half_aperture
    offset = np.linspace(-half, half, _SINES)
    sine = geometry.sin_squint + offset
    weight = window(offset / (2.0 * half)) * filter_gain(radar, grid, sine) ** 2 * (1.0 - sine**2) ** -1.5
    total = np.concatenate([[0.0], np.cumsum(weight[1:] + weight[:-1])])
    parts = []
    for end in (geometry.x[0] - 0.5 * geometry.spacing, geometry.x[-1] + 0.5 * geometry.spacing):
        ahead = grid.azimuth[:, None] - end
        parts.append(np.interp(ahead / np.hypot(ahead, grid.range), sine, total / total[-1]))
    return np.asarray(parts[0] - parts[1])


def pulse_weights(
    radar: Radar,
    grid: ImageGrid,
    point: ArrayLike,
    azimuth_window: str | Window,
    pulses: slice = slice(None),
) -> F64:
    """Weight w g g_filter of pulses in the pixel at points (..., 3), giving (..., n_pulses) float64.

    A subset of the pulses where pixels have their own apertures, which do not depend on the number of pulses.
    """
    some = radar if pulses == slice(None) else radar.of_pulses(pulses)
    look = look_directions(some, point)
    gain = direction_gain(some, slice(None), look) * filter_gain(radar, grid, look @ grid.along)
    return np.asarray(aperture_weights(some, point, azimuth_window) * gain)


def filter_gain(radar: Radar, grid: ImageGrid, sin_angle: F64) -> F64:
    """Antenna pattern as matched weight: that at the image's central range if pixels have own apertures, else 1."""
    if not radar.antenna.directive or not lit_in_turn(radar):
        return np.ones_like(sin_angle)
    drop = float(grid.origin[2] - grid.height)
    rho = float(grid.range[grid.range.size // 2])
    broadside = np.sqrt(max(rho**2 - drop**2, 0.0)) * grid.across - np.array([0.0, 0.0, drop])
    broadside = broadside / np.linalg.norm(broadside)
    cos_angle = np.sqrt(np.clip(1.0 - sin_angle**2, 0.0, None))
    look = sin_angle[..., None] * grid.along + cos_angle[..., None] * broadside
    return direction_gain(radar, radar.track.center_index, look)
