"""First pictures of five cities: shipped blocks, Munich, and models drawn by seed with their own units and headings.

Prints which share of each picture is black and writes the pictures.
"""

import argparse
import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from benchmarks.support import harness

BLACK = 0.1  # of the grey scale: what is darker looks black


@dataclass(frozen=True)
class City:
    """A scene and how it is rendered.

    Parameters
    ----------
    name : of the picture
    make : writes what it needs into a folder and returns the scene's file or name
    options : of ``render``
    """

    name: str
    make: Callable[[Path], str]
    options: tuple[str, ...]


def gable(width: float, depth: float, eaves: float, ridge: float) -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """Walls and roof of a house about the origin, ridge along x."""
    x, y = 0.5 * width, 0.5 * depth
    low = [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)]
    high = [(a, b, eaves) for a, b, _ in low]
    corner = np.array([*low, *high, (-x, 0, ridge), (x, 0, ridge)], dtype=float)
    walls = [(0, 1, 5), (0, 5, 4), (1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7)]
    walls += [(5, 6, 9), (7, 4, 8)]
    roof = [(4, 5, 9), (4, 9, 8), (6, 7, 8), (6, 8, 9)]
    return trimesh.Trimesh(corner, walls, process=False), trimesh.Trimesh(corner, roof, process=False)


def town(seed: int, size: float, heading: float) -> trimesh.Scene:
    """Houses with gables and boxes with flat roofs in rows that are turned by ``heading`` (rad), on a round ground."""
    rng = np.random.default_rng(seed)
    parts: dict[str, list[trimesh.Trimesh]] = {"Ground": [], "Wall": [], "Roof tiles": [], "Metal sheet": []}
    parts["Ground"].append(trimesh.creation.cylinder(0.5 * size, 0.2, sections=48, transform=_at(0, 0, -0.1)))
    step = 34.0
    for i in range(int(size // step)):
        for j in range(int(size // step)):
            x, y = (np.array([i, j]) + 0.5) * step - 0.5 * size + rng.uniform(-3, 3, 2)
            if math.hypot(x, y) > 0.5 * size - 16.0:
                continue
            width, depth = rng.uniform(10, 22, 2)
            move = _at(x, y, 0) @ trimesh.transformations.rotation_matrix(rng.normal(0, 0.15), [0, 0, 1])
            if rng.random() < 0.6:
                eaves = rng.uniform(4, 9)
                walls, roof = gable(width, depth, eaves, eaves + rng.uniform(2, 5))
                parts["Wall"].append(walls.apply_transform(move))
                parts["Roof tiles"].append(roof.apply_transform(move))
            else:
                height = rng.uniform(6, 30)
                box = trimesh.creation.box((width, depth, height), transform=move @ _at(0, 0, 0.5 * height))
                parts["Wall" if rng.random() < 0.8 else "Metal sheet"].append(box)
    scene = trimesh.Scene()
    turn = trimesh.transformations.rotation_matrix(heading, [0, 0, 1])
    for grey, (name, meshes) in enumerate(parts.items()):
        mesh = trimesh.util.concatenate(meshes).apply_transform(turn)
        material = trimesh.visual.material.PBRMaterial(name=name, baseColorFactor=[20 * grey] * 3)
        mesh.visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(mesh.vertices), 2)), material=material)
        scene.add_geometry(mesh, node_name=name)
    return scene


def _at(x: float, y: float, z: float) -> np.ndarray:
    return trimesh.transformations.translation_matrix([x, y, z])


def _upright(scene: trimesh.Scene) -> trimesh.Scene:
    """Turned to y up, as glTF wants it."""
    return scene.apply_transform(trimesh.transformations.rotation_matrix(-0.5 * math.pi, [1, 0, 0]))


def _glb(folder: Path) -> str:
    path = folder / "town.glb"
    _upright(town(3, 240.0, 0.0)).export(path)
    return str(path)


def _obj_millimetres(folder: Path) -> str:
    path = folder / "suburb.obj"
    town(7, 220.0, math.radians(27.0)).apply_scale(1000.0).export(path)
    return str(path)


def _glb_far(folder: Path) -> str:
    path = folder / "quarter.glb"
    moved = town(11, 240.0, math.radians(12.0)).apply_transform(_at(691_000, 5_334_000, 520))
    _upright(moved).export(path)
    return str(path)


def _munich(folder: Path) -> str:
    path = harness.munich()
    return "" if path is None else str(path)


# L band: cells of 2 m make small pictures of whole towns
RADAR = ("--radar", "airborne_l", "-D", "polarisation=VV")
CITIES = (
    City("town", _glb, ("--radar", "airborne_x", "-D", "sar_antenna.azimuth_resolution=1.5")),
    City("suburb", _obj_millimetres, (*RADAR, "--unit", "mm", "-D", "heading_deg=40")),
    City("quarter", _glb_far, (*RADAR, "-D", "heading_deg=-75", "-D", "look_angle_deg=50")),
    City("munich", _munich, RADAR),
    City("urban_block", lambda _: "urban_block", ()),
)


def black_share(picture: np.ndarray) -> float:
    """Share of a grey picture (rows, columns), 0 to 1, that is darker than a tenth."""
    return float((picture < BLACK).mean())


def shown(out: Path) -> np.ndarray:
    """Grey values, 0 to 1, that the quick-look of an output folder shows."""
    from sarmitsuba.files import read_image
    from sarmitsuba.view.display import PictureOptions, prepare

    display = prepare(read_image(out / "image.h5"), PictureOptions(), 1600)
    low, high = display.limits
    return np.clip((display.values - low) / (high - low), 0.0, 1.0)


def render(city: City, folder: Path, *more: str) -> Path | None:
    """Folder of the results; None where the scene is not here."""
    from sarmitsuba import cli

    scene = city.make(folder)
    if not scene:
        return None
    out = folder / city.name
    status = cli.main(["render", scene, "-o", str(out), "--force", "--no-error-bars", *city.options, *more])
    if status:
        raise SystemExit(status)
    return out


def main() -> None:
    """Command line: ``[-o FOLDER] [NAME...]``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="cities (default: all)")
    parser.add_argument("-o", "--output", type=Path, help="folder that keeps the pictures")
    args = parser.parse_args()
    folder = args.output or Path(tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    for city in CITIES:
        if args.names and city.name not in args.names:
            continue
        out = render(city, folder)
        if out is not None:
            grey = shown(out)
            print(
                f"{city.name}: {100 * black_share(grey):.0f} % black, median grey {100 * np.median(grey):.0f} %"
            )


if __name__ == "__main__":
    main()
