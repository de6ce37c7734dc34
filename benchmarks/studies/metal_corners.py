"""Sampling error of double bounces between metal facets at right angles: true and stated, with and without their rays.

Run ``python benchmarks/studies/metal_corners.py``: samples 250, 400 and 850 of the shipped recipe of vehicles and
boats with automatic ray spacing; ``--corners 24`` as many drawn dihedrals and trihedrals, ``--scenes`` the rays and the
build times of shipped scenes. Prints Markdown tables.

True: distance to the mean of two runs with a quarter of the plain lattice's spacing. Stated: as in data sets, from the
difference of two runs with other lattices. Both are energies over the image's, dB.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.mesh.pieces import part_sizes  # noqa: F401
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.refinement.error_bars import estimate_pass_error
from sarmitsuba.simulation.render import render
from sarmitsuba.simulation.run import Run
from sarmitsuba.trace import scene_tables
from sarmitsuba.units import db_from_power

SAMPLES = (250, 400, 850)
RECIPE = Path(__file__).parents[2] / "scenes" / "recipes" / "vehicles_and_boats.toml"
"""Truth: ray spacing relative to the plain lattice's."""
FINER = 0.25
ROUNDS = 5


@contextmanager
def without_corner_rays() -> Iterator[None]:
    """Scenes built within have no ray spacing planned for metal corners."""
    own = scene_tables.corner_needs
    scene_tables.corner_needs = lambda corners, *_: (np.full(len(corners), np.inf),) * 2
    try:
        yield
    finally:
        scene_tables.corner_needs = own


def automatic(scene: Scene, **settings: object) -> Scene:
    """The scene with automatic or other ray spacing."""
    return replace(scene, settings=replace(scene.settings, **{"ray_spacing": 0.0, **settings}))


def image(scene: Scene, pass_index: int = 0) -> NDArray[np.complexfloating]:
    """First channel of one look."""
    made = render(scene, range_window="taylor", azimuth_window="taylor", pass_index=pass_index)
    return np.asarray(made.total(made.channels[0]))


def spacing_of(scene: Scene) -> float:
    """Spacing of the plain coherent lattice of one look, m."""
    run = Run(scene)
    assert run.sampling is not None
    return run.sampling.of_one_look().spacings.coherent


def truth(scene: Scene, spacing: float) -> NDArray[np.complexfloating]:
    """Mean of two runs with finer rays."""
    finer = automatic(scene, ray_spacing=FINER * spacing)
    return 0.5 * (image(finer, 10) + image(finer, 11))


def errors(scene: Scene, right: NDArray[np.complexfloating]) -> tuple[float, float]:
    """True and stated error, dB."""
    first, second = image(scene), image(scene, 1)
    energy = float(np.square(np.abs(right)).sum())
    true = np.mean([np.square(np.abs(x - right)).sum() for x in (first, second)]) / energy
    bars = estimate_pass_error((second - first)[None], 0.5 * (first + second)[None], ("VV",), 0.5)
    return float(db_from_power(true)), bars.error_db[0] + 3.0
