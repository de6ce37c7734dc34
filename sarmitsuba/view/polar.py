"""Radar cross section over aspect: a polar plot for wide sweeps, else decibels over the angle."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.projections.polar import PolarAxes

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.view.figure import Figure

# smallest sweep drawn in polar axes, deg
POLAR_FROM = 90.0
# curves weaker than the strongest by more than this are not drawn, dB
SPAN_DB = 60.0
# radius of the hole in the middle of polar axes, over the length of the scale
_HOLE = 0.25
# size of the note below the panels, points, and its letters an inch, with a margin
_NOTE_SIZE, _LETTERS = 7.5, 16


@dataclass(frozen=True, eq=False)
class AspectCurves:
    """Radar cross sections of one channel over the swept angle.

    Parameters
    ----------
    title : above the panel
    total : (n,) dBsm
    parts : (n,) dBsm by name, such as ``2 bounces``
    name : of the total
    """

    title: str
    total: F64
    parts: Mapping[str, F64]
    name: str = "sum"


def aspect_figure(
    angle_deg: F64,
    curves: Sequence[AspectCurves],
    *,
    swept: str,
    title: str,
    note: str = "",
    span_db: float = SPAN_DB,
) -> Figure:
    """Draw one panel per channel, its bounce orders in colour below the black total.

    Parameters
    ----------
    angle_deg : (n,) swept angle, ascending; 0 to the right, counted counter-clockwise
    curves : of every channel
    swept : name of the angle, ``azimuth`` or ``elevation``
    title : first line
    note : below the panels, such as the statement of the error
    span_db : from the centre or bottom of the plot to the strongest return

    Raises
    ------
    DataError : all returns of all channels are zero
    """
    finite = [c.total[np.isfinite(c.total)] for c in curves]
    if not any(v.size for v in finite):
        raise DataError("RCS: zero in all directions and channels; nothing to draw")
    top = 5.0 * float(np.ceil(max(float(v.max()) for v in finite if v.size) / 5.0))
    polar = float(np.ptp(angle_deg)) >= POLAR_FROM
    size = (6.2 * len(curves), 7.0) if polar else (8.0, 3.4 * len(curves) + 0.6)
    figure = Figure(figsize=size, dpi=100, layout="constrained")
    figure.suptitle(title, fontsize=10, parse_math=False)
    if note:
        below = textwrap.fill(note, round(_LETTERS * size[0]))
        figure.supxlabel(below, fontsize=_NOTE_SIZE, parse_math=False)
    for i, one in enumerate(curves):
        place = (1, len(curves), i + 1) if polar else (len(curves), 1, i + 1)
        axes = figure.add_subplot(*place, projection="polar" if polar else None)
        around, *lines = _close_curves(angle_deg, [one.total, *one.parts.values()], whole=polar)
        x = np.radians(around) if polar else around
        for name, line in zip((one.name, *one.parts), lines, strict=True):
            if np.isfinite(line).any() and line.max() >= top - span_db:
                style = {"color": "black", "linewidth": 1.3} if name == one.name else {"linewidth": 0.8}
                axes.plot(x, np.maximum(line, top - span_db), label=name, **style)
        axes.set_ylim(top - span_db, top)
        axes.set_title(
            f"{one.title}, dBsm over {swept}" if polar else one.title, fontsize=9, parse_math=False
        )
        axes.tick_params(labelsize=8)
        axes.grid(True, linewidth=0.3)
        if isinstance(axes, PolarAxes):
            axes.set_rorigin(top - (1.0 + _HOLE) * span_db)
            axes.set_rlabel_position(67.5)
        else:
            axes.set_xlabel(f"{swept} (deg)", fontsize=9)
            axes.set_ylabel("RCS (dBsm)", fontsize=9)
            axes.set_xlim(float(angle_deg.min()), float(angle_deg.max()))
        axes.legend(fontsize=7, loc="lower right", bbox_to_anchor=(1.08, -0.06) if polar else None)
    return figure


def _close_curves(angle: F64, lines: Sequence[F64], *, whole: bool) -> list[F64]:
    """Angle and curves, with the first point repeated at the end if uniformly spaced angles cover the full circle."""
    n = angle.size
    if not whole or float(np.ptp(angle)) * n / (n - 1) < 360.0 - 1e-6:
        return [angle, *lines]
    return [np.append(angle, angle[0] + 360.0), *(np.append(line, line[0]) for line in lines)]
