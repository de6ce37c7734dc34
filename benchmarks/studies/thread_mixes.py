"""Public functions called from two to four threads at once, in drawn mixes: bits against those of one thread.

Every mix draws its threads, and for each thread what it calls: ``simulate``, ``focus`` by drawn focusers,
``trace_paths``, ``monostatic_rcs``, ``write_image`` and ``read_image``; half of the scenes are shared by all threads,
half loaded by the thread. One mix in ``FRESH`` runs in a process of its own where nothing has been imported, so that
registries, back end and plugins are first used by all threads together.
"""

import argparse
import hashlib
import json
import random
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

from tests.support.unweighted import focus

# scenes that take a fraction of a second: mirrors, curved metal, ideal points, clutter
SCENES = ("dihedral", "sphere", "point", "flat_ground")
# parameters that keep them small
SMALL = {
    "flat_ground": {"range_film.image_extent_azimuth": "10", "range_film.image_extent_range": "10"},
}
FOCUSERS = ("backprojection", "omega_k", "range_doppler")
SUFFIXES = ("h5", "hdf5")
TASKS = ("simulate", "focus", "paths", "rcs", "write")
FRESH = 20  # every so many mixes: a process takes two seconds to start
SEED = 26


def digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


class Calls:
    """What threads call; the same arguments give the same digest, whoever calls and when."""

    def __init__(self) -> None:
        self.scenes: dict[str, object] = {}
        self.raw: dict[str, object] = {}
        self.image: dict[str, object] = {}

    def scene(self, name: str, shared: bool) -> object:
        import sarmitsuba

        if not shared:
            return sarmitsuba.load_scene(name, parameters=SMALL.get(name, {}))
        return self.scenes[name]

    def prepare(self, names: tuple[str, ...]) -> None:
        import sarmitsuba

        for name in names:
            self.scenes[name] = sarmitsuba.load_scene(name, parameters=SMALL.get(name, {}))
            self.raw[name] = sarmitsuba.simulate(self.scenes[name], seed=1)
            self.image[name] = focus(self.raw[name])

    def call(self, task: tuple[str, str, str, bool]) -> str:
        """Do one task (function, scene, variant, shared scene) and return its result's digest."""
        import numpy as np

        import sarmitsuba

        what, name, variant, shared = task
        if what == "simulate":
            return digest(sarmitsuba.simulate(self.scene(name, shared), seed=int(variant)).data.tobytes())
        if what == "focus":
            return digest(focus(self.raw[name], focuser=variant).data.tobytes())
        if what == "paths":
            table = sarmitsuba.trace_paths(self.scene(name, shared), pulses=int(variant))
            return digest(table.amplitude.tobytes() + table.points.tobytes())
        if what == "rcs":
            scene = self.scene(name, shared)
            found = sarmitsuba.monostatic_rcs(
                scene.geometry, scene.materials, [[0.0, -0.6, 0.8]], scene.radar.waveform.center_frequency
            )
            return digest(np.ascontiguousarray(found.amplitude).tobytes())
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"image.{variant}"
            sarmitsuba.write_image(self.image[name], path)
            return digest(sarmitsuba.read_image(path).data.tobytes())


def draw_mix(seed: int) -> list[list[tuple[str, str, str, bool]]]:
    """One list of tasks for each thread."""
    rng = random.Random(f"{SEED} {seed}")
    threads = []
    for _ in range(rng.randint(2, 4)):
        tasks = []
        for _ in range(rng.randint(1, 3)):
            what, name = rng.choice(TASKS), rng.choice(SCENES)
            if what == "rcs" and name in {"point", "flat_ground"}:
                name = "dihedral"
            variant = {
                "simulate": str(rng.randint(1, 2)),
                "focus": rng.choice(FOCUSERS),
                "paths": str(rng.randint(0, 1)),
                "rcs": "",
                "write": rng.choice(SUFFIXES),
            }[what]
            tasks.append((what, name, variant, rng.random() < 0.5))
        threads.append(tasks)
    return threads


def in_threads(mix: list[list[tuple[str, str, str, bool]]], call: Callable[..., str]) -> list[list[str]]:
    """Digests, or the error's first words, of every thread's tasks done at the same time."""
    found: list[list[str]] = [[] for _ in mix]
    gate = threading.Barrier(len(mix))

    def work(k: int) -> None:
        gate.wait()
        for task in mix[k]:
            try:
                found[k].append(call(task))
            except Exception as error:
                found[k].append(f"{type(error).__name__}: {str(error)[:200]}")

    threads = [threading.Thread(target=work, args=(k,)) for k in range(len(mix))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return found


def fresh(mix: list[list[tuple[str, str, str, bool]]]) -> list[list[str]]:
    """The same in a process that has imported nothing: every thread loads its own scenes first."""
    alone = [[(what, name, variant, False) for what, name, variant, _ in tasks] for tasks in mix]
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.studies.thread_mixes", "--child", json.dumps(alone)],
        capture_output=True,
        text=True,
        timeout=600,
        cwd=Path(__file__).parents[2],
    )
    if done.returncode:
        return [[f"status {done.returncode}: {done.stderr[-300:]}"] for _ in mix]
    return json.loads(done.stdout)  # type: ignore[no-any-return]


def child(mix: list[list[list[str]]]) -> list[list[str]]:
    calls = Calls()

    def call(task: tuple[str, str, str, bool]) -> str:
        name = task[1]
        if task[0] in {"focus", "write"} and name not in calls.image:
            calls.prepare((name,))
        return calls.call(task)

    return in_threads([[tuple(task) for task in tasks] for tasks in mix], call)  # type: ignore[misc]


def run(count: int, first: int = 0, fresh_every: int = FRESH) -> dict[str, object]:
    """Counts of mixes, calls and differences; the first differences with their seeds."""
    calls = Calls()
    calls.prepare(SCENES)
    truth: dict[tuple[str, str, str], str] = {}
    wrong: list[str] = []
    total = 0
    for seed in range(first, first + count):
        mix = draw_mix(seed)
        for tasks in mix:
            for task in tasks:
                if task[:3] not in truth:
                    truth[task[:3]] = calls.call(task)
        apart = fresh_every > 0 and seed % fresh_every == fresh_every - 1
        found = fresh(mix) if apart else in_threads(mix, calls.call)
        for tasks, digests in zip(mix, found, strict=True):
            for k, task in enumerate(tasks):
                total += 1
                got = digests[k] if k < len(digests) else "nothing"
                if got != truth[task[:3]]:
                    wrong.append(f"mix {seed}{' (own process)' if apart else ''}: {task}: {got}")
    return {"mixes": count, "calls": total, "different": len(wrong), "first": wrong[:10]}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=200, help="mixes (default: 200)")
    parser.add_argument("--first", type=int, default=0, help="first seed (default: 0)")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        print(json.dumps(child(json.loads(options.child))))
        sys.exit(0)
    report = run(options.count, options.first)
    print(json.dumps(report, indent=1))
    sys.exit(bool(report["different"]))
