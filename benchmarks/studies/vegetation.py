"""Scenes with trees at L, C and X band in one figure, and what volumes cost: CPU seconds with and without, in turns.

    python -m benchmarks.studies.vegetation -o vegetation.png

The first rendering of each kind compiles its kernels and is not counted.
"""

import argparse
import os
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.support import harness  # noqa: F401  the package beside this folder
from sarmitsuba import (
    RadarDescription,
    SceneMesh,
    SceneVolume,
    TraceSettings,
    build_scene,
    load_scene,
    render,
)
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.scene.materials.vegetation.canopy import CANOPIES
from sarmitsuba.scene.mesh.tessellate import sphere
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.tracing.scatterers.volumes.source import volume_scatterers
from sarmitsuba.truth import theory
from sarmitsuba.view.quicklook import draw

SCENES = ("forest", "street_trees")
WINDOW = "taylor:4:-35"
# what is timed; the others are only drawn
TIMED = (("forest", "L"), ("street_trees", "X"))
BANDS = {"L": "1.27e9", "C": "5.4e9", "X": "9.65e9"}


def seconds() -> float:
    """CPU seconds of this process, user and system."""
    return sum(os.times()[:2])


def timed(scene: Any) -> tuple[Any, float]:
    """Image and the CPU seconds that it took."""
    start = seconds()
    image = render(scene, range_window=WINDOW, azimuth_window=WINDOW)
    return image, seconds() - start


def presets() -> None:
    """Print extinction and water-cloud sigma0 of every preset as a table."""
    theta = np.radians(40.0)
    for canopy in CANOPIES:
        cells, depth = [], 2.0 if canopy.name == "hedge" else 10.0
        for frequency in BANDS.values():
            kappa, power = canopy.medium(float(frequency)).at(float(np.cos(theta)))
            extinction = (*kappa, kappa.mean())
            level = [
                10 * np.log10(theory.water_cloud_sigma0(p, k, depth, theta))
                for p, k in zip(power, extinction, strict=True)
            ]
            taken = 10.0 / np.log(10.0) * kappa
            cells.append(f"{taken[0]:.2f}, {taken[1]:.2f}; {level[0]:.1f}, {level[1]:.1f}, {level[2]:.1f}")
        print(f"| `{canopy.name}`: {canopy.title} | {' | '.join(cells)} |")


def scatterers() -> None:
    """Print the CPU seconds of one look at a stand of 64 crowns with ever more scatterers in them."""
    warnings.simplefilter("ignore", SarmitsubaWarning)
    corners = np.array([[-40.0, -40.0, 0.0], [40.0, -40.0, 0.0], [40.0, 40.0, 0.0], [-40.0, 40.0, 0.0]])
    ground = SceneMesh(corners, [[0, 1, 2], [0, 2, 3]], {"material": "medium_dry_ground", "rms_height": 0.01})
    vertices, faces = sphere(3.0, 0.03)
    for spacing in (0.5, 0.25, 0.2):
        medium = {"preset": "deciduous_summer", "scatterer_spacing": spacing}
        crowns = [
            SceneVolume(vertices + np.array([x, y, 6.0]), faces, medium)
            for x in np.arange(-28.0, 29.0, 8.0)
            for y in np.arange(-28.0, 29.0, 8.0)
        ]
        radar = RadarDescription(
            slant_range=8e3, look_angle_deg=40.0, bandwidth=150e6, azimuth_resolution=1.0
        )
        scene = build_scene([ground], volumes=crowns, radar=radar, settings=TraceSettings(method="image"))
        n = volume_scatterers(scene.volumes, 1.0, 0).n
        timed(scene)
        print(
            f"{len(crowns)} crowns, {n:8d} scatterers: {timed(scene)[1]:.2f} CPU s for one look", flush=True
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--out", default="vegetation.png", type=Path)
    parser.add_argument("--rounds", default=2, type=int, help="renderings of each kind that are counted")
    parser.add_argument("--presets", action="store_true", help="only print what the presets return and take")
    parser.add_argument(
        "--scatterers", action="store_true", help="only time one look at ever more scatterers"
    )
    args = parser.parse_args()
    if args.scatterers:
        scatterers()
        return
    if args.presets:
        presets()
        return
    warnings.simplefilter("ignore", SarmitsubaWarning)
    figure = Figure(figsize=(13.0, 8.6), layout="constrained")
    print("scene          band     scatterers   CPU s with, without, share   median sigma0 HH, VV, HV (dB)")
    for row, name in enumerate(SCENES):
        for column, (band, frequency) in enumerate(BANDS.items()):
            scene = load_scene(name, parameters={"center_frequency": frequency})
            sampling = SamplingPlan.of(scene)
            n = volume_scatterers(scene.volumes, sampling.azimuth_cell * sampling.range_cell, 0).n
            image, _ = timed(scene)
            levels = ", ".join(f"{10 * np.log10(np.median(image.sigma0(c))):.1f}" for c in image.channels)
            cost = ""
            if (name, band) in TIMED:
                bare = replace(scene, settings=replace(scene.settings, effects={"vegetation": "off"}))
                timed(bare)
                spent = np.array([[timed(each)[1] for each in (scene, bare)] for _ in range(args.rounds)])
                on, off = np.min(spent, axis=0)
                cost = f"{on:.2f} {off:.2f} {1.0 - off / on:.0%}"
            print(f"{name:14s} {band:4s} {n:18d}   {cost:18s} {levels}", flush=True)
            axes = figure.add_subplot(len(SCENES), len(BANDS), row * len(BANDS) + column + 1)
            draw(image, axes)
            axes.set_title(f"{name}, {band} band, HH", fontsize=10)
    FigureCanvasAgg(figure).print_png(args.out)
    print(args.out)


if __name__ == "__main__":
    main()
