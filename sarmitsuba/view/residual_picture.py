"""Picture of a fit: image of the measured data, of the model, and of what the model leaves, on one scale."""

from dataclasses import replace

import numpy as np

from sarmitsuba.echo.raw_data import Layer, RawData
from sarmitsuba.focusing import focus
from sarmitsuba.view.display import LARGEST, PictureOptions, prepare
from sarmitsuba.view.figure import Figure
from sarmitsuba.view.side_by_side import side_by_side


def residual_figure(measured: RawData, residual: RawData, channel: str | None = None) -> Figure:
    """Draw the images of measured data, of a model, and of measured less modelled data, side by side.

    Parameters
    ----------
    measured : data that a model was fitted to
    residual : measured less modelled, as of :class:`sarmitsuba.Fit`
    channel : polarisation; None: the first of the residual

    Raises
    ------
    DataError : the data cannot be focused
    """
    left = focus(residual)
    name = channel or left.channels[0]
    seen, rest = focus(measured, left.grid).total(name), left.total(name)
    planes = {"measured": seen, "model": seen - rest, "measured less model": rest}
    images = {
        title: replace(left, data=plane[None].astype(np.complex64), layers=(Layer(name),))
        for title, plane in planes.items()
    }
    options = PictureOptions(limits=prepare(images["measured"], PictureOptions(), LARGEST).limits)
    return side_by_side([(title, image, options) for title, image in images.items()])
