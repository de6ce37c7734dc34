"""Buildings as closed solids: an extruded footprint with a roof, facade relief, and pavement around it.

Roofs are flat, gabled over four corners, or pyramids over convex outlines. Pavement lies a kerb's height above ground.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.loading.importing.facades import FacadeBuilder, FacadeOptions, Walls, wall_quads
from sarmitsuba.loading.importing.parts import Parts
from sarmitsuba.loading.importing.polygons import triangulate, why_unusable

if TYPE_CHECKING:
    import shapely

    pass


# default pitch of 35 degrees, and largest height of a roof relative to the house
_RISE, _SHARE = 0.35, 0.5
# deviation from a straight wall up to which a corner is redundant, m
_STRAIGHT = 1e-3
GABLED = ("gabled",)
PYRAMIDS = ("pyramidal", "hipped", "tented")


@dataclass(frozen=True, eq=False)
class Roof:
    """Surface of a roof.

    Parameters
    ----------
    corners : (n, 2) float64, m
    lift : (n,) float64, 0 at the eaves, 1 at the ridge
    faces : (m, 3) int32, seen from above counter-clockwise
    gables : (k, 3) int32, vertical triangles under a ridge, of the walls' material
    """

    corners: F64
    lift: F64
    faces: I32
    gables: I32

    @property
    def is_flat(self) -> bool:
        """Whether the roof has no ridge."""
        return not self.lift.any()


def rise(polygon: "shapely.Polygon", height: float) -> float:
    """Default height of a pitched roof over a footprint, m, for a house of a given height, m."""
    x, y = np.asarray(polygon.minimum_rotated_rectangle.exterior.coords.xy)
    sides = np.hypot(np.diff(x), np.diff(y))
    return float(min(_RISE * sides.min(), _SHARE * height))


def make_roof(polygon: "shapely.Polygon", shape: str, across: bool) -> Roof:
    """Roof of a shape of OpenStreetMap's ``roof:shape`` for simple footprints, else flat.

    Parameters
    ----------
    polygon : footprint, m, valid, exterior counter-clockwise
    shape : ``gabled`` needs four corners; ``pyramidal``, ``hipped`` and ``tented`` become a pyramid over convex
        outlines
    across : the ridge runs along the shorter side
    """
    corners = np.asarray(polygon.simplify(_STRAIGHT).exterior.coords)[:-1]
    if not polygon.interiors and shape in GABLED and len(corners) == 4 and _convex(corners):
        return _make_gable(corners, across)
    if not polygon.interiors and shape in PYRAMIDS and _convex(corners):
        n = len(corners)
        apex = np.asarray(polygon.centroid.coords)
        faces = [[i, (i + 1) % n, n] for i in range(n)]
        return _roof(np.concatenate([corners, apex]), [0.0] * n + [1.0], faces, [])
    flat, triangles = triangulate(polygon)
    return Roof(flat, np.zeros(len(flat)), triangles, np.zeros((0, 3), dtype=np.int32))


def _make_gable(corners: F64, across: bool) -> Roof:
    """Gabled roof with its ridge between the midpoints of two opposite sides, along the longer ones unless across."""
    side = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    long_first = side[0] + side[2] >= side[1] + side[3]
    a, b, c, d = corners if long_first != across else np.roll(corners, -1, axis=0)
    points = np.array([a, b, c, d, 0.5 * (b + c), 0.5 * (d + a)])
    slopes = [[0, 1, 4], [0, 4, 5], [2, 3, 5], [2, 5, 4]]
    return _roof(points, [0.0] * 4 + [1.0] * 2, slopes, [[1, 2, 4], [3, 0, 5]])


def _roof(corners: F64, lift: list[float], faces: list[list[int]], gables: list[list[int]]) -> Roof:
    whole = [np.array(rows, dtype=np.int32).reshape(-1, 3) for rows in (faces, gables)]
    return Roof(corners, np.array(lift), whole[0], whole[1])


def _convex(corners: F64) -> bool:
    """Whether a counter-clockwise outline is convex."""
    step = np.roll(corners, -1, axis=0) - corners
    after = np.roll(step, -1, axis=0)
    return bool((step[:, 0] * after[:, 1] > step[:, 1] * after[:, 0]).all())


# depth of walls below the ground, m; avoids gaps at the foot of walls
FOOT = 0.5


@dataclass(frozen=True, eq=False)
class Building:
    """A building in the scene's frame.

    Parameters
    ----------
    polygon : footprint, m, valid
    foot, ground, eaves, ridge : heights of the lower end of the walls, the ground, the upper end of the walls and the
        top of the roof, m
    roof_shape, across : see `sarmitsuba.loading.importing.buildings.make_roof`
    wall, roof : names of materials
    storey : height of a storey, m
    """

    polygon: "shapely.Polygon"
    foot: float
    ground: float
    eaves: float
    ridge: float
    roof_shape: str
    across: bool
    wall: str
    roof: str
    storey: float


def wall_segments(polygon: "shapely.Polygon") -> F64:
    """Start and end of every wall, (n, 2, 2) float64, m, the outside to the right, holes included."""
    from shapely.geometry.polygon import orient

    turned = orient(polygon)
    rings = [np.asarray(ring.coords)[:, :2] for ring in (turned.exterior, *turned.interiors)]
    pairs = np.concatenate([np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings])
    return np.asarray(pairs[np.linalg.norm(pairs[:, 1] - pairs[:, 0], axis=1) > 0.0])


def add_building(parts: Parts, building: Building, number: int, facades: FacadeBuilder) -> Roof:
    """Add walls, underside and roof of a building, normals outwards, and return the roof.

    ``number`` of the building is for its relief.

    Notes
    -----
    Ignores details missing in OpenStreetMap: overhanging eaves, chimneys, courtyards under roofs.
    """
    from shapely.geometry.polygon import orient

    polygon = orient(building.polygon)
    walls = Walls(
        number,
        wall_segments(polygon),
        building.foot,
        building.ground,
        building.eaves,
        building.storey,
        building.wall,
    )
    facades.add_walls(parts, walls)
    roof = make_roof(polygon, building.roof_shape, building.across)
    z = building.eaves + (building.ridge - building.eaves) * roof.lift
    top = np.column_stack([roof.corners, z])
    parts.add("roofs", building.roof, top, roof.faces)
    parts.add("walls", building.wall, top, roof.gables)
    corners, faces = triangulate(polygon)
    under = np.column_stack([corners, np.full(len(corners), building.foot)])
    parts.add("walls", building.wall, under, faces[:, ::-1])
    return roof


# corners of outlines are extended at most by this factor of the pavement's width
_MITRE = 1.5
# corners closer than this are one, m
_SAME = 1e-3


def add_pavement(parts: Parts, buildings: Iterable[Building], options: FacadeOptions, material: str) -> int:
    """Add one level slab below buildings on the plane z = 0 that reaches out to a kerb; returns its triangles.

    Parameters
    ----------
    parts : collection to which it is added
    buildings : those raised above the ground by ``min_height`` have none
    options : height of the kerb and width of the pavement
    material : of the pavement

    Notes
    -----
    Walls pass through the slab, so that no gap is left at their feet. Ignores streets: the pavement is as wide on all
    sides, and neighbours nearer than twice its width share it.
    """
    import shapely

    outlines = [
        b.polygon.buffer(options.pavement, join_style="mitre", mitre_limit=_MITRE)
        for b in buildings
        if b.ground == 0.0
    ]
    made = shapely.get_parts(shapely.union_all(outlines, grid_size=_SAME))
    before = parts.n_triangles
    for slab in made:
        if why_unusable(slab):
            continue
        corners, faces = triangulate(slab)
        parts.add(
            "pavement", material, np.column_stack([corners, np.full(len(corners), options.kerb)]), faces
        )
        for start, end in wall_segments(slab):
            parts.add("pavement", material, *wall_quads(start, end, -FOOT, options.kerb))
    return parts.n_triangles - before
