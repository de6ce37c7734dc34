"""Runs that are killed at random times against one that is not: bits, what is lost, and what keeping blocks costs."""

import random
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

import sarmitsuba
from benchmarks.support import harness
from sarmitsuba.files import read_image, read_raw
from sarmitsuba.machine.journal import Journal

# one of each kind: shared and single tracing, subsets (always, from the command line), orders, noise, channels
RUNS = {
    "tower": ("tower",),
    "tower, 32 pulses a block, orders": (
        *("tower", "-D", "sar_path.key_pulse_interval=32", "-D", "sar_path.keep_orders=true"),
        *("-D", "sar_antenna.azimuth_resolution=3"),
    ),
    "tower, raw, noise": (
        *("tower", "--method", "raw", "-D", "sar_antenna.azimuth_resolution=5"),
        *("-D", "sar_antenna.noise_temperature=500"),
    ),
    "flat_ground, two channels": ("flat_ground", "-D", "polarisation=HH,VV"),
}
# kills of a full run: twenty, as asked for; of a quick one, enough to see that it works
KILLS, KILLS_QUICK = 20, 2
# paired runs with and without kept blocks: an odd number has a median
PAIRS = 5
SEED = 16


def start(options: tuple[str, ...], out: Path) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "sarmitsuba", "render", *options, "--format", "hdf5", "-o", str(out)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def blocks_in(out: Path) -> int:
    """Finished blocks that a killed run has left."""
    path = out / "raw.blocks"
    if not path.exists():
        return 0
    journal = Journal(path)
    journal.close()
    return sum(label["kind"] == "block" for label in journal.labels)


def differing(out: Path, whole: Path) -> tuple[int, int]:
    """Values of raw data and of the image whose bits are not the same."""
    pairs = [
        (read_raw(out / "raw.h5").data, read_raw(whole / "raw.h5").data),
        (read_image(out / "image.h5").data, read_image(whole / "image.h5").data),
    ]
    raw, image = (int(np.sum(a.view(np.uint64) != b.view(np.uint64))) for a, b in pairs)
    return raw, image


def killed_runs(folder: Path, kills: int) -> list[list[object]]:
    """One row for every run that was brought to its end: its kills, what each found, and bits that differ."""
    draw, rows, left = random.Random(SEED), [], kills
    whole: dict[str, tuple[Path, float]] = {}
    while left > 0:
        for name, options in RUNS.items():
            if left <= 0:
                break
            if name not in whole:
                begin, out = time.perf_counter(), folder / f"whole {len(whole)}"
                process = start(options, out)
                _, errors = process.communicate()
                if process.returncode:
                    raise RuntimeError(errors)
                whole[name] = (out, time.perf_counter() - begin)
            reference, seconds = whole[name]
            out, at, found = folder / f"killed {len(rows)}", [], []
            while True:
                process, wait = start(options, out), draw.uniform(0.0, seconds)
                try:
                    if left <= 0:
                        wait = None
                    _, errors = process.communicate(timeout=wait)
                    break
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.communicate()
                    left -= 1
                    at.append(f"{wait / seconds:.2f}")
                    found.append("raw.h5" if (out / "raw.h5").exists() else str(blocks_in(out)))
            if process.returncode:
                raise RuntimeError(errors)
            same = {path.name for path in out.iterdir()} == {path.name for path in reference.iterdir()}
            raw, image = differing(out, reference)
            rows.append([name, ", ".join(at), ", ".join(found), raw, image, "yes" if same else "no"])
    return rows


def overhead(name: str, folder: Path) -> tuple[float, list[float]]:
    """Processor seconds of a simulation that keeps nothing, and of each pair what keeping its blocks adds, per cent."""
    scene = sarmitsuba.load_scene(name)
    scene = replace(scene, settings=replace(scene.settings, keep_subsets=True))
    state = folder / "raw.blocks"

    def seconds(keep: bool) -> float:
        begin = time.process_time()
        sarmitsuba.simulate(scene, state=state if keep else None)
        taken = time.process_time() - begin
        state.unlink(missing_ok=True)
        return taken

    seconds(False)  # compiles
    pairs = [(seconds(False), seconds(True)) for _ in range(PAIRS)]
    return median(off for off, _ in pairs), [100.0 * (on / off - 1.0) for off, on in pairs]


@harness.benchmark
def run(quick: bool) -> harness.Report:
    report = harness.Report(
        "kill",
        "Killed runs",
        "`render` is killed (SIGKILL) at random times and started again with the same command, until it comes to its "
        "end; raw data and image against those of a run that was left alone. Times are shares of that run's.",
    )
    kills = KILLS_QUICK if quick else KILLS
    with tempfile.TemporaryDirectory() as folder:
        rows = killed_runs(Path(folder), kills)
    columns = [
        "run",
        "killed at",
        "finished blocks then",
        "raw values that differ",
        "pixels that differ",
        "same files",
    ]
    report.table(f"{kills} kills", columns, rows)
    report.claim(
        "values that differ", sum(int(str(row[3])) + int(str(row[4])) for row in rows), 0, at_least=False
    )
    report.claim("runs with other files", sum(row[5] == "no" for row in rows), 0, at_least=False)
    costs, worst = [], 0.0
    for name in ("tower",) if quick else ("tower", "urban_block"):
        with tempfile.TemporaryDirectory() as folder:
            seconds, added = overhead(name, Path(folder))
        worst = max(worst, median(added))
        costs.append(
            [name, f"{seconds:.2f}", f"{median(added):+.1f}", ", ".join(f"{v:+.1f}" for v in sorted(added))]
        )
    report.table(
        f"Cost of keeping blocks, {PAIRS} pairs",
        ["scene", "processor s without", "added % (median)", "of each pair"],
        costs,
    )
    report.claim("processor time that keeping blocks adds", worst, 3.0, at_least=False, unit="%")
    return report
