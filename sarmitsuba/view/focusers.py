"""Images of all focusers side by side, with their differences from the reference."""

import math
import textwrap
from collections.abc import Sequence

import numpy as np

from sarmitsuba.core.units import db_from_power
from sarmitsuba.signal.focusing.focuser_comparison import FocuserResult
from sarmitsuba.signal.image.shown_axes import ShownAxes
from sarmitsuba.view.display import PictureOptions, prepare
from sarmitsuba.view.figure import Figure
from sarmitsuba.view.quicklook import draw

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
    peak = float(db_from_power(np.abs(reference.total()).max() ** 2))
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
