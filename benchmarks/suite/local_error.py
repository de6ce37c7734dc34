"""The map of the local error that one run states, against the true local error, over drawn scenes."""

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.support import denser_runs, harness

# scenes of boxes on ground, drawn by seed: no constant was chosen with them
FIRST, COUNT = 430, 21
# edge of a place, resolution cells
PLACE = 10.0


@harness.benchmark
def run(quick: bool) -> harness.Report:
    report = harness.Report(
        "local_error",
        "Local error",
        f"Rms sampling error over places of {PLACE:g} x {PLACE:g} resolution cells: as the map of one "
        f"run states it, over the truth "
        f"(distance to the median of {denser_runs.DENSER_RUNS} runs of {2**denser_runs.DENSER} times the rays). "
        "Boxes on ground, drawn by seed; `lit`: more than a hundredth of the mean error energy.",
    )
    ratios, lit, rows = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(FIRST, FIRST + (2 if quick else COUNT)):
            found = _compared(seed, Path(folder) / str(seed))
            if found is None:
                continue
            ratio, bright = found
            ratios.append(ratio)
            lit.append(bright)
            rows.append([seed, ratio.size, *_figures(ratio), *_figures(ratio[bright])])
            print(*rows[-1], file=sys.stderr, flush=True)
    every, bright = np.concatenate(ratios), np.concatenate(lit)
    rows.append(["all", every.size, *_figures(every), *_figures(every[bright])])
    head = ["median dB", "within a factor 2", "too small by more"]
    report.table("", ["seed", "places", *head, *(f"lit: {name}" for name in head)], rows)
    report.data["ratios_db"] = every.tolist()
    report.claim(
        "places within a factor 2",
        100.0 * float(np.mean(np.abs(every) <= 20.0 * np.log10(2.0))),
        90.0,
        at_least=True,
        unit="%",
    )
    report.claim(
        "lit places within a factor 2",
        100.0 * float(np.mean(np.abs(every[bright]) <= 20.0 * np.log10(2.0))),
        90.0,
        at_least=True,
        unit="%",
    )
    return report


def _figures(ratio_db: "np.ndarray[Any, np.dtype[np.float64]]") -> list[str]:
    """Median ratio, and shares of places within a factor 2 and below it."""
    if not ratio_db.size:
        return ["-", "-", "-"]
    twice = 20.0 * np.log10(2.0)
    within, below = np.mean(np.abs(ratio_db) <= twice), np.mean(ratio_db < -twice)
    return [f"{np.median(ratio_db):+.1f}", f"{100 * within:.0f} %", f"{100 * below:.0f} %"]


def _compared(seed: int, folder: Path) -> "tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]] | None":
    """Stated over true rms error of every place, dB, and which places are lit; None where it would cost too much."""
    from sarmitsuba.signal.image import block_means
    from sarmitsuba.simulation.execution.error_bars import error_bars as local_errors
    from sarmitsuba.simulation.execution.raw import echoes
    from sarmitsuba.simulation.execution.run import Run
    from tests.support.unweighted import focus

    scene = denser_runs.drawn_scene(seed, folder)
    if scene is None:
        return None
    # bounces and blocks of pulses as in the truth: their error is not the rays'
    scene = harness.with_settings(scene, max_depth=Run(scene).plan.max_depth, keep_subsets=True)
    image = focus(echoes(Run(scene)), request=scene.image)
    reference = denser_runs.converged(Run(scene).at(2.0 ** (-0.5 * denser_runs.DENSER)), image.grid)
    grid = image.grid
    edge = tuple(
        max(1, round(PLACE * cell / step))
        for cell, step in (
            (image.azimuth_resolution_cell, grid.azimuth_spacing),
            (image.range_resolution_cell, grid.range_spacing),
        )
    )
    channel = image.channels[0]
    true = block_means(np.abs(image.total(channel) - reference) ** 2, edge)
    stated = block_means(np.asarray(local_errors(image, window=1).per_pixel[0], np.float64) ** 2, edge)
    some = (true > 0.0) & (stated > 0.0)
    return 10.0 * np.log10(stated[some] / true[some]), true[some] > 0.01 * true.mean()


if __name__ == "__main__":
    harness.main(run)
