"""The scene `land_cover`: a map of classes and a row of houses."""

import numpy as np
import trimesh
from solids import check_closed, merged, prism, turned

from sarmitsuba.core.arrays import F64, U8

# half the edge of the map and the edge of a pixel, m; how far fields and road are turned from east, deg
HALF, PIXEL, TURN = 80.0, 0.5, 14.0
COLOURS = {
    "meadow": 0x7CB342,
    "wheat": 0xE6C229,
    "soil": 0x8D5A2B,
    "potatoes": 0x2E7D32,
    "road": 0x606060,
    "water": 0x1565C0,
    "yard": 0xC8BFAE,
}
# middles of the houses along the road and off it, m, and which way their ridges run
HOUSES = ((-46.0, -9.0, 0), (-28.0, -10.0, 90), (-9.0, -9.0, 0), (8.0, -11.0, 90), (-28.0, -28.0, 0))


def class_map() -> U8:
    """(rows, columns, 3) colours, first row in the north."""
    n = round(2.0 * HALF / PIXEL)
    x = -HALF + PIXEL * (np.arange(n) + 0.5)
    x, y = np.meshgrid(x, -x)
    along, across = _turned(x, y)
    river = 46.0 + 9.0 * np.sin(y / 24.0)
    names = np.full(x.shape, "meadow", dtype=object)
    names[(across > 5.0) & (across < 30.0)] = "wheat"
    names[(across >= 30.0) & (across < 52.0)] = "soil"
    names[across >= 52.0] = "potatoes"
    names[(across < -42.0) & (along < 24.0)] = "soil"
    names[(np.abs(along + 16.0) < 44.0) & (across < 0.0) & (across > -20.0)] = "yard"
    names[np.hypot((x + 40.0) / 16.0, (y + 45.0) / 9.0) < 1.0] = "water"
    names[np.abs(x - river) < 11.0] = "meadow"
    names[np.abs(x - river) < 6.5] = "water"
    names[(np.abs(along - 24.0) < 1.75) & (across < 0.0)] = "road"
    names[np.abs(across - 2.0) < 3.0] = "road"
    code = np.vectorize(COLOURS.__getitem__, otypes=[np.uint32])(names)
    return np.stack([(code >> shift) & 255 for shift in (16, 8, 0)], axis=-1).astype(np.uint8)


def houses() -> dict[str, trimesh.Trimesh]:
    """Houses of 11 m x 8 m with gables, walls and roofs apart."""
    walls, roofs = [], []
    for along, across, ridge in HOUSES:
        profile = ((-4.0, -0.5), (4.0, -0.5), (4.0, 4.5), (0.0, 8.5), (-4.0, 4.5))
        house = turned(prism(profile, (-5.5, 5.5)), 90.0 + ridge + TURN, (0.0, 0.0))
        c, s = np.cos(np.radians(TURN)), np.sin(np.radians(TURN))
        house.apply_translation([c * along - s * across, s * along + c * across, 0.0])
        check_closed("house", house)
        up = house.face_normals[:, 2] > 0.2
        roofs.append(house.triangles[up])
        walls.append(house.triangles[~up])
    return {
        "land_cover_walls": merged(np.concatenate(walls)),
        "land_cover_roofs": merged(np.concatenate(roofs)),
    }


def _turned(x: F64, y: F64) -> tuple[F64, F64]:
    """Coordinates along and across fields and road."""
    c, s = np.cos(np.radians(TURN)), np.sin(np.radians(TURN))
    return c * x + s * y, c * y - s * x
