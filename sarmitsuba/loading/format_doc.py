"""Generated tables of the documentation pages on scene files and effects, from the program's parameter tables."""

import re

from sarmitsuba.effects.effect import effects
from sarmitsuba.loading.shapes import SHAPE_PARAMETERS
from sarmitsuba.loading.tables import plugin_tables
from sarmitsuba.radar.mode import MODES
from sarmitsuba.scene.materials.bsdfs import ADAPTER_BSDFS, ORDINARY_BSDFS
from sarmitsuba.scene.materials.diffuse_law import LAWS
from sarmitsuba.scene.materials.named.itu_p2040 import ITU_BANDS

_BLOCK = re.compile(r"(<!-- table: (?P<name>[\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def fill_tables(page: str) -> str:
    """Return a page with the text between ``<!-- table: NAME -->`` and ``<!-- end -->`` generated again.

    NAME is a plugin, ``effects``, ``laws``, ``modes``, ``itu``, ``bsdfs`` or ``shapes``. To update pages::

        python -m sarmitsuba.loading.format_doc docs/scene_format.md docs/effects.md
    """
    return _BLOCK.sub(lambda match: f"{match[1]}{_table(match['name'])}\n{match[3]}", page)


def _table(name: str) -> str:
    plugins = plugin_tables()
    if name in plugins:
        table = plugins[name]
        return f"{table.doc}\n\n{table.markdown()}" if table.rows else table.doc
    tables = {
        "effects": _effects,
        "laws": _laws,
        "modes": _modes,
        "itu": _itu,
        "bsdfs": _bsdfs,
        "shapes": _shapes,
    }
    return tables[name]()


def _modes() -> str:
    rows = ["| mode | beam | parameters of its own |", "|---|---|---|"]
    for mode in sorted(MODES, key=lambda mode: mode.name):
        rows.append(f"| `{mode.name}` | {mode.doc} | {', '.join(f'`{p.name}`' for p in mode.parameters)} |")
    return "\n".join(rows)


def _effects() -> str:
    rows = ["| effect | off when | off means |", "|---|---|---|"]
    rows += [f"| `{effect.name}` | {effect.off_when} | {effect.off_means} |" for effect in effects()]
    return "\n".join(rows)


def _laws() -> str:
    rows = ["| diffuse_law | return | diffuse_level_db is | needs |", "|---|---|---|---|"]
    for law in sorted(LAWS, key=lambda law: law.name):
        needs = ", ".join(f"`{name}`" for name in (*law.needs, *(p.name for p in law.parameters)))
        rows.append(f"| `{law.name}` | {law.title} | {law.level or 'not taken'} | {needs} |")
    return "\n".join(rows)


def _itu() -> str:
    rows = ["| material | from GHz | to GHz | a | b | c | d |", "|---|---|---|---|---|---|---|"]
    for name, bands in ITU_BANDS.items():
        rows += [f"| {name} | " + " | ".join(f"{value:g}" for value in band) + " |" for band in bands]
    return "\n".join(rows)


def _bsdfs() -> str:
    rows = ["| BSDF | read as |", "|---|---|"]
    rows += [
        f"| `{name}` | {words}{', with its typical surface' if surface == kind else ''} |"
        for name, (kind, surface, words) in ORDINARY_BSDFS.items()
    ]
    rows += [f"| `{name}` | {words} |" for name, words in ADAPTER_BSDFS.items()]
    return "\n".join(rows)


def _shapes() -> str:
    rows = ["| shape | parameters |", "|---|---|"]
    rows += [
        f"| `{name}` | {', '.join(f'`{p}`' for p in parameters) or 'shapes nested in it'} |"
        for name, parameters in SHAPE_PARAMETERS.items()
    ]
    return "\n".join(rows)


if __name__ == "__main__":
    import sys
    from pathlib import Path

    for file in map(Path, sys.argv[1:]):
        file.write_text(fill_tables(file.read_text(encoding="utf-8")), encoding="utf-8")
