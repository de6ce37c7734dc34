"""Cuts through an image: decibels over metres, along range or azimuth."""

from typing import Literal

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.units import db_from_power
from sarmitsuba.signal.image import RadiometricQuantity, SarImage, ShownAxes, backscatter
from sarmitsuba.view.display import quantity_label
from sarmitsuba.view.figure import Figure


def cut_profile(
    image: SarImage,
    axis: Literal["range", "azimuth"],
    *,
    at: float | None = None,
    channel: str | None = None,
    quantity: RadiometricQuantity = "rcs",
) -> tuple[F64, F64, float]:
    """Cut through an image: position (n,) m, power (n,) dB, and position of the cut on the other axis, m.

    Parameters
    ----------
    image : the image
    axis : direction of the cut
    at : position on the other axis, m of the grid (for a place of a picture see ``ShownAxes.grid_coordinates``); None:
        through the brightest pixel
    channel : polarisation; None: the first
    quantity : ``rcs``, ``sigma0``, ``beta0`` or ``gamma0``
    """
    power = backscatter(image, quantity, channel)
    along, other = image.grid.range, image.grid.azimuth
    if axis == "azimuth":
        along, other, power = other, along, power.T
    if at is None:
        index = int(np.unravel_index(int(power.argmax()), power.shape)[0])
    elif other[0] <= at <= other[-1]:
        index = int(np.abs(other - at).argmin())
    else:
        raise DataError(f"profile: at = {at:g} m is outside the image, {other[0]:g} to {other[-1]:g} m")
    return along, db_from_power(power[index]), float(other[index])


def profile(
    image: SarImage,
    axis: Literal["range", "azimuth"] = "range",
    *,
    at: float | None = None,
    channel: str | None = None,
    quantity: RadiometricQuantity = "rcs",
    span_db: float = 60.0,
) -> Figure:
    """Draw a cut; see :func:`cut_profile`."""
    position, values, place = cut_profile(image, axis, at=at, channel=channel, quantity=quantity)
    other = "azimuth" if axis == "range" else "range"
    figure = Figure(figsize=(8.0, 4.0), dpi=100, layout="constrained")
    axes = figure.add_subplot()
    top = float(values.max()) if np.isfinite(values.max()) else 0.0
    axes.plot(position, np.maximum(values, top - span_db - 100.0), color="black", linewidth=0.8)
    axes.set_ylim(top - span_db, top + 3.0)
    axes.set_xlim(float(position[0]), float(position[-1]))
    labels = ShownAxes.of(image.grid, "radar")
    axes.set_xlabel(labels.range_label if axis == "range" else labels.azimuth_label)
    axes.set_ylabel(quantity_label(image, quantity))
    axes.set_title(
        f"{channel or image.channels[0]}, {axis} cut at {other} {place:.2f} m", fontsize=9, parse_math=False
    )
    axes.ticklabel_format(axis="x", useOffset=False, style="plain")
    axes.grid(True, linewidth=0.3)
    return figure
