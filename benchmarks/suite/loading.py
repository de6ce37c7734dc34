"""CPU seconds of loading a city of thousands of mesh files; the tracer's scene counts apart."""

import resource
import statistics
import warnings
from collections.abc import Callable
from typing import Any

from benchmarks.support import harness
from sarmitsuba.loading.mesh_files import read_mesh
from sarmitsuba.loading.xml import parse_file


def cpu_seconds(action: Callable[[], Any], rounds: int) -> list[float]:
    """User and system time together of every round, s."""
    times = []
    for _ in range(rounds):
        before = resource.getrusage(resource.RUSAGE_SELF)
        action()
        after = resource.getrusage(resource.RUSAGE_SELF)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return times


@harness.benchmark
def run(quick: bool) -> harness.Report:
    report = harness.Report(
        "loading",
        "Loading",
        "CPU seconds (user and system) of `load_scene` on Munich, 2367 PLY files of the package sionna-rt.",
    )
    city = harness.munich()
    if city is None:
        report.notes.append("The package sionna-rt, which carries the scene, is not installed.")
        return report
    rounds = 1 if quick else 5
    files = sorted((city.parent / "meshes").glob("*.ply"))
    parts: dict[str, Callable[[], Any]] = {
        "`load_scene`": harness.load_munich,
        "of it: XML": lambda: parse_file(city, {}),
        "of it: mesh files": lambda: [read_mesh(path, path.name) for path in files],
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        harness.load_munich()  # Mitsuba and the libraries are imported
        taken = {name: cpu_seconds(action, rounds) for name, action in parts.items()}
    report.table(
        "",
        ("what", "median, s", "least, s", "most, s"),
        [(name, statistics.median(t), min(t), max(t)) for name, t in taken.items()],
    )
    whole = statistics.median(taken["`load_scene`"])
    report.claim(f"{len(files)} files loaded in", whole, 1.5, at_least=False, unit="CPU s")
    report.data = {"files": len(files), "seconds": taken}
    return report


if __name__ == "__main__":
    harness.main(run)
