"""One picture a validation case: theory as a line, simulation as points, the deviation below."""

from pathlib import Path

import numpy as np

from sarmitsuba.validation.comparison import Case, Comparison

_COLUMNS = 4
_THEORY, _SIMULATED, _TOLERANCE = "0.45", "tab:red", "0.88"


def plot_case(case: Case, path: Path) -> None:
    """Write the plot of a case as PNG; one panel a comparison, curve above and deviation below."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    n = len(case.comparisons)
    columns = min(_COLUMNS, n)
    rows = -(-n // columns)
    figure = Figure(figsize=(4.0 * columns + 0.4, 3.6 * rows + 0.5), dpi=70, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2 * rows, columns, height_ratios=[2.2, 1.0] * rows)
    for i, comparison in enumerate(case.comparisons):
        row, column = divmod(i, columns)
        above = figure.add_subplot(grid[2 * row, column])
        below = figure.add_subplot(grid[2 * row + 1, column], sharex=above)
        _panel(above, below, comparison)
        above.set_title(_wrapped(comparison.label), fontsize=9)
        if column == 0:
            above.set_ylabel(case.y_label, fontsize=8)
            below.set_ylabel("deviation", fontsize=8)
        if row == rows - 1:
            below.set_xlabel(case.x_label, fontsize=8)
    figure.suptitle(case.title, fontsize=11)
    figure.savefig(path, metadata={"Software": None})


def _panel(above: object, below: object, c: Comparison) -> None:
    """Curve and deviation of one comparison."""
    from typing import Any, cast

    a, b = cast(Any, above), cast(Any, below)
    single = c.x.size < 3
    a.plot(c.x, c.theory, "_" if single else "-", color=_THEORY, lw=1.4, ms=16, label="theory")
    a.plot(c.x, c.simulated, ".", color=_SIMULATED, ms=5 if c.x.size < 40 else 3, label="simulation")
    shown = c.theory[c.compared]
    if c.unit in ("dBsm", "dB") and np.isfinite(c.floor) and shown.size:
        a.set_ylim(shown.max() - 1.3 * c.floor, shown.max() + 0.1 * c.floor)
    else:
        # a curve that is flat must not be blown up to its rounding
        both = np.concatenate([c.theory[c.compared], c.simulated[c.compared]])
        pad = max(0.08 * float(np.ptp(both)), c.tolerance) if both.size else 1.0
        if both.size and np.isfinite(both).all():
            a.set_ylim(both.min() - pad, both.max() + pad)
    a.legend(fontsize=7)
    a.grid(alpha=0.3)
    a.tick_params(labelsize=7, labelbottom=False)
    b.axhspan(-c.tolerance, c.tolerance, color=_TOLERANCE, lw=0)
    b.plot(c.x, c.deviation, ".", color=_SIMULATED, ms=3)
    b.set_ylim(-1.3 * max(c.tolerance, min(c.worst, 1e9)), 1.3 * max(c.tolerance, min(c.worst, 1e9)))
    b.grid(alpha=0.3)
    b.tick_params(labelsize=7)


def _wrapped(text: str, width: int = 44) -> str:
    import textwrap

    return "\n".join(textwrap.wrap(text, width))


__all__ = ["plot_case"]
