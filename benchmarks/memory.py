"""Predicted memory against the measured peak of `render`, scene by scene and method by method."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace

import harness
import numpy as np
from focuser_sizes import memory

from sarmitsuba.focusing import default_grid
from sarmitsuba.focusing.focusers.backprojection import Backprojection
from sarmitsuba.loader.library import resolve
from sarmitsuba.loader.load import load_scene
from sarmitsuba.simulation.raw import simulate

# what `render` writes about a run that it announces, and the peak of the process when it has ended
CHILD = """
import json, sys
from sarmitsuba.commands import render
from sarmitsuba.cli import main
from sarmitsuba.memory import peak_memory

announced = []
inner = render._announcing

def announcing(console, *limit):
    ready = inner(console, *limit)

    def both(run):
        announced.append(run.needs())
        announced.append(announced[0].memory)
        ready(run)

    return both

render._announcing = announcing
assert main(["render", "--quiet", *sys.argv[1:]]) == 0
needs = announced[0]
print(json.dumps({"predicted": announced[1], "measured": peak_memory(), "parts": dict(needs.parts)}))
"""
RUNS = {
    "tower, hybrid": ("tower",),
    "tower, raw, 5 m": ("tower", "--method", "raw", "-D", "sar_antenna.azimuth_resolution=5"),
    "tower, image": ("tower", "--method", "image"),
    "tower, two passes, 5 m": ("tower", "--target-error", "-20", "-D", "sar_antenna.azimuth_resolution=5"),
    "bridge, hybrid": ("bridge",),
    "sphere, hybrid": ("sphere",),
    "buildings16, hybrid": ("buildings16",),
    "urban_block, hybrid": ("urban_block",),
    "urban_block, hybrid, four channels": ("urban_block", "-D", "polarisation=HH,HV,VH,VV"),
    "urban_block, image": ("urban_block", "--method", "image"),
    "urban_block, raster": ("urban_block", "--method", "raster"),
    "tower, image, rays of 2 cm": ("tower", "--method", "image", "-D", "sar_path.ray_spacing=0.02"),
    "buildings16, image, pixels of 5 cm": (
        *("buildings16", "--method", "image", "-D", "range_film.pixel_spacing_azimuth=0.05"),
        *("-D", "range_film.pixel_spacing_range=0.05"),
    ),
}
# pixels along each side of images that are focused: below a tile, and many of them
SIDES = (1000, 2000, 4000, 8000)
QUICK = ("tower, image", "urban_block, raster")


@harness.benchmark
def run(quick: bool) -> harness.Report:
    report = harness.Report(
        "memory",
        "Memory",
        "What `render` says that it will take, before anything is allocated, against the most that its process held "
        "(compiled kernels, files and pictures included).",
    )
    rows, worst = [], 0.0
    for name in QUICK if quick else RUNS:
        with tempfile.TemporaryDirectory() as folder:
            done = subprocess.run(
                [sys.executable, "-c", CHILD, *RUNS[name], "-o", f"{folder}/out"],
                capture_output=True,
                text=True,
                check=True,
            )
        found = json.loads(done.stdout.splitlines()[-1])
        ratio = found["predicted"] / found["measured"]
        worst = max(worst, abs(ratio - 1.0))
        parts = ", ".join(f"{part} {1e-6 * size:.0f}" for part, size in found["parts"].items())
        rows.append(
            [
                name,
                f"{1e-6 * found['predicted']:.0f}",
                f"{1e-6 * found['measured']:.0f}",
                f"{ratio:.2f}",
                parts,
            ]
        )
    report.table("", ["run", "predicted MB", "measured MB", "ratio", "parts, MB"], rows)
    report.claim("largest deviation of the prediction", 100.0 * worst, 30.0, at_least=False, unit="%")
    of_tiles(report, SIDES[:2] if quick else SIDES)
    return report


def of_tiles(report: harness.Report, sides: Sequence[int]) -> None:
    """Memory of backprojection as the image grows: tiles bound what comes on top of its pixels."""
    focuser = Backprojection()
    raw = simulate(load_scene(resolve("point"))).of_pulses(slice(None, None, 32))
    aim = default_grid(raw.radar, raw.request)
    rows, beside = [], []
    for side in sides:
        steps = np.linspace(-0.5, 0.5, side)
        grid = replace(
            aim,
            azimuth=np.ptp(aim.azimuth) * steps + aim.azimuth.mean(),
            range=np.ptp(aim.range) * steps + aim.range.mean(),
        )
        taken, image = memory(focuser, raw, grid), 8 * side**2
        predicted = focuser.making_bytes(raw.radar, grid, 1)
        beside.append(taken - image)
        rows.append(
            [f"{side} x {side}", *(f"{1e-6 * v:.0f}" for v in (predicted, taken, image, taken - image))]
        )
    columns = ["pixels", "predicted MB", "measured MB", "of it the image", "of it all else"]
    report.table("Focusing, beside the raw data", columns, rows)
    growth, pixels = beside[-1] / beside[-2], (sides[-1] / sides[-2]) ** 2
    report.claim(
        f"what is not the image, where the pixels grow {pixels:.0f} times", growth, 1.5, at_least=False
    )
