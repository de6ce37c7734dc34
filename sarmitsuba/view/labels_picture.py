"""Pictures of an image's labels: colours of codes over the image with a legend, and masks pixel by pixel."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.patches import Patch
from PIL import Image

from sarmitsuba.core.arrays import U8
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import did_you_mean
from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.signal.image import SarImage, ShownAxes
from sarmitsuba.signal.pixel_labels import LabelLayer, Labels
from sarmitsuba.view.display import PictureOptions, limits_db
from sarmitsuba.view.figure import Figure
from sarmitsuba.view.quicklook import quicklook

# colours of codes of layover and shadow; 0, and codes of other layers beyond those of the colour map, are not coloured
_COLOURS = {1: "tab:blue", 2: "tab:orange", 3: "tab:purple", 255: "0.5"}
_MASK, _OPACITY = "layover_shadow", 0.45
# codes in a legend, the most frequent ones first, and letters of each name
_ROWS, _LETTERS = 12, 28


def labels_figure(
    image: SarImage, labels: Labels, layer: str = _MASK, options: PictureOptions | None = None
) -> Figure:
    """Draw a layer of codes in colours over the quick-look of an image; the legend gives the share of each code.

    Parameters
    ----------
    image : on the grid of the labels
    labels : of its pixels
    layer : of codes
    options : of the quick-look

    Raises
    ------
    DataError : there is no such layer of codes, or the image has another size
    """
    found = _codes(labels, layer)
    if image.grid.shape != labels.grid.shape:
        raise DataError(
            f"labels: of {labels.grid.shape[0]} x {labels.grid.shape[1]} pixels, and the image has "
            f"{image.grid.shape[0]} x {image.grid.shape[1]}; label the image itself"
        )
    options = options or PictureOptions()
    figure = quicklook(image, options)
    axes = figure.axes[0]
    limits = axes.get_xlim(), axes.get_ylim()
    values, counts = np.unique(found.values, return_counts=True)
    colours = {int(code): _colour(layer, place, int(code)) for place, code in enumerate(values) if code != 0}
    over = np.zeros((*found.values.shape, 4))
    for code, colour in colours.items():
        over[found.values == code] = (*colour, _OPACITY)
    axes.imshow(
        over,
        extent=ShownAxes.of(image.grid, options.axes).extent(image.grid),
        origin="lower",
        aspect="auto",
        interpolation="nearest",
    )
    axes.set_xlim(limits[0])
    axes.set_ylim(limits[1])
    entries = [
        Patch(
            facecolor=(*colours[int(values[i])], 0.9) if int(values[i]) in colours else "none",
            edgecolor="white",
            label=f"{found.codes.get(int(values[i]), str(values[i]))[:_LETTERS]} "
            f"{100.0 * counts[i] / found.values.size:.1f} %",
        )
        for i in np.argsort(-counts, kind="stable")[:_ROWS]
    ]
    axes.legend(
        handles=entries,
        fontsize=7,
        loc="lower left",
        framealpha=0.7,
        facecolor="black",
        labelcolor="white",
        title=layer.replace("_", " "),
        title_fontproperties={"size": 8},
    ).get_title().set_color("white")
    return figure


def _codes(labels: Labels, layer: str) -> LabelLayer:
    """A layer of codes."""
    named = [name for name, one in labels.layers.items() if one.codes]
    if layer not in named:
        raise DataError(
            f'labels: there is no layer of codes "{layer}"{did_you_mean(layer, named)}; there are {", ".join(named)}'
        )
    return labels.layers[layer]


def _colour(layer: str, place: int, code: int) -> tuple[float, float, float]:
    """Red, green and blue of a code, the ``place``-th of those present."""
    if layer == _MASK:
        return matplotlib.colors.to_rgb(_COLOURS[code])
    table = matplotlib.colormaps["tab20"]
    red, green, blue, _ = table(place % table.N)
    return float(red), float(green), float(blue)


def write_mask(path: Path | str, labels: Labels, layer: str) -> None:
    """Write a layer of codes as a PNG of one pixel for each of the image.

    Codes up to 255 are the pixels of a palette, whose colours are those of :func:`labels_figure`; larger ones are grey
    values of 16 bits. Rows are azimuth, the earliest on top; columns are range, the nearest on the left.

    Raises
    ------
    DataError : there is no such layer of codes, or a code does not fit into 16 bits
    """
    values = _codes(labels, layer).values
    if values.size and (values.min() < 0 or values.max() > 0xFFFF):
        raise DataError(f"labels: layer {layer}: a code is outside 0 ... 65535, which PNG files can hold")
    if values.size and values.max() > 0xFF:
        _write_png(path, Image.fromarray(values.astype(np.uint16)))
        return
    palette = np.zeros((256, 3), np.uint8)
    for place, code in enumerate(np.unique(values)):
        palette[code] = 255.0 * np.array(_colour(layer, place, int(code))) if code else 0.0
    picture = Image.fromarray(values.astype(np.uint8))
    picture.putpalette(palette.tobytes())
    _write_png(path, picture)


def write_pixels(path: Path | str, image: SarImage) -> None:
    """Write the first channel as a grey PNG of decibels, pixels as :func:`write_mask`."""
    decibels = image.to_db()
    black, white = limits_db(decibels)
    shown: U8 = np.round(255.0 * np.clip((decibels - black) / (white - black), 0.0, 1.0)).astype(np.uint8)
    _write_png(path, Image.fromarray(shown))


def _write_png(path: Path | str, picture: Image.Image) -> None:
    with atomic_path(path) as temporary:
        picture.save(temporary, format="PNG")
