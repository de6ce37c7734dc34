"""From complex pixels to the decibels that a picture shows: averaged power, robust limits, magnification."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.image.sar_image import SarImage
from sarmitsuba.units import db_from_power

Quantity = Literal["sigma0", "rcs"]

_SYMBOLS: dict[str, str] = {"sigma0": "sigma0 (dB)", "rcs": "radar cross section (dBsm)"}

# quartiles of single-look speckle are 6.8 dB apart, those of a city 12 dB, of side lobes alone more than 20 dB
_CLUTTER_SPREAD_DB = 16.0
_ABOVE_CLUTTER_DB = 25.0


@dataclass(frozen=True, eq=False)
class Display:
    """A picture ready to be drawn.

    Parameters
    ----------
    values_db : (rows, columns) float64, dB; rows are azimuth, columns range; -inf where there is nothing
    extent : range of the first column's near edge and the last one's far edge, azimuth likewise, m
    label : quantity and unit of the values
    averaged : (azimuth, range) pixels whose power was averaged into one
    """

    values_db: NDArray[np.float64]
    extent: tuple[float, float, float, float]
    label: str
    averaged: tuple[int, int]


def prepare(image: SarImage, power: NDArray[np.floating], quantity: Quantity, largest: int) -> Display:
    """Turn power into decibels, averaging blocks of pixels when the picture would be larger than ``largest``.

    Averaging power (multilooking) keeps the mean of speckle, which dropping or smoothing pixels does not.

    Parameters
    ----------
    image : whose grid it is
    power : (n_azimuth, n_range) float64, linear
    quantity : what the power is
    largest : most screen pixels on the longer side
    """
    grid = image.grid
    n_azimuth, n_range = power.shape
    width, height = n_range * grid.range_spacing, n_azimuth * grid.azimuth_spacing
    smallest_step = max(width, height) / largest  # metres a screen pixel, at least
    block = (
        max(1, math.ceil(smallest_step / grid.azimuth_spacing - 1e-9)),
        max(1, math.ceil(smallest_step / grid.range_spacing - 1e-9)),
    )
    rows, columns = n_azimuth // block[0] or 1, n_range // block[1] or 1
    block = (min(block[0], n_azimuth), min(block[1], n_range))
    kept = np.asarray(power, dtype=np.float64)[: rows * block[0], : columns * block[1]]
    mean = kept.reshape(rows, block[0], columns, block[1]).mean(axis=(1, 3))
    r0 = float(grid.range[0]) - 0.5 * grid.range_spacing
    a0 = float(grid.azimuth[0]) - 0.5 * grid.azimuth_spacing
    extent = (
        r0,
        r0 + columns * block[1] * grid.range_spacing,
        a0,
        a0 + rows * block[0] * grid.azimuth_spacing,
    )
    return Display(db_from_power(mean), extent, _SYMBOLS[quantity], block)


def limits_db(values_db: NDArray[np.float64], span_db: float = 50.0) -> tuple[float, float]:
    """Lowest and highest decibel of the grey scale.

    White is the 99.9th percentile, so that a few corner reflectors do not turn the rest black. In a picture that
    is mostly clutter it is at most 25 dB above the clutter's upper quartile, so that streets show beside the
    double-bounce lines of a city. Pixels at -inf are left out; without any finite one white is 0 dB.
    """
    finite = values_db[np.isfinite(values_db)]
    if not finite.size:
        return -span_db, 0.0
    low, high, top = (float(q) for q in np.percentile(finite, (25.0, 75.0, 99.9)))
    if high - low < _CLUTTER_SPREAD_DB:
        top = min(top, high + _ABOVE_CLUTTER_DB)
    return top - span_db, top


def screen_size(display: Display, largest: int, smallest: int) -> tuple[int, int]:
    """(width, height) in screen pixels, equal metres in both directions.

    The finer of the two pixel spacings gets a whole number of screen pixels, so that no pixel looks larger than
    its neighbours. Small and narrow pictures are magnified as far as ``largest`` allows.
    """
    rows, columns = display.values_db.shape
    width = display.extent[1] - display.extent[0]
    height = display.extent[3] - display.extent[2]
    step = min(width / columns, height / rows)
    longest, shortest = max(width, height) / step, min(width, height) / step
    wanted = max(math.ceil(smallest / longest), math.ceil(0.4 * smallest / shortest))
    factor = max(1, min(wanted, int(largest // longest)))
    return max(1, round(width / step * factor)), max(1, round(height / step * factor))


def power_of(image: SarImage, channel: str | None, quantity: Quantity) -> NDArray[np.float64]:
    """Linear power of a channel in the quantity asked for, (n_azimuth, n_range) float64."""
    return image.sigma0(channel) if quantity == "sigma0" else image.rcs(channel)


__all__ = ["Display", "Quantity", "limits_db", "power_of", "prepare", "screen_size"]
