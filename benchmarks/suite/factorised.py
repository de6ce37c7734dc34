"""Factorised backprojection beside backprojection: processor seconds in one run, and the error between the images.

Usage: python -m benchmarks.suite.factorised [--quick] [-o FOLDER]

As many pulses as pixels along azimuth, two pixels per cell both ways, 10 km, X band, ground grid; echoes are noise that
fills the band, so that no sample is spared an error. Backprojection's own error is below -100 dB.

Then an image of 12 000 x 8800 pixels from echoes of ideal points in noise of the same energy: pixels per second of one
core, and the error against exact backprojection in patches about the points and between them.
"""

import statistics
import time
from typing import Any

import numpy as np
import scipy.fft

from benchmarks.suite.focusers import band_noise
from benchmarks.support import harness
from sarmitsuba.core.progress import silent
from sarmitsuba.machine.backend import ensure_backend
from sarmitsuba.machine.memory import held_memory
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.factorised.division import Plan
from sarmitsuba.signal.focusing.focuser import FocusTask
from sarmitsuba.signal.focusing.focusers.backprojection import Backprojection, backproject
from sarmitsuba.signal.focusing.focusers.factorised import Factorised
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.planning.prediction.speed import Machine

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
# the large image: pixels along azimuth and range, pulses enough for its extent, and samples for its swath and curvature
LARGE, LARGE_QUICK = (12000, 8800, 7500, 7200), (1500, 1100, 940, 1050)
# wanted of it: dB, and million pixels per processor second; fastsar states the same for this size
LARGE_DB, LARGE_RATE = -60.0, 1.2
# wanted errors: one whose true error is that, and one that states it
LARGE_SETTINGS = (-50.0, LARGE_DB)
# pixels of a patch's side; noise in a pixel over a point's peak, power, so that both have the same energy in a patch
PATCH, NOISE = 32, 4e-3
# pulses of noise made at a time
CHUNK = 500
# a track's pulses per metre follow from the cell: 25 % more than its Doppler band
PRF_FACTOR, SLANT_RANGE, WAVELENGTH = 1.25, 10e3, 0.03123


def geometry(rows: int, columns: int, pulses: int, samples: int) -> tuple[Radar, ImageGrid]:
    """A radar with that many pulses and samples, and a ground grid of two pixels per cell both ways."""
    cell = float(np.sqrt(0.5 * WAVELENGTH * SLANT_RANGE * PRF_FACTOR / pulses))
    radar = ideal_radar(
        slant_range=SLANT_RANGE,
        resolution=cell,
        bandwidth=150e6 / cell,
        n_samples=samples,
        prf_factor=PRF_FACTOR,
    )
    step = 0.5 * cell
    request = ImageRequest(
        grid="ground",
        extent_azimuth=step * (rows - 1.5),
        extent_range=step * 2**0.5 * (columns - 1.5),
        spacing_azimuth=step,
        spacing_range=step * 2**0.5,
    )
    return radar, default_grid(radar, request)


def task_of(size: int) -> FocusTask:
    """Noise of ``size`` pulses, and as many pixels along both sides of an image."""
    radar, grid = geometry(size, size, size, int(1.25 * size))
    window = parse_window("rectangular")
    return FocusTask(band_noise(radar), grid, window, window, silent)


def add_noise(raw: RawData, power: float) -> None:
    """Noise that fills the band, of that mean power in a pixel, a few pulses at a time."""
    radar, rng = raw.radar, np.random.default_rng(2)
    n, samples = radar.track.n_pulses, radar.window.n_samples
    level = np.float32(np.sqrt(0.5 * power * n) * radar.amplitude_constant / SLANT_RANGE**2)
    beyond = np.abs(scipy.fft.fftfreq(samples)) > 0.5 / 1.2
    for start in range(0, n, CHUNK):
        part = raw.data[0, start : start + CHUNK]
        spectrum = scipy.fft.fft(
            rng.standard_normal((*part.shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
        )
        spectrum[:, beyond] = 0.0
        part += level * scipy.fft.ifft(spectrum)


def large_rows(
    size: tuple[int, int, int, int], settings: tuple[float, ...] = LARGE_SETTINGS
) -> list[dict[str, Any]]:
    """The large image by every setting: rate, memory and error."""
    radar, grid = geometry(*size)
    centers = [
        (int(a * (grid.shape[0] - 1 - PATCH)) + PATCH // 2, int(b * (grid.shape[1] - 1 - PATCH)) + PATCH // 2)
        for a, b in (
            (0.5, 0.5),
            (0, 0),
            (0, 1),
            (1, 0),
            (1, 1),
            (0.25, 0.3),
            (0.3, 0.8),
            (0.7, 0.2),
            (0.9, 0.6),
        )
    ]
    points = [grid.positions_on_line(i)[j] + [0.01, 0.02, 0.0] for i, j in centers[:5]]
    raw = ideal_echoes(radar, points)
    add_noise(raw, NOISE)
    patches, exact = [], []
    for i, j in centers:
        rows, columns = (slice(c - PATCH // 2, c + PATCH // 2) for c in (i, j))
        places = np.array([grid.positions_on_line(row)[columns] for row in range(rows.start, rows.stop)])
        patches.append((rows, columns))
        exact.append(backproject(raw, places.reshape(-1, 3), interpolation="kernel:8", oversampling=4)[0])
    return [_large_row(raw, grid, Factorised(error=error), patches, exact) for error in settings]


def _large_row(
    raw: RawData, grid: ImageGrid, focuser: Factorised, patches: list[tuple[slice, slice]], exact: list[Any]
) -> dict[str, Any]:
    """The large image by one setting, against exact pixels of patches, of which the first five hold points."""
    radar, window = raw.radar, parse_window("rectangular")
    plan = focuser.plan(radar, grid, window)
    assert isinstance(plan, Plan)
    held = [held_memory()]
    task = FocusTask(raw, grid, window, window, lambda *_: held.append(held_memory()))
    start = time.process_time()
    image = focuser.focus(task).pixels[0]
    seconds = time.process_time() - start
    wrong, energy = np.zeros(len(patches)), np.zeros(len(patches))
    for k, patch in enumerate(patches):
        found = image[patch].ravel()
        wrong[k], energy[k] = (float(np.sum(np.abs(x) ** 2)) for x in (found - exact[k], exact[k]))
    error = [
        10.0 * np.log10(wrong[part].sum() / energy[part].sum()) for part in (slice(0, 5), slice(5, None))
    ]
    return {
        "error": focuser.error,
        "pixels": f"{grid.shape[0]} x {grid.shape[1]}",
        "pulses": radar.track.n_pulses,
        "sections": len(plan.sections),
        "stages": plan.merges + 2,
        "stated_db": focuser.error_db(radar, grid),
        "points_db": error[0],
        "between_db": error[1],
        "seconds": seconds,
        "rate": image.size / seconds / 1e6,
        "predicted_gb": focuser.making_bytes(radar, grid, 1) / 1e9,
        "held_gb": (max(held) - held[0]) / 1e9,
        "slowness": Machine.here().slowness,
    }


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
    large_rows(LARGE_QUICK)  # compiles
    large = large_rows(LARGE_QUICK if quick else LARGE)
    report.data["large"] = large
    report.table(
        "A large image, by wanted error; slowness is the time of a small job over that of the reference core",
        [
            *(
                "pixels",
                "pulses",
                "wanted, dB",
                "sections",
                "stages",
                "stated, dB",
                "at points, dB",
                "between, dB",
            ),
            *("CPU s", "Mpixel per CPU s", "predicted GB", "held GB", "slowness"),
        ],
        [
            [str(row[key]) for key in ("pixels", "pulses", "error", "sections", "stages")]
            + [f"{row[key]:.1f}" for key in ("stated_db", "points_db", "between_db", "seconds")]
            + [f"{row[key]:.2f}" for key in ("rate", "predicted_gb", "held_gb", "slowness")]
            for row in large
        ],
    )
    good = [row for row in large if max(row["points_db"], row["between_db"]) <= LARGE_DB]
    report.claim("large image: settings whose error is -60 dB", len(good), len(large), at_least=True)
    if not quick:
        report.claim(
            "12 000 x 8800 pixels: million pixels per processor second at -60 dB",
            max((row["rate"] for row in good), default=0.0),
            LARGE_RATE,
            at_least=True,
        )
        report.claim(
            "4096 x 4096 pixels, 4096 pulses: times faster than backprojection at -45 dB",
            rows[-1]["ratio"],
            8.0,
            at_least=True,
        )
    return report


if __name__ == "__main__":
    harness.main(run)
