"""A loop over settings compiles nothing after its first round, and neither does the next process."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

# what the loop goes through: the first round visits the ends and the middle (the memory of grids has a few sizes, each
# four times the one before), later ones lie anywhere between. On one core: two kernels are others for one thread than
# for many, and on several cores a run takes one or all by its predicted time, which is longer on a busy machine
CHILD = """
import json, os, random, sys, warnings
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
from sarmitsuba.machine.backend import ensure_backend
ensure_backend()
import drjit as dr
from sarmitsuba.signal.chirp import to_chirped
from sarmitsuba.signal.focusing import focus
from sarmitsuba.loading.load import load_scene
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.execution.render import render

warnings.simplefilter("ignore")
dr.set_flag(dr.JitFlag.KernelHistory, True)
RANGES = {
    "look_angle_deg": (30.0, 50.0),
    "sar_antenna.heading_deg": (0.0, 360.0),
    "sar_antenna.bandwidth": (250e6, 500e6),
    "sar_antenna.center_frequency": (9e9, 10e9),
    "sar_antenna.azimuth_resolution": (0.5, 0.8),
    "range_film.image_extent_azimuth": (21.0, 47.0),
    "range_film.image_extent_range": (33.0, 61.0),
}
STRIPMAP = {"sar_antenna.mode": "stripmap", "sar_antenna.pattern": "rectangular"}
LENGTHS = {"sar_antenna.antenna_length": (1.0, 1.6), "sar_antenna.antenna_height": (0.1, 0.2)}
NOISE = {"sar_antenna.transmit_power": "5", "sar_antenna.noise_temperature": "290"}
PULSES = {"sar_antenna.azimuth_resolution": (3.0, 6.0)}  # few of them: every one is traced
KINDS = {
    "hybrid": ("hybrid", {"polarisation": "VV"}, {}),
    "HH": ("hybrid", {"polarisation": "HH"}, {}),
    "stripmap": ("hybrid", STRIPMAP | NOISE, LENGTHS),
    "image": ("image", {}, {}),
    "raster": ("raster", {}, {}),
    "raw": ("raw", {}, PULSES),
    "chirped": ("chirped", NOISE, {}),
}

rng = random.Random(int(sys.argv[1]))


def once(kind, pick):
    method, fixed, more = KINDS[kind]
    values = {name: str(pick(*ends)) for name, ends in (RANGES | more).items()} | fixed
    scene = load_scene("tower", parameters=values)
    dr.kernel_history_clear()
    if method == "chirped":
        focus(to_chirped(simulate(scene, seed=rng.randrange(99))))
    else:
        render(scene, method=method, seed=rng.randrange(99))
    kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    missed = [k for k in kernels if not k["cache_hit"]]
    return [len(kernels), sum(not k["cache_disk"] for k in missed)]


first, later = [], []
kinds = sys.argv[4].split(",")
for corner in range(int(sys.argv[2])):
    for kind in kinds:
        share = lambda: 0.5 * corner if corner < 3 else rng.randrange(2)
        first.append([kind, *once(kind, lambda a, b: a + share() * (b - a))])
for _ in range(int(sys.argv[3])):
    for kind in kinds:
        later.append([kind, *once(kind, rng.uniform)])
print(json.dumps([first, later]))
"""


def compiled(
    seed: int, corners: int, runs: int, kinds: str, cache: Path
) -> tuple[list[list[int]], list[list[int]]]:
    """Kernels launched and compiled by every run of a new process: of those at the ends, of those between."""
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(seed), str(corners), str(runs), kinds],
        capture_output=True,
        text=True,
        env={**os.environ, "DRJIT_CACHE_DIR": str(cache)},
    )
    assert done.returncode == 0, done.stderr
    first, later = json.loads(done.stdout.splitlines()[-1])
    return first, later


@pytest.mark.parametrize(
    "kinds", ["hybrid", pytest.param("stripmap,HH,image,raster,raw,chirped", marks=pytest.mark.slow)]
)
def test_a_loop_compiles_nothing_after_its_first_round(kinds: str, tmp_path: Path) -> None:
    """Cold: an empty cache. Warm: looks, headings, bands, apertures and images anywhere between those seen."""
    pytest.importorskip("drjit")
    first, later = compiled(1, 5, 2, kinds, tmp_path)
    assert sum(row[2] for row in first) > 5  # the cache was cold, and the history does count
    assert all(row[1] > 0 for row in first + later)
    assert [row for row in later if row[2]] == []
    # the next process
    again, _ = compiled(1, 1, 0, kinds, tmp_path)
    assert [row for row in again if row[2]] == []
