"""Results of studies that pages of the documentation show: stored in docs/measured, from which the pages are made."""

import json
from typing import Any

import harness

DOCS = harness.ROOT / "docs"
FOLDER = DOCS / "measured"


def read(name: str) -> dict[str, Any]:
    """What a study stored last, by its name; nothing where it never did."""
    path = FOLDER / f"{name}.json"
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.exists() else {}


def write(name: str, results: dict[str, Any]) -> None:
    """Store results."""
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / f"{name}.json").write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


def filled(page: str, name: str, text: str) -> str:
    """The page with what a study generates put in its place."""
    start, end = f"<!-- generated: benchmarks/studies/{name}.py --docs -->\n", "\n<!-- end -->"
    head, mark, rest = page.partition(start)
    _, stop, tail = rest.partition(end)
    assert mark and stop, f"the page has no place for {name}"
    return f"{head}{start}\n{text.strip()}\n{stop}{tail}"


def show(name: str, text: str, page: str = "effects_measured.md") -> None:
    """Put what a study generates onto its page."""
    import kernel_sources

    path = DOCS / page
    text = f"{text.strip()}\n\n{kernel_sources.statement(kernel_sources.measured())}"
    path.write_text(filled(path.read_text(encoding="utf-8"), name, text), encoding="utf-8")


__all__ = ["filled", "read", "show", "write"]
