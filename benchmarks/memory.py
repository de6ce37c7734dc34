"""Predicted memory against the measured peak of `render`, scene by scene and method by method."""

import json
import subprocess
import sys
import tempfile

import harness

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
    "tower, three passes": ("tower", "--target-error", "-48"),
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
    return report
