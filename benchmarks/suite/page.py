"""The page of a run: its size, and CPU seconds of a headless browser that opens it and draws it in software.

Usage: python -m benchmarks.suite.page [--quick] [-o FOLDER]; needs the package playwright and a Chromium.
"""

import importlib.util
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.suite import browser
from benchmarks.support import harness

FRAMES = 10  # of which the CPU seconds are the mean
# reading a pixel waits until the frame is drawn
DRAW = """async (n) => {
  const { world } = window.sarmitsuba.view.page;
  const gl = world.renderer.getContext();
  const pixel = new Uint8Array(4);
  for (let i = 0; i < n; i++) {
    world.renderer.render(world.scene, world.camera);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
  }
}"""


def opened(context: Any, path: Path) -> tuple[float, float]:
    """CPU seconds of the browser until the page can be used, and of one frame of its scene."""
    start = browser.cpu_seconds()
    page = context.new_page()
    page.goto(path.as_uri())
    page.wait_for_selector("html[data-ready]", timeout=300_000)
    ready = browser.cpu_seconds() - start
    start = browser.cpu_seconds()
    page.evaluate(DRAW, FRAMES)
    frame = (browser.cpu_seconds() - start) / FRAMES
    page.close()
    return ready, frame


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.cli import main

    report = harness.Report(
        "page",
        "The page",
        "`render --page`, and the page in a headless Chromium, 1280 x 800, WebGL drawn in software on this machine's "
        "cores: CPU seconds until it can be used, and of one frame.",
    )
    tools = browser.page_tools()
    path = tools.browser()
    if path is None or importlib.util.find_spec("playwright") is None:
        report.notes.append("Left out: no browser, or no package playwright to drive it.")
        return report
    scenes = [("tower", "tower", [])]
    if not quick:
        scenes.append(("urban_block", "urban_block", []))
        city = harness.munich()
        if city is not None:
            scenes.append(("munich", str(city), ["--radar", "airborne_x"]))
    rows = []
    with tempfile.TemporaryDirectory() as folder, tools.opened(path, Path(folder) / "browser") as context:
        for name, scene, options in scenes:
            out = Path(folder) / name
            arguments = ["render", scene, "-o", str(out), "--page", "--no-error-bars", "--quiet", *options]
            assert main(arguments) == 0
            ready, frame = opened(context, out / "page.html")
            rows.append([name, (out / "page.html").stat().st_size / 1e6, ready, frame])
    report.table("", ["scene", "page MB", "opens, CPU s", "frame, CPU s"], rows)
    bounds = {"urban_block": (25.0, None), "munich": (40.0, 5.0)}
    for name, size, ready, _ in rows:
        most, longest = bounds.get(name, (None, None))
        if most is not None:
            report.claim(f"page of {name}", size, most, at_least=False, unit="MB")
        if longest is not None:
            # two cores: twice as many CPU seconds as seconds
            report.claim(f"page of {name} opens, CPU seconds", ready, 2.0 * longest, at_least=False, unit="s")
    report.data["rows"] = rows
    return report


if __name__ == "__main__":
    harness.main(run)
