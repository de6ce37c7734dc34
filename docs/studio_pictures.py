"""Pictures of the studio in ``docs``, from a headless browser.

Run ``python docs/studio_pictures.py``; writes ``docs/images/studio.png`` and ``docs/images/studio_derivative.png``.
Needs the packages viser and playwright and a Chromium.
"""

import importlib.util
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sarmitsuba.apps.fit.changed_view import DIFFERENCE
from sarmitsuba.apps.studio import Studio
from sarmitsuba.machine.backend import ensure_backend

DOCS = Path(__file__).parent
# what moves, and how far on the slider: 2 mm, where the wall's change is a fifth off to first order
PARAMETER, CENTIMETRES = "shift:walls:x", 0.2
SCENE, HEADING, SIZE = "tower", 20.0, {"width": 1280, "height": 920}
# seconds for the page to draw, in software, and longest wait for the studio
DRAWN, LONGEST = 6.0, 300.0


def page_tools() -> Any:
    """The headless browser of the page's tests."""
    path = DOCS.parent / "tests" / "page" / "conftest.py"
    spec = importlib.util.spec_from_file_location("page_tools", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def wait(done: Callable[[], bool]) -> None:
    """Wait for the studio's thread, then for the browser to draw."""
    end = time.monotonic() + LONGEST
    while not done():
        if time.monotonic() > end:
            raise TimeoutError("the studio does not answer")
        time.sleep(0.2)
    time.sleep(DRAWN)


def photograph(studio: Studio, page: Any) -> None:
    """Take both pictures."""
    page.set_viewport_size(SIZE)
    wait(lambda: studio.view is not None)
    page.goto(studio.address)
    wait(lambda: True)
    page.locator("button.mantine-Notification-closeButton").first.click()  # that there is no graphics card
    wait(lambda: True)
    page.screenshot(path=DOCS / "images" / "studio.png")
    tab = studio.derivative
    page.get_by_text("derivative", exact=True).click()
    tab.parameter.value = PARAMETER
    wait(lambda: tab.changed is not None)
    tab.which.value, tab.change.value = DIFFERENCE, CENTIMETRES
    wait(lambda: tab.changed is not None and tab.changed.change > 0.0)
    page.screenshot(path=DOCS / "images" / "studio_derivative.png")


def main() -> None:
    """Serve a studio in this thread, and look at it in another."""
    tools, failed, done = page_tools(), [], threading.Event()
    ensure_backend()
    with tempfile.TemporaryDirectory() as folder:
        studio = Studio(SCENE, Path(folder) / "saved")
        studio.controls["heading_deg"].value = HEADING

        def look() -> None:
            try:
                with tools.browsing(tools.browser(), Path(folder) / "profile") as context:
                    context.set_offline(False)
                    photograph(studio, context.new_page())
            except Exception as error:
                failed.append(error)
            finally:
                done.set()

        threading.Thread(target=look).start()
        try:
            studio.serve(done.is_set)
        finally:
            studio.close()
    if failed:
        sys.exit(f"not made: {failed[0]}")


if __name__ == "__main__":
    main()
