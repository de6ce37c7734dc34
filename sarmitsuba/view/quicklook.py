"""Quick-look pictures: by default grey decibels, axes in metres, range to the right, azimuth up, not smoothed.

The margin has a scale bar and directions of flight, look, east and north. Beside the image may be an optical plan of
the scene: faces seen from above, shaded, on axes of the ground.
"""

import dataclasses
import math
import textwrap
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path

import matplotlib
import matplotlib.figure
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.text import Annotation

from sarmitsuba.core.arrays import U8
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import did_you_mean
from sarmitsuba.core.witness import USELESS_DB, Witness
from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image import ImageGrid, SarImage, ShownAxes
from sarmitsuba.view.display import (
    LARGEST,
    SMALLEST,
    TURNTABLE,
    Display,
    PictureOptions,
    prepare,
    screen_size,
)
from sarmitsuba.view.figure import PACKED, Figure, RoomyTicks
from sarmitsuba.view.outlines import draw_outlines

_ARROW = {"arrowstyle": "-|>", "color": "black", "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0}
_NEEDLE = 20.0  # half the length of the arrows to the north and the east, screen pixels


def draw_flight_and_look(figure: matplotlib.figure.Figure, metadata: Mapping[str, object]) -> None:
    """Draw the directions of flight (up) and look (right) in the lower left corner, by an image's metadata."""
    x, y, length = 18.0, 14.0, 26.0
    for tip in ((x, y + length), (x + length, y)):
        _arrow(figure, (x, y), tip)
    # a target on a turntable is flown past by no antenna
    turns = metadata.get(TURNTABLE) is True
    look = "from the radar" if turns else f"look {metadata.get('look_side', '')}".rstrip()
    _text(figure, (x + 5, y + length), "radar moves" if turns else "flight", va="top")
    _text(figure, (x + length + 3, y), look, va="center")


def draw_north_and_east(figure: matplotlib.figure.Figure, grid: ImageGrid, x: float) -> None:
    """Draw the directions of north (y of the scene) and east (x) on the ground about ``x`` screen pixels from the left.

    Seen from a radar that looks to the left, east is to the left of north: with range to the right the picture is
    mirrored.
    """
    y = 34.0
    for index, name in ((1, "N"), (0, "E")):
        direction = np.array([grid.across[index], grid.along[index]], dtype=np.float64)
        direction /= max(float(np.hypot(*direction)), 1e-12)
        tip = (x + _NEEDLE * float(direction[0]), y + _NEEDLE * float(direction[1]))
        _arrow(figure, (x, y), tip)
        beside = (x + (_NEEDLE + 8.0) * float(direction[0]), y + (_NEEDLE + 6.0) * float(direction[1]))
        _text(figure, beside, name, va="center", ha="center")


def draw_scale_bar(figure: matplotlib.figure.Figure, pixels_per_metre: float, right: float) -> None:
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


def _arrow(figure: matplotlib.figure.Figure, start: tuple[float, float], tip: tuple[float, float]) -> None:
    figure.add_artist(Annotation("", xy=tip, xycoords="figure pixels", xytext=start, arrowprops=_ARROW))


def _text(
    figure: matplotlib.figure.Figure, place: tuple[float, float], text: str, *, va: str, ha: str = "left"
) -> None:
    label = Annotation(text, xy=place, xycoords="figure pixels", fontsize=7, va=va, ha=ha, parse_math=False)
    figure.add_artist(label)


# colours of materials in turn, and light from near range and late azimuth (the upper left), above
_COLOURS = np.array(
    [(0.80, 0.78, 0.70), (0.86, 0.66, 0.56), (0.62, 0.72, 0.84), (0.66, 0.80, 0.64), (0.82, 0.74, 0.86)]
)
_LIGHT = np.array([-0.5, 0.5, 1.0]) / np.sqrt(1.5)
_DARKEST = 0.35  # of faces turned away
# most faces drawn; the largest ones are kept
_MOST = 200_000


def ground_grid(grid: ImageGrid) -> ImageGrid:
    """Grid on the ground of the extent of an image; that of a slant-range image, has even steps."""
    if grid.kind == "ground":
        return grid
    across = grid.across_distance()
    near, far = float(across[0]), float(across[-1])
    middle = 0.5 * (near + far)
    flat = np.array([grid.origin[0], grid.origin[1], grid.height])
    return ImageGrid(
        "ground",
        grid.azimuth,
        np.linspace(near - middle, far - middle, grid.range.size),
        flat + middle * grid.across,
        grid.along,
        grid.across,
        grid.height,
        grid.offset,
        grid.anchor,
    )


def draw_plan(axes: Axes, scene: Scene, grid: ImageGrid, frame: str | None = None) -> None:
    """Draw the scene from above at time zero, range to the right and azimuth upwards.

    Parameters
    ----------
    axes : get the limits of the grid's picture
    scene : to draw
    grid : the image's; slant-range images are shown over ground range
    frame : of the axes' numbers, see :class:`sarmitsuba.signal.image.ShownAxes`
    """
    ground = ground_grid(grid)
    shown = ShownAxes.of(ground, frame)
    left, right, below, above = shown.extent(ground)
    own = ground.in_frame(scene.radar.offset)
    offset = scene.geometry.vertices - own.origin
    across, up = shown.shown(offset @ own.along, offset @ own.across)
    corner = np.stack([across, up], axis=-1)[scene.geometry.faces]
    turned = np.stack([offset @ own.across, offset @ own.along, offset[:, 2]], axis=-1)[scene.geometry.faces]
    inside = np.ones(len(corner), dtype=bool)
    for i, ends in enumerate(((left, right), (below, above))):
        inside &= (corner[:, :, i].max(axis=1) > min(ends)) & (corner[:, :, i].min(axis=1) < max(ends))
    normal = np.cross(turned[:, 1] - turned[:, 0], turned[:, 2] - turned[:, 0])
    area = np.linalg.norm(normal, axis=1)
    pick = np.flatnonzero(inside & (np.abs(normal[:, 2]) > 1e-9 * area))
    pick = pick[np.argsort(-area[pick], kind="stable")[:_MOST]]
    pick = pick[np.argsort(turned[pick, :, 2].mean(axis=1), kind="stable")]  # higher faces cover lower ones
    unit = normal[pick] / area[pick, None] * np.sign(normal[pick, 2:])
    light = _DARKEST + (1.0 - _DARKEST) * np.maximum(unit @ _LIGHT, 0.0) / _LIGHT[2]
    colour = _COLOURS[scene.geometry.face_material[pick] % len(_COLOURS)]
    axes.set_facecolor("0.9")
    axes.add_collection(
        PolyCollection(
            list(corner[pick]),
            facecolors=np.clip(colour * light[:, None], 0.0, 1.0),
            edgecolors="face",
            linewidths=0.2,
        ),
        autolim=False,
    )
    if scene.points:
        place = np.array([point.position for point in scene.points]) - own.origin
        axes.plot(*shown.shown(place @ own.along, place @ own.across), "r+", label="points")
    axes.set_xlim(left, right)
    axes.set_ylim(below, above)
    axes.set_xlabel(shown.range_label, fontsize=9)
    axes.set_ylabel(shown.azimuth_label, fontsize=9)
    axes.tick_params(labelsize=8)
    axes.set_title("seen from above", fontsize=9)


def plan_width(grid: ImageGrid) -> float:
    """Width of the plan, m."""
    ground = ground_grid(grid)
    return ground.range_spacing * ground.range.size


# function that draws a picture on demand
Drawing = Callable[[], Figure]

_DPI = 100.0
_LARGEST_PANEL, _SMALLEST_PANEL = 700, 360
_LEFT, _RIGHT, _BOTTOM, _TOP = 90, 130, 74, 74  # screen pixels around a picture: labels, colour bar, title
_ROOMY = 220  # width from which on numbers below a picture have room
_NARROWEST = 300  # width needed for the title
_WINDOWS = ("azimuth_window", "range_window")  # names used by the focusers

# of pictures, by the suffixes of their files
_FORMATS = {"": "png", ".png": "png", ".jpg": "jpg", ".jpeg": "jpg", ".pdf": "pdf", ".svg": "svg"}


def quicklook(
    image: SarImage,
    options: PictureOptions | None = None,
    *,
    channel: str | None = None,
    title: str | None = None,
    scene: Scene | None = None,
    outlined: bool = False,
    with_plan: bool = False,
) -> Figure:
    """Draw one channel, by default the sum of all bounce orders.

    Parameters
    ----------
    image : to draw
    options : of the picture; None: the defaults
    channel : overrides that in ``options``
    title : first line above the picture; None: the scene's name
    scene : of the image, needed for the following
    outlined : draw footprints and laid over upper rims of bodies, see :mod:`sarmitsuba.view.outlines`
    with_plan : draw the scene seen from above, to the same scale, to the right

    Returns
    -------
    Figure whose picture area has one screen pixel, or a whole number of them, for every image pixel; images
    of more than 1600 pixels are shown with the power of blocks of pixels averaged.

    Raises
    ------
    DataError : an option does not fit the image
    """
    options = _fill_options(image, options, channel)
    display = prepare(image, options, LARGEST)
    width, height = screen_size(display, LARGEST, SMALLEST)
    left = _LEFT + max(0, (_NARROWEST - width) // 2)
    scale = width / abs(display.extent[1] - display.extent[0])  # screen pixels per metre
    whole = 2 * left - _LEFT + width + _RIGHT
    plan = max(1, round(plan_width(image.grid) * scale)) if with_plan and scene else 0
    figure = _figure(whole + (_LEFT + plan + 20 if plan else 0), height + _BOTTOM + _TOP)
    axes = _axes(figure, left, _BOTTOM, width, height)
    picture = _draw(axes, display, image, options)
    draw_flight_and_look(figure, image.metadata)
    draw_north_and_east(figure, image.grid, left + width + 62.0)
    draw_scale_bar(figure, scale, left + width)
    _colour_bar(figure, picture, left + width + 18, _BOTTOM, height, display.label)
    if scene and outlined:
        draw_outlines(axes, scene, image.grid, display.axes)
    if scene and plan:
        draw_plan(_axes(figure, whole + _LEFT - 30, _BOTTOM, plan, height), scene, image.grid, options.axes)
    first = title if title is not None else str(image.metadata.get("scene", ""))
    first = ",  ".join(text for text in (first, _not_usable(image)) if text)
    lines = (first, *_subtitle(image, options, display))
    # a given height: Matplotlib would measure all labels to find that none is in the way
    axes.set_title("\n".join(line for line in lines if line), fontsize=9, y=1.0, parse_math=False)
    return figure


def draw(image: SarImage, axes: Axes, options: PictureOptions | None = None) -> AxesImage:
    """Draw one channel into given axes, with labels in metres and without title and colour bar.

    Parameters
    ----------
    image : to draw
    axes : get equal scales in both directions
    options : of the picture; None: the defaults

    Returns
    -------
    AxesImage, for ``figure.colorbar``

    Raises
    ------
    DataError : an option does not fit the image
    """
    options = _fill_options(image, options, None)
    picture = _draw(axes, prepare(image, options, LARGEST), image, options)
    axes.set_aspect("equal")
    axes.xaxis.set_major_locator(RoomyTicks())
    return picture


def png(image: SarImage, options: PictureOptions | None = None, *, title: str | None = None) -> bytes:
    """Quick-look as the bytes of a PNG file."""
    return quicklook(image, options, title=title).png()


def panel(image: SarImage, options: PictureOptions | None = None, *, width: float = 3.4) -> Figure:
    """Draw one channel for a narrow column of a page, with a colour bar below; ``width`` in inches at 150 dpi.

    Raises
    ------
    DataError : an option does not fit the image
    """
    options = _fill_options(image, options, None)
    extents = (
        image.grid.shape[0] * image.grid.azimuth_spacing,
        image.grid.shape[1] * image.grid.range_spacing,
    )
    height = width * float(np.clip(extents[0] / extents[1], 0.3, 2.0)) + 0.6
    figure = Figure(figsize=(width, height), dpi=150, layout="constrained")
    axes = figure.add_subplot()
    picture = draw(image, axes, options)
    axes.set_xlabel(axes.get_xlabel(), fontsize=7)
    # beside a low picture in several lines, of letters about 4/7 as wide as high
    letters = int((height - 0.6) * 0.75 * 72.0 / 4.0)
    axes.set_ylabel(textwrap.fill(axes.get_ylabel(), max(letters, 12)), fontsize=7)
    axes.tick_params(labelsize=6)
    bar = figure.colorbar(picture, ax=axes, orientation="horizontal", fraction=0.05, pad=0.02)
    bar.set_label(f"{options.channel}, {prepare(image, options, LARGEST).label}", fontsize=7)
    bar.ax.tick_params(labelsize=6)
    return figure


def pixels(figure: Figure) -> U8:
    """Pixels of a figure, (rows, columns, 3) uint8, red, green and blue, first row on top."""
    canvas, buffer = FigureCanvasAgg(figure), BytesIO()
    canvas.print_figure(buffer, format="rgba", dpi=figure.dpi)
    width, height = canvas.get_width_height()
    return np.frombuffer(buffer.getvalue(), dtype=np.uint8).reshape(height, width, 4)[..., :3]


def quicklook_by_order(image: SarImage, options: PictureOptions | None = None, *, columns: int = 3) -> Figure:
    """Draw all bounce orders of a channel side by side on one scale; needs layers kept by order.

    Parameters
    ----------
    image : to draw
    options : of the picture; None: the defaults
    columns : largest number of columns of panels

    Raises
    ------
    DataError : the image does not hold the orders separately, or an option does not fit it
    """
    options = _fill_options(image, options, None)
    orders = bounce_orders(image)
    if not orders:
        raise DataError(
            'image: bounce orders were not kept separately; set keep_orders to "true" in the scene\'s integrator'
        )
    whole = prepare(image, options, _LARGEST_PANEL)
    alike = dataclasses.replace(options, limits=whole.limits, looks=whole.averaged)
    apart = [dataclasses.replace(alike, order=order) for order in orders]
    displays = [prepare(image, one, _LARGEST_PANEL) for one in apart]
    width, height = screen_size(displays[0], _LARGEST_PANEL, _SMALLEST_PANEL)
    columns = min(columns, len(orders))
    rows = -(-len(orders) // columns)
    bottom_edge = _BOTTOM + 10  # below it the directions of flight and look
    step_x, step_y = width + _LEFT - 20, height + bottom_edge + 20
    figure = _figure(columns * step_x + _RIGHT + 20, rows * step_y + 40)
    for i, (order, display) in enumerate(zip(orders, displays, strict=True)):
        left, bottom = _LEFT - 20 + i % columns * step_x, bottom_edge + (rows - 1 - i // columns) * step_y
        axes = _axes(figure, left, bottom, width, height)
        picture = _draw(axes, display, image, options)
        axes.set_title(
            f"{options.channel}, {order} bounce{'s' if order > 1 else ''}", fontsize=9, parse_math=False
        )
        if i % columns:
            axes.set_ylabel("")
    draw_flight_and_look(figure, image.metadata)
    _colour_bar(figure, picture, columns * step_x + 28, bottom_edge, height, displays[0].label)
    return figure


def bounce_orders(image: SarImage) -> tuple[int, ...]:
    """Bounce orders that the image holds separately, ascending; empty if they were summed."""
    return tuple(sorted({layer.order for layer in image.layers if layer.order > 0}))


def picture_format(path: Path | str) -> str:
    """Format of a picture's file by its suffix: png (also without any), jpg, pdf or svg.

    Raises
    ------
    DataError : another suffix
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _FORMATS:
        raise DataError(f'{path}: no picture has the suffix "{suffix}"; take .png, .jpg, .pdf or .svg')
    return _FORMATS[suffix]


def save(figure: Figure, path: Path | str) -> None:
    """Write a figure in the format of the path's suffix, see `picture_format`, completely or not at all."""
    kind = picture_format(path)
    with atomic_path(path) as temporary:
        if kind in ("png", "jpg"):
            packed = PACKED if kind == "png" else None
            FigureCanvasAgg(figure).print_figure(temporary, format=kind, dpi=_DPI, pil_kwargs=packed)
        else:  # without the date: the same picture is the same file
            dates = {"pdf": "CreationDate", "svg": "Date"}
            figure.savefig(temporary, format=kind, dpi=_DPI, metadata={dates[kind]: None})


def _fill_options(image: SarImage, options: PictureOptions | None, channel: str | None) -> PictureOptions:
    """Options with explicit channel and colour map, both checked."""
    options = options or PictureOptions()
    name = channel or options.channel or image.channels[0]
    if name not in image.channels:
        raise DataError(f'picture: the image has no channel "{name}"; it has {", ".join(image.channels)}')
    colours = options.colour_map or ("twilight" if options.quantity == "phase" else "gray")
    if colours not in matplotlib.colormaps:
        raise DataError(
            f'picture: colour map "{colours}" is unknown{did_you_mean(colours, matplotlib.colormaps)}; choose one of '
            "Matplotlib's, such as gray, viridis or inferno"
        )
    return dataclasses.replace(options, channel=name, colour_map=colours)


def _figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)


def _axes(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Axes of exactly these screen pixels."""
    full_width, full_height = (figure.get_size_inches() * _DPI).tolist()
    box = (left / full_width, bottom / full_height, width / full_width, height / full_height)
    return figure.add_axes(box)


def _draw(axes: Axes, display: Display, image: SarImage, options: PictureOptions) -> AxesImage:
    limits = display.limits
    values = np.where(np.isfinite(display.values), display.values, limits[0])
    picture = axes.imshow(
        values,
        cmap=options.colour_map,
        vmin=limits[0],
        vmax=limits[1],
        extent=display.extent,
        origin="lower",
        aspect="auto",  # the axes' box already has equal scales in both directions
        interpolation="nearest",  # speckle is not smoothed
    )
    axes.set_xlabel(display.axes.range_label, fontsize=9)
    axes.set_ylabel(display.axes.azimuth_label, fontsize=9)
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.tick_params(labelsize=8)
    if axes.bbox.width < _ROOMY:
        axes.xaxis.set_major_locator(RoomyTicks())
    else:
        axes.locator_params(axis="x", nbins=int(np.clip(axes.bbox.width / 110, 1, 8)))
    axes.locator_params(axis="y", nbins=int(np.clip(axes.bbox.height / 60, 1, 8)))
    return picture


def _colour_bar(
    figure: Figure, picture: AxesImage, left: float, bottom: float, height: float, label: str
) -> None:
    bar_axes = _axes(figure, left, bottom, 16, height)
    bar = figure.colorbar(picture, cax=bar_axes)
    bar.set_label(label, fontsize=9)
    bar.ax.tick_params(labelsize=8)


def _not_usable(image: SarImage) -> str:
    """Mark of an image whose rays miss the tolerance, by the measurement; empty for others."""
    witnesses = image.metadata.get("witnesses")
    rays = Witness.read(witnesses.get("rays")) if isinstance(witnesses, Mapping) else None
    if rays is None or not (rays.useless and rays.law_db > USELESS_DB):
        return ""
    return f"ray sampling error {rays.error_db:.0f} dB: not usable"


def _subtitle(image: SarImage, options: PictureOptions, display: Display) -> tuple[str, ...]:
    facts = [
        str(options.channel),
        f"{SPEED_OF_LIGHT / image.wavelength / 1e9:.4g} GHz",
        f"cell {image.azimuth_resolution_cell:.3g} x {image.range_resolution_cell:.3g} m (azimuth x range)",
    ]
    if options.order is not None:
        facts.insert(1, f"{options.order} bounce{'s' if options.order > 1 else ''}")
    focus = image.metadata.get("focus", {})
    windows = list(dict.fromkeys(str(focus[key]) for key in _WINDOWS if key in focus))
    more = [f"window {' x '.join(windows)}"] if windows else []
    if options.spectral_looks != (1, 1):
        more.append(
            f"{options.spectral_looks[0]} x {options.spectral_looks[1]} looks of the spectrum averaged"
        )
    if max(display.averaged) > 1:
        what = "complex values" if options.quantity == "phase" else "power"
        text = f"{what} of {display.averaged[0]} x {display.averaged[1]} pixels averaged"
        more.append(f"multilooked: {text}, scale of the means" if display.multilooked else text)
    return ",  ".join(facts), ",  ".join(more)
