"""An elevation raster alone: terrain without buildings."""

from pathlib import Path

from sarmitsuba.importing.import_options import ImportOptions
from sarmitsuba.importing.source_format import SOURCES, CitySource, SourceFormat


def read_terrain(path: Path, options: ImportOptions) -> CitySource:
    """Nothing but the terrain, which the conversion reads."""
    return CitySource(path.name, dem=path)


SOURCES.register(SourceFormat("raster", "terrain", (".tif", ".tiff"), read_terrain))

__all__ = ["read_terrain"]
