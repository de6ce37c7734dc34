"""Truth of sampling errors: drawn boxes on ground, and their images from runs of many times the rays."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.support import harness, random_scenes

if TYPE_CHECKING:
    from sarmitsuba.scene.scene import Scene
    from sarmitsuba.signal.image import ImageGrid
    from sarmitsuba.simulation.execution.run import Run

TARGETS = (-30.0, -18.0)  # dB
MOST_PASSES = 5
DENSER, DENSER_RUNS = 3, 3
# rays of a first pass over all key pulses; scenes that take more are left out, the truth costs a hundred times that
MOST_RAYS = 1e6


def drawn_scene(seed: int, folder: Path) -> "Scene | None":
    """A scene, its blocks of pulses alike in all runs; None where its truth would cost too much."""
    from sarmitsuba.loading.load import load_scene
    from sarmitsuba.simulation.execution.run import Run

    scene = harness.with_settings(load_scene(random_scenes.draw_boxes(seed).write(folder)), method="hybrid")
    sampling = Run(scene).sampling
    assert sampling is not None
    interval = sampling.key_pulse_interval
    if sampling.rays_per_pulse * scene.radar.track.n_pulses / interval > MOST_RAYS:
        return None
    return harness.with_settings(scene, key_pulse_interval=interval)


def converged(run: "Run", grid: "ImageGrid") -> "np.ndarray[Any, Any]":
    """The truth: pixels by a run of dense rays, several times with lattices of their own."""
    from sarmitsuba.simulation.execution.raw import echoes
    from tests.support.unweighted import focus

    images = [focus(echoes(run, pass_index=1000 + i), grid).total() for i in range(DENSER_RUNS)]
    # the median: what one of them has by a rare chance is not the truth
    return np.asarray(np.median(np.real(images), axis=0) + 1j * np.median(np.imag(images), axis=0))
