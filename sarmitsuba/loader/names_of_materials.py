"""Radar materials of mesh files from words in their names, such as `brick` or `window`."""

import re
import unicodedata
from collections.abc import Mapping

from sarmitsuba.errors import SceneError
from sarmitsuba.materials.named_materials import MATERIALS
from sarmitsuba.parameters import did_you_mean, one_line

# material of the library: beginnings of words in a name, whole words after "=", tested in this order; English, German
# and French, without accents
WORDS: dict[str, tuple[str, ...]] = {
    "metal": (
        *("metal", "steel", "iron", "alumin", "copper", "zinc", "chrome", "=rail", "=rails", "railing"),
        *("stahl", "eisen", "blech", "kupfer", "acier", "=fer", "=tole", "cuivre"),
    ),
    "car_paint": (
        *("carpaint", "=car", "=cars", "bodywork", "=auto", "autolack", "=lack", "karosserie"),
        *("carrosserie", "=voiture"),
    ),
    "glass": (
        "glas",
        "window",
        "glazing",
        "pane",
        "fenster",
        "scheibe",
        "=verre",
        "vitre",
        "vitrage",
        "fenetre",
    ),
    "tile": ("tile", "fliese", "tuile", "carrelage"),
    "brick": (
        *("brick", "clay", "roof", "shingle", "ziegel", "backstein", "klinker", "=dach", "dachziegel"),
        *("brique", "toit", "toiture"),
    ),
    "leaf": ("leaf", "leaves", "foliage", "=laub", "blatt", "blaetter", "feuille"),
    "wood": (
        *("wood", "timber", "tree", "trunk", "bark", "holz", "baum", "=stamm", "rinde"),
        *("=bois", "arbre", "=tronc", "ecorce"),
    ),
    "marble": (
        *("marble", "stone", "granit", "limestone", "sandstone", "marmor", "=stein", "naturstein"),
        *("marbre", "pierre"),
    ),
    "asphalt": (
        *(
            "asphalt",
            "road",
            "street",
            "tarmac",
            "bitum",
            "pavement",
            "paving",
            "strasse",
            "gehweg",
            "pflaster",
        ),
        *("=route", "=rue", "chaussee", "trottoir"),
    ),
    "concrete": (
        *(
            "concrete",
            "cement",
            "wall",
            "facade",
            "building",
            "plaster",
            "stucco",
            "beton",
            "zement",
            "=wand",
        ),
        *("mauer", "fassade", "=putz", "gebaeude", "ciment", "=mur", "=murs", "batiment", "platre"),
    ),
    "grass": ("grass", "lawn", "meadow", "=gras", "rasen", "wiese", "herbe", "pelouse", "gazon", "prairie"),
    "gravel": ("gravel", "=kies", "schotter", "gravier"),
    "snow": ("snow", "schnee", "neige"),
    "water": ("water", "wasser", "=eau", "=eaux"),
    "soil": (
        "soil",
        "earth",
        "dirt",
        "=boden",
        "erdboden",
        "=erde",
        "=acker",
        "ackerboden",
        "=terre",
        "=sol",
    ),
    "medium_dry_ground": ("ground", "terrain", "garden", "jardin", "gelaende"),
}
# material of the library: ends of compound words, read where no word begins as above: Schiffsstahl, Sperrholz, topsoil
ENDS: dict[str, tuple[str, ...]] = {
    "metal": ("stahl", "eisen", "blech", "steel"),
    "glass": ("glas", "scheibe", "fenster", "window", "glass"),
    "brick": ("ziegel", "brick", "dach", "roof"),
    "marble": ("stein", "stone"),
    "wood": ("holz", "wood", "timber"),
    "asphalt": ("strasse", "pflaster", "asphalt"),
    "concrete": ("beton", "putz", "mauer", "concrete"),
    "grass": ("rasen", "wiese", "grass"),
    "gravel": ("kies", "schotter", "gravel"),
    "snow": ("schnee", "snow"),
    "water": ("wasser", "water"),
    "soil": ("boden", "soil"),
}
# for unknown names, and for meshes without any
DEFAULT = "concrete"
# in place of a name, in choices: all names, and what has none
EVERY = "*"


def kind_of(name: str, chosen: Mapping[str, str]) -> str:
    """Material of the library for a name in a mesh file; empty for an unknown name.

    Parameters
    ----------
    name : as in the file; ``itu_concrete``, ``Brick.001`` or ``old stone wall``
    chosen : materials of the library by name, which come first; that of ``EVERY`` is of all names without their own
    """
    if name not in chosen and EVERY in chosen:
        name = EVERY
    if name in chosen:
        return chosen[name] if chosen[name] in MATERIALS.names else kind_of(chosen[name], {})
    plain = re.sub(r"[.\d]+$", "", name).lower().removeprefix("mat-")
    plain = re.sub(r"^itu[_-]", "", plain).replace("-", "_").replace(" ", "_").strip("_")
    if plain in MATERIALS.names:
        return plain
    bare = unicodedata.normalize("NFKD", name.replace("ß", "ss"))
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", "".join(c for c in bare if not unicodedata.combining(c)))
    words = re.findall(r"[a-z]+", spaced.lower())  # of StoneWall: stone, wall
    for kind, starts in WORDS.items():
        if any(w == s[1:] if s[0] == "=" else w.startswith(s) for w in words for s in starts):
            return kind
    return next((kind for kind, ends in ENDS.items() if any(w.endswith(ends) for w in words)), "")


def check_chosen(chosen: Mapping[str, str], names: set[str], where: str) -> None:
    """Raise a SceneError for a choice of a material that the file or the library does not have."""
    for name, kind in chosen.items():
        if name not in names and name != EVERY:
            listed = ", ".join(sorted(names)) or "none"
            raise SceneError(
                f'{where}: no material "{one_line(name)}" in this file{did_you_mean(name, names)}; it has {listed}'
            )
        if kind not in MATERIALS.names and not kind_of(kind, {}):
            known = ", ".join(sorted(MATERIALS.names))
            raise SceneError(
                f'{where}: "{one_line(kind)}" is no known material{did_you_mean(kind, MATERIALS.names)}; known: {known}'
            )
