"""CPU seconds that a change on the bench (`python -m sarmitsuba studio`) takes: loading, simulating, drawing.

Every slider moves in turn; the first change of a scene, which may compile kernels, is left out of the median. Prints
a table.

Run ``python benchmarks/studies/live_changes.py [SCENE ...]``.
"""

import dataclasses
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from sarmitsuba.studio.bench import BenchState, first_state, view_of
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


def main(scenes: list[str]) -> None:
    """Measure and print."""
    print(f"{'scene':<14}{'first':>8}{'median':>8}{'most':>8}   CPU s per change")
    with tempfile.TemporaryDirectory() as folder:
        for scene in scenes:
            seconds = []
            for state in changes(first_state(scene)):
                start = time.process_time()
                view = view_of(state, Path(folder))
                pixels(panel(view.image))
                seconds.append(time.process_time() - start)
            rest = seconds[1:]
            print(f"{scene:<14}{seconds[0]:>8.2f}{np.median(rest):>8.2f}{max(rest):>8.2f}")


if __name__ == "__main__":
    main(sys.argv[1:] or list(SCENES))
