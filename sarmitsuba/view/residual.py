"""Picture of measured data beside what a model leaves of them."""

from sarmitsuba.image.sar_image import SarImage
from sarmitsuba.view.display import PictureOptions
from sarmitsuba.view.figure import Figure
from sarmitsuba.view.quicklook import draw

# inches
_WIDTH, _HEIGHT = 10.0, 4.6


def residual_picture(measured: SarImage, left: SarImage) -> Figure:
    """Draw the images of measured data and of their difference to a model side by side on one scale.

    Parameters
    ----------
    measured, left : on the same grid; their first channel is drawn
    """
    figure = Figure(figsize=(_WIDTH, _HEIGHT), layout="constrained")
    first, second = figure.subplots(1, 2)
    drawn = draw(measured, first)
    low, high = drawn.get_clim()
    draw(left, second, PictureOptions(limits=(low, high)))
    first.set_title("measured")
    second.set_title("left by the fit")
    figure.colorbar(drawn, ax=(first, second), label="dB")
    return figure
