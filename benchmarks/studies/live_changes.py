"""CPU seconds that a change on the bench (`python -m sarmitsuba studio`) takes: loading, simulating, drawing.

Every slider moves in turn; the first change of a scene, which may compile kernels, is left out of the median. Then the
derivative of the image by the first shape's place, the second time, and a picture of the slider over it. Prints a
table.

Run ``python -m benchmarks.studies.live_changes [SCENE ...]``.
"""

import dataclasses
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from sarmitsuba.apps.fit.changed_view import DIFFERENCE, ChangedView
from sarmitsuba.apps.fit.image_derivative import image_derivative
from sarmitsuba.apps.fit.parsing import list_parameters
from sarmitsuba.apps.studio_bench import BenchState, View, first_state, view_of
from sarmitsuba.view.quicklook import panel, pixels

SCENES = ("tower", "dihedral")


def changes(state: BenchState) -> list[BenchState]:
    """The state and the ones that one slider each is moved to."""
    moved = (
        {"look_angle_deg": state.look_angle_deg + 4.0},
        {"heading_deg": state.heading_deg + 15.0},
        {"resolution": 1.2 * state.resolution},
        {"frequency": 5.405e9},
        {"max_depth": 2},
        {"size": 0.8},
        {"mode": "spotlight"},
    )
    return [state, *(dataclasses.replace(state, **one) for one in moved)]


def derivative(view: View) -> tuple[float, float]:
    """CPU seconds of a derivative of a view's image, and of one picture of the slider over it."""
    settings = dataclasses.replace(view.scene.settings, method="hybrid")
    scene = dataclasses.replace(view.scene, settings=settings)
    for _ in range(2):
        start = time.process_time()
        found = image_derivative(scene, list_parameters(scene)[0], leave_out=True)
        seconds = time.process_time() - start
    shown, start = ChangedView.of(found), time.process_time()
    pixels(panel(*shown.at(0.1).picture(DIFFERENCE)))
    return seconds, time.process_time() - start


def main(scenes: list[str]) -> None:
    """Measure and print."""
    print("CPU s per change, of a derivative, and of a picture of the slider over it")
    print(f"{'scene':<14}{'first':>8}{'median':>8}{'most':>8}{'derivative':>12}{'slider':>8}")
    with tempfile.TemporaryDirectory() as folder:
        for scene in scenes:
            seconds = []
            for state in changes(first_state(scene)):
                start = time.process_time()
                view = view_of(state, Path(folder))
                pixels(panel(view.image))
                seconds.append(time.process_time() - start)
            rest = seconds[1:]
            own, slider = derivative(view_of(first_state(scene), Path(folder)))
            figures = f"{seconds[0]:>8.2f}{np.median(rest):>8.2f}{max(rest):>8.2f}{own:>12.2f}{slider:>8.2f}"
            print(f"{scene:<14}{figures}")


if __name__ == "__main__":
    main(sys.argv[1:] or list(SCENES))
