"""Hard cases: runs tests/numerics and turns what the tests measure into the table of docs/numerics.md.

Usage: python benchmarks/studies/numerics.py [--output docs/numerics.md] [--json FILE]

Every line is one check of a test: the naive way's error where the test measures it, ours, the bound that the test
holds. Ends with status 1 when a test fails; the page is then not written.
"""

import argparse
import ast
import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import _support
import kernel_sources
import pytest

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
The page is written by `python benchmarks/studies/numerics.py`.
"""
TAIL = """
## Curved surfaces: what was tried

A sphere of ka = 60 in facets of sagitta λ/32 is up to 0.8 dB off in some of 60 directions (0.35 dB rms): the facets,
1.3 wavelengths wide, repeat so regularly that the ±0.1 rad by which they miss the sphere act as a grating. Three
remedies:

- vertices shifted at random by 0.2 edges: worse, 1.2 dB, because the largest facets grow;
- the phase of every hit corrected to the true surface by the vertices' normals: 0.3 dB (measured once, in NumPy; it
  would cost one more table and would bulge flat roofs with blunt ridges);
- facets below 0.55 wavelengths, so that their rows lie less than half a wavelength apart: 0.2 dB. Chosen.

Shapes of a scene file are cut to a sagitta of λ/512, which implies such facets for all but the largest spheres.

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
    parts = [HEAD, f"\n{kernel_sources.statement(kernel_sources.current())}\n"]
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
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "numerics.md")
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
        print("a test failed: the page is not written", file=sys.stderr)
        sys.exit(1)
    kernel_sources.measured()
    args.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
