"""Measured noise of an empty scene and power of a focused point, for comparison with a link budget."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing import focus
from sarmitsuba.signal.focusing.ideal import ideal_echoes
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.noise import add_noise
from sarmitsuba.signal.raw_data import Layer, RawData

# noise is independent in every channel: four realisations in one pass
_FOUR = tuple(Layer(channel) for channel in ("HH", "HV", "VH", "VV"))


def empty_echoes(radar: Radar, seed: int) -> RawData:
    """Range-compressed data of an empty scene: receiver noise in four channels."""
    radar = radar.as_recorded()
    shape = (len(_FOUR), radar.track.n_pulses, radar.window.n_samples)
    return add_noise(RawData(np.zeros(shape, np.complex64), _FOUR, "compressed", radar), seed=seed)


def focused_noise(noise: RawData, grid: ImageGrid, window: str) -> tuple[float, float]:
    """Mean power of focused noise over all pixels and channels: as a radar cross section (m^2), and as sigma0."""
    image = focus(noise, grid, range_window=window, azimuth_window=window)
    sigma0 = [image.sigma0(layer.channel).mean() for layer in image.layers]
    return float(np.mean(np.abs(image.data) ** 2)), float(np.mean(sigma0))


def focused_peak(
    radar: Radar, grid: ImageGrid, row: int, column: int, window: str, rcs: ArrayLike = 1.0
) -> float:
    """Power of an ideal point of an RCS (m^2) at a pixel of a grid, m^2; focused as the radar is recorded."""
    spot = replace(grid, azimuth=grid.azimuth[[row]], range=grid.range[[column]])
    echoes = ideal_echoes(radar, spot.positions()[0, 0], rcs=rcs)
    told = replace(echoes, radar=radar.as_recorded())
    image = focus(told, spot, range_window=window, azimuth_window=window)
    return float(abs(image.data[0, 0, 0]) ** 2)
