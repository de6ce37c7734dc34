"""Radar materials by name: exact names, others for the same, and guesses from words such as `brick` or `window`."""

import re
import unicodedata
from collections.abc import Mapping

from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import did_you_mean, one_line
from sarmitsuba.scene.materials.named_materials import MATERIALS

# other names of materials of the library, in English, German and French, without accents, blanks and underscores
ALIASES: dict[str, tuple[str, ...]] = {
    "pec": ("perfectconductor", "perfectelectricconductor", "idealconductor"),
    "metal": (
        *(
            "steel",
            "iron",
            "aluminium",
            "aluminum",
            "copper",
            "zinc",
            "metall",
            "stahl",
            "eisen",
            "kupfer",
            "zink",
        ),
        *("metaux", "acier", "fer", "cuivre", "sheetmetal", "blech", "tole"),
    ),
    "car_paint": ("carbody", "autolack"),
    "glass": ("glas", "verre"),
    "tile": ("tiles", "rooftile", "rooftiles", "tuile", "tuiles"),
    "brick": ("bricks", "ziegel", "backstein", "klinker", "brique", "briques"),
    "concrete": ("beton",),
    "wood": ("timber", "holz", "bois"),
    "plywood": ("sperrholz",),
    "chipboard": ("spanplatte",),
    "plasterboard": ("gypsumboard", "drywall", "gipskarton"),
    "marble": ("marmor", "marbre"),
    "asphalt": ("tarmac", "asphalte"),
    "grass": ("lawn", "gras", "rasen", "herbe", "pelouse", "gazon"),
    "gravel": ("kies", "schotter", "gravier"),
    "soil": ("earth", "erde", "erdboden", "terre"),
    "leaf": ("leaves", "foliage", "laub", "feuillage"),
    "snow": ("drysnow", "schnee", "neige"),
    "water": ("wasser", "eau"),
    "sea_water": ("saltwater", "meerwasser", "salzwasser", "eaudemer"),
    "fresh_water": ("suesswasser", "susswasser", "eaudouce"),
    "plastic": ("plastics", "kunststoff", "plastique"),
}
# words of names that say nothing of the material
_NEUTRAL = frozenset(
    "a an the of and my mat material mesh part surface texture old new red green blue white black grey gray brown "
    "yellow dark light front back left right north south east west inner outer upper lower top bottom main side small "
    "large big long high low simple default shader slot house".split()
)
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


def exact_kind(name: str) -> str:
    """Material of the library of that name or of another name for the same; empty for any other name.

    Case, accents, blanks, hyphens and underscores do not count, nor a number at the end, or ``mat-`` and ``itu_`` at
    the start.

    Parameters
    ----------
    name : such as ``Sea Water``, ``mat-itu_concrete`` or ``Brick.003``
    """
    if name in MATERIALS.names:
        return name
    plain = re.sub(r"[.\d\s_-]+$", "", _remove_accents(name)).lower().removeprefix("mat-")
    bare = re.sub(r"[\s_-]", "", re.sub(r"^itu[_-]", "", plain))
    if found := next((kind for kind in MATERIALS.names if kind.lower().replace("_", "") == bare), ""):
        return found
    return next((kind for kind, names in ALIASES.items() if bare in names), "")


def kind_of(name: str, chosen: Mapping[str, str]) -> str:
    """Material of the library for a name in a mesh file: exact, else guessed from its words; empty for an unknown name.

    Parameters
    ----------
    name : as in the file; ``itu_concrete``, ``Brick.001`` or ``old stone wall``
    chosen : materials of the library by name, which come first; that of ``EVERY`` is of all other names
    """
    if name not in chosen and EVERY in chosen:
        name = EVERY
    if name in chosen:
        return exact_kind(chosen[name])
    if exact := exact_kind(name):
        return exact
    words = _words(name)
    for kind, starts in WORDS.items():
        if any(_begins(word, start) for word in words for start in starts):
            return kind
    return next((kind for kind, ends in ENDS.items() if any(w.endswith(ends) for w in words)), "")


def is_doubtful(name: str, chosen: Mapping[str, str]) -> bool:
    """Whether a guess of `kind_of` leaves words out that may change the material: ``wet_snow``, ``my wall paint``."""
    if name in chosen or EVERY in chosen or exact_kind(name):
        return False
    starts = [start for each in WORDS.values() for start in each]
    ends = tuple(end for each in ENDS.values() for end in each)
    return not all(
        word in _NEUTRAL or word.endswith(ends) or any(_begins(word, start) for start in starts)
        for word in _words(name)
        if len(word) > 1
    )


def _begins(word: str, start: str) -> bool:
    """Whether a word begins as an entry of ``WORDS`` says."""
    return word == start[1:] if start[0] == "=" else word.startswith(start)


def _words(name: str) -> list[str]:
    """Words of a name, lower case: of ``StoneWall`` stone and wall."""
    return re.findall(r"[a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", _remove_accents(name)).lower())


def _remove_accents(name: str) -> str:
    bare = unicodedata.normalize("NFKD", name.replace("ß", "ss"))
    return "".join(c for c in bare if not unicodedata.combining(c))


def check_chosen(chosen: Mapping[str, str], names: set[str], where: str) -> None:
    """Raise a SceneError for a choice of a material that the file or the library does not have."""
    for name, kind in chosen.items():
        if name not in names and name != EVERY:
            listed = ", ".join(sorted(names)) or "none"
            raise SceneError(
                f'{where}: no material "{one_line(name)}" in this file{did_you_mean(name, names)}; it has {listed}'
            )
        if not exact_kind(kind):
            known = ", ".join(sorted(MATERIALS.names))
            raise SceneError(
                f'{where}: "{one_line(kind)}" is no known material{did_you_mean(kind, MATERIALS.names)}; known: {known}'
            )
