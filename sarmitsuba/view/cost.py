"""Plots of error against time."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sarmitsuba.machine.atomic import atomic_path

if TYPE_CHECKING:
    from sarmitsuba.view.figure import Figure

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
    axes.set_xlabel("processor time, whole scene (s)")
    axes.set_ylabel("error of the image (dB)")
    axes.set_title(title, parse_math=False)
    axes.grid(alpha=0.3, which="both")
    axes.legend()
    return figure


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a PNG file, completely or not at all."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=120)
