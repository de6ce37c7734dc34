"""Outline of an image on the Earth as GeoJSON and KML; see docs/files.md."""

import json
import xml.etree.ElementTree as ET
from pathlib import Path

from sarmitsuba.core.parameters import printable
from sarmitsuba.files.formats import FORMATS, FileFormat
from sarmitsuba.files.geocoding import outlines, warn_unplaced
from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.signal.image import SarImage

_KML = "http://www.opengis.net/kml/2.2"


def write_geojson(path: Path, image: SarImage) -> None:
    """Write the outline as a GeoJSON feature (RFC 7946: longitude, latitude in degrees, height in m).

    A polygon, or several where it crosses the antimeridian.
    """
    warn_unplaced(image.anchor)
    rings = [[ring.tolist()] for ring in outlines(image.grid)]
    one = len(rings) == 1
    feature = {
        "type": "Feature",
        "geometry": {
            "type": "Polygon" if one else "MultiPolygon",
            "coordinates": rings[0] if one else rings,
        },
        "properties": {
            "name": printable(str(image.metadata.get("scene", path.stem))),
            "channels": list(image.channels),
            "wavelength_m": image.wavelength,
        },
    }
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(feature, indent=1) + "\n", encoding="utf-8")


def write_kml(path: Path, image: SarImage) -> None:
    """Write the outline as a KML polygon on the ground, or as several where it crosses the antimeridian."""
    warn_unplaced(image.anchor)
    ET.register_namespace("", _KML)
    root = ET.Element(f"{{{_KML}}}kml")
    mark = ET.SubElement(root, f"{{{_KML}}}Placemark")
    ET.SubElement(mark, f"{{{_KML}}}name").text = printable(str(image.metadata.get("scene", path.stem)))
    rings = outlines(image.grid)
    parent = mark if len(rings) == 1 else ET.SubElement(mark, f"{{{_KML}}}MultiGeometry")
    for ring in rings:
        element = parent
        for name in ("Polygon", "outerBoundaryIs", "LinearRing"):
            element = ET.SubElement(element, f"{{{_KML}}}{name}")
        text = " ".join(f"{east:.9f},{north:.9f},{height:.3f}" for east, north, height in ring)
        ET.SubElement(element, f"{{{_KML}}}coordinates").text = text
    with atomic_path(path) as temporary:
        ET.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


FORMATS.register(
    FileFormat(
        name="geojson",
        doc="outline of the image on the Earth, GeoJSON",
        suffixes=(".geojson",),
        write_image=write_geojson,
    )
)
FORMATS.register(
    FileFormat(
        name="kml", doc="outline of the image on the Earth, KML", suffixes=(".kml",), write_image=write_kml
    )
)
