"""What `render` says that it will take against what it took: processor seconds and peak memory, scene by scene.

``python -m benchmarks.suite.forecast [--quick] [-o FOLDER] [--only NAME ...] [--rounds N] [--first SEED]``. Every run
is the command in a process of its own. Seconds are compared as processor seconds of all threads, user and system,
from the line that states them to the end, files and pictures included: other programs on the machine change those
little, elapsed time as they like. Of the rounds of a run the one of the least seconds counts; the first may compile
kernels, once per machine.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.support import harness
from benchmarks.support.focuser_sizes import memory
from sarmitsuba.loading.library import list_scenes, resolve
from sarmitsuba.loading.load import load_scene
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.focusers.backprojection import Backprojection
from sarmitsuba.simulation.execution.render import simulate

# what `render` writes about a run that it announces, and what it has taken when it has ended
CHILD = """
import json, resource, sys, time
from sarmitsuba.cli import main
from sarmitsuba.commands import results
from sarmitsuba.machine.memory import peak_memory

found, inner = {}, results.with_files

def processor():
    whose = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    return sum(used.ru_utime + used.ru_stime for used in map(resource.getrusage, whose))

def announced(*arguments, **options):
    needs = inner(*arguments, **options)
    found.update(seconds=needs.processor, all=needs.elapsed, bytes=needs.memory, stages=dict(needs.stages))
    found.update(before=processor(), elapsed=time.perf_counter())
    return needs

results.with_files = announced
assert main(["render", "--quiet", *sys.argv[1:]]) == 0
found["processor"], found["elapsed"] = processor() - found["before"], time.perf_counter() - found["elapsed"]
with open(sys.argv[-1] + "/parameters.json", encoding="utf-8") as file:
    record = json.load(file)
found.update(took=record.get("simulation", {}).get("seconds"), after=record["seconds"], peak=peak_memory())
print(json.dumps(found))
"""
# methods, channels, passes and sizes beside the scenes as they are shipped
VARIANTS = {
    "tower, raw, 5 m": ("tower", "--method", "raw", "-D", "sar_antenna.azimuth_resolution=5"),
    "tower, image": ("tower", "--method", "image"),
    "tower, two passes, 5 m": ("tower", "--target-error", "-20", "-D", "sar_antenna.azimuth_resolution=5"),
    "urban_block, four channels": ("urban_block", "-D", "polarisation=HH,HV,VH,VV"),
    "urban_block, image": ("urban_block", "--method", "image"),
    "urban_block, raster": ("urban_block", "--method", "raster"),
    "tower, image, rays of 2 cm": ("tower", "--method", "image", "-D", "sar_path.ray_spacing=0.02"),
    "buildings16, image, pixels of 5 cm": (
        *("buildings16", "--method", "image", "-D", "range_film.pixel_spacing_azimuth=0.05"),
        *("-D", "range_film.pixel_spacing_range=0.05"),
    ),
}
# runs of passes end by a wanted error: how many there will be is not forecast
ENDS_BY_ERROR = ("tower, two passes, 5 m",)
CITIES = ("etoile", "florence", "munich", "san_francisco")
# drawn scenes of boxes: the first seed, other than those that the constants were fitted to (0 to 9), and how many
FIRST, DRAWS = 10, 10
# rounds of a run, and of one that takes more than so many processor seconds
ROUNDS, LONG, SECONDS = 3, 2, 10.0
# wanted of time and of memory, either way; of the crane's time
TIME, MEMORY, CRANE = 1.3, 1.15, 1.5
# pixels along each side of images that are focused: below a tile, and many of them
SIDES = (1000, 2000, 4000, 8000)
QUICK = ("plate", "tower, image")


def runs(folder: Path, first: int = FIRST) -> dict[str, tuple[str, ...]]:
    """Arguments of `render` by name: shipped scenes, variants of them, drawn ones, cities and the crane."""
    from benchmarks.support import crane, random_scenes

    out: dict[str, tuple[str, ...]] = {entry.name: (entry.name,) for entry in list_scenes()}
    for seed in range(first, first + DRAWS):
        place = folder / f"boxes{seed}"
        place.mkdir()
        out[f"boxes {seed}"] = (str(random_scenes.draw_boxes(seed).write(place)),)
    for name in CITIES:
        path = harness.carried(name)
        if path is not None:
            out[name] = (str(path), "--radar", "airborne_x")
    out["crane"] = (str(crane.crane(folder)), "--radar", "airborne_x")
    return out | VARIANTS


def made(arguments: Sequence[str], rounds: int) -> dict[str, Any]:
    """The forecast and what was taken, of the round of the least processor seconds."""
    found: list[dict[str, Any]] = []
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as folder:
            done = subprocess.run(
                [sys.executable, "-c", CHILD, *arguments, "-o", f"{folder}/out"],
                capture_output=True,
                text=True,
                check=True,
            )
        found.append(json.loads(done.stdout.splitlines()[-1]))
        if len(found) == LONG and found[-1]["processor"] > SECONDS:
            break
    return min(found, key=lambda row: row["processor"])


def factor(said: float, true: float) -> float:
    """How far off, at least 1."""
    return max(said / true, true / said)


def spread(report: harness.Report, what: str, factors: dict[str, float], bound: float) -> None:
    """Claims about a set of factors: share within the bound, and the worst."""
    within = sum(value <= bound for value in factors.values()) / len(factors)
    worst = max(factors, key=lambda name: factors[name])
    report.claim(
        f"{what} within a factor {bound:g}", 100.0 * within, 100.0, at_least=True, unit="% of the runs"
    )
    report.claim(f"{what}, worst factor: {worst}", factors[worst], bound, at_least=False)


@harness.benchmark
def run(quick: bool, only: Sequence[str] = (), rounds: int = ROUNDS, first: int = FIRST) -> harness.Report:
    report = harness.Report(
        "forecast",
        "Forecasts of time and memory",
        "What `render` says before it traces against what it took: processor seconds of all threads from that line to "
        "the end, and the most that its process held (compiled kernels, files and pictures included). Kernels are "
        "compiled. `before`: processor seconds until the line, Python and libraries included.",
    )
    times: dict[str, float] = {}
    sizes: dict[str, float] = {}
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        wanted = runs(Path(folder), first)
        names = QUICK if quick else [name for name in wanted if not only or name in only]
        for name in names:
            found = made(wanted[name], LONG if quick else rounds)
            said = sum(found["seconds"].values())
            size = found["bytes"] / found["peak"]
            sizes[name] = factor(size, 1.0)
            if name not in ENDS_BY_ERROR:
                times[name] = factor(said, found["processor"])
            rows.append(
                [
                    name,
                    f"{said:.2f}",
                    f"{found['processor']:.2f}",
                    f"{said / found['processor']:.2f}" if name in times else "-",
                    f"{sum(found['all'].values()):.2f}",
                    f"{found['elapsed']:.2f}",
                    f"{found['before']:.1f}",
                    f"{1e-6 * found['bytes']:.0f}",
                    f"{1e-6 * found['peak']:.0f}",
                    f"{size:.2f}",
                ]
            )
            print(" | ".join(rows[-1]), f"| load {harness.load()}", file=sys.stderr, flush=True)
            report.data[name] = found
    report.table(
        "",
        [
            *("run", "said CPU s", "CPU s", "ratio", "said s, idle", "s, as it was", "before, CPU s"),
            *("said MB", "peak MB", "ratio"),
        ],
        rows,
    )
    crane = times.pop("crane", None)
    if times:
        spread(report, "time", times, TIME)
        spread(report, "memory", sizes, MEMORY)
    if crane is not None:
        report.claim("time of the crane, factor", crane, CRANE, at_least=False)
    if not only:
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


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two small runs, one round")
    parser.add_argument("--only", nargs="*", default=[], metavar="NAME", help="runs, by name")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="of each run")
    parser.add_argument("--first", type=int, default=FIRST, metavar="SEED", help="of the drawn scenes")
    parser.add_argument("-o", "--output", type=Path, default=harness.RESULTS)
    given = parser.parse_args()
    run(given.quick, given.only, given.rounds, given.first).save(given.output)
