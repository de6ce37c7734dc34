"""Content of a city source before placement in the scene, and the registry of source formats."""

import os
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.arrays import F64
from sarmitsuba.errors import SceneError
from sarmitsuba.importing.import_options import ImportOptions
from sarmitsuba.loader.mesh_files import MeshPart
from sarmitsuba.parameters import one_line
from sarmitsuba.registry import Registry

if TYPE_CHECKING:
    import shapely


@dataclass(frozen=True, eq=False)
class BuildingFootprint:
    """Footprint of a building with its attributes.

    Parameters
    ----------
    name : in the file
    polygon : in the coordinates of the file
    height, above : of its top and of its lower side over the ground, m
    roof : part of the height that the roof takes, m; nan: not said
    roof_shape, across : see `sarmitsuba.importing.roofs.make_roof`
    storey : height of a storey, m
    wall_material, roof_material : as the file names them, or empty
    is_part : of a building whose outline may stand in the file too
    """

    name: str
    polygon: "shapely.Polygon"
    height: float
    above: float = 0.0
    roof: float = np.nan
    roof_shape: str = ""
    across: bool = False
    storey: float = 3.0
    wall_material: str = ""
    roof_material: str = ""
    is_part: bool = False


@dataclass(frozen=True, eq=False)
class Solid:
    """A building as plane polygons in space.

    Parameters
    ----------
    name : in the file
    polygons : part (``walls``, ``roofs``) and rings (n, 3): coordinates of the file and height in m, exterior first
    """

    name: str
    polygons: tuple[tuple[str, tuple[F64, ...]], ...]


@dataclass(eq=False)
class CitySource:
    """Content of a file or folder.

    Parameters
    ----------
    name : of the file, start of every message
    crs : of footprints and solids
    footprints, solids : buildings
    meshes : parts in metres, upright, in the scene's frame
    skipped, assumed : how many were left out, or taken for something that the file does not say, by reason
    first : name of the first, by reason
    notes : what was assumed
    dem : the source is an elevation raster itself
    """

    name: str
    crs: str = ""
    footprints: list[BuildingFootprint] = field(default_factory=list)
    solids: list[Solid] = field(default_factory=list)
    meshes: list[MeshPart] = field(default_factory=list)
    skipped: Counter[str] = field(default_factory=Counter)
    assumed: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    first: dict[str, str] = field(default_factory=dict)
    dem: Path | None = None

    def skip(self, reason: str, name: str) -> None:
        """Count one that is left out."""
        self.skipped[reason] += 1
        self.first.setdefault(reason, one_line(name, 40))

    def assume(self, reason: str, name: str) -> None:
        """Count one of which something is assumed."""
        self.assumed[reason] += 1
        self.first.setdefault(reason, one_line(name, 40))

    def said(self) -> list[str]:
        """Lines about what was left out and assumed, and all notes."""
        lines = [
            f"{self.name}: {what} {count} {reason} (first: {self.first[reason]})"
            for what, counts in (("left out", self.skipped), ("assumed for", self.assumed))
            for reason, count in sorted(counts.items())
        ]
        return [*self.notes, *lines]


@dataclass(frozen=True)
class SourceFormat:
    """Format of a city source.

    Parameters
    ----------
    name : e.g. ``geojson``
    doc : description in one line
    suffixes : of its files, lower case, with the dot
    read : of a file, or of a folder where ``folders`` says so
    folders : a folder of such files is one city
    """

    name: str
    doc: str
    suffixes: tuple[str, ...]
    read: Callable[[Path, ImportOptions], CitySource]
    folders: bool = False


SOURCES: Registry[SourceFormat] = Registry("source of scenes", "sarmitsuba.importing.sources")


def find_source(path: Path) -> SourceFormat:
    """Format of a file or folder, by its suffix or by those in it.

    Raises
    ------
    SceneError : it is not there, or its suffix tells nothing
    """
    try:
        there, folder = os.path.exists(path), os.path.isdir(path)
        suffixes = {p.suffix.lower() for p in path.iterdir()} if folder else {path.suffix.lower()}
    except OSError as error:
        raise SceneError(
            f"{one_line(path.name)}: cannot be read: {error.strerror}; check the path"
        ) from error
    if not there:
        raise SceneError(f"{one_line(path)}: no such file or folder; check the path")
    for entry in SOURCES:
        if suffixes & set(entry.suffixes) and (entry.folders or not folder):
            return entry
    known = ", ".join(f"{entry.name} ({' '.join(entry.suffixes)})" for entry in SOURCES)
    what = "a folder without files of a known kind" if folder else f'of unknown suffix "{path.suffix}"'
    raise SceneError(f"{one_line(path.name)}: {what}; there are {known}")
