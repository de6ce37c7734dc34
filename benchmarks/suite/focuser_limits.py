"""Frequency-domain focusers: point targets against backprojection, where each breaks, seconds and memory, noise.

Usage: python -m benchmarks.suite.focuser_limits [--quick] [-o FOLDER]

Phases are against the float64 sum (``backproject_numpy``), widths and side lobes against backprojection with its best
kernel, whose own error against that sum is stated.
"""

import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.support import focuser_breaks, harness
from benchmarks.support.focuser_breaks import CHIP, FORMS, SWEEPS, focused, limit_of, place_of, setting
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.mode import MODES, AimGeometry
from sarmitsuba.radar.radar import ReceiveWindow
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.focuser import parse_focuser
from sarmitsuba.signal.focusing.focusers.backprojection import backproject, backproject_numpy
from sarmitsuba.signal.focusing.focusers.chirp_scaling import ChirpScaling
from sarmitsuba.signal.focusing.frequency_domain.migration import MAX_PHASE
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.metrics import image_error_db, point_target
from sarmitsuba.signal.raw_data import Layer, RawData
from tests.support.geometries import random_geometry

ALGORITHMS = ("omega_k", "omega_k,stolt=phase", "range_doppler", "chirp_scaling")
SIZE, SIZE_QUICK = 4096, 512  # square that is timed: the size that the limits are promised for
SECONDS = 6.0  # promised on two cores
TIMED = 2**31  # pixel-pulses of backprojection that are timed: some seconds
NOISE_PIXELS = 160  # some 6000 cells: the mean power has a sigma of 0.06 dB
SMEARED = -6.0  # dB: a peak below this part of its height is no longer one


@dataclass(frozen=True)
class Against:
    """A point against backprojection: width, %, and side lobe, dB, of the worse axis; phase, degrees; peak, dB."""

    irw: float
    pslr: float
    phase: float
    peak: float


def compare(pixels: Any, reference: Any, grid: ImageGrid, value: complex, place: tuple[int, int]) -> Against:
    """Point of an image and of its reference about a pixel, where the exact sum is ``value``."""
    spacing = (grid.azimuth_spacing, grid.range_spacing)
    ratio = pixels[place] / value
    phase, peak = abs(float(np.degrees(np.angle(ratio)))), 20.0 * float(np.log10(abs(ratio)))
    if peak < SMEARED:  # nothing to measure a width of
        return Against(float("inf"), float("inf"), phase, peak)
    one, other = (point_target(data, *spacing, near=place, chip=CHIP) for data in (pixels, reference))
    axes = [(one.azimuth, other.azimuth), (one.range, other.range)]
    return Against(
        max(100.0 * abs(a.irw / b.irw - 1.0) for a, b in axes),
        max(abs(a.pslr_db - b.pslr_db) for a, b in axes),
        phase,
        peak,
    )


def point_rows() -> list[list[Any]]:
    """Worst of nine points, at centre, edges and corners."""
    rows = []
    for seed, (slant_range, cell) in enumerate([(10e3, 1.0), (700e3, 5.0)]):
        for mode in ("spotlight", "stripmap"):
            radar, grid = random_geometry(mode, slant_range, cell, seed)
            at = [np.array([CHIP // 2 + 2, n // 2, n - CHIP // 2 - 3]) for n in grid.shape]
            nine = replace(
                grid,
                azimuth=grid.azimuth[at[0]] + 0.3 * grid.azimuth_spacing,
                range=grid.range[at[1]] + 0.2 * grid.range_spacing,
            )
            points = nine.positions().reshape(-1, 3)
            raw = ideal_echoes(radar, points)
            reference = backproject(raw, grid, interpolation="kernel:8", oversampling=4)[0]
            places = [place_of(grid, point) for point in points]
            for name in (*ALGORITHMS, "polar_format"):
                if parse_focuser(name).refusal(radar, grid):
                    continue
                pixels = focused(name, raw, grid)
                got = [compare(pixels, reference, grid, complex(reference[place]), place) for place in places]
                worst = [max(getattr(g, key) for g in got) for key in ("irw", "pslr", "phase")]
                worst.append(image_error_db(pixels, reference))
                rows.append([mode, f"{slant_range / 1e3:.0f} km", name, *(float(f"{v:.2g}") for v in worst)])
    return rows


def break_rows(quick: bool) -> list[list[Any]]:
    """The limit of each form, and what a point at the image's edge looks like there and at twice the limit."""
    rows = []
    for which, _, low, high, _ in SWEEPS[: 1 if quick else None]:
        for name in FORMS[1:]:
            limit = limit_of(name, which, low, high)
            cells: list[Any] = []
            for value in (limit, 2.0 * limit):
                if not low < value <= high:
                    cells += [float("nan")] * 3
                    continue
                radar, grid, point = setting(which, value)
                raw = ideal_echoes(radar, point)
                place = place_of(grid, point)
                chip = tuple(slice(max(p - CHIP, 0), p + CHIP) for p in place)
                part = replace(grid, azimuth=grid.azimuth[chip[0]], range=grid.range[chip[1]])
                inside = (place[0] - chip[0].start, place[1] - chip[1].start)
                reference = backproject(raw, part, interpolation="kernel:8", oversampling=4)[0]
                exact = backproject_numpy(raw, part.positions()[inside][None])[0, 0]
                got = compare(focused(name, raw, grid)[chip], reference, part, complex(exact), inside)
                cells += [float(f"{v:.2g}") for v in (got.irw, got.pslr, got.phase)]
            shown = f"all to {high:g}" if limit != limit else f"{limit:.3g}" if limit > low else "none"
            rows.append([which, name, shown, *cells])
    return rows


def theory_rows() -> list[list[Any]]:
    """Error of a point away from the reference range, and the rms of the residual phase by its leading terms."""
    rows = []
    for squint, swath in ((3.0, 100.0), (7.0, 100.0), (12.0, 60.0)):
        radar, grid, point = setting("squint", squint)
        away = 0.5 * swath
        origin = radar.track.center_position
        rho = float(np.hypot(origin[0], origin[2])) + away
        point = np.array([np.sqrt(rho**2 - origin[2] ** 2) + origin[0], 0.0, 0.0])
        raw = ideal_echoes(radar, point)
        place = place_of(grid, point)
        chip = tuple(slice(max(p - CHIP, 0), p + CHIP) for p in place)
        part = replace(grid, azimuth=grid.azimuth[chip[0]], range=grid.range[chip[1]])
        reference = backproject(raw, part, interpolation="kernel:8", oversampling=4)[0]
        line = point - radar.track.position
        theta = np.arcsin(line @ grid.along / np.linalg.norm(line, axis=1))
        offset = 4.0 * np.pi / SPEED_OF_LIGHT * radar.waveform.bandwidth * np.linspace(-0.5, 0.5, 65)
        kc = 4.0 * np.pi / radar.waveform.wavelength
        center = 1.0 / np.cos(np.radians(squint))
        coupling = -away * np.outer(np.tan(theta) ** 2 / np.cos(theta), offset**2) / (2.0 * kc)
        migration = away * np.outer(1.0 / np.cos(theta) - center, offset)
        expected = {
            "omega_k,stolt=phase": migration + coupling,
            "chirp_scaling,scaling=no": migration + coupling,
            "range_doppler": coupling,
            "chirp_scaling": coupling,
        }
        for name, phase in expected.items():
            error = image_error_db(focused(name, raw, grid)[chip], reference)
            rows.append([squint, away, name, error, float(10.0 * np.log10(np.mean(phase**2)))])
    return rows


def stripmap(n: int) -> tuple[RawData, ImageGrid]:
    """Noise in n x n samples of a stripmap radar of 0.5 m cells at 10 km, 1 m of antenna, and n x n pixels."""
    plain = ideal_radar(slant_range=10e3, resolution=0.5, bandwidth=300e6, n_samples=n)
    spacing = 0.4
    center = plain.track.center_position
    track = Track.straight(center, [0.0, 100.0, 0.0], 100.0 / spacing, n)
    aim = AimGeometry(np.zeros(3), center, np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    sample = plain.window.sample_spacing
    start = (round(10e3 / sample) - n // 2) * sample
    radar = replace(
        plain,
        mode="stripmap",
        antenna=Antenna("rectangular", 1.0, 0.886 * plain.waveform.wavelength, 0.4),
        track=track,
        pointing=MODES["stripmap"].pointing(track, aim),
        window=ReceiveWindow(np.full(n, start), sample, n),
        half_aperture=plain.waveform.wavelength / 2.0,
    )
    rng = np.random.default_rng(0)
    data = rng.standard_normal((1, n, 2 * n), dtype=np.float32).view(np.complex64)
    middle = np.arange(n) - n // 2
    grid = ImageGrid(
        kind="slant",
        azimuth=0.25 * middle,
        range=10e3 + 0.25 * middle,
        origin=center,
        along=np.array([0.0, 1.0, 0.0]),
        across=np.array([1.0, 0.0, 0.0]),
        height=0.0,
    )
    return RawData(data, (Layer("VV"),), "compressed", radar), grid


def speed_rows(quick: bool) -> list[dict[str, Any]]:
    """Processor seconds and memory on one stripmap image; of backprojection as many rows as ``TIMED`` lets."""
    raw, grid = stripmap(SIZE_QUICK if quick else SIZE)
    isotropic = replace(raw, radar=replace(raw.radar, antenna=Antenna()))
    jobs = [(name, name, raw) for name in (*ALGORITHMS, "backprojection")]
    jobs.append(("backprojection, isotropic antenna", "backprojection", isotropic))
    rows = []
    for label, name, data in jobs:
        n = grid.azimuth.size
        lines = min(n, TIMED // n**2) if name == "backprojection" else n
        middle = slice(n // 2 - lines // 2, n // 2 - lines // 2 + lines)
        part = replace(grid, azimuth=grid.azimuth[middle])
        tracemalloc.start()
        focused(name, data, part)  # compiles, too
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        start, busy = time.perf_counter(), time.process_time()
        focused(name, data, part)
        busy, wall = (
            seconds * n / lines for seconds in (time.process_time() - busy, time.perf_counter() - start)
        )
        stated = parse_focuser(name).cpu_seconds(data.radar, grid)
        row = {"name": label, "cpu_s": busy, "wall_s": wall, "peak_bytes": peak, "stated_s": stated}
        rows.append(row | {"share": lines / n, "pixels": grid.shape})
    return rows


def noise_rows() -> list[list[Any]]:
    """Power of white receiver noise in the pixels, over that of the matched filter's weights, dB."""
    radar = ideal_radar(resolution=1.0, n_samples=256)
    spacing = {"spacing_azimuth": 0.45, "spacing_range": 0.45}
    extent = 0.45 * NOISE_PIXELS
    grid = default_grid(
        radar,
        {"center_x": 0.0, "center_y": 0.0, "height": 0.0, "grid": "slant", **spacing}
        | {"extent_azimuth": extent, "extent_range": extent},
    )
    rng = np.random.default_rng(1)
    shape = (1, radar.track.n_pulses, 2 * radar.window.n_samples)
    data = np.sqrt(0.5) * rng.standard_normal(shape, dtype=np.float32)
    raw = RawData(data.astype(np.float32).view(np.complex64), (Layer("VV"),), "compressed", radar)
    r = np.linalg.norm(radar.aim_point - radar.track.position, axis=1)
    share = radar.waveform.bandwidth / radar.window.sampling_rate
    predicted = share * np.sum(r**4) / (radar.amplitude_constant * r.size) ** 2
    rows = []
    for name in ("backprojection", *ALGORITHMS):
        power = float(np.mean(np.abs(focused(name, raw, grid)) ** 2))
        rows.append([name, 10.0 * float(np.log10(power / predicted))])
    return rows


def step(text: str, work: Callable[[], Any]) -> Any:
    print(f"... {text}", flush=True)
    return work()


@harness.benchmark
def run(quick: bool) -> harness.Report:
    points = step("points", point_rows)
    breaks = step("limits", lambda: break_rows(quick))
    theory = step("theory", theory_rows)
    noise = step("noise", noise_rows)
    speed = step("speed", lambda: speed_rows(quick))
    curves = {}
    for which in focuser_breaks.NODES:
        curves[which] = step(f"curves: {which}", partial(focuser_breaks.curves, which, quick))
    curves["track"] = step("curves: track", lambda: focuser_breaks.track_curves(quick))
    factor = ChirpScaling().largest_factor(*setting("squint", 5.0)[:2])
    report = harness.Report(
        "focuser_limits",
        "Frequency-domain focusers",
        "Omega-K, range-Doppler and chirp scaling against backprojection. Each refuses past a residual phase of "
        f"{MAX_PHASE:.3g} rad at the image's edges.",
        data={"speed": speed, "curves": curves},
    )
    report.table(
        "Nine points at centre, edges and corners in random geometries, worst difference to backprojection",
        ["mode", "range", "method", "IRW, %", "PSLR, dB", "phase, degrees", "image, dB"],
        points,
    )
    fixed = "; ".join(f"{name} ({unit}): {rest}" for name, unit, _, _, rest in SWEEPS)
    columns = ["quantity", "method", "limit", "IRW, %", "PSLR, dB", "phase", "IRW at 2 x", "PSLR", "phase"]
    report.table(
        f"Where each breaks, and a point at the swath's edge there: {fixed}; X band, 10 km", columns, breaks
    )
    report.table(
        "Residual phase: error of a point measured, and by theory",
        ["squint, degrees", "off the reference range, m", "method", "measured, dB", "theory, dB"],
        theory,
    )
    report.table("Noise in the pixels over the matched filter's", ["method", "dB"], noise)
    report.table(
        f"{speed[0]['pixels'][0]} x {speed[0]['pixels'][1]} samples and pixels, stripmap",
        [
            "method",
            "CPU seconds",
            "by its own estimate",
            "wall seconds",
            "peak of arrays beside data, MB",
            "rows timed",
        ],
        [
            [s["name"], s["cpu_s"], s["stated_s"], s["wall_s"], s["peak_bytes"] / 2**20, s["share"]]
            for s in speed
        ],
    )
    report.notes.append(f"Largest chirp scaling factor at a squint of 5 degrees: {factor:.3g}.")
    for key, place, bound, unit in (
        ("IRW", 3, 2.0, "%"),
        ("PSLR", 4, 0.5, "dB"),
        ("phase", 5, 5.0, "degrees"),
    ):
        worst = max(row[place] for row in points)
        report.claim(f"{key} of points against backprojection", worst, bound, at_least=False, unit=unit)
        at_limit = [row[place] for row in breaks if row[place] == row[place]]
        report.claim(f"{key} at each limit", max(at_limit), bound, at_least=False, unit=unit)
    report.claim(
        "noise against prediction", max(abs(row[1]) for row in noise), 0.3, at_least=False, unit="dB"
    )
    for row in (row for row in speed if row["name"] in ALGORITHMS):
        report.claim(
            f"{row['name']}, CPU seconds over two cores", row["cpu_s"] / 2, SECONDS, at_least=False, unit="s"
        )
    for which, unit, _, _, rest in SWEEPS:
        drawn = focuser_breaks.figure(curves[which], f"{which}, {unit}", rest, logarithmic=which != "squint")
        report.figure(which, drawn)
    text = "track that sways across and up, 120 m of image, 1 m cells"
    drawn = focuser_breaks.figure(curves["track"], "largest deviation from a line, m", text, logarithmic=True)
    report.figure("track", drawn)
    return report


if __name__ == "__main__":
    harness.main(run)
