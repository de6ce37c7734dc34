"""Ray density over small round bodies at 7 GHz: error and time of sweeps and images, with 4.5 and 9 rays and as now.

``python -m benchmarks.studies.small_round_bodies`` prints, for an almond, a sphere, a cylinder and an ogive, the rays
of a direction, the sampling error stated and true, and processor seconds: of a sweep of 180 degrees with 4.5 rays a
wavelength and with automatic rays, and of an image over 60 degrees with up to 9 rays a wavelength and with automatic
ones. True is against 70 rays a wavelength. Each is run once before, for its kernels.

``--spheres 200`` draws spheres instead, as meshes of meridians, of icospheres, scans with noise, fans and bodies of
revolution of 20 to 20 000 faces at ka 0.5 to 30, and prints for each the true error against the Mie series and the
stated one, and at the end the share of statements that are more than 3 dB too small, and their median looseness. Sweeps
that warn of facets, or state no figure, count as honest: their text says so.

``--on-ground 20`` draws posts, trunks, tanks, silos, pillars by a wall and cars on ground instead, at C and X band,
with smooth and rough materials, at cells of 0.5 and 5 m. It prints for each the level of the automatic rays against
rays at a quarter of their spacing, the true error of the image, and what was stated; at the end medians and the worst.
"""

import argparse
import math
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from sarmitsuba.analysis.error_budget import error_budget
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.mesh import pieces
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.simulation.execution.error_bars import add_error_bars
from sarmitsuba.simulation.execution.image import Imager
from sarmitsuba.simulation.execution.raw import echoes
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.turntable import Aspects, rcs_sweep, turntable_scene
from sarmitsuba.truth.theory import sphere_mie
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.measured import bodies
from tests.support.unweighted import focus, render

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


# kinds of round bodies on ground, and halvings of the rays of their truth
KINDS = ("post", "trunk", "tank", "silo", "pillar", "car")
TRUTH_HALVINGS = 2


def cylinder_on_ground(radius: float, height: float, wavelength: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of an upright cylinder whose facets are as fine as the loader makes them."""
    body = targets.cylinder(radius, height, wavelength / 512.0)
    vertices = np.array(body.vertices)
    vertices[:, 2] -= vertices[:, 2].min()
    return vertices, np.asarray(body.faces)


def car_body(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a body with rounded sides and a cabin, 0.2 m above the ground."""
    ball = trimesh.creation.icosphere(subdivisions=5)
    unit = np.asarray(ball.vertices)
    power = rng.uniform(0.35, 0.6)  # of a superellipsoid: 1 is an ellipsoid, 0 a box
    blunt = np.sign(unit) * np.abs(unit) ** power
    blunt /= np.sum(np.abs(blunt) ** (2.0 / power), axis=1, keepdims=True) ** (power / 2.0)
    size = np.array([rng.uniform(1.9, 2.3), rng.uniform(0.8, 0.95), 0.5 * rng.uniform(1.1, 1.4)])
    return blunt * size + np.array([0.0, 0.0, size[2] + 0.2]), np.asarray(ball.faces)


def scene_on_ground(seed: int) -> tuple[Scene, str]:
    """Scene of a seed, and what was drawn."""
    rng = np.random.default_rng([seed, 0x6E0D])
    kind = KINDS[seed % len(KINDS)]
    frequency = float((5.4e9, 9.65e9)[seed // len(KINDS) % 2])
    cell = float((0.5, 5.0)[int(rng.integers(2))])
    wavelength = 299_792_458.0 / frequency
    rough = bool(rng.integers(2))
    rms = wavelength * rng.uniform(0.02, 0.06) if rough else 0.0

    def material(name: str) -> dict[str, float | str | bool]:
        return {"material": name, "rms_height": rms} if rough else {"material": name, "smooth": True}

    low, high = {"post": (0.04, 0.3), "trunk": (0.1, 0.4), "tank": (1.0, 2.0), "silo": (0.6, 1.2)}.get(
        kind, (0.15, 0.5)
    )
    radius = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    height = float(rng.uniform(2.0, 6.0))
    half = 14.0 if cell < 1.0 else 40.0
    ground = targets.parallelogram([-half, -half, 0.0], [2.0 * half, 0.0, 0.0], [0.0, 2.0 * half, 0.0])
    heading = float(rng.uniform(0.0, 360.0))
    meshes = [SceneMesh(*ground, material("asphalt"), "ground")]
    if kind == "car":
        turn = trimesh.transformations.rotation_matrix(rng.uniform(0.0, 2.0 * np.pi), [0.0, 0.0, 1.0])
        meshes.append(SceneMesh(*car_body(rng), material("metal"), "car", smooth=True, to_world=turn))
        label = "car"
    else:
        name = {"trunk": "wood", "pillar": "concrete"}.get(kind, "metal")
        meshes.append(SceneMesh(*cylinder_on_ground(radius, height, wavelength), material(name), kind))
        label = f"{kind} of {name}, radius {radius / wavelength:.1f} wavelengths, {height:.1f} m"
    if kind in ("silo", "pillar"):
        wall = trimesh.creation.box((0.3, 5.0, 4.0))
        turn = np.radians(-heading) + rng.uniform(-0.3, 0.3) + (np.pi / 2.0) * int(rng.integers(2))
        away = radius + rng.uniform(0.3, 1.0) + 0.15
        place = trimesh.transformations.rotation_matrix(turn, [0.0, 0.0, 1.0])
        place = place @ trimesh.transformations.translation_matrix([away, 0.0, 2.0])
        meshes.append(SceneMesh(wall.vertices, wall.faces, material("brick"), "wall", to_world=place))
    radar = RadarDescription(
        mode="spotlight",
        slant_range=2000.0 if cell < 1.0 else 20_000.0,
        look_angle_deg=float(rng.uniform(30.0, 60.0)),
        heading_deg=heading,
        center_frequency=frequency,
        bandwidth=0.886 * 299_792_458.0 / (2.0 * cell),
        azimuth_resolution=cell,
        polarisation=str(rng.choice(("HH", "VV"))),
        aim_x=0.0,
        aim_y=0.0,
        aim_z=0.0,
    )
    film = FilmDescription(image_extent_azimuth=16.0 * cell, image_extent_range=max(16.0 * cell, 16.0))
    method = "hybrid" if seed % 4 == 3 else "image"
    settings = TraceSettings(method=method, keep_subsets=True)
    scene = build_scene(meshes, radar=radar, film=film, settings=settings, name=f"{kind}_{seed}")
    text = f"{label}, {frequency / 1e9:g} GHz, cell {cell:g} m, {'rough' if rough else 'smooth'}, {method}"
    return scene, text


@dataclass(frozen=True)
class OnGround:
    """Errors of one scene, dB.

    Parameters
    ----------
    level : energy of the image over that by dense rays
    true : of the image, its energy against that of its difference from dense rays
    rays, total : stated of the rays, and of the sum of all errors that are known
    seconds : processor seconds of the run, and of its truth
    """

    seed: int
    label: str
    level: float
    true: float
    rays: float
    total: float
    seconds: tuple[float, float]

    @property
    def text(self) -> str:
        mark = "  TOO SMALL" if self.true > self.total + 3.0 else ""
        return (
            f"{self.seed:3} level {self.level:+6.2f} dB, true {self.true:6.1f}, rays {self.rays:6.1f}, all known "
            f"{self.total:6.1f} dB{mark}; {self.seconds[0]:.1f} and {self.seconds[1]:.1f} CPU s; {self.label}"
        )


def image_on_ground(scene: Scene, halvings: int = 0) -> tuple[SarImage, Run]:
    """Image with error bars by the scene's method, and its run."""
    run = Run(scene)
    if halvings:
        assert run.sampling is not None
        run.sampling = replace(run.sampling, halvings=halvings)
    if scene.settings.method == "hybrid":
        return add_error_bars(focus(echoes(run))), run
    imager = Imager(run)
    if halvings:
        imager.sampling = run.sampling
    return add_error_bars(imager.image()), run


def on_ground(seed: int) -> OnGround:
    """Error of the automatic rays of a drawn scene, and what they state."""
    scene, label = scene_on_ground(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SarmitsubaWarning)
        start = time.process_time()
        image, _ = image_on_ground(scene)
        took = time.process_time() - start
        interval = image.metadata.get("sampling", {}).get("key_pulse_interval", 0)
        diffuse = float(image.metadata["ray_spacing_settings"].get("diffuse_ray_spacing", 0.0))
        fixed = replace(
            scene,
            settings=replace(
                scene.settings,
                key_pulse_interval=interval,
                diffuse_ray_spacing=diffuse * 2.0**-TRUTH_HALVINGS,
            ),
        )
        dense, _ = image_on_ground(fixed, TRUTH_HALVINGS)
    channel = image.channels[0]
    found, exact = image.total(channel), dense.total(channel)
    energy = [float(np.sum(np.abs(x) ** 2)) for x in (found, exact)]
    parts = [part for part in error_budget(image) if part.counts and not math.isnan(part.error_db)]
    total = 10.0 * math.log10(sum(10.0 ** (0.1 * max(part.error_db, -200.0)) for part in parts))
    rays = next((part.error_db for part in parts if part.name == "rays"), math.nan)
    return OnGround(
        seed,
        label,
        10.0 * math.log10(energy[0] / energy[1]),
        image_error_db(found, exact),
        rays,
        total,
        (took, time.process_time() - start - took),
    )


def draw_on_ground(first: int, count: int) -> int:
    """Print the errors of drawn scenes; the number of statements that are 3 dB too small."""
    rows = []
    for seed in range(first, first + count):
        rows.append(on_ground(seed))
        print(rows[-1].text, flush=True)
    level = np.abs([row.level for row in rows])
    apart = np.array([row.rays - row.true for row in rows])
    short = sum(row.true > row.total + 3.0 for row in rows)
    print(
        f"{count} scenes: level error median {np.median(level):.2f}, worst {level.max():.2f} dB; {short} true "
        f"errors more than 3 dB above the stated sum; rays stated within 3 dB in {int((np.abs(apart) < 3.0).sum())}, "
        f"median {np.median(apart):+.1f} dB"
    )
    return short


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--step", type=float, default=2.5, help="of the sweep, deg")
    parser.add_argument("--spheres", type=int, default=0, metavar="COUNT", help="draw spheres instead")
    parser.add_argument(
        "--on-ground", type=int, default=0, metavar="COUNT", help="draw round bodies on ground instead"
    )
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="first seed of --on-ground")
    args = parser.parse_args()
    if args.on_ground:
        return int(draw_on_ground(args.first, args.on_ground) > 0)
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
