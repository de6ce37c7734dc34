"""Weights of pulses in factorised backprojection's pixels: antenna, aperture band, and their sum over the image."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from types import ModuleType

import numpy as np

from sarmitsuba.core.arrays import F32, F64
from sarmitsuba.machine.backend import arrays, device_array, dr
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import beam_turn, flight
from sarmitsuba.signal.focusing.backprojection_kernel import AXES_STRIDE, ApertureBand, Beam, Weighting
from sarmitsuba.signal.focusing.factorised.kernels import sum_weights
from sarmitsuba.signal.focusing.summed_weights import SummedWeights, sum_at_nodes
from sarmitsuba.signal.focusing.windows import WINDOWS, Window
from sarmitsuba.signal.image import ImageGrid

# nodes of the azimuth window over a pixel's own aperture
_WINDOW_NODES = 1025


def weighting_of(types: ModuleType, radar: Radar, window: Window) -> Weighting:
    """Antenna and aperture band of a radar; the azimuth window is over the band where there is one."""
    band = None
    if np.isfinite(radar.half_aperture):
        nodes = window(np.linspace(-0.5, 0.5, _WINDOW_NODES)).astype(np.float32)
        band = ApertureBand(dr.opaque(types.Float32, radar.half_aperture), device_array(types.Float32, nodes))
    return Weighting(None if not radar.antenna.directive else Beam.of(types, radar.antenna), band)


def pulse_weights(radar: Radar, window: Window) -> F64:
    """Azimuth window over the pulses, (n_pulses,); ones where each pixel has its own band."""
    n_pulses = radar.track.n_pulses
    return np.ones(n_pulses) if np.isfinite(radar.half_aperture) else window.aperture(n_pulses)


def axes_table(radar: Radar, weights: F64, pulses: slice, frame: F64) -> F32:
    """Axes, weight and flight of pulses (n, ``AXES_STRIDE``) in a frame of unit vectors, as backprojection's."""
    forward, sine, gap = (part[pulses] for part in flight(radar))
    table = np.zeros((len(sine), AXES_STRIDE), dtype=np.float32)
    table[:, 0:3] = radar.pointing.azimuth_axis[pulses] @ frame.T
    table[:, 3] = weights[pulses]
    table[:, 4:7] = radar.pointing.elevation_axis[pulses] @ frame.T
    table[:, 7] = gap
    table[:, 8:11] = radar.pointing.boresight[pulses] @ frame.T
    table[:, 11] = beam_turn(radar)[pulses]
    table[:, 12:15], table[:, 15] = forward @ frame.T, sine
    return table


def alike(radar: Radar) -> bool:
    """Whether a pulse has equal weight in all pixels."""
    return not radar.antenna.directive and bool(np.isinf(radar.half_aperture))


def image_weights(radar: Radar, grid: ImageGrid, window: Window) -> SummedWeights:
    """Sum of all pulses' weights w g^2 over an image; kept for the radars and images asked for last."""
    return _image_weights(radar, grid, window, WINDOWS[window.name].function)


@lru_cache(maxsize=8)
@exclusive
def _image_weights(
    radar: Radar, grid: ImageGrid, window: Window, _function: Callable[..., F64]
) -> SummedWeights:
    """See :func:`image_weights`; the function is that of the window's name, for the cache."""
    types = arrays()
    weighting = weighting_of(types, radar, window)
    table = axes_table(radar, pulse_weights(radar, window), slice(0, radar.track.n_pulses), np.eye(3))
    axes = device_array(types.Float32, table)

    def sums(nodes: ImageGrid) -> F64:
        points = nodes.positions().reshape(-1, 3)
        return sum_weights(types, points, radar.track.position, axes, weighting).reshape(nodes.shape)

    return sum_at_nodes(grid, sums)
