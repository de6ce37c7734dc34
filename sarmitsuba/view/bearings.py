"""Scale bar and directions of flight, look, east and north in the margin below a picture."""

import math

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation

from sarmitsuba.signal.image.sar_image import ImageGrid

_ARROW = {"arrowstyle": "-|>", "color": "black", "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0}
_NEEDLE = 20.0  # half the length of the arrows to the north and the east, screen pixels


def draw_flight_and_look(figure: Figure, look_side: str) -> None:
    """Draw the directions of flight (up) and look (right) in the lower left corner."""
    x, y, length = 18.0, 14.0, 26.0
    for tip in ((x, y + length), (x + length, y)):
        _arrow(figure, (x, y), tip)
    _text(figure, (x + 5, y + length), "flight", va="top")
    _text(figure, (x + length + 3, y), f"look {look_side}".rstrip(), va="center")


def draw_north_and_east(figure: Figure, grid: ImageGrid, x: float) -> None:
    """Draw the directions of north (y of the scene) and east (x) on the ground about ``x`` screen pixels from the left.

    Seen from a radar that looks to the left, east is to the left of north: with range to the right the picture is
    mirrored.
    """
    y = 30.0
    for index, name in ((1, "N"), (0, "E")):
        direction = np.array([grid.across[index], grid.along[index]], dtype=np.float64)
        direction /= max(float(np.hypot(*direction)), 1e-12)
        tip = (x + _NEEDLE * float(direction[0]), y + _NEEDLE * float(direction[1]))
        _arrow(figure, (x, y), tip)
        beside = (x + (_NEEDLE + 8.0) * float(direction[0]), y + (_NEEDLE + 6.0) * float(direction[1]))
        _text(figure, beside, name, va="center", ha="center")


def draw_scale_bar(figure: Figure, pixels_per_metre: float, right: float) -> None:
    """Draw a bar of 1, 2 or 5 times a power of ten metres that ends ``right`` screen pixels from the left edge.

    Parameters
    ----------
    figure : to draw into
    pixels_per_metre : scale of the picture
    right : screen pixels
    """
    longest = 80.0 / pixels_per_metre  # metres
    power = 10.0 ** math.floor(math.log10(longest))
    metres = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= longest)
    length = metres * pixels_per_metre
    width, height = figure.get_size_inches() * figure.dpi
    ends = np.array([right - length, right]) / width
    bar = Line2D(ends, np.full(2, 12.0) / height, color="black", linewidth=2.5, solid_capstyle="butt")
    figure.add_artist(bar)
    _text(figure, (right - length - 4.0, 12.0), f"{metres:g} m", va="center", ha="right")


def _arrow(figure: Figure, start: tuple[float, float], tip: tuple[float, float]) -> None:
    figure.add_artist(Annotation("", xy=tip, xycoords="figure pixels", xytext=start, arrowprops=_ARROW))


def _text(figure: Figure, place: tuple[float, float], text: str, *, va: str, ha: str = "left") -> None:
    label = Annotation(text, xy=place, xycoords="figure pixels", fontsize=7, va=va, ha=ha, parse_math=False)
    figure.add_artist(label)
