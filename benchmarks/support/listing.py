"""List of all scripts of the benchmarks: what each measures, by its docstring, and the page that shows its results."""

import ast
import re
from collections.abc import Mapping

from benchmarks.support import harness

FOLDERS = harness.ROOT / "benchmarks"
DOCS = harness.ROOT / "docs"
NOT_YET = "not run"


def scripts(folder: str) -> dict[str, str]:
    """First sentence of the docstring of every module of a folder, by name."""
    found = {}
    for path in sorted((FOLDERS / folder).glob("*.py")):
        if not path.stem.startswith("_"):
            text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
            found[path.stem] = " ".join(text.partition("\n\n")[0].split())
    return found


def suite(sections: Mapping[str, str]) -> str:
    """Table of the benchmarks of ``run_all.py``; ``sections`` are the titles of those on the page, by name."""
    rows = ["## All benchmarks", "", "| `benchmarks/suite/` | what it measures | results |", "|---|---|---|"]
    for name, text in scripts("suite").items():
        title, pages = sections.get(name), _pages("suite", name)
        shown = f"[{title}](#{_anchor(title)})" if title else NOT_YET + ("; see " if pages else "") + pages
        rows.append(f"| `{name}` | {text} | {shown} |")
    return "\n".join(rows)


def by_hand() -> str:
    """Tables of the scripts that are run by hand, and of what all of them import."""
    lines = ["## Studies", "", "Run by hand, by `python -m benchmarks.studies.NAME`.", ""]
    lines += ["| `benchmarks/studies/` | what it measures | results |", "|---|---|---|"]
    lines += [
        f"| `{name}` | {text} | {_pages('studies', name)} |" for name, text in scripts("studies").items()
    ]
    lines += ["", "## What the scripts share", "", "| `benchmarks/support/` | |", "|---|---|"]
    lines += [f"| `{name}` | {text} |" for name, text in scripts("support").items()]
    return "\n".join(lines)


def _pages(folder: str, name: str) -> str:
    """Links to the pages that name a script by its path or as ``--only NAME``."""
    named = re.compile(rf"{folder}/{name}\.py|{folder}\.{name}\b|run_all --only {name}\b")
    found = [
        path.stem for path in sorted(DOCS.glob("*.md")) if named.search(path.read_text(encoding="utf-8"))
    ]
    return ", ".join(f"[{stem.replace('_', ' ')}](../{stem}.md)" for stem in found)


def _anchor(title: str) -> str:
    return re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-")


__all__ = ["NOT_YET", "by_hand", "scripts", "suite"]
