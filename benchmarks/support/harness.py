"""What all benchmarks share: their registry, timing in interleaved rounds, machine facts, tables, JSON, plots.

A benchmark is a file with a function ``run(quick) -> Report`` under ``@harness.benchmark``; its name is the file's.
``run_all.py`` finds those that lie in ``benchmarks/suite`` and takes others by path.
"""

import argparse
import importlib
import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import Any

from sarmitsuba.core.errors import ExtensionError
from sarmitsuba.core.registry import Registry

ROOT = Path(__file__).resolve().parents[2]
SUITE = ROOT / "benchmarks" / "suite"
RESULTS = ROOT / "benchmarks" / "results"
# pages that programs make: not in the repository, shown by `make docs`
PAGES = ROOT / "docs" / "generated"
# rounds of the full suite: the median of three survives one disturbance
ROUNDS = 3
ROUNDS_QUICK = 1


def machine() -> dict[str, Any]:
    """Context that figures depend on."""
    import importlib.metadata

    cpu = platform.processor()
    if sys.platform.startswith("linux"):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                cpu = line.partition(":")[2].strip()
                break
    facts: dict[str, Any] = {
        "cpu": cpu,
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "day": date.today().isoformat(),
    }
    for name in ("sarmitsuba", "mitsuba", "drjit", "numpy", "scipy"):
        facts[name] = importlib.metadata.version(name)
    if hasattr(os, "sysconf"):
        facts["memory_gb"] = round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    facts["load"] = load()
    return facts


def write_page(page: Path, text: str) -> None:
    """Write a page of the site; nothing where it is the same already, so that the site is not built again."""
    page.parent.mkdir(parents=True, exist_ok=True)
    if not page.is_file() or page.read_text(encoding="utf-8") != text:
        page.write_text(text, encoding="utf-8")


def load() -> float:
    """Other programs' share: the 1-minute load average, NaN where there is none."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else float("nan")


@dataclass(frozen=True)
class Timing:
    """Seconds of one job: first run less the median (compiling and first touches), median, fastest and slowest."""

    compile: float
    median: float
    low: float
    high: float

    def __str__(self) -> str:
        return (
            f"{self.median:.3g}"
            if self.low == self.high
            else f"{self.median:.3g} ({self.low:.3g} ... {self.high:.3g})"
        )


def interleave(jobs: Mapping[str, Callable[[], Any]], rounds: int) -> dict[str, Timing]:
    """Run every job once to warm up, then all of them in turn ``rounds`` times."""
    first, taken = {}, {name: [] for name in jobs}
    for name, job in jobs.items():
        start = time.perf_counter()
        job()
        first[name] = time.perf_counter() - start
    for _ in range(rounds):
        for name, job in jobs.items():
            start = time.perf_counter()
            job()
            taken[name].append(time.perf_counter() - start)
    out = {}
    for name, seconds in taken.items():
        median = statistics.median(seconds)
        out[name] = Timing(max(0.0, first[name] - median), median, min(seconds), max(seconds))
    return out


@dataclass
class Report:
    """One benchmark's outcome, on its way to table, JSON, plot and the collected page.

    Parameters
    ----------
    name : file name without suffix
    title : heading
    text : one paragraph: what is measured, against what
    """

    name: str
    title: str
    text: str
    tables: list[dict[str, Any]] = field(default_factory=list)
    claims: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    figures: dict[str, Any] = field(default_factory=dict)
    data: dict[str, Any] = field(default_factory=dict)
    machine: dict[str, Any] = field(default_factory=machine)

    def table(self, caption: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
        """Add a table."""
        self.tables.append({"caption": caption, "columns": list(columns), "rows": [list(r) for r in rows]})

    def claim(self, text: str, value: float, bound: float, *, at_least: bool, unit: str = "") -> None:
        """Add a figure that the program promises, with its bound."""
        met = value >= bound if at_least else value <= bound
        self.claims.append(
            {
                "text": text,
                "value": value,
                "bound": bound,
                "at_least": at_least,
                "unit": unit,
                "met": bool(met),
            }
        )

    def figure(self, name: str, figure: Any) -> None:
        """Add a Matplotlib figure; ``name`` is part of the file's name."""
        self.figures[name] = figure

    def markdown(self, images: str = "") -> str:
        """The report as Markdown; ``images`` is the folder of the pictures as seen from the page."""
        lines = [f"## {self.title}", "", self.text, ""]
        for name in self.figures:
            lines += [f"![{self.title}: {name}]({images}{self.name}_{name}.png)", ""]
        for t in self.tables:
            if t["caption"]:
                lines += [f"**{t['caption']}**", ""]
            lines.append("| " + " | ".join(t["columns"]) + " |")
            lines.append("|" + "---|" * len(t["columns"]))
            lines += ["| " + " | ".join(_cell(v) for v in row) + " |" for row in t["rows"]]
            lines.append("")
        if self.claims:
            lines += ["| promised | measured | bound | |", "|---|---|---|---|"]
            for c in self.claims:
                sign = ">=" if c["at_least"] else "<="
                assessment = "met" if c["met"] else "**not met**"
                lines.append(
                    f"| {c['text']} | {_cell(c['value'])} {c['unit']} | {sign} {_cell(c['bound'])} "
                    f"{c['unit']} | {assessment} |"
                )
            lines.append("")
        lines += [f"{note}  " for note in self.notes]
        facts = ", ".join(f"{self.machine[name]}" for name in ("cpu", "system"))
        versions = ", ".join(
            f"{name} {self.machine[name]}" for name in ("sarmitsuba", "mitsuba", "drjit", "numpy")
        )
        lines += [
            f"Measured on {self.machine['day']}: {facts}, {self.machine['cores']} cores, load average {load()} at the "
            f"end; {versions}.",
            "",
        ]
        return "\n".join(lines)

    def save(self, folder: Path) -> None:
        """Write JSON, Markdown and pictures, and print the Markdown."""
        folder.mkdir(parents=True, exist_ok=True)
        facts = {
            k: getattr(self, k)
            for k in ("name", "title", "text", "tables", "claims", "notes", "data", "machine")
        }
        (folder / f"{self.name}.json").write_text(
            json.dumps(facts, indent=1, default=float), encoding="utf-8"
        )
        text = self.markdown()
        (folder / f"{self.name}.md").write_text(text, encoding="utf-8")
        for name, figure in self.figures.items():
            figure.savefig(folder / f"{self.name}_{name}.png", dpi=110)
        print(text, flush=True)


@dataclass(frozen=True)
class Benchmark:
    """A benchmark before it is run: ``run(quick)``, with small sizes and one round when quick."""

    name: str
    run: Callable[[bool], Report]


BENCHMARKS: Registry[Benchmark] = Registry("benchmark", Benchmark)


def benchmark(run: Callable[[bool], Report]) -> Callable[[bool], Report]:
    """Register a benchmark under the name of its file; used as a decorator."""
    path = Path(run.__code__.co_filename)
    if path.stem in BENCHMARKS:
        raise ExtensionError(
            f"{path}: there is a benchmark {path.stem!r} already; give the file another name"
        )
    BENCHMARKS.register(Benchmark(path.stem, run))
    return run


def discover(folder: Path = SUITE) -> None:
    """Import every file of a folder that holds a benchmark."""
    for path in sorted(folder.glob("*.py")):
        if path.stem not in BENCHMARKS.names and "\n@harness.benchmark\n" in path.read_text(encoding="utf-8"):
            importlib.import_module(f"benchmarks.{folder.name}.{path.stem}")


def _cell(value: Any) -> str:
    if isinstance(value, float):
        if value != value:
            return "-"
        return f"{value:.1f}" if 10.0 <= abs(value) < 1e5 else f"{value:.3g}"
    return str(value)


def new_figure(width: float = 7.0, height: float = 4.4, columns: int = 1, rows: int = 1) -> tuple[Any, Any]:
    """A Matplotlib figure without a window system, and its axes: one, or an array without dimensions of 1."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax in axes.flat:
        ax.grid(alpha=0.3)
    return figure, axes[0, 0] if axes.size == 1 else axes.squeeze()


def munich() -> Path | None:
    """Scene file of Munich, None where it is not installed."""
    return carried("munich")


def carried(name: str) -> Path | None:
    """Scene file of a city that the package sionna-rt carries, None where it is not installed.

    Found without importing it: its Dr.Jit must not start before the back end is chosen.
    """
    import importlib.util

    try:
        spec = importlib.util.find_spec("sionna")
    except (ImportError, ValueError):
        return None
    for place in (spec.submodule_search_locations or ()) if spec else ():
        path = Path(place) / "rt" / "scenes" / name / f"{name}.xml"
        if path.exists():
            return path
    return None


def load_munich(**parameters: str) -> Any:
    """Munich under the airborne X-band radar: 400 m x 400 m, 512 pulses; None where it is not installed."""
    from sarmitsuba.loading.library import resolve_radar
    from sarmitsuba.loading.load import load_scene

    path = munich()
    if path is None:
        return None
    fixed = {"n_pulses": "512", "aim_x": "0", "aim_y": "0", "aim_z": "0"}  # the same from version to version
    return load_scene(path, radar=resolve_radar("airborne_x"), parameters={**fixed, **parameters})


def with_settings(scene: Any, **changes: Any) -> Any:
    """The scene with other trace settings."""
    from dataclasses import replace

    return replace(scene, settings=replace(scene.settings, **changes))


def main(run: Callable[[bool], Report]) -> None:
    """Command line of a benchmark: ``[--quick] [-o FOLDER]``."""
    import warnings

    from sarmitsuba.core.errors import SarmitsubaWarning

    parser = argparse.ArgumentParser(description=sys.modules["__main__"].__doc__)
    parser.add_argument("--quick", action="store_true", help="small sizes, one round")
    parser.add_argument(
        "-o", "--output", type=Path, default=RESULTS, help="folder for JSON, Markdown and plots"
    )
    args = parser.parse_args()
    warnings.simplefilter("ignore", SarmitsubaWarning)
    from sarmitsuba.machine.backend import ensure_backend

    ensure_backend()
    run(args.quick).save(args.output)
