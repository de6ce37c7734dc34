"""Bar charts of the account of an image: error by cause and seconds by stage."""

import math
import textwrap
from collections.abc import Sequence

from matplotlib.axes import Axes

from sarmitsuba.analysis.quality.account import Account, likely_total_db
from sarmitsuba.analysis.quality.error_budget import BOUND, LAW, MEASURED, ErrorPart
from sarmitsuba.view.figure import Figure

_DPI = 100.0
# screen pixels: of a bar, around the bars, and of the names
_ROW, _TOP, _BOTTOM, _NAMES, _BARS, _VALUES, _LINE = 22, 34, 46, 124, 190, 350, 15
_LETTERS = 190  # of a line below the charts
_WALL, _PROCESSOR = "#8c5a1c", "#e3c08f"
# by kind of figure: a law, which nothing in this run confirmed, is grey; a measurement that contradicts its law is red
_KINDS = {MEASURED: "#1f5f99", BOUND: "#a9c8e4", LAW: "#b5b5b5"}
_CONTRADICTED = "#b3261e"
_SMALL = 8
# stages shorter than this share of the whole are summed up as "other"
_LEAST = 0.01


def account_figure(account: Account, title: str = "") -> Figure:
    """Two charts: what the error is made of, and where the time went.

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
    width, height = 2 * (_NAMES + _BARS + _VALUES), _TOP + _ROW * rows + foot
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    left, right = (
        figure.add_axes(
            (
                (_NAMES + i * width / 2) / width,
                (foot + _ROW * (rows - n)) / height,
                _BARS / width,
                _ROW * n / height,
            )
        )
        for i, n in enumerate((len(account.parts), len(stages)))
    )
    _errors(left, account)
    _times(right, stages)
    total = "none known"
    if math.isfinite(account.total_db):
        total = f"{account.total_db:.1f} dB of the image ({account.kind})"
    figure.text(8 / width, 1 - 18 / height, f"{title}error by cause: {total}", fontsize=9, parse_math=False)
    elapsed = sum(stage[1] for stage in stages)
    figure.text(
        0.5 + 8 / width, 1 - 18 / height, f"time by stage: {elapsed:.3g} s", fontsize=9, parse_math=False
    )
    for i, line in enumerate(reversed(notes)):
        figure.text(8 / width, (6 + _LINE * i) / height, line, fontsize=_SMALL, parse_math=False)
    return figure


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
        "share of the known error energy, %; light: bound, grey: law, red: contradicts its law",
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
    return float(10.0 ** (0.1 * (part.weight_db - total_db)))


def _value(part: ErrorPart, share: float) -> str:
    return part.value if not share else f"{part.value} ({_percent(share)})"


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
