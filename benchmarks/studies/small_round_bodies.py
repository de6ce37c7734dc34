"""Ray density over small round bodies at 7 GHz: error and time of sweeps and images, with 4.5 and 9 rays and as now.

``python benchmarks/studies/small_round_bodies.py`` prints, for an almond, a sphere, a cylinder and an ogive, the rays
of a direction, the sampling error stated and true, and processor seconds: of a sweep of 180 degrees with 4.5 rays a
wavelength and with automatic rays, and of an image over 60 degrees with up to 9 rays a wavelength and with automatic
ones. True is against 70 rays a wavelength. Each is run once before, for its kernels.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Callable

import _support
import numpy as np
import trimesh

from sarmitsuba.errors import SarmitsubaWarning
from sarmitsuba.loader.build import SceneMesh, build_scene
from sarmitsuba.mesh import pieces
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.simulation.turntable import Aspects, rcs_sweep
from sarmitsuba.simulation.turntable_image import turntable_scene
from sarmitsuba.validation import targets
from sarmitsuba.validation.measured import bodies
from tests.support.unweighted import render

FREQUENCY = 7e9
WAVELENGTH = 299_792_458.0 / FREQUENCY
ELEVATION = 0.2
DENSE = 70.0


def ogive() -> targets.Mesh:
    """Six wavelengths long, half angle of the tip 22.6 degrees."""
    angle, x = np.radians(22.62), np.linspace(-3.0, 3.0, 81) * WAVELENGTH
    arc = 3.0 * WAVELENGTH / np.sin(angle)
    profile = np.column_stack([np.sqrt(arc**2 - x**2) - arc * np.cos(angle), x])
    profile[[0, -1], 0] = 0.0
    body = trimesh.creation.revolve(profile, sections=90)
    return body.vertices[:, [2, 0, 1]], body.faces


def mesh_of(name: str) -> targets.Mesh:
    if name == "almond":
        return bodies.almond()
    if name == "ogive":
        return ogive()
    sagitta = WAVELENGTH / 512
    if name == "sphere":
        body = targets.sphere(1.5 * WAVELENGTH, sagitta)
    else:
        body = targets.cylinder(WAVELENGTH, 3.0 * WAVELENGTH, sagitta)
    return body.vertices, body.faces


def error_db(found: np.ndarray, dense: np.ndarray) -> float:
    return float(10.0 * np.log10(np.sum(np.abs(found - dense) ** 2) / np.sum(np.abs(dense) ** 2)))


def timed(run: Callable[[], object]) -> tuple[object, float]:
    run()
    start = time.process_time()
    found = run()
    return found, time.process_time() - start


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--step", type=float, default=2.5, help="of the sweep, deg")
    args = parser.parse_args()
    warnings.simplefilter("ignore", SarmitsubaWarning)  # rays as wide as they were
    azimuth, arc = np.radians(np.arange(0.0, 180.0, args.step)), np.radians(np.arange(60.0, 120.0))
    aspects, turned = (Aspects(a, np.full(a.size, ELEVATION)) for a in (azimuth, arc))
    spacings = pieces.ROUND_SPACINGS
    for name in ("almond", "sphere", "cylinder", "ogive"):
        scene = build_scene(
            [SceneMesh(*mesh_of(name), "pec", name)], radar=RadarDescription(center_frequency=FREQUENCY)
        ).replace(full_wave="off")
        exact = rcs_sweep(scene.replace(ray_spacing=WAVELENGTH / DENSE), aspects, channels=("HH",), checked=0)
        for label, given in (("4.5", scene.replace(ray_spacing=WAVELENGTH / 4.5)), ("automatic", scene)):
            found, took = timed(lambda given=given: rcs_sweep(given, aspects, channels=("HH",)))
            true = error_db(found.result.amplitude.sum(axis=1), exact.result.amplitude.sum(axis=1))
            print(
                f"{name:9} sweep, {label:>9} rays a wavelength: {found.result.rays_per_direction:6} a direction, "
                f"stated {found.error_db[0]:6.1f} dB, true {true:6.1f} dB, {took:5.2f} CPU s",
                flush=True,
            )
        image = turntable_scene(scene, turned, channels=("HH",)).replace(method="hybrid")
        exact_image = render(image.replace(ray_spacing=WAVELENGTH / DENSE)).total("HH")
        for label, allowed in (("up to 9", spacings[:1]), ("automatic", spacings)):
            pieces.ROUND_SPACINGS = allowed
            found, took = timed(lambda image=image: render(image))
            true = error_db(found.total("HH"), exact_image)
            print(
                f"{name:9} image, {label:>9} rays a wavelength: true {true:6.1f} dB, {took:5.2f} CPU s",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
