"""A loop over looks, headings, bands and polarisations in a fresh kernel cache: processor time and compiled kernels."""

import json
import os
import subprocess
import sys
import tempfile

from benchmarks.support import harness

CHILD = """
import json, random, sys, time, warnings
from sarmitsuba.machine.backend import ensure_backend
ensure_backend()
import drjit as dr
from sarmitsuba.loading.load import load_scene
from sarmitsuba.simulation.execution.render import render

warnings.simplefilter("ignore")
dr.set_flag(dr.JitFlag.KernelHistory, True)
rng = random.Random(7)
for i in range(int(sys.argv[1])):
    values = {
        "look_angle_deg": rng.uniform(25, 55),
        "polarisation": ("VV", "HH")[i % 2],
        "sar_antenna.heading_deg": rng.uniform(0, 360),
        "sar_antenna.bandwidth": rng.uniform(250e6, 500e6),
        "sar_antenna.center_frequency": rng.uniform(9e9, 10e9),
        "range_film.image_extent_azimuth": rng.uniform(40, 60),
        "range_film.image_extent_range": rng.uniform(60, 100),
    }
    scene = load_scene("tower", parameters={name: str(value) for name, value in values.items()})
    dr.kernel_history_clear()
    start = time.process_time()
    render(scene, method=sys.argv[2])
    taken = time.process_time() - start
    kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT and not k["cache_hit"]]
    disk = sum(bool(k["cache_disk"]) for k in kernels)
    print(json.dumps([taken, len(kernels) - disk, disk]))
"""
RUNS, QUICK = 20, 4


def loop(method: str, runs: int, cache: str) -> list[list[float]]:
    """Processor seconds, kernels compiled and kernels read from disk of every run of a new process."""
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(runs), method],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "DRJIT_CACHE_DIR": cache},
    )
    return [json.loads(line) for line in done.stdout.splitlines()]


@harness.benchmark
def run(quick: bool) -> harness.Report:
    runs = QUICK if quick else RUNS
    report = harness.Report(
        "loop",
        "A loop of runs",
        f"{runs} runs of the tower with another look angle, heading, bandwidth, frequency, polarisation and image each "
        "(one process, an empty kernel cache), and the same in the next process. Processor seconds of all threads.",
    )
    rows = []
    for method in ("hybrid",) if quick else ("hybrid", "image", "raster"):
        with tempfile.TemporaryDirectory() as cache:
            for process in ("first", "next"):
                found = loop(method, runs, cache)
                seconds, compiled, read = (sum(column) for column in zip(*found, strict=True))
                late = sum(row[1] for row in found[runs // 2 :])
                rows.append([method, process, f"{seconds:.1f}", int(compiled), int(late), int(read)])
                if process == "next":
                    report.claim(
                        f"{method}: kernels compiled again in the next process", compiled, 0, at_least=False
                    )
    columns = ["method", "process", "CPU s", "kernels compiled", "in the second half", "read from disk"]
    report.table("", columns, rows)
    return report
