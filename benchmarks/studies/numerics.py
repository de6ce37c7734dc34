"""Hard cases: runs tests/numerics and turns what the tests measure into a page of the site.

Usage: python -m benchmarks.studies.numerics [--page] [--json FILE]

Every line is one check of a test: the naive way's error where the test measures it, ours, the bound that the test
holds. Ends with status 1 when a test fails; the page is then not made.
"""

import argparse
import ast
import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from benchmarks.support import harness

ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "tests" / "numerics"
# the order of the page; other modules of the folder follow
ORDER = (
    "test_long_ranges",
    "test_far_from_origin",
    "test_seams",
    "test_reflection",
    "test_limits",
    "test_meshes_as_they_come",
    "test_curved_surfaces",
    "test_cavities",
    "test_dynamic_range",
    "test_sampling_is_said",
    "test_trajectories",
    "test_parameters",
    "test_xml_fuzz",
)
HEAD = """# Numerics

This page lists hard cases of numerical precision in ray-traced radar simulation, and the remedy for each.
Every line is a check of a test in `tests/numerics`: the error of the naive way where the test measures it, our error,
the bound that the test holds, and the remedy. A naive error of `nan` means that the naive way gives no number at all.
The naive way is the same code with other arguments, or a stand-in of a few lines in the test, in plain Mitsuba or
NumPy: the order of its error counts, not its digits.
`python -m benchmarks.studies.numerics --page` makes this page.
"""
TAIL = """
## Not met

- **Caustics of concave mirrors.** Tubes spread and shrink with the curvature of the surfaces that they leave, but the
  phase that a wave gains where its rays cross is not added.
- **Overlapping coplanar walls of different materials** give the same image whatever the order of the faces, but which
  of the two materials a ray sees still changes from patch to patch.
- **Noise of vertices** tilts slivers by any angle. Facets whose vertices lie within 0.002 wavelengths of one plane are
  moved into it (`mesh/flattening.py`), and outlines within 0.001 wavelengths of a line are straight. More noise is a
  real shape: slivers are then sampled by chance.
- **Scenes within 5 km of their origin** are not re-centred, unless they lie farther off than 500 m and twenty times
  their size: 1 km off, the edges that float32 moves change an image by 2e-4 of its peak, 3 km off by 1e-3.
"""


class Collector:
    """Pytest plugin that keeps the lines that tests record."""

    def __init__(self) -> None:
        self.lines: dict[str, list[dict[str, Any]]] = {}
        self.seconds: dict[str, float] = {}
        self.counts: dict[str, int] = {}

    def pytest_runtest_logreport(self, report: Any) -> None:
        module = Path(report.fspath).stem
        self.seconds[module] = self.seconds.get(module, 0.0) + report.duration
        if report.when != "call":
            return
        self.counts[module] = self.counts.get(module, 0) + 1
        for name, value in report.user_properties:
            if name == "numerics":
                self.lines.setdefault(module, []).append(value)


def figure(value: float | None, unit: str) -> str:
    if value is None:
        return ""
    if not math.isfinite(value):
        return "nan"
    if unit == "dB" and value <= -200.0:
        return "none"
    return f"{value:.3g} {unit}".strip()


def page(collector: Collector) -> str:
    """Return the Markdown page."""
    parts = [HEAD]
    modules = [m for m in ORDER if m in collector.counts]
    modules += sorted(m for m in collector.lines if m not in modules)
    for module in modules:
        doc = ast.get_docstring(ast.parse((TESTS / f"{module}.py").read_text(encoding="utf-8"))) or module
        title, count = doc.splitlines()[0].rstrip("."), collector.counts[module]
        parts.append(f"\n## {title}\n\n`tests/numerics/{module}.py`, {count} tests\n")
        lines = collector.lines.get(module, [])
        if lines:
            parts.append("\n| case | naive | ours | bound | remedy |\n|---|---|---|---|---|\n")
        for line in lines:
            unit, case = line["unit"], line["case"].replace("|", "\\|")
            parts.append(
                f"| {case} | {figure(line.get('naive'), unit)} | {figure(line['ours'], unit)} "
                f"| {figure(line['bound'], unit)} | {line['remedy']} |\n"
            )
    parts.append(TAIL)
    return "".join(parts)


def main() -> None:
    """Run the tests, print the table, write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--page", action="store_true", help="make a page in docs/generated")
    parser.add_argument("--json", type=Path, help="the lines as JSON")
    args = parser.parse_args()
    collector = Collector()
    start = time.perf_counter()
    status = pytest.main(["-q", "--no-header", "--rootdir", str(ROOT), str(TESTS)], plugins=[collector])
    seconds = time.perf_counter() - start
    text = page(collector)
    print(text)
    slowest = sorted(collector.seconds.items(), key=lambda item: -item[1])[:5]
    print(f"{seconds:.0f} s in all; " + ", ".join(f"{name} {s:.0f} s" for name, s in slowest))
    if args.json:
        args.json.write_text(
            json.dumps({"seconds": seconds, "lines": collector.lines}, indent=1), encoding="utf-8"
        )
    if status != 0:
        print("a test failed: the page is not made", file=sys.stderr)
        sys.exit(1)
    if args.page:
        harness.write_page(harness.PAGES / "numerics.md", text)


if __name__ == "__main__":
    main()
