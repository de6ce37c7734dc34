"""Charts: account of an image, error against time, curves against a reference, echoes, focusers, fits, image quality.

References are lines, measured values points, deviations below. Images of one grid are side by side, each with its
title, scale and colour bar, or with its difference from the reference.
"""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Rectangle
from matplotlib.textpath import TextPath
from matplotlib.ticker import LogFormatter
from numpy.typing import NDArray

from sarmitsuba.analysis.account import Account, likely_total_db
from sarmitsuba.analysis.carrier import Carrier
from sarmitsuba.analysis.error_budget import BOUND, LAW, MEASURED, NONE_DB, ErrorPart
from sarmitsuba.analysis.image_quality import QualityReport
from sarmitsuba.analysis.point_quality import PointQuality
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.signal.focusing.comparison import FocuserResult
from sarmitsuba.signal.image import SarImage, ShownAxes
from sarmitsuba.signal.raw_data import Layer, RawData
from sarmitsuba.view.display import LARGEST, PictureOptions, prepare, quantity_label
from sarmitsuba.view.figure import Figure
from sarmitsuba.view.quicklook import draw

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_DPI = 100.0
# screen pixels: of a bar, around the bars, and of the names
_ROW, _TOP, _BOTTOM, _NAMES, _BARS, _VALUES, _LINE = 22, 34, 46, 124, 190, 350, 15
_GAP = 16  # between the values and the names of the stages, screen pixels
_LETTERS = 190  # of a line below the charts
_WALL, _PROCESSOR = "#8c5a1c", "#e3c08f"
# by kind of figure: a law, which nothing in this run confirmed, is grey; a measurement that contradicts its law is red
_KINDS = {MEASURED: "#1f5f99", BOUND: "#a9c8e4", LAW: "#b5b5b5"}
_CONTRADICTED = "#b3261e"
_SMALL = 8
# stages shorter than this share of the whole are summed up as "other"
_LEAST = 0.01


def account_figure(account: Account, title: str = "") -> Figure:
    """Two charts: parts of the error, and parts of the time.

    Parameters
    ----------
    account : of the image
    title : first words of the title

    Returns
    -------
    Figure. Left: share of every cause in the likely sum of the known error energies, linear from 0, with its level
    relative to the image; a cause that is not measured has no bar. Right: elapsed and processor seconds of every stage.
    Below: the changes of settings that pay most.
    """
    stages = _stages(account)
    rows = max(len(account.parts), len(stages))
    notes = [
        line for text in account.advice for line in textwrap.wrap(text, _LETTERS, subsequent_indent="    ")
    ]
    foot = _BOTTOM + _LINE * len(notes)
    likely = likely_total_db(account.parts)
    longest = max((_text_width(_value(part, _share(part, likely))) for part in account.parts), default=0.0)
    starts = (0.0, _NAMES + _BARS + max(_VALUES, longest + _GAP))
    width, height = starts[1] + _NAMES + _BARS + _VALUES, _TOP + _ROW * rows + foot
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    left, right = (
        figure.add_axes(
            (
                (_NAMES + start) / width,
                (foot + _ROW * (rows - n)) / height,
                _BARS / width,
                _ROW * n / height,
            )
        )
        for start, n in zip(starts, (len(account.parts), len(stages)), strict=True)
    )
    _errors(left, account)
    _times(right, stages)
    total = "none known"
    if math.isfinite(account.total_db) and account.total_db > NONE_DB:
        total = f"{account.total_db:.1f} dB of the image ({account.kind})"
    figure.text(8 / width, 1 - 18 / height, f"{title}error by cause: {total}", fontsize=9, parse_math=False)
    elapsed = sum(stage[1] for stage in stages)
    figure.text(
        (starts[1] + 8) / width,
        1 - 18 / height,
        f"time by stage: {elapsed:.3g} s",
        fontsize=9,
        parse_math=False,
    )
    for i, line in enumerate(reversed(notes)):
        figure.text(8 / width, (6 + _LINE * i) / height, line, fontsize=_SMALL, parse_math=False)
    return figure


def _text_width(text: str) -> float:
    """Width of a small text, screen pixels."""
    return float(TextPath((0.0, 0.0), text, size=_SMALL).get_extents().width) * _DPI / 72.0


def _errors(axes: Axes, account: Account) -> None:
    likely = likely_total_db(account.parts)
    shares = [_share(part, likely) for part in account.parts]
    colours = [
        _CONTRADICTED if part.contradicts else _KINDS.get(part.known, _KINDS[MEASURED])
        for part in account.parts
    ]
    _bars(axes, [part.name for part in account.parts], [100.0 * share for share in shares], colours)
    for i, (part, share) in enumerate(zip(account.parts, shares, strict=True)):
        axes.text(102.0, i, _value(part, share), fontsize=_SMALL, va="center", parse_math=False)
    axes.set_xlim(0.0, 100.0)
    axes.set_xlabel(
        "share of the known error energy, %; light: bound, grey: law, red: more than its law",
        fontsize=_SMALL,
        parse_math=False,
        loc="left",
    )


def _times(axes: Axes, stages: Sequence[tuple[str, float, float]]) -> None:
    elapsed_seconds = [elapsed for _, elapsed, _ in stages]
    processors = [0.0 if math.isnan(processor) else processor for _, _, processor in stages]
    most = max([*elapsed_seconds, *processors], default=0.0) or 1.0
    _bars(axes, [name for name, _, _ in stages], processors, [_PROCESSOR] * len(stages), 0.78)
    axes.barh(range(len(stages)), elapsed_seconds, height=0.34, color=_WALL)
    for i, (_, elapsed, processor) in enumerate(stages):
        text = f"{elapsed:.2f} s" + (f", {processor:.2f} CPU s" if math.isfinite(processor) else "")
        axes.text(1.02 * most, i, text, fontsize=_SMALL, va="center", parse_math=False)
    axes.set_xlim(0.0, most)
    axes.set_xlabel("seconds; light: processor seconds of all threads", fontsize=_SMALL, parse_math=False)


def _bars(
    axes: Axes, names: Sequence[str], values: Sequence[float], colours: Sequence[str], height: float = 0.62
) -> None:
    axes.barh(range(len(names)), values, height=height, color=colours)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_yticks(range(len(names)), names, fontsize=_SMALL, parse_math=False)
    axes.tick_params(axis="y", length=0)
    axes.tick_params(axis="x", labelsize=_SMALL)
    axes.locator_params(axis="x", nbins=5)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _share(part: ErrorPart, total_db: float) -> float:
    if not part.counts or not math.isfinite(part.weight_db):
        return 0.0
    return power_from_db(part.weight_db - total_db)


def _value(part: ErrorPart, share: float) -> str:
    return part.value if not share else f"{_percent(share)}: {part.value}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %" if share >= 0.005 else "< 1 %"


def _stages(account: Account) -> list[tuple[str, float, float]]:
    """Stages with elapsed and processor seconds; those that hardly count are summed."""
    whole = sum(t.elapsed for t in account.stages.values())
    kept, rest = [], (0.0, 0.0)
    for name, time in account.stages.items():
        if max(time.elapsed, 0.0 if math.isnan(time.processor) else time.processor) >= _LEAST * whole:
            kept.append((name, time.elapsed, time.processor))
        else:
            rest = (rest[0] + time.elapsed, rest[1] + time.processor)
    return [*kept, ("other", *rest)] if rest[0] > 0.0 else kept


Point = tuple[float, float]


def cost_figure(
    points: Sequence[Point], front: Sequence[Point], chosen: Point, target_db: float, title: str
) -> "Figure":
    """Plot error (dB) over seconds: all combinations, the Pareto front, the recommendation.

    Parameters
    ----------
    points, front : (seconds, error in dB) of all combinations and of the Pareto front
    chosen : the recommended one
    target_db : wanted error
    title : of the plot
    """
    from sarmitsuba.view.figure import Figure

    figure = Figure(figsize=(7.0, 4.6), layout="constrained")
    axes = figure.add_subplot()
    x, y = zip(*points, strict=True)
    axes.scatter(x, y, s=6, color="0.75", label="combinations", rasterized=True)
    x, y = zip(*front, strict=True)
    axes.step(x, y, where="post", color="C0", marker="o", ms=4, label="Pareto front")
    axes.axhline(target_db, color="C3", lw=0.8, ls="--", label=f"wanted: {target_db:g} dB")
    axes.plot(*chosen, "*", ms=14, color="C1", label="recommended")
    axes.set_xscale("log")
    for axis_ticks in (axes.xaxis.set_major_formatter, axes.xaxis.set_minor_formatter):
        axis_ticks(LogFormatter(minor_thresholds=(2.0, 0.5)))  # plain numbers
    axes.set_xlabel("processor time, whole scene (s)")
    axes.set_ylabel("error of the image (dB)")
    axes.set_title(title, parse_math=False)
    axes.grid(alpha=0.3, which="both")
    axes.legend()
    return figure


def depth_figure(
    errors_db: Sequence[float], energies_db: Sequence[float], seconds: Sequence[float], title: str
) -> Figure:
    """Plot the contribution of each bounce to an image and its cost, from the first bounce on.

    Parameters
    ----------
    errors_db : of the image that ends at each bounce, against the deepest; not finite: no error, not drawn
    energies_db : of the image of each bounce alone, over the deepest image; likewise
    seconds : of a run that ends at each bounce; all NaN: not measured, and not drawn
    title : of the plot
    """
    timed = np.isfinite(seconds).any()
    figure = Figure(figsize=(10.0 if timed else 5.4, 4.2), dpi=100, layout="constrained")
    panels = figure.subplots(1, 2 if timed else 1, squeeze=False)[0]
    bounces = np.arange(1, len(errors_db) + 1)
    for values, style, label in (
        (errors_db, "o-", "error of the image that ends here"),
        (energies_db, "s--", "energy of this bounce alone"),
    ):
        drawn = np.isfinite(values)
        panels[0].plot(bounces[drawn], np.asarray(values)[drawn], style, ms=5, label=label)
    panels[0].set_ylabel("dB of the deepest image's energy")
    panels[0].legend(fontsize=_SMALL)
    if timed:
        panels[1].plot(bounces, seconds, "o-", color=_WALL, ms=5)
        panels[1].set_ylabel("processor seconds, without compiling")
        panels[1].set_ylim(0.0, 1.1 * float(np.nanmax(seconds)))
    for axes in panels:
        axes.set_xlabel("bounces traced")
        axes.set_xticks(bounces)
        axes.grid(alpha=0.3)
    figure.suptitle(title, fontsize=10, parse_math=False)
    return figure


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a PNG file, completely or not at all."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=120)


_COLUMNS = 4
_REFERENCE, _MEASURED, _BESIDE, _TOLERANCE = "0.45", "tab:red", "tab:blue", "0.88"
_TITLE_WIDTH = 44  # characters of a panel's title per line


@dataclass(frozen=True, eq=False)
class DeviationPanel:
    """One curve against its reference.

    Parameters
    ----------
    title : of the panel
    x : (n,) float64
    reference, measured : (n,) float64, in one unit
    compared : (n,) bool, the points whose deviation counts
    tolerance : half the height of the grey band about zero deviation, in the curves' unit
    depth : range of the value axis below the peak of the reference; None shows all compared values
    reference_name : in the legend
    beside : (n,) float64, a further curve for orientation, such as a measurement; None: none
    """

    title: str
    x: F64
    reference: F64
    measured: F64
    compared: NDArray[np.bool_]
    tolerance: float
    depth: float | None = None
    reference_name: str = "theory"
    beside: F64 | None = None

    @property
    def deviation(self) -> F64:
        """Measured minus reference, (n,) float64; nan where not compared."""
        out = np.full(self.reference.shape, np.nan)
        out[self.compared] = self.measured[self.compared] - self.reference[self.compared]
        return out

    @property
    def limits(self) -> tuple[float, float] | None:
        """Limits of the value axis; None: those of Matplotlib."""
        if self.depth is not None:
            peak = float(self.reference[self.compared].max())
            return peak - 1.3 * self.depth, peak + 0.1 * self.depth
        both = np.concatenate([self.reference[self.compared], self.measured[self.compared]])
        if not both.size or not np.isfinite(both).all():
            return None
        # rounding errors of a constant curve must not fill the axis
        pad = max(0.08 * float(np.ptp(both)), self.tolerance)
        return float(both.min()) - pad, float(both.max()) + pad

    @property
    def reach(self) -> float:
        """Half the height of the deviation's axis: tolerance or worst deviation, with a margin."""
        worst = np.abs(self.deviation[self.compared])
        finite = worst.size > 0 and bool(np.isfinite(worst).all())
        return 1.3 * max(self.tolerance, float(worst.max()) if finite else 1e9)


def save_deviation(
    panels: Sequence[DeviationPanel], path: Path, *, title: str, x_label: str, y_label: str
) -> None:
    """Write a PNG with one panel per curve."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from sarmitsuba.view.figure import Figure

    n = len(panels)
    columns = min(_COLUMNS, n)
    rows = -(-n // columns)
    figure = Figure(figsize=(4.0 * columns + 0.4, 3.6 * rows + 0.5), dpi=70, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2 * rows, columns, height_ratios=[2.2, 1.0] * rows)
    for i, panel in enumerate(panels):
        row, column = divmod(i, columns)
        above = figure.add_subplot(grid[2 * row, column])
        below = figure.add_subplot(grid[2 * row + 1, column], sharex=above)
        _draw(above, below, panel)
        if column == 0:
            above.set_ylabel(y_label, fontsize=8)
            below.set_ylabel("deviation", fontsize=8)
        if row == rows - 1:
            below.set_xlabel(x_label, fontsize=8)
    figure.suptitle(title, fontsize=11, parse_math=False)
    figure.savefig(path, metadata={"Software": None})


def _draw(above: "Axes", below: "Axes", panel: DeviationPanel) -> None:
    """Curve and deviation of one panel."""
    n = panel.x.size
    line, size = ("_", 16) if n < 3 else ("-", 6)
    if panel.beside is not None:
        above.plot(panel.x, panel.beside, line, color=_BESIDE, lw=1.0, ms=size, label="measured")
    above.plot(panel.x, panel.reference, line, color=_REFERENCE, lw=1.4, ms=size, label=panel.reference_name)
    above.plot(panel.x, panel.measured, ".", color=_MEASURED, ms=5 if n < 40 else 3, label="simulation")
    if panel.limits is not None:
        above.set_ylim(*panel.limits)
    above.set_title("\n".join(textwrap.wrap(panel.title, _TITLE_WIDTH)), fontsize=9, parse_math=False)
    above.legend(fontsize=7)
    above.grid(alpha=0.3)
    above.tick_params(labelsize=7, labelbottom=False)
    below.axhspan(-panel.tolerance, panel.tolerance, color=_TOLERANCE, lw=0)
    below.plot(panel.x, panel.deviation, ".", color=_MEASURED, ms=3)
    below.set_ylim(-panel.reach, panel.reach)
    below.grid(alpha=0.3)
    below.tick_params(labelsize=7)


# most pulses and samples drawn; blocks of more are drawn by their strongest sample
_MOST = 1000
# dB from black to white
_ECHO_SPAN_DB = 50.0


def echoes_figure(raw: RawData, channel: str | None = None) -> Figure:
    """Draw the level of one channel (default: the first), dB of the strongest sample; first pulse below.

    Blocks of samples that share a pixel of the picture are drawn by the strongest. The axis of range is that of the
    first pulse; windows of later pulses may start elsewhere, which bends the echoes of a point.

    Parameters
    ----------
    raw : range-compressed or chirped echoes
    channel : polarisation; None: the first
    """
    name = channel or raw.channels[0]
    power = np.square(np.abs(raw.total(name)))
    rows, columns = (-(-n // _MOST) for n in power.shape)
    padded = np.pad(power, [(0, -power.shape[0] % rows), (0, -power.shape[1] % columns)])
    strongest = padded.reshape(padded.shape[0] // rows, rows, -1, columns).max(axis=(1, 3))
    level = db_from_power(strongest / max(float(strongest.max()), 1e-300))
    window, radar = raw.radar.window, raw.radar
    first = float(window.start_range[0])
    if raw.domain == "compressed":
        start, step, label = first, window.sample_spacing, "slant range (m)"
    else:
        start = 1e6 * (2.0 * first / SPEED_OF_LIGHT - 0.5 * radar.waveform.pulse_width)
        step, label = 1e6 / window.sampling_rate, "time after transmission (us)"
    figure = Figure(figsize=(6.4, 4.2), dpi=100, layout="constrained")
    axes = figure.add_subplot()
    extent = (start, start + step * padded.shape[1], 0.0, float(padded.shape[0]))
    shown = axes.imshow(
        np.maximum(level, -_ECHO_SPAN_DB),
        cmap="gray",
        vmin=-_ECHO_SPAN_DB,
        vmax=0.0,
        extent=extent,
        aspect="auto",
        origin="lower",
        interpolation="nearest",
    )
    axes.set(xlabel=label, ylabel="pulse")
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.set_title(f"{name}, {raw.domain} echoes", fontsize=9, parse_math=False)
    figure.colorbar(shown, ax=axes, label="dB of the strongest sample")
    return figure


_PANEL = 3.2  # inches
_LARGEST = 1600  # pixels of a panel's image, more are averaged
_SPAN_DB = 60.0


def focusers_figure(results: Sequence[FocuserResult]) -> Figure:
    """Draw one column per focuser: its image above, its difference from the first one below, on the same scales.

    A focuser that cannot focus the data has its reason in place of the pictures.
    """
    reference = results[0].image
    assert reference is not None
    limits = prepare(reference, PictureOptions(span_db=_SPAN_DB), _LARGEST).limits
    options = PictureOptions(limits=limits)
    # the difference is shown down to float32 rounding
    peak = db_from_power(np.abs(reference.total()).max() ** 2)
    grid = reference.grid
    extent = ShownAxes.of(grid).extent(grid)
    figure = Figure(figsize=(_PANEL * len(results), 2.0 * _PANEL), dpi=100, layout="constrained")
    panels = figure.subplots(2, len(results), squeeze=False)
    difference = None
    for result, (above, below) in zip(results, panels.T, strict=True):
        if result.image is None:
            above.set_axis_off()
            below.set_axis_off()
            above.set_title(f"{result.name}: refused", fontsize=8, parse_math=False)
            above.text(
                0.5,
                0.9,
                textwrap.fill(result.refusal, 34),
                ha="center",
                va="top",
                fontsize=8,
                parse_math=False,
            )
            continue
        draw(result.image, above, options)
        above.set_title(f"{result.name}, {result.seconds:.2g} s", fontsize=8, parse_math=False)
        if math.isinf(result.error_db):
            below.set_axis_off()
            below.text(0.5, 0.5, "reference", ha="center", fontsize=8)
            continue
        apart = np.abs(result.image.total().astype(np.complex128) - reference.total()) ** 2
        difference = below.imshow(
            np.maximum(db_from_power(apart) - peak, -140.0),
            extent=extent,
            origin="lower",
            cmap="magma",
            vmin=-140.0,
            vmax=0.0,
            aspect="equal",
            interpolation="nearest",
        )
        below.set_title(
            f"difference: {result.error_db:.1f} dB, coherence {result.coherence:.6f}",
            fontsize=8,
            parse_math=False,
        )
    if difference is not None:
        bar = figure.colorbar(difference, ax=panels[1].tolist(), shrink=0.8)
        bar.set_label("difference, dB of the brightest pixel", fontsize=8)
    return figure


# inches: width of the figure, height of one of three pictures, and height of title and colour bar, of the title alone
_WIDTH, _PICTURE, _AROUND, _TITLE = 14.0, 4.2, 1.4, 0.5


def side_by_side(pictures: Sequence[tuple[str, SarImage, PictureOptions]], title: str = "") -> Figure:
    """Draw images of one grid with their titles and options, and a title of one or more lines above all.

    Raises
    ------
    DataError : an option does not fit an image
    """
    grid = pictures[0][1].grid
    ratio = grid.shape[0] * grid.azimuth_spacing / (grid.shape[1] * grid.range_spacing)
    picture = _PICTURE * 3.0 / max(len(pictures), 2)
    height = _AROUND + picture * float(np.clip(ratio, 0.3, 1.6)) + (_TITLE if title else 0.0)
    room = (0.0, 0.0, 1.0, 1.0 - 0.5 * (_TITLE / height if title else 0.0))
    figure = Figure(figsize=(_WIDTH, height), dpi=100, layout=ConstrainedLayoutEngine(rect=room))
    for axes, (name, image, options) in zip(figure.subplots(1, len(pictures)), pictures, strict=True):
        bar = figure.colorbar(draw(image, axes, options), ax=axes, orientation="horizontal", shrink=0.8)
        bar.set_label(prepare(image, options, LARGEST).label, fontsize=8)
        axes.set_title(name, fontsize=10, parse_math=False)
    if title:
        figure.suptitle(title, fontsize=9, parse_math=False)
    return figure


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


_MOST_POINTS = 6  # most points whose response is drawn
_FLOOR_DB = -50.0
_REACH, _STEPS = 8.0, 401  # half the length of a cut, in widths of the response, and its samples


def quality_figure(image: SarImage, report: QualityReport, frame: str | None = None) -> Figure:
    """Draw the image with points and areas marked, and cuts through the first six points.

    ``frame`` is that of the image's axes, see :class:`sarmitsuba.signal.image.ShownAxes`.
    """
    shown = report.points[:_MOST_POINTS]
    figure = Figure(
        figsize=(6.6 + (4.8 if shown else 0.0), max(5.0, 1.7 * len(shown))), dpi=100, layout="constrained"
    )
    grid = figure.add_gridspec(
        max(len(shown), 1), 3 if shown else 1, width_ratios=[2, 1, 1] if shown else [1]
    )
    axes = figure.add_subplot(grid[:, 0])
    options = PictureOptions(channel=report.channel, axes=frame)
    bar = figure.colorbar(draw(image, axes, options), ax=axes, fraction=0.046, pad=0.02)
    bar.set_label(quantity_label(image, options.quantity), fontsize=8)
    bar.ax.tick_params(labelsize=7)
    shown_axes = ShownAxes.of(image.grid, frame)
    for point in report.points:
        across, up = shown_axes.shown(point.azimuth, point.range)
        place = (float(across), float(up))
        axes.plot(*place, "o", markersize=9, markerfacecolor="none", color="tab:red")
        _mark(axes, point.name, place, "tab:red")
    for area in report.areas:
        x, y = shown_axes.shown(np.array(area.azimuth), np.array(area.range))
        corner, size = (float(x[0]), float(y[0])), (float(np.diff(x)[0]), float(np.diff(y)[0]))
        axes.add_patch(Rectangle(corner, *size, fill=False, color="tab:blue"))
        middle = (corner[0] + 0.5 * size[0], corner[1] + 0.5 * size[1])
        _mark(axes, f"{area.name}: ENL {area.enl:.2f}", middle, "tab:blue")
    for i, point in enumerate(shown):
        for column, axis in ((1, "azimuth"), (2, "range")):
            _response(figure.add_subplot(grid[i, column]), image, report.channel, point, axis)
    return figure


def _mark(axes: Axes, text: str, place: tuple[float, float], colour: str) -> None:
    """Write a name beside a place, on the side that has more room within the axes."""
    sides = []
    for value, (first, last) in zip(place, (axes.get_xlim(), axes.get_ylim()), strict=True):
        sides.append(-1 if (value - first) / (last - first) > 0.5 else 1)
    axes.annotate(
        text,
        place,
        xytext=(8 * sides[0], 8 * sides[1]),
        textcoords="offset points",
        ha="left" if sides[0] > 0 else "right",
        va="bottom" if sides[1] > 0 else "top",
        color=colour,
        fontsize=7,
        parse_math=False,
        bbox={"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1.0},
    )


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
