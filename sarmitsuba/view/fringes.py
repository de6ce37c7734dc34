"""Pictures of an interferogram: fringes over amplitude, coherence, heights; range to the right, azimuth up."""

from collections.abc import Callable

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.image import AxesImage

from sarmitsuba.analysis.interferometry import HeightMap, Interferogram
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import db_from_power
from sarmitsuba.signal.image import ShownAxes
from sarmitsuba.view.figure import Figure, RoomyTicks

_CYCLIC = "hsv"
# brightness of the fringes: amplitude of black below white, dB; percentile of white
_SPAN_DB, _WHITE = 30.0, 98.0
# heights of less coherent blocks are not shown
LEAST_COHERENCE = 0.3


def interferogram_figure(pair: Interferogram, map_: HeightMap | None = None, *, title: str = "") -> Figure:
    """Draw fringes, coherence and, if given, the height map, side by side.

    Parameters
    ----------
    pair : the interferogram
    map_ : its heights; dark blocks (shadow) and those of a coherence below 0.3 are grey
    title : first line above the pictures
    """
    panels: list[Callable[[Figure, Axes], None]] = [
        lambda figure, axes: _phase(figure, axes, pair),
        lambda figure, axes: _coherence(figure, axes, pair),
    ]
    if map_ is not None:
        heights = map_
        panels.append(lambda figure, axes: _heights(figure, axes, pair, heights))
    grid = pair.grid
    shown = ShownAxes.of(grid)
    shape = grid.shape[0] * grid.azimuth_spacing / (grid.shape[1] * grid.range_spacing)
    width = 5.0
    height = width * float(np.clip(shape, 0.4, 1.6)) + 0.9
    figure = Figure(figsize=(width * len(panels), height), dpi=100, layout="constrained")
    for axes, draw in zip(np.ravel(figure.subplots(1, len(panels), sharey=True)), panels, strict=True):
        draw(figure, axes)
        axes.set_xlabel(shown.range_label)
        axes.ticklabel_format(useOffset=False, style="plain")
        axes.tick_params(labelsize=8)
        axes.xaxis.set_major_locator(RoomyTicks())
        if axes.get_subplotspec().is_first_col():
            axes.set_ylabel(shown.azimuth_label)
    b = pair.baseline
    lines = [
        title,
        f"{pair.channel}, {pair.kind}, perpendicular baseline "
        f"{b.perpendicular:.4g} m of {b.critical:.4g} m critical, height of ambiguity {b.height_of_ambiguity:.4g} m, "
        f"{pair.independent_looks:.3g} looks",
    ]
    figure.suptitle("\n".join(line for line in lines if line), fontsize=9, parse_math=False)
    return figure


def _phase(figure: Figure, axes: Axes, pair: Interferogram) -> None:
    colours = matplotlib.colormaps[_CYCLIC]((pair.phase + np.pi) / (2.0 * np.pi))[..., :3]
    _show(axes, pair, colours * _brightness(pair)[..., None])
    scale = ScalarMappable(Normalize(-np.pi, np.pi), _CYCLIC)
    bar = figure.colorbar(scale, ax=axes, ticks=[-np.pi, 0.0, np.pi], shrink=0.8)
    bar.ax.set_yticklabels(["-pi", "0", "pi"])
    axes.set_title("phase (rad), brightness from the amplitude", fontsize=9)


def _brightness(pair: Interferogram) -> F64:
    """Brightness 0 ... 1 from the amplitude, linear in decibels."""
    power = np.sqrt(pair.powers[0] * pair.powers[1])
    lit = power[power > 0.0]
    white = float(np.percentile(lit, _WHITE)) if lit.size else 1.0
    return np.asarray(np.clip(1.0 + db_from_power(power / white) / _SPAN_DB, 0.0, 1.0))


def _coherence(figure: Figure, axes: Axes, pair: Interferogram) -> None:
    shown = _show(axes, pair, pair.coherence, cmap="gray", vmin=0.0, vmax=1.0)
    figure.colorbar(shown, ax=axes, shrink=0.8)
    axes.set_title("coherence", fontsize=9)


def _heights(figure: Figure, axes: Axes, pair: Interferogram, map_: HeightMap) -> None:
    z = np.where((map_.coherence >= LEAST_COHERENCE) & (_brightness(pair) > 0.0), map_.z, np.nan)
    known = z[np.isfinite(z)]
    low, high = np.percentile(known, (1.0, 99.0)) if known.size else (0.0, 1.0)
    axes.set_facecolor("0.75")
    shown = _show(axes, pair, z, cmap="viridis", vmin=float(low), vmax=float(high))
    figure.colorbar(shown, ax=axes, shrink=0.8)
    axes.set_title(
        f"height (m)\ngrey: shadow, dark, or coherence below {LEAST_COHERENCE:g}",
        fontsize=9,
        parse_math=False,
    )


def _show(
    axes: Axes,
    pair: Interferogram,
    values: F64,
    cmap: str | None = None,
    vmin: float | None = None,
    vmax: float | None = None,
) -> AxesImage:
    grid = pair.grid
    return axes.imshow(
        values,
        origin="lower",
        extent=ShownAxes.of(grid).extent(grid),
        interpolation="none",
        cmap=cmap,
        vmin=vmin,
        vmax=vmax,
        aspect="equal",
    )
