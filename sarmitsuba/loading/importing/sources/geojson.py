"""GeoJSON (RFC 7946): footprints of buildings with heights, as published by OpenStreetMap and cities."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from sarmitsuba.core.errors import SceneError
from sarmitsuba.loading.importing.city_model import footprint, is_building
from sarmitsuba.loading.importing.import_options import ImportOptions
from sarmitsuba.loading.importing.places import WGS84, crs_named
from sarmitsuba.loading.importing.polygons import MOST_CORNERS, require_shapely
from sarmitsuba.loading.importing.reading import read_json
from sarmitsuba.loading.importing.source_format import SOURCES, CitySource, SourceFormat

if TYPE_CHECKING:
    import shapely


def read_geojson(path: Path, options: ImportOptions) -> CitySource:
    """Read every polygon with the tags of a building; every polygon if none has such tags.

    Raises
    ------
    SceneError : the file is no GeoJSON
    """
    require_shapely(path.name)
    content = read_json(path)
    if not isinstance(content, Mapping) or content.get("type") not in (
        "FeatureCollection",
        "Feature",
        *_SHAPES,
    ):
        raise SceneError(f"{path.name}: is no GeoJSON: it has no features; export it as a FeatureCollection")
    source = CitySource(path.name, crs=_crs(content))
    features = list(_features(content))
    tagged = any(is_building(tags) or "height" in tags for _, tags, _ in features)
    for name, tags, geometry in features:
        if tagged and not is_building(tags) and "height" not in tags:
            source.skip("features other than buildings", name)
            continue
        polygons = list(_polygons(geometry))
        if not polygons:
            source.skip("features without an area", name)
        for polygon in polygons:
            if isinstance(polygon, str):
                source.skip(polygon, name)
                continue
            made = footprint(source, name, polygon, tags, options)
            if made is not None:
                source.footprints.append(made)
    return source


_SHAPES = ("Polygon", "MultiPolygon", "GeometryCollection")


def _crs(content: Mapping[str, object]) -> str:
    """Coordinate system from the member ``crs`` (removed in RFC 7946), else longitude and latitude."""
    crs = content.get("crs")
    properties = crs.get("properties") if isinstance(crs, Mapping) else None
    name = properties.get("name") if isinstance(properties, Mapping) else None
    return crs_named(name) if isinstance(name, str) else WGS84


def _features(content: Mapping[str, object]) -> Iterator[tuple[str, Mapping[str, object], object]]:
    """Name, tags and geometry of each feature."""
    rows = content.get("features") if content["type"] == "FeatureCollection" else [content]
    for number, row in enumerate(rows if isinstance(rows, list) else []):
        if not isinstance(row, Mapping):
            yield f"feature {number}", {}, None
            continue
        given = row.get("properties")
        tags = dict(given) if isinstance(given, Mapping) else {}
        inner = tags.get("tags")  # overpass and osmtogeojson nest OpenStreetMap's tags here
        if isinstance(inner, Mapping):
            tags = {**tags, **inner}
        name = row.get("id", tags.get("@id", tags.get("id", f"feature {number}")))
        yield str(name), tags, row.get("geometry") if row.get("type") == "Feature" else row


def _polygons(geometry: object) -> "Iterator[shapely.Polygon | str]":
    """Polygons of a geometry, and for invalid ones the reasons."""
    import shapely

    if not isinstance(geometry, Mapping):
        return
    kind, rows = geometry.get("type"), geometry.get("coordinates")
    if kind == "GeometryCollection":
        members = geometry.get("geometries")
        for member in members if isinstance(members, list) else []:
            if isinstance(member, Mapping) and member.get("type") != "GeometryCollection":
                yield from _polygons(member)
        return
    if kind not in ("Polygon", "MultiPolygon") or not isinstance(rows, list):
        return
    for rings in [rows] if kind == "Polygon" else rows:
        try:
            if sum(map(len, rings)) > MOST_CORNERS:
                yield f"outlines of more than {MOST_CORNERS} corners"
                continue
            shell, *holes = [[(float(x), float(y)) for x, y, *_ in ring] for ring in rings]
            yield shapely.Polygon(shell, holes)
        except (ValueError, TypeError, OverflowError, shapely.errors.ShapelyError):
            yield "outlines without a ring of at least three corners"


SOURCES.register(SourceFormat("geojson", "footprints with heights", (".geojson", ".json"), read_geojson))
