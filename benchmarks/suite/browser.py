"""The page's backprojection in a headless browser, against ours: agreement, and CPU seconds with WebGL in software.

Usage: python -m benchmarks.suite.browser [--quick] [-o FOLDER]; needs the package playwright and a Chromium.
"""

import base64
import importlib.util
import os
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.support import harness

SIZE = 256  # pixels each way of the preview that follows a slider
# drawn once for all cases: points over the middle of the image
POINTS = 12
IMAGES = 5  # of which the CPU seconds are the mean: the clock of processes ticks every 10 ms

FOCUS = """
const { createBackprojector } = await import("sarmitsuba/backprojector.js");
window.bp = await createBackprojector(null, data, grid, device);
bp.addAll();
const { re, im } = await bp.read();
return [pack(re), pack(im)];
"""
AGAIN = "for (let i = 0; i < n; i++) { bp.reset(); bp.addAll(); await bp.read(); }"


def page_tools() -> Any:
    """The headless browser of the page's tests."""
    path = harness.ROOT / "tests" / "page" / "conftest.py"
    spec = importlib.util.spec_from_file_location("page_tools", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def cpu_seconds() -> float:
    """User and system seconds of all running descendants of this process; NaN where there is no /proc."""
    if not Path("/proc/self/stat").exists():
        return float("nan")
    parent, seconds = {}, {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = entry.read_text(encoding="utf-8").rpartition(")")[2].split()
        except OSError:  # it ended meanwhile
            continue
        pid = int(entry.parent.name)
        parent[pid] = int(fields[1])
        seconds[pid] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    own, total = os.getpid(), 0.0
    for pid in seconds:
        above = parent.get(pid, 0)
        while above not in (0, own):
            above = parent.get(above, 0)
        total += seconds[pid] if above == own else 0.0
    return total


def cases(quick: bool) -> dict[str, tuple[Any, dict[str, Any]]]:
    """Radars and image requests by name."""
    from sarmitsuba.signal.focusing.ideal import ideal_radar

    def square(spacing: float, **more: Any) -> dict[str, Any]:
        extent = (SIZE - 2) * spacing
        return {
            "extent_azimuth": extent,
            "extent_range": extent,
            "spacing_azimuth": spacing,
            "spacing_range": spacing,
            **more,
        }

    airborne = ideal_radar(n_samples=400)
    found = {"10 km, ground": (airborne, square(0.5, grid="ground"))}
    if not quick:
        squinted = ideal_radar(n_samples=512, squint_angle=0.2, center_frequency=5.4e9)
        # as stripmap does it: every pixel takes the pulses within a band of its own
        band = replace(
            ideal_radar(n_samples=400, resolution=0.5), half_aperture=airborne.waveform.wavelength / 4.0
        )
        orbit = ideal_radar(slant_range=700e3, n_samples=512, resolution=4.0)
        found |= {
            "10 km, squint 11 deg, C band": (squinted, square(0.5, grid="ground")),
            "10 km, own aperture per pixel": (band, square(0.5, grid="slant")),
            "700 km": (orbit, {**square(0.5, grid="slant"), "extent_azimuth": 508.0, "spacing_azimuth": 2.0}),
        }
    return found


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.signal.focusing import default_grid
    from sarmitsuba.signal.focusing.focusers.backprojection import backproject
    from sarmitsuba.signal.focusing.ideal import ideal_echoes
    from sarmitsuba.signal.metrics import coherence, image_error_db
    from sarmitsuba.view.page.quantised_profiles import page_grid, page_profiles

    report = harness.Report(
        "browser",
        "Backprojection in the page",
        f"Points focused by the page's own code in a headless Chromium, WebGL2 drawn in software on this machine's "
        f"cores, and by `backproject` here: {SIZE} x {SIZE} pixels. `first` includes the range windows and the upload; "
        "`again` is what a slider costs.",
    )
    tools = page_tools()
    path = tools.browser()
    if path is None or importlib.util.find_spec("playwright") is None:
        report.notes.append("Left out: no browser, or no package playwright to drive it.")
        return report
    rng = np.random.default_rng(5)
    rows, worst = [], 1.0
    with tempfile.TemporaryDirectory() as folder, tools.opened(path, Path(folder)) as context:
        for name, (radar, request) in cases(quick).items():
            points = np.column_stack([rng.uniform(-50, 50, (POINTS, 2)), rng.uniform(0, 4, POINTS)])
            raw = ideal_echoes(
                radar, points, rng.uniform(0.3, 3.0, POINTS), rng.uniform(0.0, 2.0 * np.pi, POINTS)
            )
            grid = default_grid(raw, request)
            want = backproject(raw, grid)[0]
            profiles = page_profiles(raw, grid)
            for device in ("gpu", "cpu") if name == "10 km, ground" else ("gpu",):
                bench = tools.Bench(context.new_page(), Path(folder))
                start = cpu_seconds()
                out = bench.run(FOCUS, data=profiles.payload(), grid=page_grid(grid), device=device)
                first = cpu_seconds() - start
                count = IMAGES if device == "gpu" else 1
                start = cpu_seconds()
                bench.run(AGAIN, n=count)
                again = (cpu_seconds() - start) / count
                bench.page.close()
                parts = [np.frombuffer(base64.b64decode(text), dtype=np.float32) for text in out]
                got = (parts[0] + 1j * parts[1]).reshape(grid.shape)
                alike = coherence(got, want)
                worst = min(worst, alike)
                pulses = radar.track.n_pulses
                rows.append(
                    [
                        name,
                        {"gpu": "WebGL2", "cpu": "JavaScript"}[device],
                        pulses,
                        profiles.samples.shape[1],
                        profiles.samples.nbytes / 1e6,
                        f"{alike:.6f}",
                        image_error_db(got, want),
                        first,
                        again,
                        want.size * pulses / again / 1e6,
                    ]
                )
    report.table(
        "",
        [
            "radar",
            "device",
            "pulses",
            "bins",
            "data MB",
            "coherence",
            "error dB",
            "first, CPU s",
            "again, CPU s",
            "pixel-pulses per CPU s, millions",
        ],
        rows,
    )
    report.claim("coherence with our backprojection", worst, 0.999, at_least=True)
    # one second of two cores
    report.claim(
        f"CPU seconds of a preview of {SIZE} x {SIZE} pixels and 200 pulses",
        rows[0][8] * 200.0 / rows[0][2],
        2.0,
        at_least=False,
        unit="s",
    )
    report.data["rows"] = rows
    return report


if __name__ == "__main__":
    harness.main(run)
