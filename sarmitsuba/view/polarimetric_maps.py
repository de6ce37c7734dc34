"""Pictures of polarimetry: colour composites, maps of H, A and alpha, and the entropy-alpha plane."""

import textwrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from sarmitsuba.analysis.polarimetry import (
    ALPHA_BOUNDS_DEG,
    ENTROPY_BOUNDS,
    SPAN_DB,
    CloudePottier,
    PolarimetryReport,
)
from sarmitsuba.core.arrays import F64, U8
from sarmitsuba.signal.image import SarImage, ShownAxes
from sarmitsuba.view.figure import Figure, RoomyTicks

_ZONE_PLACES = {1: (0.95, 72.0), 2: (0.95, 47.0), 4: (0.7, 80.0), 5: (0.7, 45.0), 6: (0.7, 10.0)} | {
    7: (0.25, 80.0),
    8: (0.06, 45.0),
    9: (0.25, 10.0),
}
# longer side of a map, inches
_LONGEST, _LONGEST_OF_SEVERAL = 7.0, 4.3
# letters an inch of a title of 8 points, with a margin
_LETTERS = 14


def composite_figure(image: SarImage, colours: U8, looks: tuple[int, int], title: str, legend: str) -> Figure:
    """Colour composite of blocks of an image.

    Parameters
    ----------
    image : whose grid is used
    colours : (rows, columns, 3) uint8, rows azimuth, first row the lowest
    looks : pixels (azimuth, range) of a block
    title, legend : above the picture; meaning of red, green and blue
    """
    figure = _figure(image, 1)
    axes = figure.add_subplot()
    axes.imshow(
        colours,
        extent=ShownAxes.of(image.grid).extent(image.grid, looks),
        origin="lower",
        interpolation="nearest",
    )
    _labels(axes, image)
    first = str(image.metadata.get("scene", ""))
    brightness = f"brightness: {SPAN_DB:g} dB of the sum,  blocks of {looks[0]} x {looks[1]} pixels"
    letters = int(_LETTERS * figure.get_figwidth())
    lines = [part for line in (first, title, legend, brightness) for part in textwrap.wrap(line, letters)]
    figure.suptitle("\n".join(lines), fontsize=8, parse_math=False)
    return figure


def maps_figure(image: SarImage, report: PolarimetryReport) -> Figure:
    """Maps of entropy, anisotropy and mean alpha side by side; the report needs quad-pol channels."""
    assert report.decomposition is not None
    d = report.decomposition
    figure = _figure(image, 3)
    panels = (
        ("entropy H", d.entropy, 1.0),
        ("anisotropy A", d.anisotropy, 1.0),
        ("mean alpha (deg)", np.degrees(d.alpha), 90.0),
    )
    for i, (name, values, top) in enumerate(panels):
        axes = figure.add_subplot(1, 3, i + 1)
        picture = axes.imshow(
            values,
            cmap="turbo",
            vmin=0.0,
            vmax=top,
            extent=ShownAxes.of(image.grid).extent(image.grid, report.looks),
            origin="lower",
            interpolation="nearest",
        )
        _labels(axes, image)
        axes.set_title(name, fontsize=9, parse_math=False)
        figure.colorbar(picture, ax=axes, fraction=0.046, pad=0.03).ax.tick_params(labelsize=7)
    scene = str(image.metadata.get("scene", ""))
    blocks = f"blocks of {report.looks[0]} x {report.looks[1]} pixels"
    figure.suptitle(",  ".join(part for part in (scene, blocks) if part), fontsize=9, parse_math=False)
    return figure


def plane_figure(decomposition: CloudePottier) -> Figure:
    """Density of blocks in the entropy-alpha plane, with its zones and the bounds of feasible values."""
    figure = Figure(figsize=(6.4, 4.6), dpi=110, layout="constrained")
    axes = figure.add_subplot()
    lit = np.isfinite(decomposition.entropy)
    counts, x, y = np.histogram2d(
        decomposition.entropy[lit],
        np.degrees(decomposition.alpha[lit]),
        bins=(100, 90),
        range=((0.0, 1.0), (0.0, 90.0)),
    )
    picture = axes.pcolormesh(
        x, y, np.where(counts > 0, counts, np.nan).T, norm=LogNorm(1, max(2.0, counts.max())), cmap="viridis"
    )
    figure.colorbar(picture, ax=axes, label="blocks")
    for bound in ENTROPY_BOUNDS:
        axes.axvline(bound, color="0.5", linewidth=0.7)
    edges = (0.0, *ENTROPY_BOUNDS, 1.0)
    for low, high, bounds in zip(edges[:-1], edges[1:], ALPHA_BOUNDS_DEG, strict=True):
        axes.hlines(bounds, low, high, color="0.5", linewidth=0.7)
    for number, place in _ZONE_PLACES.items():
        axes.text(*place, str(number), parse_math=False, fontsize=9, color="0.3", ha="center", va="center")
    for entropy, alpha in feasible_bounds():
        axes.plot(entropy, alpha, color="black", linewidth=1.0)
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 90.0)
    axes.set_xlabel("entropy H")
    axes.set_ylabel("mean alpha (deg)")
    return figure


def feasible_bounds(n: int = 200) -> tuple[tuple[F64, F64], tuple[F64, F64]]:
    r"""Lower and upper bound of alpha (deg) over entropy for all coherency matrices.

    Lower: ``T = diag(1, m, m)``, 0 <= m <= 1. Upper: ``diag(0, 1, 2 m)`` for m <= 1/2, then ``diag(2 m - 1, 1, 1)``
    up to 1 (Cloude and Pottier 1997, equations 21 and 22).
    """
    m = np.linspace(0.0, 1.0, n)
    lower = np.stack([np.ones(n), m, m])
    upper = np.where(
        m <= 0.5, np.stack([0.0 * m, 1.0 + 0.0 * m, 2.0 * m]), np.stack([2.0 * m - 1.0, m**0, m**0])
    )
    curves = []
    for values in (lower, upper):
        share = values / values.sum(axis=0)
        entropy = -np.sum(share * np.log(np.where(share > 0.0, share, 1.0)), axis=0) / np.log(3.0)
        curves.append((np.asarray(entropy), np.asarray(90.0 * (share[1] + share[2]))))
    return curves[0], curves[1]


def _figure(image: SarImage, panels: int) -> Figure:
    """Figure for maps of the image side by side, with margins for labels, colour bars and a title."""
    extents = np.array(image.grid.shape) * (image.grid.azimuth_spacing, image.grid.range_spacing)
    height, width = extents / extents.max() * (_LONGEST if panels == 1 else _LONGEST_OF_SEVERAL)
    beside, above = (0.6, 1.0) if panels == 1 else (1.1, 0.9)
    size = (panels * (max(width, 3.2 if panels == 1 else 2.4) + beside), max(height, 2.0) + above)
    return Figure(figsize=size, dpi=110, layout="constrained")


def _labels(axes: Axes, image: SarImage) -> None:
    shown = ShownAxes.of(image.grid)
    axes.set_xlabel(shown.range_label, fontsize=8)
    axes.set_ylabel(shown.azimuth_label, fontsize=8)
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.tick_params(labelsize=7)
    axes.xaxis.set_major_locator(RoomyTicks())
    axes.set_aspect("equal")
