"""Attributes of buildings from OpenStreetMap tags and equivalent properties of other maps."""

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.loading.importing.import_options import ImportOptions
from sarmitsuba.loading.importing.source_format import BuildingFootprint, CitySource

if TYPE_CHECKING:
    import shapely

Tags = Mapping[str, object]

_NUMBER = re.compile(r"\s*([-+]?\d+(?:[.,]\d+)?)\s*(m|ft|'|)\s*", re.IGNORECASE)
_FOOT = 0.3048
# the tallest building has 828 m and 163 storeys
_TALLEST, _MOST_LEVELS = 1200.0, 300.0
_HEIGHTS = ("height", "building:height", "HEIGHT", "Height", "measuredHeight", "building_height")
_LEVELS = ("building:levels", "levels", "num_floors", "storeys")


def is_building(tags: Tags) -> bool:
    """Whether the tags are those of a building, or of a part of a building, above the ground."""
    kind = str(tags.get("building") or tags.get("building:part") or "no")
    return kind != "no" and tags.get("location") != "underground"


def metres(value: object) -> float:
    """Length in metres from ``12``, ``12 m``, ``12,5`` or ``40'``; nan if malformed."""
    if isinstance(value, bool):
        return np.nan
    if isinstance(value, int | float):
        return float(value) if abs(value) < 1e6 else np.nan
    found = _NUMBER.fullmatch(str(value)[:40])
    if not found:
        return np.nan
    return float(found[1].replace(",", ".")) * (_FOOT if found[2].lower() in ("ft", "'") else 1.0)


def footprint(
    source: CitySource, name: str, polygon: "shapely.Polygon", tags: Tags, options: ImportOptions
) -> BuildingFootprint | None:
    """Footprint of a building with the attributes in its tags; None, counted as skipped, if its heights contradict.

    A ``height`` extends from the ground to the top of the roof; ``building:levels`` exclude those of the roof.
    """
    storey = options.storey
    levels = _positive(source, name, tags, _LEVELS, _MOST_LEVELS, "storeys")
    roof = _positive(source, name, tags, ("roof:height",), _TALLEST, "roof heights")
    roof_levels = metres(tags.get("roof:levels"))
    if np.isnan(roof) and roof_levels > 0.0:
        roof = roof_levels * storey
    height = _positive(source, name, tags, _HEIGHTS, _TALLEST, "heights")
    if np.isnan(height) and levels > 0.0:
        height = levels * storey + (roof if roof > 0.0 else 0.0)
    elif np.isnan(height):
        height = options.height
        source.assume(f"buildings without a height, {height:g} m taken", name)
    elif levels > 0.0:
        storey = float(np.clip(height / levels, 2.0, 6.0))
    above = metres(tags.get("min_height", tags.get("building:min_height")))
    if np.isnan(above):
        above = metres(tags.get("building:min_level")) * storey
    above = 0.0 if np.isnan(above) else above
    if not 0.0 <= above < height:
        source.skip("buildings whose min_height is not below their height", name)
        return None
    return BuildingFootprint(
        name,
        polygon,
        height,
        above,
        roof=roof,
        roof_shape=str(tags.get("roof:shape", "")),
        across=tags.get("roof:orientation") == "across",
        storey=storey,
        wall_material=str(tags.get("building:material", tags.get("building:facade:material", ""))),
        roof_material=str(tags.get("roof:material", "")),
        is_part="building:part" in tags,
    )


def _positive(
    source: CitySource, name: str, tags: Tags, keys: tuple[str, ...], most: float, what: str
) -> float:
    """Value of the first tag present; nan if none is, or (counted) if it is no number above 0."""
    value = next((tags[key] for key in keys if tags.get(key) not in (None, "")), None)
    if value is None:
        return np.nan
    number = metres(value)
    if not 0.0 < number <= most:
        if number != 0.0:
            source.assume(f"{what} that are no number from 0 to {most:g}, ignored", name)
        return np.nan
    return number
