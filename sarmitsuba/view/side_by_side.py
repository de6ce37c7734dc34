"""Images of one grid side by side, each with its title, scale and colour bar."""

from collections.abc import Sequence

import numpy as np
from matplotlib.layout_engine import ConstrainedLayoutEngine

from sarmitsuba.signal.image.sar_image import SarImage
from sarmitsuba.view.display import LARGEST, PictureOptions, prepare
from sarmitsuba.view.figure import Figure
from sarmitsuba.view.quicklook import draw

# inches: width of the figure, of a picture with its axes, and height of title and colour bar, of the title alone
_WIDTH, _PICTURE, _AROUND, _TITLE = 14.0, 4.2, 1.4, 0.5


def side_by_side(pictures: Sequence[tuple[str, SarImage, PictureOptions]], title: str = "") -> Figure:
    """Draw images of one grid with their titles and options, and a title of one or more lines above all.

    Raises
    ------
    DataError : an option does not fit an image
    """
    grid = pictures[0][1].grid
    ratio = grid.shape[0] * grid.azimuth_spacing / (grid.shape[1] * grid.range_spacing)
    height = _AROUND + _PICTURE * float(np.clip(ratio, 0.3, 1.6)) + (_TITLE if title else 0.0)
    room = (0.0, 0.0, 1.0, 1.0 - 0.5 * (_TITLE / height if title else 0.0))
    figure = Figure(figsize=(_WIDTH, height), dpi=100, layout=ConstrainedLayoutEngine(rect=room))
    for axes, (name, image, options) in zip(figure.subplots(1, len(pictures)), pictures, strict=True):
        bar = figure.colorbar(draw(image, axes, options), ax=axes, orientation="horizontal", shrink=0.8)
        bar.set_label(prepare(image, options, LARGEST).label, fontsize=8)
        axes.set_title(name, fontsize=10, parse_math=False)
    if title:
        figure.suptitle(title, fontsize=9, parse_math=False)
    return figure
