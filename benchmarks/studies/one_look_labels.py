"""Labels of echoes: their cost, their sum against the image, the mean level over seeds, and one look against hybrid.

``python -m benchmarks.studies.one_look_labels car bridge urban_block --seeds 50`` (car: a chip of one) prints one line
each: processor seconds of the labels and of the hybrid image, both with compiled kernels; the error of the sum of all
parts against method image; the ratio of the mean power of so many realisations to the expected one, channel by channel;
and of method image against hybrid the difference of the complex images (dB), of means over 5 x 5 pixels of the brighter
half (rms, dB), and of the whole energy (dB).
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

import sarmitsuba
from sarmitsuba.analysis.echo_labels import EchoLabels, echo_labels
from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.loading.load import load_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import Method
from sarmitsuba.signal.focusing import default_grid

BLOCK = 5


def car() -> Scene:
    """Chip of a car of two metal boxes on soil."""
    import trimesh

    soil = {
        "material": "medium_dry_ground",
        "rms_height": 0.02,
        "diffuse_law": "lambert",
        "diffuse_level_db": -8.0,
    }
    corners = [[-20.0, -20.0, 0.0], [20.0, -20.0, 0.0], [20.0, 20.0, 0.0], [-20.0, 20.0, 0.0]]
    meshes = [SceneMesh(corners, [[0, 1, 2], [0, 2, 3]], soil, "ground")]
    for name, size in (("hull", (1.8, 4.5, 0.8)), ("cabin", (1.6, 2.2, 1.5))):
        place = trimesh.transformations.rotation_matrix(0.5, [0.0, 0.0, 1.0])
        place[2, 3] = 0.5 * size[2]
        meshes.append(SceneMesh.of(trimesh.creation.box(size), "metal", name, to_world=place))
    radar = RadarDescription(
        mode="spotlight", slant_range=5e3, look_angle_deg=40.0, azimuth_resolution=0.3, bandwidth=600e6
    )
    film = FilmDescription(image_extent_azimuth=19.2, image_extent_range=25.6)
    return build_scene(meshes, radar=radar, film=film, name="car")


def seconds(call: Callable[[], object]) -> float:
    """Processor seconds of the second of two calls."""
    call()
    start = time.process_time()
    call()
    return time.process_time() - start


def without_noise(scene: Scene) -> Scene:
    """The scene without receiver noise."""
    effects = {**scene.settings.effects, "noise": "off"}
    return replace(scene, settings=replace(scene.settings, effects=effects))


def image(scene: Scene, method: Method, seed: int | None = None) -> C64:
    """Pixels (n_channels, n_azimuth, n_range)."""
    return sarmitsuba.render(scene, method=method, seed=seed).data


def blocks(data: C64) -> F64:
    """Mean power over blocks, of all channels."""
    power = np.square(np.abs(data), dtype=np.float64).sum(axis=0)
    rows, columns = (n // BLOCK for n in power.shape)
    part = power[: rows * BLOCK, : columns * BLOCK]
    return np.asarray(part.reshape(rows, BLOCK, columns, BLOCK).mean(axis=(1, 3)))


def db(ratio: float) -> float:
    """A ratio of powers, dB."""
    return float(10.0 * np.log10(max(ratio, 1e-30)))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=["car", "dihedral", "bridge", "urban_block"])
    parser.add_argument("--seeds", type=int, default=0)
    given = parser.parse_args()
    for name in given.scenes:
        scene = without_noise(car() if name == "car" else load_scene(name))
        grid = default_grid(scene.radar, scene.image)
        labels, hybrid = (
            seconds(lambda s=scene, g=grid: echo_labels(s, g, {})),
            seconds(lambda s=scene: image(s, "hybrid")),
        )
        echoes = EchoLabels(scene, grid, {})
        whole, one, exact = echoes.image, image(scene, "image"), image(scene, "hybrid")
        error = db(float(np.square(np.abs(whole - one)).sum() / np.square(np.abs(one)).sum()))
        off = db(float(np.square(np.abs(one - exact)).sum() / np.square(np.abs(exact)).sum()))
        a, b = blocks(one), blocks(exact)
        bright = b > np.median(b)
        apart = float(np.sqrt(np.mean(np.square(10.0 * np.log10(a[bright] / b[bright])))))
        print(
            f"{name}: {grid.shape[0]} x {grid.shape[1]} pixels, labels {labels:.2f} CPU s, hybrid {hybrid:.2f} CPU s; "
            f"sum {error:.0f} dB; image against hybrid: {off:.1f} dB, blocks {apart:.2f} dB, energy "
            f"{db(float(a.sum() / b.sum())):+.2f} dB",
            flush=True,
        )
        if given.seeds:
            mean = sum(
                np.square(np.abs(image(scene, "image", seed))).sum(axis=(1, 2)) for seed in range(given.seeds)
            )
            area = echoes.imager.pack(whole).cell_area
            level = echo_labels(scene, grid, {})[0]["expected_sigma0"].values.astype(np.float64)
            wanted = (level * area[..., None]).sum(axis=(0, 1))
            ratio = ", ".join(f"{x:.4f}" for x in mean / given.seeds / wanted)
            print(f"{name}: mean of {given.seeds} realisations over the expected level: {ratio}", flush=True)


if __name__ == "__main__":
    main()
