"""Plot of a validation case."""

from pathlib import Path

import numpy as np

from sarmitsuba.truth.validation.comparison import Case, Comparison
from sarmitsuba.view.deviation import DeviationPanel, save_deviation


def plot_case(case: Case, path: Path) -> None:
    """Write the plot of a case as PNG; one panel per comparison, curve above and deviation below."""
    panels = [_panel(c) for c in case.comparisons]
    save_deviation(panels, path, title=case.title, x_label=case.x_label, y_label=case.y_label)


def _panel(c: Comparison) -> DeviationPanel:
    compared = c.compared
    in_db = c.unit in ("dBsm", "dB")
    return DeviationPanel(
        title=c.label,
        x=c.x,
        reference=c.theory,
        measured=c.simulated,
        compared=compared,
        tolerance=c.tolerance,
        reference_name=c.reference,
        beside=c.measured if c.measured is not None and np.isfinite(c.measured).any() else None,
        depth=c.drawn or (c.floor if in_db and np.isfinite(c.floor) and compared.any() else None),
    )
