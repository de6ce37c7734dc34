"""Buildings, a car, a gantry and a ship of the scenes `farm_yard`, `car_park`, `crane` and `harbour_quay`.

Every body stands at the origin of its own coordinates, metres; the scene files place them.
"""

import numpy as np
import trimesh
from solids import blocks, check_closed, merged, prism, turned

Profile = tuple[tuple[float, float], ...]
# a saloon of 4.4 m from the side, nose towards +x: bumper, bonnet, windscreen, roof, rear window, boot
SALOON: Profile = (
    *((-2.2, 0.3), (2.2, 0.3), (2.2, 0.7), (1.0, 0.95)),
    *((0.25, 1.45), (-1.1, 1.45), (-1.7, 1.0), (-2.2, 0.95)),
)
# middles of the wheels along the car, their radius and half width, corners of a tyre
AXLES, TYRE, TREAD, CORNERS = (-1.35, 1.35), 0.31, 0.1, 10


def farm() -> dict[str, trimesh.Trimesh]:
    """A house, a barn with a lean roof, an open machine shed."""
    parts = {}
    for name, (length, width, eaves, ridge) in {
        "farm_house": (14.0, 9.0, 4.0, 8.0),
        "farm_barn": (30.0, 14.0, 5.0, 9.5),
    }.items():
        half = 0.5 * width
        profile = ((-half, 0.0), (half, 0.0), (half, eaves), (0.0, ridge), (-half, eaves))
        solid = turned(prism(profile, (-0.5 * length, 0.5 * length)), 90.0, (0.0, 0.0))
        parts |= split(name, solid, 0.2)
    shed = blocks(("+", (-10, 10), (-4, 4), (0, 4.5)), ("-", (-9.7, 9.7), (-4, 3.7), (0, 4.2)))
    return parts | {"farm_shed": check_closed("farm_shed", shed)}


def car() -> dict[str, trimesh.Trimesh]:
    """A saloon, windscreen and rear window apart from the body, which holds the wheels."""
    body = check_closed("car", prism(SALOON, (-0.9, 0.9)))
    x, _, z = body.triangles_center.T
    glass = (body.face_normals[:, 2] > 0.3) & (z > 1.0) & (z < 1.4)
    glass &= (np.abs(body.face_normals[:, 0]) > 0.3) & (x > -2.0)
    turn = 2.0 * np.pi * (np.arange(CORNERS) + 0.5) / CORNERS
    wheels = []
    for middle in AXLES:
        for side in (-0.82, 0.82):
            outline = np.column_stack([middle + TYRE * np.cos(turn), TYRE + TYRE * np.sin(turn)])
            wheels.append(prism(outline, (side - TREAD, side + TREAD)).triangles)
    paint = np.concatenate([body.triangles[~glass], *wheels])
    return {"car_paint": merged(paint), "car_glass": merged(body.triangles[glass])}


def shell() -> dict[str, trimesh.Trimesh]:
    """A house of four storeys before its walls: slabs, columns and a core, 18 m x 12 m, 3.2 m a storey."""
    cuts = [("+", (-9, 9), (-6, 6), (3.2 * k - 0.25, 3.2 * k)) for k in range(1, 5)]
    cuts.append(("+", (-2, 3), (-2, 2), (0, 14.5)))
    for x in (-8.5, 0.0, 8.5):
        for y in (-5.5, 5.5):
            cuts.append(("+", (x - 0.2, x + 0.2), (y - 0.2, y + 0.2), (0, 12.8)))
    return {"building_shell": check_closed("building_shell", blocks(*cuts))}


def quay() -> dict[str, trimesh.Trimesh]:
    """A coaster of 84 m, bow towards +y, and a gantry that reaches over it, towards -x."""
    half = 7.0
    outline = ((-half, -42.0), (half, -42.0), (half, 28.0), (0.0, 42.0), (-half, 28.0))
    hull = prism(outline, (-1.0, 4.0))  # along y; its (x, z) are east and north
    hull.apply_transform([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 3.0], [0, 0, 0, 1]])
    legs = [("+", (x - 0.6, x + 0.6), (y - 0.6, y + 0.6), (0, 22)) for x in (-7.0, 7.0) for y in (-8.0, 8.0)]
    sills = [("+", (-7.0, 7.0), (y - 0.6, y + 0.6), (9, 10.2)) for y in (-8.0, 8.0)]
    portals = [("+", (x - 0.6, x + 0.6), (-8.0, 8.0), (20.8, 22)) for x in (-7.0, 7.0)]
    booms = [("+", (-28, 16), (y - 0.5, y + 0.5), (22, 23.5)) for y in (-2.5, 2.5)]
    gantry = [*legs, *sills, *portals, *booms, ("+", (9, 14), (-3, 3), (23.5, 26.5))]
    return {
        "ship_hull": check_closed("ship_hull", hull),
        "quay_gantry": check_closed("quay_gantry", blocks(*gantry)),
    }


def split(name: str, solid: trimesh.Trimesh, steepness: float) -> dict[str, trimesh.Trimesh]:
    """Walls and roof of a closed solid, as two meshes."""
    check_closed(name, solid)
    up = solid.face_normals[:, 2] > steepness
    return {
        f"{name}_walls": merged(solid.triangles[~up]),
        f"{name}_roof": merged(solid.triangles[up]),
    }


def places() -> dict[str, trimesh.Trimesh]:
    """All meshes of the four scenes."""
    return farm() | car() | shell() | quay()
