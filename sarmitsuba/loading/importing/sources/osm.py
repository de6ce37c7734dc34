"""OpenStreetMap XML: closed ways and multipolygons of buildings."""

import xml.etree.ElementTree as ET
from pathlib import Path

from sarmitsuba.core.errors import SceneError
from sarmitsuba.loading.importing.city_model import footprint, is_building
from sarmitsuba.loading.importing.import_options import ImportOptions
from sarmitsuba.loading.importing.places import WGS84
from sarmitsuba.loading.importing.polygons import require_shapely
from sarmitsuba.loading.importing.reading import read_xml
from sarmitsuba.loading.importing.source_format import SOURCES, CitySource, SourceFormat


def read_osm(path: Path, options: ImportOptions) -> CitySource:
    """Read every building of an extract.

    Raises
    ------
    SceneError : the file is no OpenStreetMap XML
    """
    require_shapely(path.name)
    import shapely

    root = read_xml(path)
    if root.tag != "osm":
        raise SceneError(
            f"{path.name}: its root is <{root.tag[:40]}>, not <osm>; export it from OpenStreetMap"
        )
    nodes = {node.get("id", ""): node for node in root.iter("node")}
    ways = {way.get("id", ""): [nd.get("ref", "") for nd in way.iter("nd")] for way in root.iter("way")}
    source = CitySource(path.name, crs=WGS84)
    for element in (*root.iter("way"), *root.iter("relation")):
        tags: dict[str, object] = {tag.get("k", ""): tag.get("v", "") for tag in element.iter("tag")}
        name = f"{element.tag}/{element.get('id', '')}"
        if not is_building(tags):
            continue
        if element.tag == "way":
            rings, holes = [ways[element.get("id", "")]], []
        elif tags.get("type") == "multipolygon":
            rings, holes = (_join_ways(_members(element, role, ways)) for role in ("outer", "inner"))
        else:
            continue  # a relation of type building groups outlines that are in the file themselves
        try:
            shells = [
                shapely.Polygon([_place(nodes[ref]) for ref in ring]) for ring in rings if ring[0] == ring[-1]
            ]
            inner = [
                shapely.Polygon([_place(nodes[ref]) for ref in ring]) for ring in holes if ring[0] == ring[-1]
            ]
        except (KeyError, ValueError, IndexError, shapely.errors.ShapelyError):
            source.skip("buildings with missing or malformed corners", name)
            continue
        if len(shells) < len(rings) or not shells:
            source.skip("outlines that do not close", name)
        for shell in shells:
            own = [hole.exterior for hole in inner if shell.contains(hole.representative_point())]
            polygon = shapely.Polygon(shell.exterior, own)
            made = footprint(source, name, polygon, tags, options)
            if made is not None:
                source.footprints.append(made)
    return source


def _place(node: ET.Element) -> tuple[float, float]:
    """Longitude and latitude, deg; raises KeyError or ValueError where missing or malformed."""
    longitude, latitude = float(node.attrib["lon"]), float(node.attrib["lat"])
    if not (abs(longitude) <= 360.0 and abs(latitude) <= 90.0):
        raise ValueError
    return longitude, latitude


def _members(relation: ET.Element, role: str, ways: dict[str, list[str]]) -> list[list[str]]:
    """Nodes of the ways with a role; an empty role counts as outer."""
    refs = [m.get("ref", "") for m in relation.iter("member") if (m.get("role") or "outer") == role]
    return [list(ways[ref]) for ref in refs if ways.get(ref)]


def _join_ways(ways: list[list[str]]) -> list[list[str]]:
    """Rings joined from ways with common ends; the last node of a ring repeats the first."""
    done, open_ends = [], [way for way in ways]
    while open_ends:
        ring = open_ends.pop()
        while ring[0] != ring[-1]:
            pick = next((way for way in open_ends if ring[-1] in (way[0], way[-1])), None)
            if pick is None:
                break
            open_ends.remove(pick)
            ring += pick[1:] if pick[0] == ring[-1] else pick[-2::-1]
        done.append(ring)
    return done


SOURCES.register(SourceFormat("osm", "OpenStreetMap extract", (".osm",), read_osm))
