"""Where each focuser breaks: limits by bisection, and the error of a point at the image's edge beyond them.

Used by ``focuser_limits.py``. Spotlight, 10 km, X band; one quantity of squint, swath and bandwidth is changed at a
time. A fourth curve is over the deviation of the track from a straight line, known to the focuser and not.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.support import harness
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.progress import silent
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.focuser import FocusTask, parse_focuser
from sarmitsuba.signal.focusing.focusers.backprojection import backproject
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.focusing.motion_compensation import (
    LARGEST_RESIDUAL,
    compensate_motion,
    compensation_residual,
    plan_straightening,
)
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.signal.raw_data import RawData

# every form, the low-accuracy ones too
FORMS = (
    "omega_k",
    "omega_k,stolt=phase",
    "omega_k,stolt=off",
    "range_doppler",
    "range_doppler,src=centroid",
    "range_doppler,src=off",
    "range_doppler,rcmc=no",
    "chirp_scaling",
    "chirp_scaling,scaling=no",
    "polar_format",
)
CELL = 0.5  # m, azimuth cell where limits are looked for
CHIP = 48  # pixels about a point that is measured
# what each limit is looked for in: name, unit, range, and what is fixed meanwhile
SWEEPS = (
    ("squint", "degrees", 0.0, 50.0, "swath 200 m, bandwidth 3.1 %"),
    ("swath", "m", 8.0, 4000.0, "squint 5 degrees, bandwidth 3.1 %"),
    ("bandwidth", "% of carrier", 1.0, 30.0, "swath 200 m, squint 5 degrees"),
)
STEPS = 24  # of a bisection
# at which the curves are drawn
NODES = {
    "squint": (0.0, 1.0, 2.0, 4.0, 8.0, 15.0, 25.0, 35.0, 50.0),
    "swath": (8.0, 16.0, 40.0, 100.0, 250.0, 600.0, 1500.0),
    "bandwidth": (1.0, 2.0, 4.0, 8.0, 15.0, 30.0),
}
# m, largest deviation of the track from a line
DEVIATIONS = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
COLORS = {"omega_k": "C0", "range_doppler": "C2", "chirp_scaling": "C1", "polar_format": "C3"}
LINES = ("-", "--", ":", "-.")


def focused(name: str, raw: RawData, grid: ImageGrid) -> Any:
    """Pixels (n_azimuth, n_range), whatever the phase it leaves."""
    focuser = parse_focuser(name)
    if "bound" in focuser.options:
        focuser = replace(focuser, bound=float("inf"))
    window = parse_window("rectangular")
    return focuser.focus(FocusTask(raw, grid, window, window, silent)).pixels[0]


def place_of(grid: ImageGrid, point: Any) -> tuple[int, int]:
    line = point - grid.origin
    rho = np.hypot(line @ grid.across, line[2])
    return int(np.abs(grid.azimuth - line @ grid.along).argmin()), int(np.abs(grid.range - rho).argmin())


def setting(which: str, value: float) -> tuple[Radar, ImageGrid, Any]:
    """Spotlight radar at 10 km, image, and a point at the image's far edge, with one of the limits' quantities set."""
    squint = np.radians(value if which == "squint" else 5.0)
    swath = value if which == "swath" else 200.0
    bandwidth = 0.01 * value * 9.6e9 if which == "bandwidth" else 300e6
    cell = 0.5 * SPEED_OF_LIGHT / bandwidth
    samples = int(1.2 * swath / cell) + 100
    radar = ideal_radar(
        squint_angle=squint, resolution=CELL, bandwidth=bandwidth, n_samples=samples, prf_factor=1.4
    )
    origin = radar.track.center_position
    middle = float(np.hypot(origin[0], origin[2]))
    step = 0.5 * cell * float(np.cos(squint))
    along = 0.5 * CELL * float(np.cos(squint))
    request = {"center_x": 0.0, "center_y": 0.0, "height": 0.0, "grid": "slant"}
    extents = {"extent_azimuth": 54.0 * along, "extent_range": 8.0 * step}
    grid = default_grid(radar, request | extents | {"spacing_azimuth": along, "spacing_range": step})
    n = round(0.5 * swath / step + 26.0)
    grid = replace(grid, range=middle + step * np.arange(-n, n + 1))
    rho = middle + 0.5 * swath
    return radar, grid, np.array([np.sqrt(rho**2 - origin[2] ** 2) + origin[0], 0.1 * along, 0.0])


def limit_of(name: str, which: str, low: float, high: float) -> float:
    """Largest value that the focuser takes, by bisection; NaN where it takes all, the lowest where it takes none."""
    focuser = parse_focuser(name)

    def refuses(value: float) -> bool:
        radar, grid, _ = setting(which, value)
        return bool(focuser.refusal(radar, grid))

    if not refuses(high):
        return float("nan")
    if refuses(low):
        return low
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if refuses(middle) else (middle, high)
    return low


def curves(which: str, quick: bool) -> dict[str, list[tuple[float, float, bool]]]:
    """(value, error of an edge point against backprojection in dB, whether it refuses) of every form."""
    values = NODES[which][:: 4 if quick else 1]
    out: dict[str, list[tuple[float, float, bool]]] = {name: [] for name in FORMS}
    for value in values:
        radar, grid, point = setting(which, value)
        raw = ideal_echoes(radar, point)
        chip = tuple(slice(max(p - CHIP, 0), p + CHIP) for p in place_of(grid, point))
        part = replace(grid, azimuth=grid.azimuth[chip[0]], range=grid.range[chip[1]])
        reference = backproject(raw, part, interpolation="kernel:8", oversampling=4)[0]
        for name in FORMS:
            refuses = bool(parse_focuser(name).refusal(radar, grid))
            out[name].append((value, image_error_db(focused(name, raw, grid)[chip], reference), refuses))
    return out


def track_curves(quick: bool) -> dict[str, list[tuple[float, float, bool]]]:
    """The same over the deviation of the track: straight line assumed, compensated for omega-K, polar format."""
    out: dict[str, list[tuple[float, float, bool]]] = {
        "unknown, backprojection": [],
        "known, compensated, omega_k": [],
        "known, polar_format": [],
    }
    radar = ideal_radar(n_samples=400)
    wide = {"extent_azimuth": 120.0, "extent_range": 120.0, "spacing_azimuth": 0.45, "spacing_range": 0.45}
    grid = default_grid(radar, {"center_x": 0.0, "center_y": 0.0, "height": 0.0, "grid": "slant"} | wide)
    rows, columns = (slice(n - 2 * CHIP, n) for n in grid.shape)
    part = replace(grid, azimuth=grid.azimuth[rows], range=grid.range[columns])
    point = part.positions()[CHIP, CHIP]
    u = np.linspace(-1.0, 1.0, radar.track.n_pulses)
    shape = np.stack([np.sin(2.0 * u), 0.0 * u, np.cos(3.0 * u)], axis=1)  # across and up
    for deviation in DEVIATIONS[:: 4 if quick else 1]:
        flown = replace(
            radar, track=Track.from_samples(radar.track.time, radar.track.position + deviation * shape)
        )
        raw = ideal_echoes(flown, point)
        exact = backproject(raw, part, interpolation="kernel:8", oversampling=4)[0]
        plan = plan_straightening(flown, grid)
        images = {
            "unknown, backprojection": (backproject(replace(raw, radar=radar), part)[0], False),
            "known, compensated, omega_k": (
                focused("omega_k", compensate_motion(raw, plan), grid)[rows, columns],
                compensation_residual(plan, grid).phase > LARGEST_RESIDUAL,
            ),
            "known, polar_format": (
                focused("polar_format", raw, grid)[rows, columns],
                bool(parse_focuser("polar_format").refusal(flown, grid)),
            ),
        }
        for name, (image, refuses) in images.items():
            out[name].append((deviation, image_error_db(image, exact), refuses))
    return out


def figure(
    taken: dict[str, list[tuple[float, float, bool]]], label: str, title: str, *, logarithmic: bool
) -> Any:
    """Curves with filled marks where a form takes the data and hollow ones where it refuses."""
    drawn, axes = harness.new_figure(8.0, 4.4)
    seen: dict[str, int] = {}
    for i, (name, nodes) in enumerate(taken.items()):
        kind = name.partition(",")[0]
        color = COLORS.get(kind, f"C{i}")
        style = LINES[seen.setdefault(kind, 0) % len(LINES)]
        seen[kind] += 1
        x, y, refuses = (np.array(column) for column in zip(*nodes, strict=True))
        axes.plot(x, y, style, color=color, label=name, linewidth=1.2)
        axes.plot(x[~refuses], y[~refuses], "o", color=color, ms=4)
        axes.plot(x[refuses], y[refuses], "o", color=color, ms=4, markerfacecolor="white")
    if logarithmic:
        axes.set_xscale("log")
    axes.set_xlabel(label)
    axes.set_ylabel("error of a point at the image's edge, dB")
    axes.set_title(title, fontsize=10)
    axes.legend(
        fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5), title="hollow: it refuses", title_fontsize=7
    )
    return drawn


__all__ = [
    "CELL",
    "CHIP",
    "FORMS",
    "NODES",
    "STEPS",
    "SWEEPS",
    "curves",
    "figure",
    "focused",
    "limit_of",
    "place_of",
    "setting",
    "track_curves",
]
