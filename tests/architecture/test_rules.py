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

PRINTERS = {"cli.py", "__main__.py"}


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room(name: str) -> str | None:
    """Room of a module of the package, None where every import is allowed."""
    parts = name.split(".")
    if len(parts) < 2:
        return None
    if parts[1] in BASE or name == "sarmitsuba.trace.backend":  # the back end knows nothing of radar
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


@pytest.mark.parametrize("path", MODULES, ids=module_name)
def test_imports_point_one_way(path: Path) -> None:
    here = module_name(path)
    own = room(here)
    if own is None:
        return
    wrong = []
    for target in imports(parse(path)):
        other = room(target) if target.startswith("sarmitsuba.") else None
        if other is None or ORDER.index(other) <= ORDER.index(own):
            continue
        allowed = any(here.startswith(a) and target.startswith(b) for a, b in ALLOWED)
        if not allowed:
            wrong.append(target)
    assert not wrong, f"{here} ({own}) imports from rooms to its right: {wrong}"


def test_exceptions_are_still_needed() -> None:
    used = {
        (a, b)
        for path in MODULES
        for target in imports(parse(path))
        for a, b in ALLOWED
        if module_name(path).startswith(a) and target.startswith(b)
    }
    assert used == set(ALLOWED)


@pytest.mark.parametrize("path", MODULES, ids=module_name)
def test_only_the_command_line_prints_or_exits(path: Path) -> None:
    if path.name in PRINTERS or path.parent.name == "commands":
        return
    for node in ast.walk(parse(path)):
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            where = f"{path.name}:{node.lineno}"
            assert called not in {"print", "exit", "quit", "sys.exit", "os._exit"}, f"{where} calls {called}"
            assert not called.startswith(("sys.stdout.", "sys.stderr.")), f"{where} calls {called}"


@pytest.mark.parametrize("path", MODULES, ids=module_name)
def test_data_stages_do_not_know_mitsuba(path: Path) -> None:
    if room(module_name(path)) not in NO_MITSUBA:
        return
    assert not [t for t in imports(parse(path)) if t.split(".")[0] == "mitsuba"]


@pytest.mark.parametrize("path", MODULES, ids=module_name)
def test_dr_jit_and_matplotlib_are_imported_late(path: Path) -> None:
    # at a module's top they would be imported with the package, before LLVM is found
    late = {"mitsuba", "drjit"} if path.parent.name == "view" else {"mitsuba", "drjit", "matplotlib"}
    tops = [node for node in parse(path).body if isinstance(node, (ast.Import, ast.ImportFrom))]
    found = {name.split(".")[0] for node in tops for name in imports(node)}
    assert not found & late


@pytest.mark.parametrize("path", MODULES, ids=module_name)
def test_no_bare_or_blanket_except(path: Path) -> None:
    for node in ast.walk(parse(path)):
        if isinstance(node, ast.ExceptHandler):
            caught = ast.unparse(node.type) if node.type else ""
            assert caught not in {"", "Exception", "BaseException"}, f"{path.name}:{node.lineno}"


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


@pytest.mark.parametrize("path", [*MODULES, *sorted((ROOT / "plugins").glob("*.py"))], ids=lambda p: p.stem)
def test_modules_stay_small(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 500


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
