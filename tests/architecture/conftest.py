"""The package's modules and who imports whom, read from the syntax trees; nothing is imported."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = "sarmitsuba"


@dataclass(frozen=True)
class Import:
    """One imported module: where, the name taken from it, and when it runs.

    ``when``: ``top`` with the module, ``typing`` never (under TYPE_CHECKING), ``late`` inside a function.
    """

    source: str
    target: str
    line: int
    when: str
    name: str = ""


@dataclass(frozen=True)
class Module:
    """A source file; ``name`` is dotted, that of a plugin starts with ``plugins``."""

    name: str
    path: Path

    @cached_property
    def text(self) -> str:
        return self.path.read_text(encoding="utf-8")

    @cached_property
    def tree(self) -> ast.Module:
        return ast.parse(self.text, str(self.path))

    @property
    def lines(self) -> int:
        return len(self.text.splitlines())

    @property
    def where(self) -> str:
        return self.path.relative_to(ROOT).as_posix()

    @property
    def is_package(self) -> bool:
        return self.path.name == "__init__.py"

    @property
    def folder(self) -> str:
        """Dotted name of the folder that holds it."""
        return self.name if self.is_package else self.name.rpartition(".")[0]

    @property
    def room(self) -> str:
        """First folder or, at the top level, module; empty for the package itself."""
        parts = self.name.split(".")
        return parts[0] if parts[0] == "plugins" else "".join(parts[1:2])


class House:
    """All modules of the package and the plugins."""

    def __init__(self) -> None:
        self.modules: dict[str, Module] = {}
        for folder, name in ((ROOT / PACKAGE, PACKAGE), (ROOT / "plugins", "plugins")):
            for path in sorted(folder.rglob("*.py")):
                parts = (name, *path.relative_to(folder).with_suffix("").parts)
                dotted = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
                self.modules[dotted] = Module(dotted, path)

    def __iter__(self) -> Iterator[Module]:
        return iter(self.modules.values())

    @cached_property
    def imports(self) -> list[Import]:
        """Every import, of our own modules and of foreign ones."""
        return [found for module in self for found in self._imports(module)]

    def _imports(self, module: Module) -> Iterator[Import]:
        def visit(node: ast.AST, when: str) -> Iterator[Import]:
            # expressions hold no statement
            for child in (c for c in ast.iter_child_nodes(node) if not isinstance(c, ast.expr)):
                then = when
                if isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef)):
                    then = "late" if when == "top" else when
                if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                    for inner in child.body:
                        yield from visit(ast.Module([inner], []), "typing")
                    for inner in child.orelse:
                        yield from visit(ast.Module([inner], []), when)
                elif isinstance(child, ast.Import):
                    for alias in child.names:
                        yield Import(module.name, alias.name, child.lineno, when)
                elif isinstance(child, ast.ImportFrom):
                    base = child.module or ""
                    if child.level:  # ``from .surface import``: folders up from the module's own
                        up = module.folder.split(".")
                        base = ".".join([*up[: len(up) + 1 - child.level], *([base] if base else [])])
                    base = base.replace("sarmitsuba_plugins", "plugins")
                    for alias in child.names:
                        whole = f"{base}.{alias.name}"
                        yield Import(
                            module.name,
                            whole if whole in self.modules else base,
                            child.lineno,
                            when,
                            alias.name,
                        )
                else:
                    yield from visit(child, then)

        yield from visit(module.tree, "top")

    def run_with(self, name: str) -> set[str]:
        """Modules, ours and foreign, that importing a module runs: itself, what it imports at its top, all folders."""
        direct: dict[str, set[str]] = {}
        for found in self.imports:
            if found.when == "top":
                direct.setdefault(found.source, set()).add(found.target)
        seen: set[str] = set()
        todo = [name]
        while todo:
            here = todo.pop()
            if here in seen:
                continue
            seen.add(here)
            parts = here.split(".")
            todo += [".".join(parts[:i]) for i in range(1, len(parts))]
            todo += direct.get(here, ())
        return seen


@pytest.fixture(scope="session")
def house() -> House:
    return House()
