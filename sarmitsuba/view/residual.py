"""Picture of a fit: measured data, model, and what the model leaves of them."""

from dataclasses import replace

import numpy as np

from sarmitsuba.signal.image.sar_image import SarImage
from sarmitsuba.signal.raw.raw_data import Layer
from sarmitsuba.view.display import LARGEST, PictureOptions, prepare
from sarmitsuba.view.figure import Figure
from sarmitsuba.view.side_by_side import side_by_side


def residual_picture(measured: SarImage, left: SarImage) -> Figure:
    """Draw the images of measured data, of a model, and of their difference side by side on one scale.

    Parameters
    ----------
    measured, left : on the same grid; their first channel is drawn
    """
    channel = left.channels[0]
    model = (measured.total(channel) - left.total(channel))[None].astype(np.complex64)
    options = PictureOptions(channel, limits=prepare(measured, PictureOptions(channel), LARGEST).limits)
    return side_by_side(
        [
            ("measured", measured, options),
            ("model", replace(left, data=model, layers=(Layer(channel),)), options),
            ("left by the fit", left, options),
        ]
    )
