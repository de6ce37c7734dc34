"""Drawn metal corners on grass, in images so large that automatic rays are several wavelengths apart."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings

WAVELENGTH = 299_792_458.0 / 9.6e9
# wavelengths
NARROWEST, WIDEST = 0.5, 10.0
EXTENT = 32.0


def plates(width: float, length: float, *, trihedral: bool) -> F64:
    """Triangles (n, 3, 3), m, of a strip on the floor and one on a wall along y, and for a trihedral an end wall."""
    floor = np.array([[0, 0, 0], [width, 0, 0], [width, length, 0], [0, length, 0]], dtype=float)
    wall = floor[:, [2, 1, 0]]
    quads = [floor, wall]
    if trihedral:
        quads.append(np.array([[0, 0, 0], [width, 0, 0], [width, 0, width], [0, 0, width]], dtype=float))
    return np.array([[quad[i] for i in ids] for quad in quads for ids in ((0, 1, 2), (0, 2, 3))])


def drawn_corners(seed: int) -> tuple[Scene, float]:
    """Scene of five dihedrals or trihedrals, turned and tilted by chance, and the width of all, wavelengths."""
    rng = np.random.default_rng([seed, 0xC0])
    wide = float(np.exp(rng.uniform(np.log(NARROWEST), np.log(WIDEST))))
    trihedral = bool(seed % 2)
    meshes = []
    for k, y in enumerate(np.linspace(-11.0, 11.0, 5)):
        length = wide * WAVELENGTH if trihedral else rng.uniform(1.0, 4.0)
        yaw = np.radians(rng.uniform(-50.0, 50.0) + (45.0 if trihedral else 0.0))
        c, s = np.cos(yaw), np.sin(yaw)
        place = np.array([rng.uniform(-11.0, 11.0), y - 0.5 * length, rng.uniform(0.3, 2.0)])
        corners = plates(wide * WAVELENGTH, length, trihedral=trihedral) @ np.array(
            [[c, s, 0], [-s, c, 0], [0, 0, 1]]
        )
        vertices = (corners + place).reshape(-1, 3)
        meshes.append(SceneMesh(vertices, np.arange(len(vertices)).reshape(-1, 3), "pec", f"corner {k}"))
    half = 0.5 * EXTENT
    square = np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]])
    meshes.append(SceneMesh(square, [[0, 1, 2], [0, 2, 3]], {"material": "grass"}, "ground"))
    radar = RadarDescription(
        slant_range=8000.0,
        look_angle_deg=float(rng.uniform(35.0, 55.0)),
        center_frequency=9.6e9,
        bandwidth=400e6,
        azimuth_resolution=0.4,
        heading_deg=180.0,
    )
    film = FilmDescription(image_extent_azimuth=EXTENT, image_extent_range=EXTENT)
    settings = TraceSettings(method="image", endless_ground="off")
    return build_scene(meshes, radar=radar, film=film, settings=settings), wide
