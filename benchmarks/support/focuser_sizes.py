"""All focusers on the same raw data at growing sizes: error, impulse response, processor seconds, memory.

Used by ``focusers.py``. Spotlight from 700 km, n pulses of n samples and an image of n x n pixels: a geometry that
every algorithm takes at all sizes. Of backprojection, whose rows all take the same time, as many as ``LONGEST`` allows
are timed; the table says so.
"""

import itertools
import math
import time
import tracemalloc
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.support import harness
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.progress import silent
from sarmitsuba.machine.backend import dr
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.signal.focusing import FOCUSERS, default_grid
from sarmitsuba.signal.focusing.focuser import Focuser, FocusTask
from sarmitsuba.signal.focusing.focusers.backprojection import backproject
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.metrics import PointTargetMetrics, image_error_db, point_target
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.planning.prediction.speed import Machine

SIZES, SIZES_QUICK = (1024, 2048, 4096), (256, 512)
RANGE, BANDWIDTH = 700e3, 100e6  # m, Hz: swaths of 1.3 to 5 km
LONGEST = 2**33  # pixel-pulses that are timed at once: about a minute
CHIP = 48  # pixels about a point
# pixels of an edge, and the cell, m, which sets the number of pulses
SMALL = ((32, 1.0), (128, 1.0), (64, 0.3))


@dataclass(frozen=True, eq=False)
class Setting:
    """Raw data, image, and the pixels at which its points stand."""

    raw: RawData
    grid: ImageGrid
    places: list[tuple[int, int]]


def setting(n: int) -> Setting:
    """N pulses of n samples and n x n pixels, two a cell, with points at centre, edge and corner."""
    wavelength = SPEED_OF_LIGHT / 9.6e9
    cell = math.sqrt(wavelength * RANGE * 1.25 / 2.0 / n)
    radar = ideal_radar(slant_range=RANGE, resolution=cell, bandwidth=BANDWIDTH, n_samples=n)
    center = radar.track.center_position
    middle = np.arange(n) - n // 2
    rho = float(np.hypot(center[0], center[2]))
    grid = ImageGrid(
        kind="slant",
        azimuth=0.5 * cell * middle,
        range=rho + 0.5 * radar.waveform.range_cell * 0.8 * middle,
        origin=center,
        along=np.array([0.0, 1.0, 0.0]),
        across=np.array([1.0, 0.0, 0.0]),
        height=0.0,
    )
    at = n - CHIP - 1
    places = [(n // 2, n // 2), (n // 2, at), (at, at)]
    points = []
    for row, column in places:
        one = replace(
            grid,
            azimuth=grid.azimuth[[row]] + 0.3 * grid.azimuth_spacing,
            range=grid.range[[column]] + 0.2 * grid.range_spacing,
        )
        points.append(one.positions()[0, 0])
    return Setting(ideal_echoes(radar, points), grid, places)


@dataclass(frozen=True, eq=False)
class Chip:
    """The pixels about a point, and backprojection's with its best kernel."""

    pixels: tuple[slice, slice]
    grid: ImageGrid
    reference: Any

    @staticmethod
    def of(one: Setting, place: tuple[int, int]) -> "Chip":
        rows, columns = (slice(p - CHIP, p + CHIP) for p in place)
        grid = replace(one.grid, azimuth=one.grid.azimuth[rows], range=one.grid.range[columns])
        reference = backproject(one.raw, grid, interpolation="kernel:8", oversampling=4)[0]
        return Chip((rows, columns), grid, reference)

    def measure(self, pixels: Any) -> PointTargetMetrics:
        spacing = (self.grid.azimuth_spacing, self.grid.range_spacing)
        return point_target(pixels, *spacing, near=(CHIP, CHIP), chip=CHIP)


def once(focuser: Focuser, raw: RawData, grid: ImageGrid) -> tuple[Any, float]:
    """Pixels (n_azimuth, n_range), and processor seconds."""
    window = parse_window("rectangular")
    start = time.process_time()
    pixels = focuser.focus(FocusTask(raw, grid, window, window, silent)).pixels[0]
    return pixels, time.process_time() - start


def memory(focuser: Focuser, raw: RawData, grid: ImageGrid) -> int:
    """Bytes at the most beside the data, the image included: NumPy's, and those of Dr.Jit where it works."""
    dr.flush_malloc_cache()
    dr.detail.malloc_clear_statistics()
    tracemalloc.start()
    once(focuser, raw, grid)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return int(
        peak + sum(dr.detail.malloc_watermark(where) for where in (dr.JitBackend.LLVM, dr.JitBackend.CUDA))
    )


def row(focuser: Focuser, one: Setting, chips: list[Chip]) -> dict[str, Any]:
    """Figures of one focuser at one size; only the reason where it refuses."""
    grid, raw = one.grid, one.raw
    n, pulses = grid.azimuth.size, raw.radar.track.n_pulses
    out: dict[str, Any] = {"size": n, "focuser": focuser.name, "refusal": focuser.refusal(raw.radar, grid)}
    if out["refusal"]:
        return out
    by_pixels = focuser.name == "backprojection"  # every row takes the same time, so a part of them will do
    rows = min(n, max(8, LONGEST // (n * pulses))) if by_pixels else n
    part = replace(grid, azimuth=grid.azimuth[:rows])
    out["memory_mb"] = memory(focuser, raw, part) / 2**20  # compiles, too
    pixels, seconds = once(focuser, raw, part)
    out["cpu_s"], out["share"] = seconds * n / rows, rows / n
    if by_pixels:
        values = [once(focuser, raw, chip.grid)[0] for chip in chips]
    else:
        values = [pixels[chip.pixels] for chip in chips]
    pairs = [(chip.measure(v), chip.measure(chip.reference)) for v, chip in zip(values, chips, strict=True)]
    axes = [(getattr(a, axis), getattr(b, axis)) for a, b in pairs for axis in ("azimuth", "range")]
    return out | {
        "error_db": max(image_error_db(v, chip.reference) for v, chip in zip(values, chips, strict=True)),
        "irw_percent": max(abs(100.0 * (a.irw / b.irw - 1.0)) for a, b in axes),
        "pslr_db": max(abs(a.pslr_db - b.pslr_db) for a, b in axes),
        "islr_db": max(abs(a.islr_null_db - b.islr_null_db) for a, b in axes),
        "stated_db": focuser.error_db(raw.radar, grid),
        "stated_s": Machine.here().slowness * focuser.cpu_seconds(raw.radar, grid),
    }


def size_rows(quick: bool) -> list[dict[str, Any]]:
    """A row per focuser and size."""
    rows = []
    for n in SIZES_QUICK if quick else SIZES:
        one = setting(n)
        chips = [Chip.of(one, place) for place in one.places]
        for focuser in FOCUSERS:
            print(f"... {focuser.name}, {n}", flush=True)
            rows.append(row(focuser, one, chips))
    return rows


def small_rows() -> list[dict[str, Any]]:
    """Processor seconds of every focuser against its own estimate, on small images of few and of many pulses."""
    rows = []
    for (n, cell), antenna in itertools.product(SMALL, (None, Antenna("gaussian", 1.0, 0.03, 0.4))):
        radar = ideal_radar(
            resolution=cell, bandwidth=0.5 * SPEED_OF_LIGHT / cell, n_samples=300, antenna=antenna
        )
        step = 0.45 * cell
        extent = {"extent_azimuth": step * (n - 1.5), "extent_range": step * (n - 1.5)}
        request = {"grid": "slant", "center_x": 0.0, "center_y": 0.0, "height": 0.0, **extent}
        grid = default_grid(radar, {**request, "spacing_azimuth": step, "spacing_range": step})
        raw = ideal_echoes(radar, np.zeros(3))
        for focuser in FOCUSERS:
            if focuser.refusal(radar, grid):
                continue
            once(focuser, raw, grid)  # compiles
            rows.append(
                {
                    "pixels": int(np.prod(grid.shape)),
                    "pulses": radar.track.n_pulses,
                    "pattern": radar.antenna.pattern,
                    "focuser": focuser.name,
                    "cpu_s": min(once(focuser, raw, grid)[1] for _ in range(2)),
                    "stated_s": Machine.here().slowness * focuser.cpu_seconds(radar, grid),
                }
            )
    return rows


def exponents(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Power of the edge's length with which the processor time of every focuser grows, fitted over its sizes."""
    out = {}
    for name in dict.fromkeys(r["focuser"] for r in rows):
        taken = [(r["size"], r["cpu_s"]) for r in rows if r["focuser"] == name and not r["refusal"]]
        if len(taken) > 1:
            out[name] = float(np.polyfit(*np.log(np.array(taken).T), 1)[0])
    return out


def figure(rows: list[dict[str, Any]]) -> Any:
    """Processor seconds over the edge's length."""
    drawn, axes = harness.new_figure(6.0, 4.2)
    for name, power in exponents(rows).items():
        taken = [(r["size"], r["cpu_s"]) for r in rows if r["focuser"] == name and not r["refusal"]]
        axes.loglog(*np.array(taken).T, "o-", label=f"{name}, n^{power:.2f}")
    axes.set_xlabel("n: pulses, samples, and pixels of an edge")
    axes.set_ylabel("CPU seconds")
    axes.legend(fontsize=8)
    return drawn
