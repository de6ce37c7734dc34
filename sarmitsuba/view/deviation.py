"""Plots of curves against their reference: reference as a line, measured values as points, deviation below."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64

if TYPE_CHECKING:
    from matplotlib.axes import Axes


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
