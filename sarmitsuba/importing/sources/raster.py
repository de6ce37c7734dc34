"""An elevation raster alone: terrain without buildings."""

from pathlib import Path

from sarmitsuba.importing.import_options import ImportOptions
from sarmitsuba.importing.source_format import SOURCES, Source, SourceFormat


def read_terrain(path: Path, options: ImportOptions) -> Source:
    """Nothing but the terrain, which the conversion reads."""
    return Source(path.name, dem=path)


SOURCES.register(SourceFormat("raster", "terrain", (".tif", ".tiff"), read_terrain))

__all__ = ["read_terrain"]
