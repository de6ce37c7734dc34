"""Tables of the scene format page, generated from the tables that validate the files."""

import re

from sarmitsuba.loader.shapes import SHAPE_PARAMETERS
from sarmitsuba.loader.tables import TABLES
from sarmitsuba.materials.library import ADAPTER_BSDFS, ITU_BANDS, ORDINARY_BSDFS
from sarmitsuba.radar.mode import MODES

_BLOCK = re.compile(r"(<!-- table: (?P<name>[\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def fill_tables(page: str) -> str:
    """Return a page with the text between ``<!-- table: NAME -->`` and ``<!-- end -->`` made anew.

    NAME is a plugin, ``modes``, ``itu``, ``bsdfs`` or ``shapes``. To bring the page up to date::

        python -m sarmitsuba.loader.format_doc docs/scene_format.md
    """
    return _BLOCK.sub(lambda match: f"{match[1]}{_table(match['name'])}\n{match[3]}", page)


def _table(name: str) -> str:
    if name in TABLES:
        table = TABLES[name]
        return f"{table.doc}\n\n{table.markdown()}" if table.rows else table.doc
    return {"modes": _modes, "itu": _itu, "bsdfs": _bsdfs, "shapes": _shapes}[name]()


def _modes() -> str:
    rows = ["| mode | beam | parameters of its own |", "|---|---|---|"]
    rows += [f"| `{m.name}` | {m.doc} | {', '.join(f'`{p.name}`' for p in m.parameters)} |" for m in MODES]
    return "\n".join(rows)


def _itu() -> str:
    rows = ["| material | from GHz | to GHz | a | b | c | d |", "|---|---|---|---|---|---|---|"]
    for name, bands in ITU_BANDS.items():
        rows += [f"| {name} | " + " | ".join(f"{value:g}" for value in band) + " |" for band in bands]
    return "\n".join(rows)


def _bsdfs() -> str:
    rows = ["| BSDF | read as |", "|---|---|"]
    rows += [f"| `{name}` | {words} |" for name, (_, _, words) in ORDINARY_BSDFS.items()]
    rows += [f"| `{name}` | {words} |" for name, words in ADAPTER_BSDFS.items()]
    return "\n".join(rows)


def _shapes() -> str:
    rows = ["| shape | parameters |", "|---|---|"]
    rows += [
        f"| `{name}` | {', '.join(f'`{p}`' for p in parameters) or 'shapes nested in it'} |"
        for name, parameters in SHAPE_PARAMETERS.items()
    ]
    return "\n".join(rows)


__all__ = ["fill_tables"]


if __name__ == "__main__":
    import sys
    from pathlib import Path

    for file in map(Path, sys.argv[1:]):
        file.write_text(fill_tables(file.read_text(encoding="utf-8")), encoding="utf-8")
