"""Figures of the package's structure: rooms, arrows, files, lines, statements, imports.

``python tools/house.py [TREE]`` prints one line each. A room is a folder of the top two levels that holds modules; an
arrow leads from a room to another one of the top level that it imports. Statements and lines are those of the package;
the share of imports is that of lines within import statements.
"""

from __future__ import annotations

import argparse
import ast
import statistics
from collections.abc import Iterable
from pathlib import Path

ENTRIES = {"catalog", "modes", "patterns", "cases"}
OUTSIDE = ("apps", "truth")


def read_modules(tree: Path) -> dict[str, tuple[Path, ast.Module, list[str]]]:
    """Path, syntax tree and lines of every module of the package, by dotted name."""
    found = {}
    for path in sorted((tree / "sarmitsuba").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        name = ".".join(path.relative_to(tree).with_suffix("").parts)
        found[name.removesuffix(".__init__")] = (path, ast.parse(text), text.splitlines())
    return found


def list_imports(module: ast.Module) -> list[tuple[str, int]]:
    """Modules that a module imports, and the lines of each statement."""
    found = []
    for node in ast.walk(module):
        lines = getattr(node, "end_lineno", 0) - getattr(node, "lineno", 0) + 1
        if isinstance(node, ast.ImportFrom) and node.module:
            found.append((node.module, lines))
        elif isinstance(node, ast.Import):
            found += [(alias.name, lines) for alias in node.names]
    return found


def list_rooms(names: Iterable[str]) -> set[str]:
    """Rooms of modules that are no packages, by dotted name; folders whose entries are found by themselves apart."""
    folders = {".".join(name.split(".")[1:-1][:2]) for name in names}
    return {folder for folder in folders if folder and folder.rpartition(".")[2] not in ENTRIES}


def print_figures(tree: Path) -> None:
    """Print the figures of one tree."""
    modules = read_modules(tree)
    files = [name for name, (path, _, _) in modules.items() if path.name != "__init__.py"]
    rooms = list_rooms(files)
    arrows: set[tuple[str, str]] = set()
    importers: dict[str, set[str]] = {name: set() for name in modules}
    import_lines = 0
    for name, (_, module, _) in modules.items():
        here = name.split(".")[1:2]
        for target, lines in list_imports(module):
            import_lines += lines
            there = target.split(".")[1:2] if target.startswith("sarmitsuba.") else []
            if here and there and here != there:
                arrows.add((here[0], there[0]))
            if target in importers:
                importers[target].add(name)
    lengths = [len(modules[name][2]) for name in files]
    lines = sum(len(text) for _, _, text in modules.values())
    outside = sum(
        len(text) for name, (_, _, text) in modules.items() if name.split(".")[1:2] in [[o] for o in OUTSIDE]
    )
    statements = sum(
        isinstance(node, ast.stmt) for _, module, _ in modules.values() for node in ast.walk(module)
    )
    single = [name for name in files if len(importers[name]) == 1]
    functions = [
        node.name
        for _, module, _ in modules.values()
        for node in ast.walk(module)
        if isinstance(node, ast.FunctionDef)
    ]
    print(f"rooms at the top two levels {len(rooms)}, at the top {len({r.split('.')[0] for r in rooms})}")
    print(f"arrows between rooms of the top level {len(arrows)}")
    print(f"files {len(files)}, median {statistics.median(lengths):.0f} lines, longest {max(lengths)}")
    print(f"files under 50 lines {sum(n < 50 for n in lengths)}, files with one importer {len(single)}")
    print(f"lines {lines}, without {' and '.join(OUTSIDE)} {lines - outside}; statements {statements}")
    print(f"share of lines that import {100.0 * import_lines / lines:.1f} %")
    print(f"functions and methods {len(functions)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tree", type=Path, nargs="?", default=Path(__file__).resolve().parents[1])
    print_figures(parser.parse_args().tree)
