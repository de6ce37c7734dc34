"""Radar materials of mesh files from words in their names, such as `brick` or `window`."""

import re
from collections.abc import Mapping

from sarmitsuba.errors import SceneError
from sarmitsuba.materials.named_materials import MATERIALS
from sarmitsuba.parameters import did_you_mean, one_line

# material of the library: beginnings of words in a name, tested in this order
WORDS: dict[str, tuple[str, ...]] = {
    "metal": ("metal", "steel", "iron", "alumin", "copper", "zinc", "chrome", "rail"),
    "glass": ("glass", "window", "glazing", "pane"),
    "brick": ("brick", "clay", "roof", "tile", "shingle"),
    "wood": ("wood", "timber", "tree", "trunk", "bark"),
    "marble": ("marble", "stone", "granite", "limestone", "sandstone"),
    "asphalt_concrete": ("asphalt", "road", "street", "tarmac", "bitumen", "pavement", "paving"),
    "concrete": ("concrete", "cement", "wall", "facade", "building", "plaster", "stucco"),
    "medium_dry_ground": ("ground", "grass", "soil", "earth", "terrain", "lawn", "garden", "gravel", "dirt"),
}
# for unknown names, and for meshes without any
DEFAULT = "concrete"


def kind_of(name: str, chosen: Mapping[str, str]) -> str:
    """Material of the library for a name in a mesh file; empty for an unknown name.

    Parameters
    ----------
    name : as in the file; ``itu_concrete``, ``Brick.001`` or ``old stone wall``
    chosen : materials of the library by name, which come first
    """
    if name in chosen:
        return chosen[name]
    plain = re.sub(r"[.\d]+$", "", name).lower().removeprefix("mat-")
    plain = re.sub(r"^itu[_-]", "", plain).replace("-", "_").replace(" ", "_").strip("_")
    if plain in MATERIALS.names:
        return plain
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)  # StoneWall
    words = re.findall(r"[a-z]+", spaced.lower())
    for kind, starts in WORDS.items():
        if any(word.startswith(starts) for word in words):
            return kind
    return ""


def check_chosen(chosen: Mapping[str, str], names: set[str], where: str) -> None:
    """Raise a SceneError for a choice of a material that the file or the library does not have."""
    for name, kind in chosen.items():
        if name not in names:
            listed = ", ".join(sorted(names)) or "none"
            raise SceneError(
                f'{where}: no material "{one_line(name)}" in this file{did_you_mean(name, names)}; it has {listed}'
            )
        if kind not in MATERIALS.names:
            known = ", ".join(sorted(MATERIALS.names))
            raise SceneError(
                f'{where}: "{one_line(kind)}" is no known material{did_you_mean(kind, MATERIALS.names)}; known: {known}'
            )
