"""Make every mesh and map of the shipped scenes again, and check it: closed, outward, no degenerate faces.

    python scenes/build_meshes.py            write scenes/meshes/*.ply and scenes/maps/*.png
    python scenes/build_meshes.py --check    compare with the files that are there, write nothing

Deterministic. Needs shapely >= 2.1 besides the program's own dependencies.
"""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from land_cover import class_map, houses
from PIL import Image
from places import places
from solids import box, check_closed, merged
from targets import targets
from urban_block import urban_block

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.scene.mesh.cleaning import clean_mesh
from sarmitsuba.scene.mesh.formats import write_ply
from sarmitsuba.scene.mesh.tessellate import sphere

MESHES = Path(__file__).parent / "meshes"
MAPS = Path(__file__).parent / "maps"
Parts = dict[str, trimesh.Trimesh]


def trihedral() -> Parts:
    """Build both 1 m trihedrals, corner at the origin, opening towards -x and up; open surfaces."""
    s = 0.5**0.5
    a, b, c = np.array([-s, s, 0.0]), np.array([-s, -s, 0.0]), np.array([0.0, 0.0, 1.0])
    zero = np.zeros(3)
    pairs = [(a, b), (b, c), (c, a)]
    triangles = [[zero, p, q] for p, q in pairs]
    squares = triangles + [[p, p + q, q] for p, q in pairs]
    return {
        "trihedral": trimesh.Trimesh(
            np.reshape(triangles, (-1, 3)), np.arange(9).reshape(-1, 3), process=False
        ),
        "trihedral_square": trimesh.Trimesh(
            np.reshape(squares, (-1, 3)), np.arange(18).reshape(-1, 3), process=False
        ),
    }


def sphere_ka60() -> Parts:
    """Build the sphere of ka = 60 at 9.65 GHz with edges of at most half a wavelength: no grating lobes."""
    wavelength = SPEED_OF_LIGHT / 9.65e9
    vertices, faces = sphere(60.0 * wavelength / (2.0 * np.pi), wavelength / 32.0, edge=0.55 * wavelength)
    return {"sphere": check_closed("sphere", trimesh.Trimesh(vertices, faces, process=False))}


def tower() -> Parts:
    """Build the block of 20 m x 15 m x 24 m; its near wall stands at x = 0, its foot 0.5 m deep."""
    solid = check_closed("tower", box((0, 15), (-12, 12), (-0.5, 20)))
    return by_rule("tower", solid, lambda center, normal: np.where(normal[:, 2] > 0.5, "roof", "walls"))


def bridge() -> Parts:
    """Build a deck 1 m thick about z = 30 m with its near edge at x = 0, two piers and two banks."""
    deck = check_closed("deck", box((0, 14), (-80, 80), (29.5, 30.5)))
    parts = by_rule(
        "bridge",
        deck,
        lambda center, normal: np.select(
            [normal[:, 2] > 0.5, np.abs(normal[:, 0]) > 0.5], ["road", "fascia"], "underside"
        ),
    )
    piers = [box((5, 9), (y - 1.5, y + 1.5), (-0.5, 29.5)) for y in (-28, 28)]
    banks = [box((-80, 90), (y - 20, y + 20), (-0.5, 2.5)) for y in (-68, 68)]
    parts["bridge_piers"] = joined([check_closed("pier", p) for p in piers])
    parts["bridge_banks"] = joined([check_closed("bank", b) for b in banks])
    return parts


def by_rule(prefix: str, solid: trimesh.Trimesh, rule: Callable[..., np.ndarray]) -> Parts:
    """Split a solid by what ``rule(centers, normals)`` calls each face."""
    names = rule(solid.triangles_center, solid.face_normals)
    return {f"{prefix}_{name}": merged(solid.triangles[names == name]) for name in np.unique(names)}


def joined(solids: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Put several solids into one mesh."""
    return merged(np.concatenate([s.triangles for s in solids]))


def build() -> Parts:
    """Build all meshes by file name."""
    parts: Parts = {}
    for make in (trihedral, sphere_ka60, tower, bridge, urban_block, houses, places, targets):
        parts |= make()
    return parts


def main() -> None:
    """Write or compare."""
    only_check = "--check" in sys.argv[1:]
    MESHES.mkdir(exist_ok=True)
    different = []
    for name, mesh in build().items():
        vertices, faces, notes = clean_mesh(name, mesh.vertices, mesh.faces)
        if notes:
            raise SystemExit("\n".join(notes))
        path = MESHES / f"{name}.ply"
        path.parent.mkdir(parents=True, exist_ok=True)
        before = path.read_bytes() if path.exists() else b""
        target = path.with_suffix(".new")
        write_ply(target, vertices, faces)
        if target.read_bytes() != before:
            different.append(name)
        if only_check:
            target.unlink()
        else:
            target.replace(path)
        print(f"{name:20s} {len(faces):6d} triangles")
    path = MAPS / "land_cover.png"
    pixels = class_map()  # of a PNG the pixels are compared, whatever packed them
    if not path.exists() or not np.array_equal(np.asarray(Image.open(path).convert("RGB")), pixels):
        different.append(path.stem)
    if not only_check:
        MAPS.mkdir(exist_ok=True)
        Image.fromarray(pixels).quantize(16).save(path, optimize=True)
    if only_check and different:
        raise SystemExit(f"differ from what the script makes: {', '.join(different)}")


if __name__ == "__main__":
    main()
