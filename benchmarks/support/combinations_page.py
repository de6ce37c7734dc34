"""Cells of the matrix of combinations, and the matrix as a page of the documentation."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from benchmarks.support.combinations_reference import Deviation
from sarmitsuba.scene.settings import METHODS
from sarmitsuba.signal.focusing import FOCUSERS

RIGHT, WARNS, REFUSES, WRONG = "right", "warns", "refuses", "wrong"
# draws per mode of the full matrix
COUNT = 20
COLOURS = {RIGHT: "🟩", WARNS: "🟨", REFUSES: "🟦", WRONG: "🟥"}
# methods that make raw data, which every focuser then takes
FROM_ECHOES = ("raw", "hybrid")

HEAD = """# Combinations

Test of every radar mode with every focuser and method, at random squints, positions in the image, grids, windows,
beams and channels. Each cell of the matrix is an image of an ideal point, compared with the exact sum of its
echoes over all pulses (`benchmarks/support/combinations_reference.py`: NumPy, closed forms, no code of the program's
focusers).

| | |
|---|---|
| {right} right | level within 0.05 dB, place within 0.05 cells, phase within 1 degree, in every channel |
| {warns} warns | not right, and a warning says that something is amiss |
| {refuses} refuses | no image, and one line that says why |
| {wrong} wrong | not right, and nothing is said: a failure |

```sh
python -m benchmarks.studies.combinations --page                                 # this page
python -m benchmarks.studies.combinations --mode stripmap --first 3 --count 1    # one draw, with what was said
```

Drawn are, for each mode: squint to 30 degrees, band (P, L, C, X, Ku), cells, range, look angle, heading, side and the
mode's own parameters; the place of the image off the aim point, to 250 cells along and across, its odd sizes, the
point's place in it and its height; slant and ground grid; both windows; the beam, or two antennas; channels, compact
ones too; methods `raw` and `hybrid` for the echoes. Modes, focusers, methods and beams are those that are registered:
a new one has its row or column by itself. A seed is a draw; `make test` runs a few of them, `make test-slow` all of
this page.

Level and place are those of the main lobe, by least squares of its intensity. A point says nothing about surfaces: what
traced echoes are worth is shown by `python -m sarmitsuba validate`. Method `raster` draws surfaces alone, so it refuses
points.
"""


@dataclass(frozen=True)
class Cell:
    """One cell of the matrix.

    Parameters
    ----------
    axes : its classes
    column : the focuser, or the method that has none
    verdict : see above
    deviation : from the exact image; None where there is no image
    said : warnings, or the refusal
    command : prints it again
    """

    axes: dict[str, str]
    column: str
    verdict: str
    deviation: Deviation | None
    said: tuple[str, ...]
    command: str

    def text(self) -> str:
        """One line."""
        about = " ".join(self.axes.values())
        line = f"{self.verdict:7} {self.column:14} {about}"
        if self.deviation is not None:
            line += f"; {self.deviation}"
        return line + (f"; {self.command}" if self.verdict == WRONG else "")


def columns() -> tuple[str, ...]:
    """Focusers, the choice among them, and the methods that have none."""
    return (*FOCUSERS.own_names, "auto,error=-50", *(m for m in METHODS if m not in FROM_ECHOES))


def page(cells: Sequence[Cell]) -> str:
    """The page, Markdown."""
    counts = Counter(cell.verdict for cell in cells)
    draws = len({cell.command for cell in cells})
    lines = [HEAD.format(**COLOURS)]
    total = ", ".join(f"{COLOURS[name]} {counts[name]} {name}" for name in COLOURS)
    lines.append(f"{draws} draws, {COUNT} of each mode, {len(cells)} cells: {total}.\n")
    lines.append(_table("mode and squint", cells, lambda cell: f"{cell.axes['mode']}, {cell.axes['squint']}"))
    for axis in ("place", "grid", "beam", "channels", "band", "range window", "azimuth window"):
        lines.append(_table(axis, cells, lambda cell, axis=axis: cell.axes[axis]))
    lines.append(_worst(cells))
    for verdict, title in ((WARNS, "What is warned of"), (REFUSES, "Why images are refused")):
        lines.append(_said(cells, verdict, title))
    return "\n".join(lines)


def _table(title: str, cells: Sequence[Cell], row_of: Callable[[Cell], str]) -> str:
    names = columns()
    count = Counter((row_of(cell), cell.column, cell.verdict) for cell in cells)
    lines = [f"## By {title}\n", f"| {title} | " + " | ".join(f"`{n}`" for n in names) + " |"]
    lines.append("|---" * (len(names) + 1) + "|")
    for row in sorted({row_of(cell) for cell in cells}):
        texts = []
        for name in names:
            found = {v: count[row, name, v] for v in COLOURS if count[row, name, v]}
            texts.append(" ".join(f"{COLOURS[v]} {n}" for v, n in found.items()))
        lines.append(f"| {row} | " + " | ".join(texts) + " |")
    return "\n".join(lines) + "\n"


def _worst(cells: Sequence[Cell]) -> str:
    lines = ["## Largest deviation of what is right\n"]
    lines += ["| | level, dB | place, cells | phase, degrees |", "|---|---|---|---|"]
    for name in columns():
        found = [c.deviation for c in cells if c.column == name and c.verdict == RIGHT and c.deviation]
        if found:
            level = max(abs(d.level_db) for d in found)
            place = max(max(abs(d.azimuth), abs(d.range)) for d in found)
            phase = max(abs(d.phase_deg) for d in found)
            lines.append(f"| `{name}` | {level:.3f} | {place:.3f} | {phase:.2f} |")
    return "\n".join(lines) + "\n"


def _said(cells: Sequence[Cell], verdict: str, title: str) -> str:
    """Texts by column, numbers left out, so that those of one kind are one."""
    count: Counter[tuple[str, str]] = Counter()
    for cell in cells:
        if cell.verdict == verdict:
            for text in dict.fromkeys(_kind(text) for text in cell.said):
                count[cell.column, text] += 1
    if not count:
        return ""
    lines = [f"## {title}\n", "| | cells | |", "|---|---|---|"]
    for name in columns():
        mine = [(n, text) for (column, text), n in count.items() if column == name]
        lines += [f"| `{name}` | {n} | {text} |" for n, text in sorted(mine, key=lambda m: -m[0])]
    return "\n".join(lines) + "\n"


def _kind(text: str) -> str:
    """A message without its numbers, to its first remedy."""
    short = re.sub(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?", "N", text.split("; take focuser")[0])
    return short.replace("|", "/")[:240]


__all__ = ["COLOURS", "COUNT", "FROM_ECHOES", "REFUSES", "RIGHT", "WARNS", "WRONG", "Cell", "columns", "page"]
