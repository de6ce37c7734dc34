"""Factorised backprojection beside backprojection: processor seconds in one run, and the error between the images.

Usage: python benchmarks/suite/factorised.py [--quick] [-o FOLDER]

As many pulses as pixels along azimuth, two pixels per cell both ways, 10 km, X band, ground grid; echoes are noise that
fills the band, so that no sample is spared an error. Backprojection's own error is below -100 dB.
"""

import statistics
import time
from typing import Any

import _support
import harness
import numpy as np
from focusers import band_noise

from sarmitsuba.backend import ensure_backend
from sarmitsuba.focusing import default_grid
from sarmitsuba.focusing.factorised.division import Plan
from sarmitsuba.focusing.focuser import FocusTask
from sarmitsuba.focusing.focusers.backprojection import Backprojection
from sarmitsuba.focusing.focusers.factorised import Factorised
from sarmitsuba.focusing.ideal import ideal_radar
from sarmitsuba.focusing.windows import parse_window
from sarmitsuba.image.metrics import image_error_db
from sarmitsuba.progress import silent
from sarmitsuba.radar.image_request import ImageRequest

# pixels and pulses; plain backprojection grows with their cube: a minute and a half of one core for the last
SIZES, SIZES_QUICK = (1024, 2048, 4096), (512, 1024)
WANTED_DB = -45.0
# settings beside the automatic one, at the smallest size only
SETTINGS = (
    Factorised(error=WANTED_DB),
    Factorised(error=WANTED_DB, stages=2),
    Factorised(error=WANTED_DB, stages=3),
    Factorised(error=-60.0),
    Factorised(error=-75.0),
)
# of the factorised form; backprojection takes long enough for one to do
ROUNDS = 3
# a track's pulses per metre follow from the cell: 25 % more than its Doppler band
PRF_FACTOR, SLANT_RANGE, WAVELENGTH = 1.25, 10e3, 0.03123


def task_of(size: int) -> FocusTask:
    """Noise of ``size`` pulses, and as many pixels along both sides of an image."""
    cell = float(np.sqrt(0.5 * WAVELENGTH * SLANT_RANGE * PRF_FACTOR / size))
    radar = ideal_radar(
        slant_range=SLANT_RANGE,
        resolution=cell,
        bandwidth=150e6 / cell,
        n_samples=int(1.25 * size),
        prf_factor=PRF_FACTOR,
    )
    step = 0.5 * cell
    request = ImageRequest(
        grid="ground",
        extent_azimuth=step * (size - 1.5),
        extent_range=step * 2**0.5 * (size - 1.5),
        spacing_azimuth=step,
        spacing_range=step * 2**0.5,
    )
    window = parse_window("rectangular")
    return FocusTask(band_noise(radar), default_grid(radar, request), window, window, silent)


def rows_of(task: FocusTask, settings: tuple[Factorised, ...]) -> list[dict[str, Any]]:
    """Every setting beside backprojection of the same data."""
    radar, grid = task.raw.radar, task.grid
    start = time.process_time()
    exact = Backprojection().focus(task).pixels
    direct = time.process_time() - start
    rows = []
    for focuser in settings:
        plan = focuser.plan(radar, grid)
        assert isinstance(plan, Plan)
        seconds = []
        for _ in range(ROUNDS):
            start = time.process_time()
            image = focuser.focus(task).pixels
            seconds.append(time.process_time() - start)
        rows.append(
            {
                "size": grid.shape[0],
                "pulses": radar.track.n_pulses,
                "setting": ", ".join(f"{key}={value:g}" for key, value in focuser.options.items()),
                "sections": len(plan.sections),
                "stages": plan.merges + 2,
                "stated_db": focuser.error_db(radar, grid),
                "error_db": image_error_db(image, exact),
                "seconds": statistics.median(seconds),
                "direct_seconds": direct,
                "ratio": direct / statistics.median(seconds),
            }
        )
    return rows


@harness.benchmark
def run(quick: bool) -> harness.Report:
    variant = ensure_backend().variant
    sizes = SIZES_QUICK if quick else SIZES
    compile_first = task_of(sizes[0])
    for focuser in (Backprojection(), *SETTINGS):
        focuser.focus(compile_first)
    rows = [
        row
        for size in sizes
        for row in rows_of(task_of(size), SETTINGS if size == sizes[0] else SETTINGS[:1])
    ]
    report = harness.Report(
        "factorised",
        "Factorised backprojection",
        f"Beside backprojection with the kernel of six taps, same data, processor seconds of all threads; {variant}.",
        data={"rows": rows},
    )
    columns = ["pixels squared", "pulses", "setting", "sections", "stages", "stated, dB", "error, dB"]
    columns += ["CPU s", "backprojection, CPU s", "times faster"]
    cells = [[str(row[key]) for key in ("size", "pulses", "setting", "sections", "stages")] for row in rows]
    for line, row in zip(cells, rows, strict=True):
        line += [f"{row['stated_db']:.1f}", f"{row['error_db']:.1f}", f"{row['seconds']:.2f}"]
        line += [f"{row['direct_seconds']:.2f}", f"{row['ratio']:.1f}"]
    report.table("Automatic setting by size, and others at the smallest", columns, cells)
    if not quick:
        report.claim(
            "4096 x 4096 pixels, 4096 pulses: times faster than backprojection at -45 dB",
            rows[-1]["ratio"],
            8.0,
            at_least=True,
        )
    return report


if __name__ == "__main__":
    harness.main(run)
