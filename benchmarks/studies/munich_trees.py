"""Munich with street trees: crowns at drawn places on open ground, away from buildings, rendered with and without.

    pip install sionna-rt                              # brings the scene
    python -m benchmarks.studies.munich_trees -o munich_trees.png -D image_extent_limit=160 -D heading_deg=20

Prints how many trees found a place, and what they change.
"""

import argparse
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.support import harness
from sarmitsuba import load_scene, render
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.loading.library import resolve_radar
from sarmitsuba.machine.backend import ensure_backend, mi
from sarmitsuba.scene.materials.vegetation.canopy import CANOPIES
from sarmitsuba.scene.mesh.tessellate import sphere
from sarmitsuba.simulation.execution.tracing import build_geometry
from sarmitsuba.tracing.scatterers.volumes.kind import Volume
from sarmitsuba.view.quicklook import draw

# facades are perfectly even and stand 60 dB over the clutter
WINDOW = "taylor:8:-60"
# m: least distances from walls and between trunks, half width and half height of a crown, height of its middle
FROM_WALLS, BETWEEN, CROWN, MIDDLE = 4.0, 7.0, (2.3, 2.9), 5.6


def heights(scene: Any, places: F64) -> F64:
    """Height of what stands at places (n, 2), m, seen from above."""
    trace_scene = build_geometry(scene)
    top = float(scene.geometry.bounds[1, 2]) + 10.0
    x, y = (mi.Float(np.ascontiguousarray(column, dtype=np.float32)) for column in places.T)
    found = trace_scene.mi_scene.ray_intersect_preliminary(
        mi.Ray3f(mi.Point3f(x, y, top), mi.Vector3f(0.0, 0.0, -1.0))
    )
    return np.asarray(top - np.where(np.array(found.is_valid()), np.array(found.t), np.inf), dtype=np.float64)


def open_ground(scene: Any, trees: int, seed: int) -> F64:
    """Places (n, 3) of up to so many trees within the image, on the ground and away from walls, m."""
    rng = np.random.default_rng(seed)
    image, ground = scene.image, scene.geometry.ground_height
    half = 0.5 * max(image.extent_azimuth, image.extent_range)
    drawn = rng.uniform(-half, half, (40 * trees, 2)) + np.array([image.center_x, image.center_y])
    turn = 2.0 * np.pi * np.arange(12) / 12.0
    rings = [r * np.stack([np.cos(turn), np.sin(turn)], axis=1) for r in (2.0, FROM_WALLS)]
    around = np.concatenate([np.zeros((1, 2)), *rings])
    found = heights(scene, (drawn[:, None] + around).reshape(-1, 2)).reshape(len(drawn), -1)
    free = (np.abs(found - ground) < 1.0).all(axis=1)
    kept: list[F64] = []
    for place, height in zip(drawn[free], found[free, 0], strict=True):
        if len(kept) < trees and all(np.hypot(*(place - other[:2])) >= BETWEEN for other in kept):
            kept.append(np.append(place, height))
    return np.array(kept).reshape(-1, 3)


def planted(scene: Any, places: F64, preset: str, seed: int) -> Any:
    """The scene with a crown at each place."""
    rng = np.random.default_rng(seed)
    medium = CANOPIES[preset].medium(scene.radar.waveform.center_frequency)
    vertices, faces = sphere(1.0, 0.02)
    volumes = []
    for i, place in enumerate(places):
        size = rng.uniform(0.8, 1.25)
        crown = size * (vertices * [CROWN[0], CROWN[0], CROWN[1]] + [0.0, 0.0, MIDDLE])
        volumes.append(Volume(f"tree {i}", crown + place, faces, medium))
    return replace(scene, scatterers=(*scene.scatterers, *volumes))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--out", default="munich_trees.png", type=Path)
    parser.add_argument("--radar", default="airborne_x", help="a shipped radar or an XML file")
    parser.add_argument("--trees", default=150, type=int, help="most trees")
    parser.add_argument("--preset", default="deciduous_summer", choices=sorted(CANOPIES.names))
    parser.add_argument("--seed", default=1, type=int)
    parser.add_argument(
        "-D", "--define", action="append", default=[], help="parameter of radar or scene, as in `render`"
    )
    args = parser.parse_args()
    ensure_backend()
    path = harness.munich()
    if path is None:
        sys.exit("munich_trees: the package sionna-rt, which carries the scene, is not installed")
    warnings.simplefilter("ignore", SarmitsubaWarning)
    scene = load_scene(
        path, radar=resolve_radar(args.radar), parameters=dict(d.split("=", 1) for d in args.define)
    )
    places = open_ground(scene, args.trees, args.seed)
    if not len(places):
        sys.exit("munich_trees: no open ground within the image; enlarge it by -D image_extent_limit=...")
    green = planted(scene, places, args.preset, args.seed)
    figure = Figure(figsize=(13.0, 6.6), layout="constrained")
    for column, (each, title) in enumerate(((scene, "as it comes"), (green, f"with {len(places)} trees"))):
        image = render(each, range_window=WINDOW, azimuth_window=WINDOW)
        axes = figure.add_subplot(1, 2, column + 1)
        draw(image, axes)
        axes.set_title(f"Munich {title}", fontsize=10)
        print(f"{title}: median sigma0 {10.0 * np.log10(np.median(image.sigma0())):.1f} dB")
    FigureCanvasAgg(figure).print_png(args.out)
    print(args.out)


if __name__ == "__main__":
    main()
