"""Hash of the sources that speed and accuracy depend on, and the list of those that figures were measured with.

``docs/measured/kernels.json`` lists hashes in the order of their making. Each but the first of a measurement has a
line that says why figures measured before still hold: ``python benchmarks/run_all.py --still-holds "WHY"`` adds it.
"""

import ast
import hashlib
import re
from functools import cache
from pathlib import Path

import harness
import stored

# packages of tracing, binning and focusing, with the plan and the sampling that choose what they do
PACKAGES = ("trace", "echo", "simulation", "effects", "focusing", "materials", "mesh")
LIST = "kernels"
MARK = "Kernels' sources:"


def without_words(source: str) -> str:
    """Lines of a module without docstrings, lines of comment, empty lines and trailing blanks."""
    lines = source.splitlines()
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        first = node.body[0] if node.body else None
        if (
            isinstance(first, ast.Expr)
            and isinstance(first.value, ast.Constant)
            and isinstance(first.value.value, str)
        ):
            assert first.end_lineno is not None
            lines[first.lineno - 1 : first.end_lineno] = [""] * (first.end_lineno - first.lineno + 1)
    return "\n".join(line.rstrip() for line in lines if line.strip() and not line.lstrip().startswith("#"))


@cache
def current() -> str:
    """Hash of the sources as they are, 12 hexadecimal digits; docstrings and lines of comment do not count."""
    digest = hashlib.sha256()
    root = harness.ROOT / "sarmitsuba"
    for path in sorted(p for package in PACKAGES for p in (root / package).rglob("*.py")):
        digest.update(f"{path.relative_to(root).as_posix()}\n".encode())
        digest.update(without_words(path.read_text(encoding="utf-8")).encode())
    return digest.hexdigest()[:12]


def known() -> dict[str, str]:
    """Hashes in the order of their making, and why figures measured before each still hold; empty for none."""
    return dict(stored.read(LIST))


def measured() -> str:
    """Enter the sources as they are as those of a measurement; return their hash."""
    if current() not in known():
        stored.write(LIST, {**known(), current(): ""})
    return current()


def still_holds(why: str) -> None:
    """Enter the sources as they are, with the reason why figures measured before still hold."""
    stored.write(LIST, {**{k: v for k, v in known().items() if k != current()}, current(): why})


def holds(measured_with: str) -> bool:
    """Whether figures measured with these sources hold for those of now: each change since then has its reason."""
    order = list(known())
    if measured_with == current():
        return True
    if measured_with not in order or not order or order[-1] != current():
        return False
    return all(known()[later] for later in order[order.index(measured_with) + 1 :])


def outdated(page: str) -> list[str]:
    """Hashes on a page whose figures are not known to hold for the sources as they are."""
    return [found for found in re.findall(rf"{MARK} `(\w+)`", page) if not holds(found)]


def statement(measured_with: str) -> str:
    """Line of a page: the hash it was measured with."""
    return f"{MARK} `{measured_with}`."


def stated(page: Path) -> list[str]:
    """Hashes on a page."""
    return re.findall(r"Kernels' sources: `([0-9a-f]{12})`\.", page.read_text(encoding="utf-8"))


__all__ = ["current", "holds", "known", "measured", "stated", "statement", "still_holds", "without_words"]
