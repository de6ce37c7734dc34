"""Displayed values of a complex image: quantity, averaging, limits of the scale, magnification."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from sarmitsuba.analysis.image_quality import spectral_looks
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import did_you_mean
from sarmitsuba.core.units import amplitude_from_db, db_from_power, power_from_db
from sarmitsuba.signal.image import SarImage, ShownAxes, backscatter, block_means
from sarmitsuba.signal.raw_data import Layer

Quantity = Literal["sigma0", "gamma0", "beta0", "rcs", "amplitude", "phase"]
QUANTITIES: tuple[str, ...] = get_args(Quantity)

# entry of the metadata of images of a target on a turntable
TURNTABLE = "turntable"
LARGEST, SMALLEST = 1600, 640  # screen pixels of the longer side of a picture

_LABELS: dict[str, str] = {
    "sigma0": "sigma0 (dB)",
    "gamma0": "gamma0 (dB)",
    "beta0": "beta0 (dB)",
    "rcs": "radar cross section (dBsm)",
    "amplitude": "amplitude (m)",
    "phase": "phase (rad)",
}

# of data from elsewhere of unknown gain: every quantity of power is |pixel|^2
_UNCALIBRATED, _UNCALIBRATED_AMPLITUDE = "intensity, uncalibrated (dB)", "amplitude, uncalibrated"

# If an image does not state whether its scene scatters diffusely, clutter is told from side lobes of targets by the
# spread of its bright part, the 75th to the 95th percentile of power averaged over 4 x 4 pixels: 1 to 10 dB for
# clutter on a third or more of the picture, texture included; 17 to 32 dB for side lobes of any window
_LOOKS = 4
_CLUTTER_SPREAD_DB = 14.0
# The level of clutter is the median of the pixels near the brightest mode of their decibels: a peak of the density,
# smoothed over some dB, of at least a share of the highest. Streets are within 20 dB of roofs; side lobes outside the
# scene and shadows are darker, corners brighter
_AROUND_MODE_DB = 20.0
_MODE_WIDTH_DB = 6
_MODE_SHARE = 0.5
# Around a small body lie side lobes alone: in a corner of the picture, beside both its lines, they are twice the
# window's level below the peak and less (88 dB for a sphere of 1 m), and so is clutter that they hide
_DEEPEST_CLUTTER_DB = 80.0
# position of that level between black (0) and white (1)
_CLUTTER_AT = 0.42
# An image is speckle throughout where the standard deviation of the power in almost all blocks of pixels is below this
# multiple of its mean: 1 for speckle; edges, shadows and corners have more. Of 12 x 12 pixels a hill has 100 %, a lone
# tower on a plain 96 to 97 %, a city 75 % of such blocks
_SPECKLE_BLOCK, _SPECKLE_CONTRAST, _SPECKLE_SHARE = 12, 1.6, 0.985
# blocks along the longer side of a multilooked picture, most pixels along a side of a block, least span of the scale
_LEAST_BLOCKS, _MOST_LOOKS, _LEAST_SPAN_DB = 200, 12, 10.0
# slopes that turn away are 10 dB below level ground
_BESIDE_DB = 20.0
# share of the picture that may be white over clutter: facades of a dense city take 2 %, lines of side lobes 13 %
_MOST_WHITE = 0.15
# share of white pixels, and their level over what was taken for clutter, from which on that is side lobes of a body:
# walls and roofs lie 10 to 25 dB above clutter, side lobes 35 dB below a body and more
_LONE_BODY, _LONE_BODY_DB = 0.02, 30.0
# dB about its level within which nine tenths of clutter lie; side lobes are spread more widely
_ALIKE_DB = 10.0


@dataclass(frozen=True)
class PictureOptions:
    """Options of a picture of an image.

    Parameters
    ----------
    channel : polarisation; the first when None
    quantity : ``sigma0``, ``gamma0``, ``beta0`` (clutter) or ``rcs`` (targets) in dB; ``amplitude``, the root of the
        radar cross section, m; ``phase``, rad
    limits : values of black and white; None: automatic, see `limits_db`
    span_db : from black to white for automatic limits
    colour_map : name of a Matplotlib colour map; None takes ``gray``, for phase ``twilight``
    looks : pixels in azimuth and range averaged into one: power, and for ``phase`` the complex values; None: 1 x 1, or
        in large images that are speckle throughout as many as the picture needs, see `prepare`
    order : single bounce order to show; None: the sum of all
    spectral_looks : parts of the spectrum in azimuth and range whose powers are averaged, see
        :func:`sarmitsuba.analysis.image_quality.spectral_looks`; they reduce speckle more than ``looks`` of as many
        pixels
    axes : frame of the axes' numbers, ``scene`` or ``radar``, see
        :class:`sarmitsuba.signal.image.ShownAxes`;
        None: ``scene`` for images on the ground, ``radar`` for those in slant range
    """

    channel: str | None = None
    quantity: Quantity = "sigma0"
    limits: tuple[float, float] | None = None
    span_db: float = 50.0
    colour_map: str | None = None
    looks: tuple[int, int] | None = None
    order: int | None = None
    spectral_looks: tuple[int, int] = (1, 1)
    axes: str | None = None

    def check(self) -> None:
        """Raise a DataError for options that are invalid for every image."""
        if self.quantity not in QUANTITIES:
            raise DataError(
                f'picture: quantity "{self.quantity}" is unknown{did_you_mean(self.quantity, QUANTITIES)}; choose one '
                f"of {', '.join(QUANTITIES)}"
            )
        if self.limits is not None and not self.limits[0] < self.limits[1]:
            raise DataError(
                f"picture: limits {self.limits[0]:g} and {self.limits[1]:g} are not ascending; give the value of black "
                "first"
            )
        if not self.span_db > 0.0:
            raise DataError(f"picture: span = {self.span_db:g} dB is not above 0; give for example 50")
        if self.looks is not None and min(self.looks) < 1:
            raise DataError(f"picture: looks = {self.looks[0]} x {self.looks[1]} are not at least 1 x 1")
        if self.quantity == "phase" and self.spectral_looks != (1, 1):
            raise DataError("picture: the mean of spectral looks has no phase; show another quantity")


@dataclass(frozen=True, eq=False)
class Display:
    """Picture to be drawn.

    Parameters
    ----------
    values : (rows, columns) float64 of the quantity; rows are azimuth, columns range; -inf dB where the power is zero
    limits : values of black and white
    extent : left, right, lower and upper edge, m of ``axes``
    label : quantity and unit of the values
    averaged : (azimuth, range) pixels averaged into one
    axes : coordinates shown
    multilooked : True where pixels were averaged because the image is speckle throughout
    """

    values: F64
    limits: tuple[float, float]
    extent: tuple[float, float, float, float]
    label: str
    averaged: tuple[int, int]
    axes: ShownAxes
    multilooked: bool = False


def prepare(image: SarImage, options: PictureOptions, largest: int) -> Display:
    """Displayed values of an image, averaged over blocks of pixels as requested and to the size of the picture.

    Averaging power (multilooking) preserves the mean of speckle, unlike dropping or smoothing pixels. Without given
    ``looks``, a large image that is speckle throughout, such as terrain, is multilooked to at least 200 blocks along
    its longer side, at most 12 x 12 pixels each, and its automatic limits are those of the averaged power.

    Parameters
    ----------
    image : to show
    options : of the picture
    largest : largest number of screen pixels of the longer side

    Raises
    ------
    DataError : an option does not fit the image
    """
    options.check()
    if options.order is not None:
        image = pick_order(image, options.order)
    if options.spectral_looks != (1, 1):
        image = _average_looks(image, options)
    grid = image.grid
    looks = options.looks or _looks_of_speckle(image, options)
    multilooked = options.looks is None and looks != (1, 1)
    block = _block(image, looks, largest)
    values = _values(image, options, block)
    axes = ShownAxes.of(grid, options.axes)
    if multilooked and options.limits is None and options.quantity != "amplitude":
        options = dataclasses.replace(options, limits=_limits_of_means(values, options.span_db))
    limits = options.limits or _limits(values, options, has_clutter(image))
    return Display(
        values,
        limits,
        axes.extent(grid, block),
        quantity_label(image, options.quantity),
        block,
        axes,
        multilooked,
    )


def quantity_label(image: SarImage, quantity: Quantity) -> str:
    """Quantity and unit of displayed values; of an uncalibrated image, that it is one."""
    if image.calibrated or quantity == "phase":
        return _LABELS[quantity]
    return _UNCALIBRATED_AMPLITUDE if quantity == "amplitude" else _UNCALIBRATED


def pick_order(image: SarImage, order: int) -> SarImage:
    """Part of an image with this bounce order.

    Raises
    ------
    DataError : the image does not hold it separately
    """
    picks = [i for i, layer in enumerate(image.layers) if layer.order == order]
    if not picks:
        raise DataError(
            f'image: bounce order {order} was not kept separately; set keep_orders to "true" in the scene\'s integrator'
        )
    return dataclasses.replace(image, data=image.data[picks], layers=tuple(image.layers[i] for i in picks))


def _average_looks(image: SarImage, options: PictureOptions) -> SarImage:
    """Image without phase whose power is the mean of spectral looks."""
    channel = options.channel or image.channels[0]
    azimuth, range_ = options.spectral_looks
    power = spectral_looks(image, azimuth, range_, channel=channel).sigma0 * image.cell_area
    data = np.sqrt(power)[None].astype(np.complex64)
    return dataclasses.replace(image, data=data, layers=(Layer(channel),))


def limits_db(values_db: F64, span_db: float = 50.0, *, clutter: bool | None = None) -> tuple[float, float]:
    """Limits of the grey scale, dB.

    For clutter the scale is relative to the clutter's level, independent of the area in shadow or outside the scene and
    of bright corners. White is at most the 99.9th percentile. For targets alone white is that percentile and black
    ``span_db`` below, as where what looks like clutter lies 80 dB below the brightest pixel. Where 2 % of the
    pixels would be white and lie 30 dB above it, and most others are unlike it, what was taken for clutter is the side
    lobes around a body, and the scale is that of targets. Where more than 15 % would be white, white is the 98th
    percentile. Pixels at -inf are ignored; without any finite pixel white is 0 dB.

    Parameters
    ----------
    values_db : (rows, columns) float64
    span_db : largest span from black to white
    clutter : whether the image has clutter; None: estimated from the values
    """
    finite = values_db[np.isfinite(values_db)]
    if not finite.size:
        return -span_db, 0.0
    top = float(np.percentile(finite, 99.9))
    level = _clutter_db(values_db, clutter)
    if level is None:
        return top - span_db, top
    white = level + (1.0 - _CLUTTER_AT) * span_db
    bright = finite > white
    alike = np.mean(np.abs(finite - level) < _ALIKE_DB)
    if np.mean(bright) > _LONE_BODY and np.median(finite[bright]) - level > _LONE_BODY_DB and alike < 0.5:
        return top - span_db, top
    if np.mean(bright) > _MOST_WHITE:
        white = float(np.percentile(finite, 98.0))
        return white - span_db, white
    return level - _CLUTTER_AT * span_db, min(top, white)


def screen_size(display: Display, largest: int, smallest: int) -> tuple[int, int]:
    """Width and height in screen pixels, with equal scales in both directions.

    The finer of the two pixel spacings gets a whole number of screen pixels, so that all pixels have equal size. Small
    and narrow pictures are magnified as far as ``largest`` allows.
    """
    rows, columns = display.values.shape
    width = abs(display.extent[1] - display.extent[0])
    height = abs(display.extent[3] - display.extent[2])
    step = min(width / columns, height / rows)
    factor = magnification(width / step, height / step, largest, smallest)
    return max(1, round(width / step * factor)), max(1, round(height / step * factor))


def magnification(width: float, height: float, largest: int, smallest: int) -> int:
    """Screen pixels per finer pixel spacing, for a picture of ``width`` x ``height`` such spacings."""
    longest, shortest = max(width, height), min(width, height)
    wanted = max(math.ceil(smallest / longest), math.ceil(0.4 * smallest / shortest))
    return max(1, min(wanted, int(largest // longest)))


def _block(image: SarImage, looks: tuple[int, int], largest: int) -> tuple[int, int]:
    """Pixels (azimuth, range) to average: ``looks``, and more where the picture would be too large."""
    grid = image.grid
    sides = (grid.shape[0] * grid.azimuth_spacing, grid.shape[1] * grid.range_spacing)
    smallest_step = max(sides) / largest  # least metres per screen pixel
    steps = (grid.azimuth_spacing, grid.range_spacing)
    return (
        min(max(looks[0], math.ceil(smallest_step / steps[0] - 1e-9)), grid.shape[0]),
        min(max(looks[1], math.ceil(smallest_step / steps[1] - 1e-9)), grid.shape[1]),
    )


def _looks_of_speckle(image: SarImage, options: PictureOptions) -> tuple[int, int]:
    """Looks of a large image in which nothing is finer than speckle: square blocks of the ground; else 1 x 1."""
    grid = image.grid
    if options.quantity == "phase" or max(grid.shape) < 2 * _LEAST_BLOCKS or has_clutter(image) is False:
        return 1, 1
    power = image.rcs(options.channel)
    mean, square = block_means(power, (_SPECKLE_BLOCK,) * 2), block_means(power**2, (_SPECKLE_BLOCK,) * 2)
    lit = mean > 0.0
    if not lit.any() or np.mean(square[lit] < (1.0 + _SPECKLE_CONTRAST**2) * mean[lit] ** 2) < _SPECKLE_SHARE:
        return 1, 1
    spacing = (grid.azimuth_spacing, grid.range_spacing)
    side = max(n * step for n, step in zip(grid.shape, spacing, strict=True)) / _LEAST_BLOCKS
    azimuth, range_ = (int(np.clip(side // step, 1, _MOST_LOOKS)) for step in spacing)
    return azimuth, range_


def _limits_of_means(values_db: F64, span_db: float) -> tuple[float, float]:
    """Limits of multilooked power, dB: its 1st and 99.5th percentile, at least 10 dB and at most ``span_db`` apart.

    Pixels beside the scene, and shadow, more than ``_BESIDE_DB`` below the median, are left out.
    """
    finite = values_db[np.isfinite(values_db)]
    if not finite.size:
        return -span_db, 0.0
    shown = finite[finite > np.median(finite) - _BESIDE_DB]
    low, high = (float(value) for value in np.percentile(shown, (1.0, 99.5)))
    middle = 0.5 * (low + high)
    low, high = min(low, middle - 0.5 * _LEAST_SPAN_DB), max(high, middle + 0.5 * _LEAST_SPAN_DB)
    return max(low, high - span_db), high


def _values(image: SarImage, options: PictureOptions, block: tuple[int, int]) -> F64:
    quantity = options.quantity
    if quantity == "phase":
        total = image.total(options.channel).astype(np.complex128)
        return np.asarray(np.angle(block_means(total.real, block) + 1j * block_means(total.imag, block)))
    absolute = quantity if quantity != "amplitude" and image.calibrated else "rcs"
    power = backscatter(image, absolute, options.channel)
    mean = block_means(power, block)
    return np.sqrt(mean) if quantity == "amplitude" else db_from_power(mean)


def _limits(values: F64, options: PictureOptions, clutter: bool | None) -> tuple[float, float]:
    if options.quantity == "phase":
        return -np.pi, np.pi
    if options.quantity == "amplitude":
        level = _clutter_db(db_from_power(values**2), clutter)
        # the amplitude of single-look clutter reaches three times its root mean square
        top = float(np.percentile(values, 99.9)) if level is None else 3.0 * amplitude_from_db(level)
        return 0.0, top or 1.0
    return limits_db(values, options.span_db, clutter=clutter)


def _clutter_db(values_db: F64, known: bool | None) -> float | None:
    """Level of clutter, dB; None for targets and their side lobes alone."""
    looks = _LOOKS if min(values_db.shape) >= 8 * _LOOKS else 1
    power = block_means(power_from_db(np.where(np.isfinite(values_db), values_db, -np.inf)), (looks, looks))
    lit = db_from_power(power[power > 0.0])
    if known is None and lit.size:
        low, high = np.percentile(lit, (75.0, 95.0))
        known = bool(high - low < _CLUTTER_SPREAD_DB)
    if not known or not lit.size:
        return None
    bottom = math.floor(float(lit.min())) - _MODE_WIDTH_DB
    counts = np.bincount((lit - bottom).astype(int), minlength=_MODE_WIDTH_DB + 1).astype(np.float64)
    density = np.convolve(counts, np.ones(_MODE_WIDTH_DB), mode="valid")
    padded = np.pad(density, 1)
    peak = (density >= padded[:-2]) & (density >= padded[2:]) & (density >= _MODE_SHARE * density.max())
    mode = bottom + float(np.flatnonzero(peak)[-1]) + 0.5 * _MODE_WIDTH_DB
    level = float(np.median(lit[np.abs(lit - mode) < _AROUND_MODE_DB]))
    return None if float(np.nanmax(values_db)) - level > _DEEPEST_CLUTTER_DB else level


def has_clutter(image: SarImage) -> bool | None:
    """Whether diffuse echoes fill the image, as recorded by the simulation; None if not recorded.

    About a target on a turntable there are none: its side lobes alone.
    """
    if image.metadata.get(TURNTABLE) is True:
        return False
    effect = image.metadata.get("effects", {}).get("effects", {}).get("diffuse", {})
    return bool(effect["on"]) if "on" in effect else None
