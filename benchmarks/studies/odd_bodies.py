"""Odd bodies, drawn by seed: slender, tiny, coincident, inverted, self-crossing, of no area, huge; every result finite.

    python -m benchmarks.studies.odd_bodies --count 2000            # about 15 minutes of one core
    python -m benchmarks.studies.odd_bodies --first 137 --count 1   # one scene again; -o FOLDER keeps its files

Each scene is read and simulated with four pulses, one look, one raster, its paths or its radar cross section. It counts
as finite, as refused (one clear line before anything is simulated), or as what must not be: not finite, or a crash.
"""

import argparse
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sarmitsuba import SarmitsubaError, Scene, explain, load_scene, simulate, trace_paths
from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.simulation.execution.turntable import Aspects, rcs_sweep
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from tests.support.unweighted import render

Mesh = tuple[F64, I64]

# rays of a plain lattice
MOST_RAYS = 50_000
METHODS = ("hybrid", "hybrid", "raw", "image", "raster", "paths", "rcs", "rcs")
CHANNELS = ("VV", "VV", "HH,HV,VH,VV")
RADAR = """<sensor type="sar_antenna">
  <float name="slant_range" value="{slant_range!r}"/><float name="look_angle_deg" value="{look!r}"/>
  <float name="heading_deg" value="{heading!r}"/><string name="polarisation" value="{channels}"/>
  <float name="center_frequency" value="{frequency!r}"/><float name="bandwidth" value="{bandwidth!r}"/>
  <float name="azimuth_resolution" value="{azimuth!r}"/><integer name="n_pulses" value="4"/>
  <film type="range_film"><float name="image_extent_limit" value="{extent!r}"/></film></sensor>"""
MATERIALS = {
    "metal": '<string name="material" value="metal"/><float name="rms_height" value="0.001"/>',
    "pec": '<string name="material" value="pec"/>',
    "concrete": '<string name="material" value="concrete"/><float name="rms_height" value="0.002"/>'
    '<string name="diffuse_law" value="lambert"/><float name="diffuse_level_db" value="-15"/>',
}


@dataclass(frozen=True)
class Drawn:
    """A scene file's text, its meshes, and how it is simulated."""

    text: str
    meshes: dict[str, Mesh]
    method: str
    kinds: tuple[str, ...]


def draw(seed: int) -> Drawn:
    """The scene of a seed."""
    rng = np.random.default_rng([seed, 0x0DD])
    scale = 10.0 ** rng.uniform(-2.0, 2.0)  # m, of what is usual in the scene
    shapes, meshes, kinds = [], {}, []
    for i in range(int(rng.integers(1, 6))):
        kind = str(rng.choice([*BODIES]))
        if shapes and rng.random() < 0.15:
            kind = "coincident"
            body = shapes[-1]
        else:
            body = BODIES[kind](rng, scale, f"body{i}", meshes)
        kinds.append(kind)
        # the same place in another material is one way to be coincident
        material = str(rng.choice([*MATERIALS]))
        shapes.append(body.partition("<ref")[0] + f'<ref id="{material}"/></shape>')
    if rng.random() < 0.6:
        half = scale * rng.uniform(0.5, 3.0)
        shapes.append(
            f'<shape type="rectangle"><transform name="to_world"><scale value="{half!r}"/></transform>'
            '<ref id="concrete"/></shape>'
        )
    frequency = float(np.clip(3e8 / (scale * 10.0 ** rng.uniform(-1.5, 0.3)), 1e8, 1e11))
    extent = scale * 10.0 ** rng.uniform(0.0, 1.0)
    radar = RADAR.format(
        slant_range=float(max(50.0 * scale, 10.0 ** rng.uniform(2.0, 5.8))),
        look=float(rng.uniform(10.0, 80.0)),
        heading=float(rng.uniform(0.0, 360.0)),
        channels=str(rng.choice(CHANNELS)),
        frequency=frequency,
        bandwidth=float(min(0.2 * frequency, 10.0 * 3e8 / extent)),
        azimuth=float(max(extent / 20.0, 3e8 / frequency)),
        extent=float(extent),
    )
    spacing = extent / 10.0 ** rng.uniform(1.3, 1.9)
    integrator = f'<integrator type="sar_path"><float name="ray_spacing" value="{spacing!r}"/></integrator>'
    materials = [f'<bsdf type="radar_material" id="{k}">{v}</bsdf>' for k, v in MATERIALS.items()]
    text = "\n".join(['<scene version="3.0.0">', integrator, radar, *materials, *shapes, "</scene>"])
    return Drawn(text, meshes, str(rng.choice(METHODS)), tuple(kinds))


def _size(rng: np.random.Generator, scale: float) -> float:
    """A length: mostly of the scene's scale, else tiny or large against it, rarely anything from 1 um to 100 km."""
    luck = rng.random()
    if luck < 0.75:
        return float(scale * 10.0 ** rng.uniform(-2.0, 0.3))
    if luck < 0.98:
        return float(scale * 10.0 ** rng.choice([rng.uniform(-6.0, -2.0), rng.uniform(0.3, 1.5)]))
    return float(10.0 ** rng.uniform(-6.0, 5.0))


def _placed(rng: np.random.Generator, scale: float) -> str:
    """A transform: turned, moved, sometimes mirrored (inverted) or squeezed flat."""
    stretch = np.ones(3)
    luck = rng.random()
    if luck < 0.15:
        stretch[rng.integers(3)] = -1.0
    elif luck < 0.3:
        stretch = 10.0 ** rng.uniform(-3.0, 1.0, 3)
    elif luck < 0.36:
        stretch[rng.integers(3)] = float(rng.choice([1e-12, 1e-7, 0.0]))
    axis, angle = rng.normal(size=3), float(rng.uniform(0.0, 360.0))
    move = scale * rng.normal(size=3) * (rng.random() < 0.8)

    def xyz(v: F64) -> str:
        return " ".join(f'{name}="{float(x)!r}"' for name, x in zip("xyz", v, strict=True))

    return (
        f'<transform name="to_world"><scale {xyz(stretch)}/><rotate {xyz(axis)} angle="{angle!r}"/>'
        f"<translate {xyz(move)}/></transform>"
    )


def _cylinder(rng: np.random.Generator, scale: float, name: str, meshes: dict[str, Mesh]) -> str:
    length, turn = _size(rng, scale), rng.normal(size=3)
    radius = length * 10.0 ** rng.uniform(-4.0, 0.5)
    end = length * turn / np.linalg.norm(turn)
    point = " ".join(f'{n}="{float(x)!r}"' for n, x in zip("xyz", end, strict=True))
    return (
        f'<shape type="cylinder"><point name="p1" {point}/><float name="radius" value="{radius!r}"/>'
        f"{_placed(rng, scale)}<ref"
    )


def _sphere(rng: np.random.Generator, scale: float, name: str, meshes: dict[str, Mesh]) -> str:
    # large ones take up to 400 000 facets: rarely
    radius = _size(rng, scale) if rng.random() < 0.02 else min(_size(rng, scale), 0.05 * scale)
    return f'<shape type="sphere"><float name="radius" value="{radius!r}"/>{_placed(rng, scale)}<ref'


def _flat(rng: np.random.Generator, scale: float, name: str, meshes: dict[str, Mesh]) -> str:
    kind, half = rng.choice(["disk", "rectangle", "cube"]), _size(rng, scale)
    placed = _placed(rng, scale).replace('to_world">', f'to_world"><scale value="{half!r}"/>')
    return f'<shape type="{kind}">{placed}<ref'


def _mesh(rng: np.random.Generator, scale: float, name: str, meshes: dict[str, Mesh]) -> str:
    make = MESHES[int(rng.integers(len(MESHES)))]
    vertices, faces = make(rng)
    if rng.random() < 0.2:  # wound the other way, wholly or in part
        turned = rng.random(len(faces)) < rng.choice([0.5, 1.0])
        faces = np.where(turned[:, None], faces[:, ::-1], faces)
    if rng.random() < 0.2:
        faces = np.concatenate([faces, faces[: len(faces) // 2]])
    meshes[name] = (_size(rng, scale) * vertices, faces)
    return f'<shape type="ply"><string name="filename" value="{name}.ply"/>{_placed(rng, scale)}<ref'


def _tube(rng: np.random.Generator) -> Mesh:
    """A bent tube that may cross itself, thin or thick against its bends."""
    n, m = int(rng.integers(3, 40)), int(rng.integers(3, 16))
    t = np.linspace(0.0, 2.0 * np.pi * rng.uniform(0.1, 1.0), n)
    a, b = rng.integers(1, 4, 2)
    path = np.stack([np.cos(a * t), np.sin(b * t), 0.3 * np.sin(t)], axis=1)
    along = np.gradient(path, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    side = np.cross(along, rng.normal(size=3))
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-12)
    up, phi = np.cross(along, side), 2.0 * np.pi * np.arange(m) / m
    radius = 10.0 ** rng.uniform(-4.0, 0.3)
    ring = side[:, None] * np.cos(phi)[:, None] + up[:, None] * np.sin(phi)[:, None]
    vertices = (path[:, None] + radius * ring).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(n - 1), np.arange(m), indexing="ij")
    p, q = (i * m + j).ravel(), (i * m + (j + 1) % m).ravel()
    return vertices, np.concatenate([np.stack([p, q, q + m], 1), np.stack([p, q + m, p + m], 1)])


def _soup(rng: np.random.Generator) -> Mesh:
    """Triangles that cross each other, some of them needles or without area."""
    n = int(rng.integers(1, 60))
    corners = rng.normal(size=(n, 3, 3))
    thin = rng.random(n) < 0.4
    share = rng.random((n, 1))
    corners[thin, 2] = (corners[:, 0] * share + corners[:, 1] * (1.0 - share))[thin]
    corners[thin, 2] += 10.0 ** rng.uniform(-14.0, -1.0, (int(thin.sum()), 1)) * rng.normal(
        size=(int(thin.sum()), 3)
    )
    same = rng.random(n) < 0.1
    corners[same, 1] = corners[same, 0]
    return corners.reshape(-1, 3), np.arange(3 * n).reshape(-1, 3)


def _sliced(rng: np.random.Generator) -> Mesh:
    """A sphere of very unequal slices: slivers at the poles, curved strips between."""
    n, m = int(rng.integers(2, 12)), int(rng.integers(3, 60))
    theta = np.sort(np.pi * rng.random(n) ** rng.uniform(0.2, 5.0))
    phi = np.sort(2.0 * np.pi * rng.random(m))
    t, p = np.meshgrid(theta, phi, indexing="ij")
    vertices = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=2).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(n - 1), np.arange(m), indexing="ij")
    a, b = (i * m + j).ravel(), (i * m + (j + 1) % m).ravel()
    return vertices, np.concatenate([np.stack([a, a + m, b + m], 1), np.stack([a, b + m, b], 1)])


MESHES = (_tube, _soup, _sliced)
BODIES = {"cylinder": _cylinder, "sphere": _sphere, "flat": _flat, "mesh": _mesh}


def write(drawn: Drawn, folder: Path) -> Path:
    """The scene's files; the path of the scene."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (vertices, faces) in drawn.meshes.items():
        rows = [" ".join(repr(float(x)) for x in v) for v in vertices]
        rows += [f"3 {a} {b} {c}" for a, b, c in faces]
        head = f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\n" + "".join(
            f"property double {axis}\n" for axis in "xyz"
        )
        head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
        (folder / f"{name}.ply").write_text(head + "\n".join(rows) + "\n", encoding="utf-8")
    path = folder / "scene.xml"
    path.write_text(drawn.text, encoding="utf-8")
    return path


def outcome(drawn: Drawn, path: Path) -> tuple[str, str]:
    """``finite``, ``refused``, ``not finite`` or ``crash``, and a line about it."""
    try:
        scene = _quick(load_scene(path), drawn.method)
        if drawn.method == "rcs":
            sweep = rcs_sweep(
                scene, Aspects(np.array([0.3, 1.7]), np.array([0.2, 0.2])), checked=0, most_rays=20_000
            )
            data = [sweep.result.amplitude]
        elif drawn.method == "paths":
            table = trace_paths(scene)
            data = [table.amplitude, table.length, table.range_rate]
        elif drawn.method == "explain":
            data = [list(explain(scene, measured=True).prediction.seconds.values())]
        elif drawn.method in ("hybrid", "raw"):
            data = [simulate(scene).data]
        else:
            data = [render(scene, method=drawn.method).data]
    except SarmitsubaError as error:
        text = str(error)
        return ("not finite" if "not a finite number" in text else "refused"), text
    except Exception:
        return "crash", traceback.format_exc()
    if not all(np.isfinite(d).all() for d in data):
        return "not finite", "said by nobody"
    return "finite", "" if any(np.any(d) for d in data) else "empty"


def _quick(scene: Scene, method: str) -> Scene:
    """The scene by a method, its rays so far apart that there are few."""
    spacing = 0.0
    if method != "rcs":
        spacing = max(
            scene.settings.ray_spacing, float(np.sqrt(SamplingPlan.of(scene).window.area / MOST_RAYS))
        )
    made = {"ray_spacing": spacing, "diffuse_ray_spacing": spacing}
    name = method if method in ("raw", "image", "raster") else "hybrid"
    return replace(scene, settings=replace(scene.settings, method=name, **made))


def main() -> int:
    """Draw, simulate, count."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--first", type=int, default=0, help="seed of the first scene")
    parser.add_argument("--count", type=int, default=2000, help="scenes")
    parser.add_argument("-o", "--output", type=Path, default=None, help="folder that keeps what failed")
    parser.add_argument(
        "--explain", action="store_true", help="ask for the plan of each in place of its data"
    )
    parser.add_argument("-v", "--verbose", action="store_true", help="a line for every scene")
    options = parser.parse_args()
    counts, by_method, slowest = Counter(), Counter(), (0.0, -1)
    reasons: Counter[str] = Counter()
    start = time.process_time()
    for seed in range(options.first, options.first + options.count):
        drawn = replace(draw(seed), method="explain") if options.explain else draw(seed)
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            before = time.process_time()
            kind, line = outcome(drawn, write(drawn, Path(folder)))
            slowest = max(slowest, (time.process_time() - before, seed))
        if options.verbose:
            seconds = time.process_time() - before
            print(
                f"{seed}: {seconds:.2f} s {drawn.method} {'+'.join(drawn.kinds)}: {kind} {line[:150]}",
                flush=True,
            )
        counts[kind] += 1
        by_method[f"{drawn.method}: {kind}"] += 1
        if kind == "refused":
            reasons[line.partition(": ")[2][:60]] += 1
        if kind in ("not finite", "crash"):
            print(f"seed {seed} ({drawn.method}; {', '.join(drawn.kinds)}): {kind}: {line}", flush=True)
            if options.output is not None:
                write(drawn, options.output / str(seed))
        if (seed - options.first + 1) % 100 == 0:
            print(
                f"{seed - options.first + 1} scenes, {time.process_time() - start:.0f} s: {dict(counts)}",
                flush=True,
            )
    taken = time.process_time() - start
    print(
        f"{options.count} scenes in {taken:.0f} CPU seconds, slowest {slowest[0]:.1f} s (seed {slowest[1]})"
    )
    for name, n in sorted(counts.items()):
        print(f"{name:>12}: {n}")
    for name, n in sorted(by_method.items()):
        print(f"  {name}: {n}")
    for reason, n in reasons.most_common(12):
        print(f"  refused {n} times: {reason}")
    return int(counts["not finite"] + counts["crash"] > 0)


if __name__ == "__main__":
    sys.exit(main())
