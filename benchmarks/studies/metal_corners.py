"""Sampling error of double bounces between metal facets at right angles, true and stated, with and without their rays.

``python -m benchmarks.studies.metal_corners samples`` takes samples of the shipped recipe of vehicles and boats with
automatic ray spacing, ``corners`` drawn dihedrals and trihedrals of 0.5 to 10 wavelengths, ``scenes`` the rays and the
times of shipped scenes, ``spacings`` the drawn corners by the spacing that is planned. Prints Markdown tables.

True: distance to the mean of two runs with rays a quarter of a wavelength apart, mean of two runs. Stated: as in data
sets, from the difference of these two. Both are energies over the image's, dB.
"""

import argparse
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.apps.dataset_draw import Drawer
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.core.units import db_from_power
from sarmitsuba.loading.load import load_scene
from sarmitsuba.machine.backend import ensure_backend
from sarmitsuba.scene.mesh import metal_corners
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.error_bars import estimate_pass_error
from sarmitsuba.simulation.execution.render import render
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.tracing import build_geometry
from sarmitsuba.tracing.kernel import scene_tables
from tests.support.corners import drawn_corners

SAMPLES = (250, 400, 850)
RECIPE = Path(__file__).parents[2] / "scenes" / "recipes" / "vehicles_and_boats.toml"
SCENES = ("tower", "buildings16", "urban_block", "bridge", "car_park", "dihedral", "trihedral")
# wavelengths, spacing of the true run's rays
FINE = 0.25
# wavelengths, planned spacings that are compared
SPACINGS = (0.75, 1.5, 3.0)
ROUNDS = 7
# one of two runs has twice the error energy of their mean
OF_ONE_DB = 10.0 * float(np.log10(2.0))

Image = NDArray[np.complexfloating[Any, Any]]


@contextmanager
def without_corner_rays() -> Iterator[None]:
    """Scenes built within have no ray spacing planned for metal corners."""
    own = scene_tables.corner_needs
    scene_tables.corner_needs = lambda corners, *_: (np.full(len(corners), np.inf),) * 2
    try:
        yield
    finally:
        scene_tables.corner_needs = own


def spaced(scene: Scene, spacing: float) -> Scene:
    """The scene with another ray spacing, m; 0: automatic."""
    return replace(scene, settings=replace(scene.settings, ray_spacing=spacing))


def image(scene: Scene, pass_index: int = 0) -> Image:
    """First channel of one look."""
    made = render(scene, pass_index=pass_index)
    return np.asarray(made.total(made.channels[0]))


def truth(scene: Scene) -> Image:
    """Mean of two runs with fine rays."""
    finer = spaced(scene, FINE * scene.radar.waveform.wavelength)
    return 0.5 * (image(finer, 10) + image(finer, 11))


def errors(scene: Scene, right: Image) -> tuple[float, float]:
    """True and stated error of the automatic spacing, dB."""
    scene = spaced(scene, 0.0)
    first, second = image(scene), image(scene, 1)
    true = np.mean([np.square(np.abs(x - right)).sum() for x in (first, second)])
    bars = estimate_pass_error((second - first)[None], 0.5 * (first + second)[None], ("",), 0.5)
    return float(db_from_power(true / np.square(np.abs(right)).sum())), bars.error_db[0] + OF_ONE_DB


def n_rays(run: Run) -> int:
    """Rays of all lattices in the middle of the track; of one look where the method is."""
    assert run.sampling is not None
    sampling = run.sampling.of_one_look() if run.scene.settings.method == "image" else run.sampling
    return sum(grid.n_rays for grids in run.lattices(sampling, 0) for grid in grids)


def both(scene: Scene) -> str:
    """Cells of a row: true and stated error and rays, without and with rays for corners."""
    right, cells = truth(scene), []
    for within in (without_corner_rays, None):
        if within is None:
            found, rays = errors(scene, right), n_rays(Run(spaced(scene, 0.0)))
        else:
            with within():
                found, rays = errors(scene, right), n_rays(Run(spaced(scene, 0.0)))
        cells += [f"{found[0]:.1f}", f"{found[1]:.1f}", str(rays)]
    return " | ".join(cells)


def samples(count: int) -> None:
    """Samples of the recipe."""
    drawer = Drawer.of(str(RECIPE))
    print(
        "| sample | true before, dB | stated | rays | true, dB | stated | rays |\n|---|---|---|---|---|---|---|"
    )
    for number in SAMPLES:
        print(f"| {number} | {both(drawer.draw(number, 0).scene)} |", flush=True)


def corners(count: int) -> None:
    """Drawn corners; how far the statement is below the truth."""
    print(
        "| seed | wavelengths | true before, dB | stated | rays | true, dB | stated | rays |\n|---|"
        + "---|" * 7
    )
    over = []
    for seed in range(count):
        scene, wide = drawn_corners(seed)
        cells = both(scene)
        over.append([float(x) for x in cells.split(" | ")])
        print(f"| {seed} | {wide:.2f} | {cells} |", flush=True)
    for label, first in (("without", 0), ("with", 3)):
        table = np.array(over)
        excess = table[:, first] - table[:, first + 1]
        print(
            f"{label} rays for corners: true error, median {np.median(table[:, first]):.1f} dB, at most "
            f"{table[:, first].max():.1f}; true over stated, median {np.median(excess):.1f} dB, "
            f"{excess.min():.1f} to {excess.max():.1f}"
        )


def spacings(count: int) -> None:
    """Drawn corners by planned spacing."""
    print("| planned, wavelengths | true, dB, median | at most | rays, median |\n|---|---|---|---|")
    own = metal_corners.WIDEST_TUBE
    drawn = [drawn_corners(seed)[0] for seed in range(count)]
    right = [truth(scene) for scene in drawn]
    for wide in SPACINGS:
        metal_corners.WIDEST_TUBE = wide
        found = [errors(scene, one)[0] for scene, one in zip(drawn, right, strict=True)]
        rays = np.median([n_rays(Run(spaced(scene, 0.0))) for scene in drawn])
        print(f"| {wide:g} | {np.median(found):.1f} | {max(found):.1f} | {rays:.0f} |", flush=True)
    metal_corners.WIDEST_TUBE = own


def seconds(job: Callable[[], object]) -> float:
    """Processor seconds of a job."""
    start = time.process_time()
    job()
    return time.process_time() - start


def scenes(count: int) -> None:
    """Rays and times of shipped scenes; the least of interleaved rounds."""
    print(
        "| scene | rays before | rays | more, % | geometry, ms | search for corners, ms | of the run's plan, % |"
    )
    print("|---|" + "---|" * 6)
    for name in SCENES:
        scene = load_scene(name)
        own, search = scene_tables.corner_needs, []

        def timed(*args: Any, own: Any = own, search: list[float] = search) -> Any:
            begin = time.process_time()
            found = own(*args)
            search.append(time.process_time() - begin)
            return found

        with without_corner_rays():
            before = n_rays(Run(scene))
        rays = n_rays(Run(scene))
        scene_tables.corner_needs = timed
        try:
            geometry = min(seconds(lambda scene=scene: build_geometry(scene)) for _ in range(ROUNDS))
            plan = min(seconds(lambda scene=scene: Run(scene)) for _ in range(ROUNDS))
        finally:
            scene_tables.corner_needs = own
        least = min(search)
        print(
            f"| {name} | {before} | {rays} | {100.0 * (rays / before - 1.0):.1f} | {1e3 * geometry:.1f} | "
            f"{1e3 * least:.2f} | {100.0 * least / plan:.1f} |",
            flush=True,
        )


def main() -> None:
    """Print the tables asked for."""
    tables = {"samples": samples, "corners": corners, "scenes": scenes, "spacings": spacings}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("tables", nargs="+", choices=tables)
    parser.add_argument("--count", type=int, default=24, help="drawn scenes")
    args = parser.parse_args()
    ensure_backend()
    warnings.simplefilter("ignore", SarmitsubaWarning)
    for name in args.tables:
        tables[name](args.count)


if __name__ == "__main__":
    main()
