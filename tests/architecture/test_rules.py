"""The rules of the code's shape, checked on its syntax trees."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "sarmitsuba"
MODULES = sorted(PACKAGE.rglob("*.py"))

# imports point only to the left; what is not listed (cli, commands, doctor, simulate) may import everything
ORDER = ["base", "radar", "scene", "effects", "trace", "echo", "focus", "image", "io", "study", "view"]
BASE = {"constants", "errors", "units", "progress"}

# (importing module, imported module): why it is right
ALLOWED = {
    (
        "sarmitsuba.focus",
        "sarmitsuba.image.sar_image",
    ): "the image, a plain dataclass, is the focuser's result",
    ("sarmitsuba.trace", "sarmitsuba.echo"): "kernels add onto the grids that the echo stage plans",
}

# rooms that work on data from elsewhere too, and so must not need Mitsuba
NO_MITSUBA = ("echo", "focus", "image", "io", "view", "radar", "effects")

# modules past 500 lines, and why that is not two things in one
LONG = {"sarmitsuba/scene/tables.py": "declarations of parameters, one after the other, no logic"}

PRINTERS = {"cli.py", "__main__.py"}


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room(name: str) -> str | None:
    """Room of a module of the package, None where every import is allowed."""
    parts = name.split(".")
    if len(parts) < 2:
        return None
    if parts[1] in BASE or name == "sarmitsuba.backend":  # the back end knows nothing of radar
        return "base"
    return parts[1] if parts[1] in ORDER else None


def imports(tree: ast.AST, *, typing_only: bool = True) -> Iterator[str]:
    """Every imported module; names under TYPE_CHECKING only when ``typing_only``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            yield node.module


def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def test_imports_point_one_way() -> None:
    wrong, used = [], set()
    for path in MODULES:
        here = module_name(path)
        own = room(here)
        for target in imports(parse(path)) if own else ():
            other = room(target) if target.startswith("sarmitsuba.") else None
            if own is None or other is None or ORDER.index(other) <= ORDER.index(own):
                continue
            exceptions = {(a, b) for a, b in ALLOWED if here.startswith(a) and target.startswith(b)}
            used |= exceptions
            if not exceptions:
                wrong.append(f"{here} imports {target}, a room to its right")
    assert wrong == []
    assert used == set(ALLOWED), "an exception is no longer needed"


def test_only_the_command_line_prints_or_exits() -> None:
    wrong = []
    for path in MODULES:
        if path.name in PRINTERS or path.parent.name == "commands":
            continue
        for node in ast.walk(parse(path)):
            called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
            direct = called in {"print", "exit", "quit", "sys.exit", "os._exit"}
            if direct or called.startswith(("sys.stdout.", "sys.stderr.")):
                wrong.append(f"{path.relative_to(ROOT)}:{node.lineno} calls {called}")
    assert wrong == []


def test_data_stages_do_not_know_mitsuba() -> None:
    rooms = [path for path in MODULES if room(module_name(path)) in NO_MITSUBA]
    assert rooms
    assert [p.name for p in rooms if any(t.split(".")[0] == "mitsuba" for t in imports(parse(p)))] == []


def test_dr_jit_and_matplotlib_are_imported_late() -> None:
    # at a module's top they would be imported with the package, before LLVM is found
    wrong = []
    for path in MODULES:
        late = {"mitsuba", "drjit"} | (set() if path.parent.name == "view" else {"matplotlib"})
        tops = [node for node in parse(path).body if isinstance(node, (ast.Import, ast.ImportFrom))]
        found = {name.split(".")[0] for node in tops for name in imports(node)} & late
        wrong += [f"{path.relative_to(ROOT)} imports {name} at its top" for name in found]
    assert wrong == []


def test_no_bare_or_blanket_except() -> None:
    wrong = []
    for path in MODULES:
        for node in ast.walk(parse(path)):
            if isinstance(node, ast.ExceptHandler):
                caught = ast.unparse(node.type) if node.type else ""
                if caught in {"", "Exception", "BaseException"}:
                    wrong.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert wrong == []


def test_importing_the_package_is_light() -> None:
    code = "import sys, sarmitsuba; print({'mitsuba', 'drjit', 'matplotlib', 'scipy'} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert run.stdout.strip() == "set()"


def test_importing_every_verb_leaves_mitsuba_alone() -> None:
    code = """
import sys, sarmitsuba
for name in sarmitsuba.__all__:
    getattr(sarmitsuba, name)
assert callable(sarmitsuba.focus) and callable(sarmitsuba.simulate)
print(sorted({"mitsuba", "drjit", "matplotlib"} & set(sys.modules)))
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert run.stdout.strip() == "[]"


def test_modules_stay_small() -> None:
    files = [*MODULES, *(ROOT / "plugins").glob("*.py")]
    long = {p.relative_to(ROOT).as_posix(): len(p.read_text(encoding="utf-8").splitlines()) for p in files}
    assert {name: count for name, count in long.items() if count > 500 and name not in LONG} == {}


def text_files() -> list[Path]:
    listed = subprocess.run(["git", "ls-files"], capture_output=True, text=True, cwd=ROOT)
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    kinds = {".py", ".md", ".toml", ".xml", ".json", ".csv", ".txt", ""}
    return [ROOT / name for name in listed.stdout.splitlines() if Path(name).suffix in kinds]


def test_no_file_names_a_place_on_somebodys_machine() -> None:
    place = re.compile(r"(?<![\w.])/(home|root|Users|work)/\w")
    for path in text_files():
        if not path.is_file() or path.samefile(__file__):
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
            assert not place.search(line), f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
