"""Elevation raster without buildings."""

from pathlib import Path

from sarmitsuba.loading.importing.import_options import ImportOptions
from sarmitsuba.loading.importing.source_format import SOURCES, CitySource, SourceFormat


def read_terrain(path: Path, options: ImportOptions) -> CitySource:
    """Empty source with a reference to the raster, which the conversion reads."""
    return CitySource(path.name, dem=path)


SOURCES.register(SourceFormat("raster", "terrain", (".tif", ".tiff"), read_terrain))
