"""Focusers: speed and error of backprojection by interpolation, and all focusers side by side.

Usage: python -m benchmarks.suite.focusers [--quick] [-o FOLDER]

Errors are against the exact float64 sum
(``backproject_numpy``: trigonometric interpolation, no kernel), never against another setting of the same code.
"""

import importlib
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.support import focuser_sizes, harness
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.machine.backend import ensure_backend
from sarmitsuba.signal.focusing import FOCUSERS, default_grid
from sarmitsuba.signal.focusing.focusers.backprojection import backproject, backproject_numpy
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.metrics import image_error_db, point_target_in
from sarmitsuba.signal.raw_data import Layer, RawData
from tests.support.unweighted import focus

# (interpolation, oversampling): the defaults of each, and linear cheaper and dearer by a factor of two
SETTINGS = [
    ("linear", 3),
    ("linear", 6),
    ("linear", 12),
    ("kernel:4", 2),
    ("kernel:6", 2),
    ("kernel:8", 2),
    ("kernel:8", 4),
]
PIXELS = 512  # with 390 pulses a call takes about 0.1 s on two cores, and the suite a minute
PIXELS_QUICK = 256
EXACT_PIXELS = 300  # the exact sum costs about 0.1 ms per pixel and pulse
ROUNDS = 5  # interleaved, so that another program's load hits all settings alike
ROUNDS_QUICK = 2
POINT = np.array([3.37, -4.21, 0.0])  # off every pixel


def speed_radar(n_samples: int) -> Any:
    """About 0.7 m x 0.5 m, 10 km, X band, 390 pulses."""
    return ideal_radar(slant_range=10e3, resolution=0.7071, bandwidth=300e6, n_samples=n_samples)


def band_noise(radar: Any, seed: int = 0) -> RawData:
    """Band-limited noise: no sample is spared an error."""
    rng = np.random.default_rng(seed)
    shape = (1, radar.track.n_pulses, radar.window.n_samples)
    spectrum = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    spectrum[..., np.abs(np.fft.fftfreq(shape[-1])) > 0.5 / 1.2] = 0.0
    return RawData(np.fft.ifft(spectrum).astype(np.complex64), (Layer("VV"),), "compressed", radar)


def square(pixels: int, kind: str) -> dict[str, Any]:
    return {
        "grid": kind,
        "center_x": 0.0,
        "center_y": 0.0,
        "height": 0.0,
        "extent_azimuth": 0.25 * (pixels - 1.5),
        "extent_range": 0.25 * (pixels - 1.5),
        "spacing_azimuth": 0.25,
        "spacing_range": 0.25,
    }


def timed(raw: RawData, grid: ImageGrid, interpolation: str, oversampling: int) -> tuple[float, float, float]:
    """Seconds of one call, of the compiled kernels in it, and of all cores together in the call."""
    import drjit as dr

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        start, busy = time.perf_counter(), time.process_time()
        backproject(raw, grid, interpolation=interpolation, oversampling=oversampling)
        whole, busy = time.perf_counter() - start, time.process_time() - busy
        history = dr.kernel_history((dr.KernelType.JIT,))
    return whole, sum(entry["execution_time"] for entry in history) / 1e3, busy


def backprojection_table(quick: bool) -> list[dict[str, Any]]:
    pixels = PIXELS_QUICK if quick else PIXELS
    radar = speed_radar(n_samples=pixels)
    raw = band_noise(radar)
    grid = default_grid(radar, square(pixels, "ground"))
    work = grid.shape[0] * grid.shape[1] * radar.track.n_pulses
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (EXACT_PIXELS, 3)) * [0.2 * pixels, 0.2 * pixels, 0]
    exact = backproject_numpy(raw, points)

    first: dict[Any, float] = {}
    runs: dict[Any, list[tuple[float, float, float]]] = {setting: [] for setting in SETTINGS}
    for setting in SETTINGS:  # the first call compiles
        start = time.perf_counter()
        backproject(raw, grid, interpolation=setting[0], oversampling=setting[1])
        first[setting] = time.perf_counter() - start
    for _ in range(ROUNDS_QUICK if quick else ROUNDS):
        for setting in SETTINGS:
            runs[setting].append(timed(raw, grid, *setting))
    rows = []
    for setting in SETTINGS:
        interpolation, oversampling = setting
        whole = [work / run[0] / 1e9 for run in runs[setting]]
        kernel = [work / run[1] / 1e9 for run in runs[setting]]
        core = [work / run[2] / 1e9 for run in runs[setting]]
        value = backproject(raw, points, interpolation=interpolation, oversampling=oversampling)
        rows.append(
            {
                "interpolation": interpolation,
                "oversampling": oversampling,
                "error_db": image_error_db(value, exact),
                "kernel_gpps": statistics.median(kernel),
                "kernel_gpps_best": max(kernel),
                "kernel_gpps_worst": min(kernel),
                "whole_gpps": statistics.median(whole),
                "whole_gpps_per_core": statistics.median(core),
                "first_call_s": first[setting],
                "pixels": list(grid.shape),
                "pulses": radar.track.n_pulses,
            }
        )
    return rows


def fastsar_table(quick: bool) -> list[dict[str, Any]]:
    """Backprojection beside the PyPI package fastsar (MIT): paired runs over the same geometry, CPU seconds.

    Each takes band-filling noise in its own form, and each is compared with the exact sum over its own data. fastsar
    is no dependency of the package: where it is absent the table says so.
    """
    try:
        fastsar: Any = importlib.import_module("fastsar")
    except ImportError:
        return []
    shape = (801, 661) if not quick else (401, 331)
    radar = ideal_radar(slant_range=10e3, resolution=0.7071, bandwidth=300e6, n_samples=512)
    spacing, n_frequencies = 0.25, 512
    azimuth, ground = (spacing * (np.arange(n) - n // 2) for n in shape)
    along, across = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    grid = ImageGrid("ground", azimuth, ground, np.zeros(3), along, across)
    antenna, raw = radar.track.position, band_noise(radar)
    rng = np.random.default_rng(2)
    step = radar.waveform.bandwidth / n_frequencies
    first = radar.waveform.center_frequency - 0.5 * radar.waveform.bandwidth
    history = rng.standard_normal((2, len(antenna), n_frequencies))
    history = (history[0] + 1j * history[1]).astype(np.complex64)
    pick = rng.integers(0, shape[0] * shape[1], EXACT_PIXELS)
    points = grid.positions().reshape(-1, 3)[pick]
    exact = {
        "sarmitsuba": backproject_numpy(raw, points)[0],
        "fastsar": np.zeros(EXACT_PIXELS, np.complex128),
    }
    frequency, reference = first + step * np.arange(n_frequencies), np.linalg.norm(antenna, axis=1)
    for pulse, position, ref in zip(history, antenna, reference, strict=True):
        r = np.linalg.norm(points - position, axis=1) - ref
        exact["fastsar"] += np.exp(4j * np.pi / SPEED_OF_LIGHT * np.outer(r, frequency)) @ pulse

    def ours(interpolation: str, oversampling: int) -> Callable[[], Any]:
        return lambda: backproject(raw, grid, interpolation=interpolation, oversampling=oversampling)[0]

    def theirs(interpolation: str) -> Callable[[], Any]:
        corner = azimuth[0] * along + ground[0] * across
        former = fastsar.ExactFormer(
            antenna,
            first,
            step,
            n_frequencies,
            *shape,
            spacing,
            spacing,
            along,
            across,
            backend="cpu",
            window=False,
            interp=interpolation,
            center=corner + 0.5 * spacing * (shape[0] * along + shape[1] * across),
        )
        return lambda: former(history)

    runs = {
        ("sarmitsuba", "linear"): ours("linear", 0),
        ("fastsar", "linear"): theirs("linear"),
        ("sarmitsuba", "kernel:4"): ours("kernel:4", 0),
        ("sarmitsuba", "kernel"): ours("kernel", 0),
        ("fastsar", "cubic"): theirs("cubic"),
    }
    images = {key: run() for key, run in runs.items()}  # compiles
    seconds: dict[Any, list[float]] = {key: [] for key in runs}
    for _ in range(ROUNDS_QUICK if quick else ROUNDS):
        for key, run in runs.items():
            start = time.process_time()
            run()
            seconds[key].append(time.process_time() - start)
    rows = []
    for (program, interpolation), image in images.items():
        # the dearest setting of fastsar whose error is above ours
        other = "cubic" if interpolation in ("kernel", "cubic") else "linear"
        pairs = zip(seconds["fastsar", other], seconds[program, interpolation], strict=True)
        value, truth = image.reshape(-1)[pick], exact[program]
        value = value * (
            np.vdot(value, truth) / np.vdot(value, value)
        )  # programs scale their images differently
        rows.append(
            {
                "program": program,
                "interpolation": interpolation,
                "gpps": shape[0]
                * shape[1]
                * len(antenna)
                / statistics.median(seconds[program, interpolation])
                / 1e9,
                "ratio": statistics.median(a / b for a, b in pairs),
                "beside": other,
                "error_db": image_error_db(value, truth),
                "pixels": list(shape),
                "pulses": len(antenna),
            }
        )
    return rows


def layer_table(quick: bool) -> list[dict[str, Any]]:
    """Layers that share one pass over the geometry, such as the two ray subsets behind an error bar."""
    pixels = PIXELS_QUICK if quick else PIXELS
    radar = speed_radar(n_samples=pixels)
    grid = default_grid(radar, square(pixels, "ground"))
    plane = band_noise(radar)
    raws = {
        n: RawData(np.repeat(plane.data, n, axis=0), plane.layers * n, "compressed", radar) for n in (1, 2, 4)
    }
    seconds: dict[int, list[float]] = {n: [] for n in raws}
    for raw in raws.values():
        backproject(raw, grid)  # compiles
    for _ in range(ROUNDS_QUICK if quick else ROUNDS):
        for n, raw in raws.items():
            start = time.process_time()
            backproject(raw, grid)
            seconds[n].append(time.process_time() - start)
    return [
        {
            "layers": n,
            "seconds": statistics.median(times),
            "ratio": statistics.median(a / b for a, b in zip(times, seconds[1], strict=True)),
        }
        for n, times in seconds.items()
    ]


def method_table(quick: bool) -> list[dict[str, Any]]:
    """All focusers on the same slant grid: seconds, and difference between their images."""
    pixels = PIXELS_QUICK if quick else PIXELS
    radar = speed_radar(n_samples=2 * pixels)
    raw = ideal_echoes(radar, [[0, 0, 0], [30, -20, 0], [-25, 10, 0]])
    grid = default_grid(radar, square(pixels, "slant"))
    images, seconds = {}, {}
    for name in [f.name for f in FOCUSERS if not f.refusal(radar, grid)]:
        times = []
        for _ in range(1 + (ROUNDS_QUICK if quick else ROUNDS)):
            start = time.perf_counter()
            images[name] = focus(raw, grid, focuser=name).data
            times.append(time.perf_counter() - start)
        seconds[name] = statistics.median(times[1:])
    return [
        {
            "method": name,
            "seconds": seconds[name],
            "ratio": seconds["backprojection"] / seconds[name],
            "difference_db": None
            if name == "backprojection"
            else image_error_db(image, images["backprojection"]),
            "pixels": list(grid.shape),
            "pulses": radar.track.n_pulses,
        }
        for name, image in images.items()
    ]


def quality_table() -> list[dict[str, Any]]:
    """Point target of 2.5 m^2 off every pixel."""
    rows = []
    for slant_range, resolution in ((10e3, 1.0), (700e3, 3.0)):
        radar = ideal_radar(slant_range=slant_range, resolution=resolution)
        raw = ideal_echoes(radar, POINT, rcs=2.5)
        extent = 48.0 * resolution**0.5
        request = {**square(2, "slant"), "extent_azimuth": extent, "extent_range": extent}
        request |= {"spacing_azimuth": 0.0, "spacing_range": 0.0}
        for method in FOCUSERS.names:
            image = focus(raw, focuser=method, request=request)
            m = point_target_in(image)
            line = POINT - image.grid.origin
            place = (line @ image.grid.along, np.hypot(line @ image.grid.across, line[2]))
            cell = (image.azimuth_resolution_cell, radar.waveform.range_cell)
            rows.append(
                {
                    "method": method,
                    "slant_range_m": slant_range,
                    "pulses": radar.track.n_pulses,
                    "irw_azimuth_cells": m.azimuth.irw / cell[0],
                    "irw_range_cells": m.range.irw / cell[1],
                    "pslr_azimuth_db": m.azimuth.pslr_db,
                    "pslr_range_db": m.range.pslr_db,
                    "offset_azimuth_cells": (m.azimuth_position - place[0]) / cell[0],
                    "offset_range_cells": (m.range_position - place[1]) / cell[1],
                    "rcs_error_db": 10 * np.log10(m.rcs / 2.5),
                }
            )
    return rows


def rows_of(rows: list[dict[str, Any]], columns: dict[str, str]) -> list[list[str]]:
    """Cells of a table; a column's value is ``key`` or ``key:format``."""
    specs = [spec.partition(":") for spec in columns.values()]
    return [["" if row[name] is None else format(row[name], form) for name, _, form in specs] for row in rows]


@harness.benchmark
def run(quick: bool) -> harness.Report:
    variant = ensure_backend().variant
    speed, methods, quality = backprojection_table(quick), method_table(quick), quality_table()
    first, beside, layers = speed[0], fastsar_table(quick), layer_table(quick)
    sizes = focuser_sizes.size_rows(quick)
    growth, small = focuser_sizes.exponents(sizes), focuser_sizes.small_rows()
    report = harness.Report(
        "focusers",
        "Focusers",
        f"All focusers on the same raw data, at growing sizes; backprojection by interpolation; {variant}. Errors are "
        "against the exact float64 sum over band-limited noise, or against backprojection with its best kernel, whose "
        "error against that sum stands in the second table.",
        data={
            "backprojection": speed,
            "methods": methods,
            "point_target": quality,
            "fastsar": beside,
            "layers": layers,
            "sizes": sizes,
            "growth": growth,
            "small": small,
        },
    )
    tables: tuple[Any, ...] = (
        (
            f"The same raw data through every focuser: n pulses of n samples, n x n pixels, spotlight from "
            f"{focuser_sizes.RANGE / 1e3:g} km; worst of points at centre, edge and corner, of azimuth and range, "
            "against backprojection with its best kernel; memory beside the data. Of backprojection a share of the "
            "rows is timed",
            [row for row in sizes if not row["refusal"]],
            {
                "n": "size",
                "focuser": "focuser",
                "CPU seconds": "cpu_s:.3g",
                "by its own estimate": "stated_s:.2g",
                "rows timed": "share:.3g",
                "memory, MB": "memory_mb:.0f",
                "error, dB": "error_db:.1f",
                "it states": "stated_db:.0f",
                "IRW off, %": "irw_percent:.2g",
                "PSLR off, dB": "pslr_db:.2g",
                "ISLR off, dB": "islr_db:.2g",
            },
        ),
        (
            "Growth: power of n with which processor time grows, fitted",
            [{"focuser": name, "power": power} for name, power in growth.items()],
            {"focuser": "focuser", "power of n": "power:.2f"},
        ),
        (
            "Small images, where calls, profiles and weights take the time: lesser of two",
            small,
            {
                "pixels": "pixels",
                "pulses": "pulses",
                "antenna": "pattern",
                "focuser": "focuser",
                "CPU seconds": "cpu_s:.3g",
                "by its own estimate": "stated_s:.2g",
            },
        ),
        (
            f"Backprojection: {first['pixels'][0]} x {first['pixels'][1]} pixels, {first['pulses']} pulses, isotropic "
            'antenna, median over interleaved rounds; "per busy core" divides by the processor seconds that the call '
            "used, so that other programs on the machine matter little",
            speed,
            {
                "interpolation": "interpolation",
                "oversampling": "oversampling",
                "error, dB": "error_db:.1f",
                "kernel, G pixel-pulses/s": "kernel_gpps:.2f",
                "worst": "kernel_gpps_worst:.2f",
                "best": "kernel_gpps_best:.2f",
                "whole call, G/s": "whole_gpps:.2f",
                "per busy core, G/s": "whole_gpps_per_core:.2f",
                "first call, s": "first_call_s:.2f",
            },
        ),
        (
            "Layers in one pass over the geometry (two ray subsets are two layers), default interpolation",
            layers,
            {"layers": "layers", "CPU seconds": "seconds:.3f", "times one layer": "ratio:.2f"},
        ),
        (
            f"Focusers on one slant grid: {' x '.join(map(str, methods[0]['pixels']))} pixels, three points",
            methods,
            {
                "method": "method",
                "seconds": "seconds:.2f",
                "times faster": "ratio:.1f",
                "difference of images, dB": "difference_db:.1f",
            },
        ),
        (
            "Point target",
            quality,
            {
                "method": "method",
                "range, m": "slant_range_m:.0f",
                "pulses": "pulses",
                "IRW azimuth, cells": "irw_azimuth_cells:.4f",
                "IRW range": "irw_range_cells:.4f",
                "PSLR azimuth, dB": "pslr_azimuth_db:.2f",
                "PSLR range": "pslr_range_db:.2f",
                "offset azimuth, cells": "offset_azimuth_cells:.4f",
                "offset range": "offset_range_cells:.4f",
                "RCS error, dB": "rcs_error_db:.4f",
            },
        ),
    )
    if beside:
        shape = " x ".join(map(str, beside[0]["pixels"]))
        caption = (
            f"Beside fastsar: {shape} pixels, {beside[0]['pulses']} pulses, processor seconds of all threads"
        )
        columns = {
            "program": "program",
            "interpolation": "interpolation",
            "G pixel-pulses per CPU second": "gpps:.3f",
            "times the rate of fastsar": "ratio:.2f",
            "with": "beside",
            "error, dB": "error_db:.1f",
        }
        tables += ((caption, beside, columns),)
        for row in (row for row in beside if row["program"] == "sarmitsuba"):
            text = f"rate of {row['interpolation']} over that of fastsar's {row['beside']}, at lower error"
            report.claim(text, row["ratio"], 1.1, at_least=True)
    else:
        report.notes.append("fastsar is not installed (pip install fastsar): no comparison with it.")
    for row in sizes:
        if row["refusal"]:
            report.notes.append(f"{row['focuser']} refuses {row['size']} x {row['size']}: {row['refusal']}.")
    for caption, rows, columns in tables:
        report.table(caption, list(columns), rows_of(rows, columns))
    report.figure("sizes", focuser_sizes.figure(sizes))
    report.figure("interpolation", figure(speed))
    return report


def figure(rows: list[dict[str, Any]]) -> Any:
    """Error over speed of every interpolation."""
    drawn, axes = harness.new_figure(6.0, 4.0)
    for row in rows:
        axes.plot(row["kernel_gpps"], row["error_db"], "o")
        label = f"{row['interpolation']}, x{row['oversampling']}"
        axes.annotate(label, (row["kernel_gpps"], row["error_db"]), xytext=(5, 3), textcoords="offset points")
    axes.set_xlabel("G pixel-pulses / s")
    axes.set_ylabel("error against the exact sum, dB")
    axes.set_title("Backprojection: interpolation of the range profiles")
    axes.margins(x=0.3)
    return drawn


if __name__ == "__main__":
    harness.main(run)
