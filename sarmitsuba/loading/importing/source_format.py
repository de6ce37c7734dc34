"""Content of a city source before placement in the scene, and the registry of source formats."""

import os
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.core.registry import Registry
from sarmitsuba.loading.importing.import_options import ImportOptions
from sarmitsuba.loading.mesh_files import MeshPart
from sarmitsuba.machine.regular_files import describe_missing

if TYPE_CHECKING:
    import shapely


@dataclass(frozen=True, eq=False)
class BuildingFootprint:
    """Footprint of a building with its attributes.

    Parameters
    ----------
    name : in the file
    polygon : in the coordinates of the file
    height, above : heights of its top and of its lower side over the ground, m
    roof : height of the roof, part of ``height``, m; nan: not stated
    lacks_roof : whether ``height``, from storeys, ends at the eaves, because no height of the roof is stated
    roof_shape, across : see `sarmitsuba.loading.importing.buildings.make_roof`
    storey : height of a storey, m
    wall_material, roof_material : names in the file, or empty
    is_part : whether it is part of a building, whose outline may be in the file too
    """

    name: str
    polygon: "shapely.Polygon"
    height: float
    above: float = 0.0
    roof: float = np.nan
    lacks_roof: bool = False
    roof_shape: str = ""
    across: bool = False
    storey: float = 3.0
    wall_material: str = ""
    roof_material: str = ""
    is_part: bool = False


@dataclass(frozen=True, eq=False)
class Solid:
    """Building given by plane polygons in space.

    Parameters
    ----------
    name : in the file
    polygons : part (``walls``, ``roofs``) and rings (n, 3): coordinates of the file and height in m, exterior first
    """

    name: str
    polygons: tuple[tuple[str, tuple[F64, ...]], ...]


@dataclass(eq=False)
class CitySource:
    """Content of a file or folder with a city.

    Parameters
    ----------
    name : of the file, start of every message
    crs : coordinate system of footprints and solids
    footprints, solids : buildings
    meshes : parts in metres, z up, in the scene's frame
    skipped, assumed : numbers of objects omitted, or completed by an assumption, by reason
    first : name of the first such object, by reason
    notes : lines on assumptions
    dem : whether the source is itself an elevation raster
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
        """Count an omitted object."""
        self.skipped[reason] += 1
        self.first.setdefault(reason, one_line(name, 40))

    def assume(self, reason: str, name: str) -> None:
        """Count an object completed by an assumption."""
        self.assumed[reason] += 1
        self.first.setdefault(reason, one_line(name, 40))

    def said(self) -> list[str]:
        """Lines on omitted objects and assumptions, and all notes."""
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
    read : reads a file, or a folder if ``folders``
    folders : whether a folder of such files is one city
    """

    name: str
    doc: str
    suffixes: tuple[str, ...]
    read: Callable[[Path, ImportOptions], CitySource]
    folders: bool = False


SOURCES: Registry[SourceFormat] = Registry(
    "source of scenes", SourceFormat, "sarmitsuba.loading.importing.sources"
)


def find_source(path: Path) -> SourceFormat:
    """Format of a file by its suffix, or of a folder by the suffixes in it.

    Raises
    ------
    SceneError : it does not exist, or its suffix is unknown
    """
    try:
        there, folder = os.path.exists(path), os.path.isdir(path)
        suffixes = {p.suffix.lower() for p in path.iterdir()} if folder else {path.suffix.lower()}
    except OSError as error:
        raise SceneError(
            f"{one_line(path.name)}: cannot be read: {error.strerror}; check the path"
        ) from error
    if not there:
        raise SceneError(f"{one_line(path)}: {describe_missing(path)}; check the path")
    for entry in SOURCES:
        if suffixes & set(entry.suffixes) and (entry.folders or not folder):
            return entry
    known = ", ".join(f"{entry.name} ({' '.join(entry.suffixes)})" for entry in SOURCES)
    what = "folder without files of a known format" if folder else f'unknown suffix "{path.suffix}"'
    array = "; an array of heights becomes a raster by rasterio" if path.suffix in (".npy", ".npz") else ""
    raise SceneError(f"{one_line(path.name)}: {what}; known formats: {known}{array}")
