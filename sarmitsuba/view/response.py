"""Picture of image quality: points, areas and impulse responses."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from sarmitsuba.analysis.quality.carrier import Carrier
from sarmitsuba.analysis.quality.image_report import QualityReport
from sarmitsuba.analysis.quality.point_quality import PointQuality
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import db_from_power
from sarmitsuba.signal.image.sar_image import SarImage
from sarmitsuba.signal.image.shown_axes import ShownAxes
from sarmitsuba.view.display import PictureOptions
from sarmitsuba.view.figure import Figure
from sarmitsuba.view.quicklook import draw

_MOST = 6  # most points whose response is drawn
_FLOOR_DB = -50.0
_REACH, _STEPS = 8.0, 401  # half the length of a cut, in widths of the response, and its samples


def quality_figure(image: SarImage, report: QualityReport, frame: str | None = None) -> Figure:
    """Draw the image with points and areas marked, and cuts through the first six points.

    ``frame`` is that of the image's axes, see :class:`sarmitsuba.signal.image.shown_axes.ShownAxes`.
    """
    shown = report.points[:_MOST]
    figure = Figure(
        figsize=(6.0 + (4.5 if shown else 0.0), max(5.0, 1.7 * len(shown))), dpi=100, layout="constrained"
    )
    grid = figure.add_gridspec(
        max(len(shown), 1), 3 if shown else 1, width_ratios=[2, 1, 1] if shown else [1]
    )
    axes = figure.add_subplot(grid[:, 0])
    draw(image, axes, PictureOptions(channel=report.channel, axes=frame))
    shown_axes = ShownAxes.of(image.grid, frame)
    for point in report.points:
        across, up = shown_axes.shown(point.azimuth, point.range)
        place = (float(across), float(up))
        axes.plot(*place, "o", markersize=9, markerfacecolor="none", color="tab:red")
        axes.annotate(
            point.name,
            place,
            xytext=(6, 6),
            textcoords="offset points",
            color="tab:red",
            fontsize=7,
            parse_math=False,
        )
    for area in report.areas:
        x, y = shown_axes.shown(np.array(area.azimuth), np.array(area.range))
        corner, size = (float(x[0]), float(y[0])), (float(np.diff(x)[0]), float(np.diff(y)[0]))
        axes.add_patch(Rectangle(corner, *size, fill=False, color="tab:blue"))
        axes.annotate(
            f"{area.name}: ENL {area.enl:.2f}",
            corner,
            xytext=(2, 3),
            textcoords="offset points",
            color="tab:blue",
            fontsize=7,
            parse_math=False,
        )
    for i, point in enumerate(shown):
        for column, axis in ((1, "azimuth"), (2, "range")):
            _response(figure.add_subplot(grid[i, column]), image, report.channel, point, axis)
    return figure


def _response(axes: Axes, image: SarImage, channel: str, point: PointQuality, axis: str) -> None:
    """Draw one cut through a point along a lobe, by the Fourier series of the pixels."""
    cut = point.azimuth_cut if axis == "azimuth" else point.range_cut
    reach = min(_REACH * cut.irw, cut.extent)
    x = np.linspace(-reach, reach, _STEPS)
    axes.plot(x, _cut_db(image, channel, point, axis, x), linewidth=0.9)
    axes.set_ylim(_FLOOR_DB, 2.0)
    axes.grid(linewidth=0.3)
    axes.tick_params(labelsize=6)
    axes.set_title(
        f"{point.name}, {axis}: IRW {cut.irw:.3g} m, PSLR {cut.pslr_db:.1f}, ISLR {cut.islr_null_db:.1f} dB",
        fontsize=6,
        parse_math=False,
    )
    axes.set_xlabel("m", fontsize=6, labelpad=0)
    axes.set_ylabel("dB", fontsize=6, labelpad=0)


def _cut_db(image: SarImage, channel: str, point: PointQuality, axis: str, x: F64) -> F64:
    carrier = Carrier.of(image)
    piece = carrier.chip_about(image.total(channel), point.azimuth, point.range)
    lobes = carrier.lobes(point.azimuth, point.range)
    direction = lobes.azimuth if axis == "azimuth" else lobes.range
    grid = image.grid
    rows = (point.azimuth + direction[0] * x - grid.azimuth[0]) / grid.azimuth_spacing
    columns = (point.range + direction[1] * x - grid.range[0]) / grid.range_spacing
    power = np.abs(piece.at(rows, columns)) ** 2
    return np.asarray(np.maximum(db_from_power(power / point.rcs), _FLOOR_DB))
