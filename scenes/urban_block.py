"""The urban block of the demo: apartment house in an L, tower, rotunda, town houses, factory.

The radar looks along +x. Heights are metres above the street; every building stands 0.5 m deep in the ground.
"""

import numpy as np
import shapely
import trimesh
from solids import blocks, box, check_closed, crown, merged, prism, revolve, turned, windows

Parts = dict[str, trimesh.Trimesh]
HALF = 85.0  # m, half the side of the ground
FOOT = -0.5
HEADING = 8.0  # degrees, of the radar's flight in urban_block.xml


def urban_block() -> Parts:
    """Build the meshes of the block, one for each material."""
    parts: dict[str, list[np.ndarray]] = {}

    def add(name: str, solid: trimesh.Trimesh, materials: dict[str, str], share: float = 0.83) -> None:
        """Split a closed solid: ``top`` is what faces up above a share of its height, ``wall`` the rest."""
        check_closed(name, solid)
        high = solid.triangles_center[:, 2] > share * solid.bounds[1, 2]
        top = high & (solid.face_normals[:, 2] > 0.3)
        for kind, faces in (("top", top), ("wall", ~top)):
            if faces.any():
                parts.setdefault(materials.get(kind, materials["wall"]), []).append(solid.triangles[faces])

    stone = {"top": "roof", "wall": "walls"}
    for name, solid in _buildings().items():
        add(name, solid, stone)
    for name, solid in _brick_buildings().items():
        add(name, solid, {"top": "tiles", "wall": "brick"}, share=0.5)
    for i, solid in enumerate(_street_furniture()):
        add(f"furniture {i}", solid, {"wall": "metal"})
    for i, solid in enumerate(_trees()):
        add(f"tree {i}", solid, {"wall": "trees"})
    meshes = {f"urban_{name}": merged(np.concatenate(pieces)) for name, pieces in parts.items()}
    return meshes | {f"urban_{name}": mesh for name, mesh in _ground().items()}


def _buildings() -> dict[str, trimesh.Trimesh]:
    """Concrete buildings with flat roofs."""
    floors = 1.1 + 3.1 * np.arange(6)
    bays = -46.9 + 2.75 * np.arange(16)
    apartments = [
        ("+", (-40, -28), (-48, -4), (FOOT, 19.2)),
        ("+", (-28, -2), (-16, -4), (FOOT, 19.2)),
        # a parapet round the roof
        ("-", (-39.6, -28.4), (-47.6, -4.4), (18.6, 19.2)),
        ("-", (-28.4, -2.4), (-15.6, -4.4), (18.6, 19.2)),
        *windows("-x", -40, [y for i, y in enumerate(bays) if i % 4 != 1], floors, (1.4, 1.6), 0.55),
        *windows("+x", -28, bays[:11], floors, (1.4, 1.6), 0.55),
        *windows("-y", -16, -26.5 + 2.75 * np.arange(9), floors, (1.4, 1.6), 0.55),
        # stair houses and chimneys on the roof
        *[("+", (-36, -32), (y, y + 4.5), (18.6, 21.4)) for y in (-42, -28, -13)],
        ("+", (-14, -9), (-12, -8), (18.6, 21.4)),
        *[("+", (-34.5, -33.5), (y, y + 1), (18.6, 20.4)) for y in (-35, -20)],
    ]
    for y in bays[1::4]:  # balconies: a slab between two side walls
        for z in floors - 0.9:
            apartments += [
                ("+", (-41.4, -40), (y - 0.7, y + 2.1), (z, z + 0.2)),
                ("+", (-41.4, -40), (y - 0.7, y - 0.55), (z, z + 1.2)),
                ("+", (-41.4, -40), (y + 1.95, y + 2.1), (z, z + 1.2)),
            ]
    storeys = 3.6 + 3.2 * np.arange(10)
    tower = [
        ("+", (24, 38), (17, 43), (FOOT, 36.2)),
        ("-", (24.4, 37.6), (17.4, 42.6), (35.4, 36.2)),
        *windows("-x", 24, 18.2 + 4.1 * np.arange(6), storeys, (2.9, 2.6), 1.5),  # loggias
        *windows("-y", 17, 25.6 + 4.0 * np.arange(3), storeys + 0.6, (2.0, 1.7), 0.3),
        *windows("+y", 43, 25.6 + 4.0 * np.arange(3), storeys + 0.6, (2.0, 1.7), 0.3),
        ("+", (29, 35), (25, 35), (35.4, 39.4)),
        ("+", (21.5, 24), (27, 33), (2.9, 3.2)),  # porch
    ]
    office = [
        ("+", (-35, -13), (46.5, 55.5), (FOOT, 11.4)),
        ("-", (-34.7, -13.3), (46.8, 55.2), (10.9, 11.4)),
        *windows("-y", 46.5, -33.8 + 2.4 * np.arange(9), [1.0, 4.6, 8.0], (1.6, 1.8), 0.3),
        *windows("-x", -35, 47.6 + 2.4 * np.arange(3), [1.0, 4.6, 8.0], (1.6, 1.8), 0.3),
        ("+", (-27, -22), (49, 53), (10.9, 13.0)),
    ]
    return {
        "apartments": blocks(*apartments),
        "tower": blocks(*tower),
        "office": turned(blocks(*office), 18.0, (-24.0, 51.0)),
    }


def _brick_buildings() -> dict[str, trimesh.Trimesh]:
    """Town houses with gabled roofs, a factory with a saw-tooth roof and a stack, a domed rotunda."""
    solids = {}
    eaves, ridges = (6.4, 7.2, 5.8, 7.6, 6.6), (10.4, 11.0, 9.6, 12.0, 10.2)
    for i, (eave, ridge) in enumerate(zip(eaves, ridges, strict=True)):
        y = -47.0 + 8.4 * i
        outline = [
            (14, FOOT),
            (24, FOOT),
            (24, eave),
            (24.5, eave - 0.2),
            (19, ridge),
            (13.5, eave - 0.2),
            (14, eave),
        ]
        solids[f"house {i}"] = prism(outline, (y, y + 7.0))
        solids[f"chimney {i}"] = box((20.2, 21.0), (y + 1.2, y + 2.0), (eave, ridge + 1.2))
    teeth = [(36, FOOT), (58.4, FOOT)]
    for k in range(4):  # from the far end: a vertical light, then the slope down towards the radar
        x = 58.4 - 5.6 * k
        teeth += [(x, 9.4), (x - 5.6, 6.2)]
    solids["factory"] = prism(teeth, (-48, -8))
    # square to the radar, the rest of the block is not: only these show lines of full strength
    solids = {name: turned(solid, -HEADING, (36, -28)) for name, solid in solids.items()}
    solids["rotunda"] = revolve(
        [(0, FOOT), (9, FOOT), (9, 8), (9.5, 8), (9.5, 8.6), (8, 8.6)]
        + [(8 * np.cos(t), 8.6 + 5.5 * np.sin(t)) for t in np.deg2rad([15, 30, 45, 60, 75])]
        + [(0, 14.2)],
        (-29, 28),
        64,
    )
    solids["stack"] = revolve([(0, FOOT), (1.1, FOOT), (0.8, 24), (0, 24)], (61, -28), 16)
    return solids


def _street_furniture() -> list[trimesh.Trimesh]:
    """Parked cars, lamp posts, a monument on the square, air conditioners."""
    car = blocks(("+", (0, 4.4), (0, 1.8), (0.3, 0.9)), ("+", (1.0, 3.5), (0.15, 1.65), (0.9, 1.5)))
    along_x = [(x, 1.0) for x in (-24.5, -18.7, -13.0, -1.5, 15.0, 20.6, 33.0, 44.0)]
    along_y = [(-48.0, y) for y in (-42.5, -36.4, -24.0, -18.2, 12.0, 17.9, 31.0)]
    rng = np.random.default_rng(3)  # nobody parks exactly straight
    cars = [turned(car, rng.uniform(-3, 3), (0, 0)).apply_translation((x, y, 0)) for x, y in along_x]
    cars += [turned(car, 90 + rng.uniform(-3, 3), (0, 0)).apply_translation((x, y, 0)) for x, y in along_y]
    lamps = []
    for x in (-14.0, -4.0, 6.0, 16.0):
        for y, arm in ((12.0, 1.0), (47.0, -1.0)):
            far = sorted((y, y + 1.5 * arm))
            lamps.append(
                blocks(
                    ("+", (x, x + 0.2), (y, y + 0.2), (FOOT, 7.5)),
                    ("+", (x, x + 0.2), tuple(far), (7.3, 7.5)),
                )
            )
    monument = blocks(
        ("+", (-1, 5), (26, 32), (FOOT, 0.4)),
        ("+", (0, 4), (27, 31), (0.4, 0.8)),
        ("+", (1.4, 2.6), (28.4, 29.6), (0.8, 7)),
    )
    plant = [box((16.0 + 0, 17.4), (y, y + 1.2), (0.0 + FOOT, 1.4)) for y in (-3.4,)]
    return [*cars, *lamps, monument, *plant]


def _trees() -> list[trimesh.Trimesh]:
    """Crowns on trunks: courtyard, square and the park beside the avenue."""
    rng = np.random.default_rng(7)
    places = [(-23, -44), (-15, -41), (-7, -45), (-21, -33), (-11, -32), (-3, -37), (-19, -23), (-8, -22)]
    places += [(-62, y) for y in (-44, -31, -19, -8, 15, 26, 38, 51)]
    places += [(-12, y) for y in (20, 29, 38)]
    solids = []
    for i, (x, y) in enumerate(places):
        size = rng.uniform(0.85, 1.2)
        center = (x + rng.uniform(-0.6, 0.6), y + rng.uniform(-0.6, 0.6))
        solids.append(crown((*center, 5.0 * size), (2.1 * size, 2.1 * size, 2.6 * size), seed=i))
        solids.append(revolve([(0, FOOT), (0.2, FOOT), (0.2, 3.6), (0, 3.6)], center, 6))
    return solids


def _ground() -> Parts:
    """Streets, paved square and grass: one flat sheet at z = 0, no overlaps."""
    whole = shapely.box(-HALF, -HALF, HALF, HALF)
    streets = shapely.union_all(
        [shapely.box(-57, -HALF, -46, HALF), shapely.box(-46, 0, HALF, 9), shapely.box(4, -HALF, 12, 0)]
    )
    square = shapely.box(-18, 9, 22, 50)
    walks = shapely.union_all(
        [shapely.box(-46, -4, 4, 0), shapely.box(-46, -HALF, -40, 0), shapely.box(12, -HALF, HALF, 0)]
    )
    paving = shapely.union_all([square, walks, shapely.box(-46, 9, -18, HALF)])
    grass = whole.difference(streets).difference(paving)
    out = {}
    for name, region in (("asphalt", streets), ("paving", paving.difference(streets)), ("grass", grass)):
        pieces = shapely.constrained_delaunay_triangles(region)
        flat = np.array(
            [np.asarray(shapely.geometry.polygon.orient(t).exterior.coords)[:3] for t in pieces.geoms]
        )
        out[name] = merged(np.insert(flat, 2, 0.0, axis=2))
    return out
