"""Ray density over small round bodies at 7 GHz: error and time of sweeps and images, with 4.5 and 9 rays and as now.

``python benchmarks/studies/small_round_bodies.py`` prints, for an almond, a sphere, a cylinder and an ogive, the rays
of a direction, the sampling error stated and true, and processor seconds: of a sweep of 180 degrees with 4.5 rays a
wavelength and with automatic rays, and of an image over 60 degrees with up to 9 rays a wavelength and with automatic
ones. True is against 70 rays a wavelength. Each is run once before, for its kernels.

``--spheres 200`` draws spheres instead, as meshes of meridians, of icospheres, scans with noise, fans and bodies of
revolution of 20 to 20 000 faces at ka 0.5 to 30, and prints for each the true error against the Mie series and the
stated one, and at the end the share of statements that are more than 3 dB too small, and their median looseness. Sweeps
that warn of facets, or state no figure, count as honest: their text says so.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Callable

import _support
import numpy as np
import trimesh

from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.scene.mesh import pieces
from sarmitsuba.simulation.execution.turntable import Aspects, rcs_sweep
from sarmitsuba.simulation.execution.turntable_image import turntable_scene
from sarmitsuba.truth.theory import sphere_mie
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.measured import bodies
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


def drawn_sphere(seed: int) -> tuple[str, trimesh.Trimesh, float]:
    """Kind, mesh of radius 1 and ka of a seed."""
    rng = np.random.default_rng([seed, 0xBA11])
    kind = str(rng.choice(["meridians", "icosphere", "scan", "fan", "revolved"]))
    n = int(10.0 ** rng.uniform(0.8, 1.9))  # rows of faces
    if kind == "icosphere":
        body = trimesh.creation.icosphere(subdivisions=int(rng.integers(1, 5)))
    elif kind == "scan":
        body = trimesh.creation.icosphere(subdivisions=int(rng.integers(2, 5)))
        edge = float(np.asarray(body.edges_unique_length).mean())
        body.vertices = np.asarray(body.vertices) * (
            1.0 + 0.01 * edge * rng.normal(size=(len(body.vertices), 1))
        )
    elif kind == "fan":  # all points on the sphere, in a hull that cuts no plane evenly
        points = rng.normal(size=(max(4 * n, 30), 3))
        body = trimesh.convex.convex_hull(points / np.linalg.norm(points, axis=1, keepdims=True))
    elif kind == "revolved":
        x = -np.cos(np.pi * np.sort(np.concatenate([[0.0, 1.0], rng.random(n)])))
        body = trimesh.creation.revolve(np.c_[np.sqrt(np.maximum(1.0 - x**2, 0.0)), x], sections=2 * n)
    else:
        body = trimesh.creation.uv_sphere(1.0, count=[max(n, 4), max(int(n * rng.uniform(1.0, 3.0)), 6)])
    body.apply_transform(trimesh.transformations.random_rotation_matrix(rng.uniform(size=3)))
    return kind, body, float(10.0 ** rng.uniform(np.log10(0.5), np.log10(30.0)))


def stated_of_sphere(seed: int) -> tuple[str, float, float, str]:
    """Kind with its size, true and stated rms error (dB; infinite: not known), and the statement."""
    kind, body, ka = drawn_sphere(seed)
    radius = ka / (2.0 * np.pi)
    mesh = SceneMesh(
        np.asarray(body.vertices) * radius, np.asarray(body.faces, dtype=np.int32), "pec", "sphere"
    )
    scene = build_scene([mesh], radar=RadarDescription(center_frequency=299_792_458.0))
    azimuth = np.radians(np.arange(0.0, 360.0, 24.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SarmitsubaWarning)
        found = rcs_sweep(scene, Aspects(azimuth, np.full(azimuth.size, 0.3)), channels=("HH", "VV"))
    exact = 10.0 * np.log10(np.pi * radius**2 * sphere_mie(ka))
    level = np.stack([found.dbsm(c) for c in ("HH", "VV")], axis=1)
    true = float(np.sqrt(np.mean(np.square(level - exact), axis=0)).max())
    how = "currents" if found.currents is not None else "rays"
    return (
        f"{kind}, {len(body.faces)} faces, ka {ka:.2f}, {how}",
        true,
        found.statement.worst_db,
        found.statement.text,
    )


def draw_spheres(count: int) -> int:
    """Print the true and stated errors of drawn spheres; the number of statements that are 3 dB too small."""
    loose, short = [], 0
    for seed in range(count):
        name, true, stated, text = stated_of_sphere(seed)
        wrong = true > stated + 3.0
        short += wrong
        if np.isfinite(stated):
            loose.append(stated - true)
        print(
            f"{seed:4} {name}: true {true:.2f} dB, stated {stated:.2f} dB{'  TOO SMALL: ' + text if wrong else ''}",
            flush=True,
        )
    print(
        f"{count} spheres: {short} statements more than 3 dB too small, {count - len(loose)} not known, median "
        f"looseness {np.median(loose):.2f} dB, 95 % below {np.quantile(loose, 0.95):.2f} dB"
    )
    return short


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--step", type=float, default=2.5, help="of the sweep, deg")
    parser.add_argument("--spheres", type=int, default=0, metavar="COUNT", help="draw spheres instead")
    args = parser.parse_args()
    if args.spheres:
        return int(draw_spheres(args.spheres) > 0)
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
