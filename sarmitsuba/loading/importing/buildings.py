"""Buildings as closed solids: an extruded footprint with a roof and facade relief."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.loading.importing.facades import FacadeBuilder
from sarmitsuba.loading.importing.parts import Parts
from sarmitsuba.loading.importing.polygons import triangulate
from sarmitsuba.loading.importing.roofs import Roof, make_roof

if TYPE_CHECKING:
    import shapely


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
    roof_shape, across : see `sarmitsuba.loading.importing.roofs.make_roof`
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
    segments = wall_segments(polygon)
    facades.add_walls(
        parts,
        number,
        segments,
        building.foot,
        building.ground,
        building.eaves,
        building.storey,
        building.wall,
    )
    roof = make_roof(polygon, building.roof_shape, building.across)
    z = building.eaves + (building.ridge - building.eaves) * roof.lift
    top = np.column_stack([roof.corners, z])
    parts.add("roofs", building.roof, top, roof.faces)
    parts.add("walls", building.wall, top, roof.gables)
    corners, faces = triangulate(polygon)
    under = np.column_stack([corners, np.full(len(corners), building.foot)])
    parts.add("walls", building.wall, under, faces[:, ::-1])
    return roof
