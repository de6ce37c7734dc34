"""Munich as several radars see it: Pauli colours, fringes and heights of runs that munich_heights.py made.

    for radar in airborne_x terrasar_spotlight iceye_spotlight; do
        python -m benchmarks.studies.munich_heights --radar $radar -o out/$radar -D polarisation=VV,HH,HV,VH ...
    done
    python -m benchmarks.studies.munich_presets out/airborne_x out/terrasar_spotlight out/iceye_spotlight -o m.png

Prints how far the recovered heights of buildings are off the mesh: median and spread of blocks and of buildings.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.support import harness  # noqa: F401  the package beside this folder
from sarmitsuba.analysis.interferometry import height_map, interferogram
from sarmitsuba.analysis.polarimetry import automatic_looks, coherency, pauli_rgb, quad_pol
from sarmitsuba.files import read_image

LEAST_COHERENCE = 0.5
HEIGHTS = (-5.0, 40.0)  # m, ends of the colours


def column(figure: Figure, place: int, count: int, run: Path) -> None:
    """Draw one run, and print its figures."""
    record = json.loads((run / "munich_heights.json").read_text(encoding="utf-8"))
    first, second = read_image(run / "first" / "image.h5"), read_image(run / "second_on_first.h5")
    pair = interferogram(first, second)
    heights = height_map(pair, lowest=HEIGHTS[0])
    colours = pauli_rgb(coherency(quad_pol(first), automatic_looks(first, 1.0)))
    brightness = np.sqrt(pair.powers[0] * pair.powers[1])
    decibels = 10.0 * np.log10(np.maximum(brightness, 1e-30))
    shade = np.clip(1.0 + (decibels - np.percentile(decibels, 98.0)) / 30.0, 0.0, 1.0)
    fringes = colormaps["hsv"]((pair.phase + np.pi) / (2.0 * np.pi))[..., :3] * shade[..., None]
    shown = np.where(pair.coherence >= LEAST_COHERENCE, heights.z, np.nan)
    grid = first.grid
    extent = (grid.range[0], grid.range[-1], grid.azimuth[0], grid.azimuth[-1])
    for row, (picture, name) in enumerate(
        ((colours, "Pauli basis"), (fringes, "fringes over amplitude"), (shown, "height (m)"))
    ):
        axes = figure.add_subplot(3, count, row * count + place + 1)
        drawn = axes.imshow(picture, origin="lower", extent=extent, interpolation="nearest", aspect="auto")
        if row == 2:
            drawn.set_clim(*HEIGHTS)
            axes.set_facecolor("0.75")
            figure.colorbar(drawn, ax=axes, shrink=0.8)
        axes.set_title(f"{record['radar']}\n{name}" if row == 0 else name, fontsize=9)
        axes.tick_params(labelsize=7)
        axes.ticklabel_format(useOffset=False)
        axes.locator_params(nbins=4)
    blocks, buildings = record["blocks"], record["buildings"]
    print(
        f"{record['radar']:20s} blocks: median {blocks['median_m']:6.2f} m, spread {blocks['spread_m']:5.2f} m "
        f"({blocks['count']}); buildings: median {buildings['median_m']:6.2f} m, spread {buildings['spread_m']:5.2f} m "
        f"({buildings['count']})"
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", nargs="+", type=Path, help="folders that munich_heights.py wrote, quad-pol")
    parser.add_argument("-o", "--output", type=Path, required=True, help="PNG file")
    args = parser.parse_args()
    figure = Figure(figsize=(4.2 * len(args.runs), 12.0), dpi=90, layout="constrained")
    for place, run in enumerate(args.runs):
        column(figure, place, len(args.runs), run)
    FigureCanvasAgg(figure).print_figure(args.output)
    print(args.output)


if __name__ == "__main__":
    main()
