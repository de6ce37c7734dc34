"""CityGML 1 to 3: buildings as plane polygons, in the finest level of detail up to 3."""

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.loading.importing.import_options import ImportOptions
from sarmitsuba.loading.importing.places import WGS84, crs_named
from sarmitsuba.loading.importing.polygons import require_shapely
from sarmitsuba.loading.importing.reading import read_xml
from sarmitsuba.loading.importing.source_format import SOURCES, CitySource, Solid, SourceFormat

_PARTS = {"RoofSurface": "roofs", "OuterFloorSurface": "roofs", "Window": "windows", "Door": "windows"}
_SURFACES = ("WallSurface", "GroundSurface", "ClosureSurface", "OuterCeilingSurface", *_PARTS)
_INSIDE = (
    "InteriorWallSurface",
    "CeilingSurface",
    "FloorSurface",
    "Room",
    "BuildingRoom",
    "BuildingFurniture",
)
_LEVEL = re.compile(r"lod(\d)")
# m or deg; largest valid coordinate or height
_FARTHEST = np.array([1e8, 1e8, 1.2e4])
# surfaces steeper than 72 degrees are walls
_ROOF = 0.3


@dataclass(frozen=True)
class _FoundPolygon:
    """Polygon with its level of detail and the type of its surface."""

    level: int
    surface: str
    element: ET.Element


def read_citygml(path: Path, options: ImportOptions) -> CitySource:
    """Read every building with its polygons.

    Raises
    ------
    SceneError : the file is no CityGML, or neither the file nor the options name a coordinate system
    """
    require_shapely(path.name)
    root = read_xml(path)
    if _local(root) != "CityModel":
        raise SceneError(f"{path.name}: its root is <{_local(root)[:40]}>, not <CityModel>; is it CityGML?")
    names = [value for e in root.iter() if (value := e.get("srsName"))]
    crs = crs_named(names[0]) if names else ""
    if not (crs or options.crs):
        raise SceneError(
            f"{path.name}: names no coordinate system (srsName); give --crs EPSG:n, or --crs local"
        )
    source = CitySource(path.name, crs=crs)
    # names in urn form: latitude first, RFC 5165
    swapped = bool(names) and crs == WGS84 and "CRS84" not in names[0].upper()
    for number, building in enumerate(e for e in root.iter() if _local(e) == "Building"):
        name = next((v for k, v in building.attrib.items() if k.endswith("}id")), f"building {number}")
        found = [f for f in _polygons(building, 0, "") if f.level <= 3]
        finest = max((f.level for f in found), default=0)
        polygons: list[tuple[str, tuple[F64, ...]]] = []
        for one in found:
            if one.level != finest:
                continue
            try:
                rings = tuple(_rings(one.element, swapped))
                if not rings:
                    raise ValueError
            except ValueError:
                source.skip("polygons without a valid ring of three corners", name)
                continue
            polygons.append((_part(one.surface, rings[0]), rings))
        if polygons:
            source.solids.append(Solid(name, tuple(polygons)))
        else:
            source.skip("buildings without polygons", name)
    return source


def _local(element: ET.Element) -> str:
    return str(element.tag).rpartition("}")[2]


def _polygons(element: ET.Element, level: int, surface: str) -> Iterator[_FoundPolygon]:
    """Polygons below an element, without those of rooms; by a stack, since the depth of nesting is unbounded."""
    todo = [(element, level, surface)]
    while todo:
        here, level, surface = todo.pop()
        name = _local(here)
        if name in _INSIDE:
            continue
        found = _LEVEL.match(name)
        level = int(found[1]) if found else level
        surface = name if name in _SURFACES else surface
        if name == "Polygon":
            yield _FoundPolygon(level, surface, here)
        else:
            todo += [(child, level, surface) for child in reversed(here)]


def _outermost(element: ET.Element, name: str) -> Iterator[ET.Element]:
    """Elements of a name below one, in order; those nested in another one are omitted."""
    todo = [element]
    while todo:
        here = todo.pop()
        if _local(here) == name:
            yield here
        else:
            todo += reversed(here)


def _rings(polygon: ET.Element, swapped: bool) -> Iterator[F64]:
    """Rings, exterior first, without the repeated last corner."""
    for ring in _outermost(polygon, "LinearRing"):
        text = " ".join(e.text or "" for e in ring.iter() if _local(e) in ("posList", "pos"))
        corners = np.array(text.split(), dtype=np.float64).reshape(-1, 3)
        if len(corners) < 4 or not (np.abs(corners) <= _FARTHEST).all():
            raise ValueError
        yield corners[:-1, [1, 0, 2]] if swapped else corners[:-1]


def _part(surface: str, exterior: F64) -> str:
    """Part of the scene by the type of the surface, else by its slope."""
    if surface:
        return _PARTS.get(surface, "walls")
    corners = exterior - exterior[0]  # avoids cancellation far from the origin
    normal = np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)
    return "roofs" if normal[2] > _ROOF * float(np.linalg.norm(normal)) else "walls"


SOURCES.register(SourceFormat("citygml", "buildings as polygons, LoD 1 to 3", (".gml", ".xml"), read_citygml))
