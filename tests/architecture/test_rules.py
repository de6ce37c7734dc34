"""The rules of the code's shape: who prints, how large rooms and modules are, what is typed."""

import ast
import re
import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]

# the command line, the only code that prints or exits
PRINTERS = {"cli", "__main__", "commands"}

# `Any` per room; rooms that are not here have none. Limits may only fall.
# The untyped things behind them: Mitsuba and Dr.Jit, h5py, OpenEXR, JSON of foreign files.
ANY = {
    "machine": 13,  # the lazy modules themselves, and records of any type in journals
    "plugins": 23,  # Mitsuba's base classes and properties
    "tracing": 20,  # Mitsuba's scene and records
    "loading": 20,  # Mitsuba's properties and shapes
    "files": 16,  # h5py, OpenEXR and the JSON inside
    "apps": 8,  # drawn values of any type, and the JSON inside
    "simulation": 6,
    "signal": 8,  # metadata of raw data and images, JSON
    "extend": 1,  # a name on first use (PEP 562)
    "gradients": 1,  # tensors and arrays of PyTorch and JAX
    "": 1,  # likewise
}


def test_only_the_command_line_prints_or_exits(house: Any) -> None:
    wrong = []
    for module in house:
        if module.room in PRINTERS:
            continue
        for node in ast.walk(module.tree):
            called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
            direct = called in {"print", "exit", "quit", "sys.exit", "os._exit"}
            if called == "os._exit" and module.where.endswith("isolated.py"):
                continue  # of a forked process, which must not return into its parent's code
            if direct or called.startswith(("sys.stdout.", "sys.stderr.")):
                wrong.append(f"{module.where}:{node.lineno} calls {called}")
    assert not wrong, "\n".join(wrong)


def test_no_bare_or_blanket_except(house: Any) -> None:
    wrong = []
    for module in house:
        for node in ast.walk(module.tree):
            if isinstance(node, ast.ExceptHandler):
                caught = ast.unparse(node.type) if node.type else ""
                if caught in {"", "Exception", "BaseException"}:
                    wrong.append(f"{module.where}:{node.lineno}")
    assert not wrong, "\n".join(wrong)


def test_no_path_is_asked_in_a_way_that_raises(house: Any) -> None:
    """``Path.exists()`` and its like raise on names that are too long, which may come from anybody; os.path's never."""
    wrong = [
        f"{module.where}:{node.lineno}"
        for module in house
        for node in ast.walk(module.tree)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in {"exists", "is_dir", "is_file"}
        and ast.unparse(node.func.value) != "os.path"
    ]
    assert not wrong, "\n".join(wrong)


def test_only_results_reach_up_by_name(house: Any) -> None:
    """``late`` is for the methods that save, draw or change a result, and names modules that are there."""
    wrong, named = [], set()
    for module in house:
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "late":
                target, name = (ast.literal_eval(argument) for argument in node.args)
                named.add(target)
                if module.room not in {"signal", "scene", "analysis"} or target not in house.modules:
                    wrong.append(f"{module.where}:{node.lineno} {target}.{name}")
    assert named and not wrong, "\n".join(wrong)


def test_types_of_arrays_have_one_home(house: Any) -> None:
    wrong = [
        f"{module.where}:{node.lineno}"
        for module in house
        if module.name != "sarmitsuba.core.arrays"
        for node in module.tree.body
        if isinstance(node, ast.Assign) and re.fullmatch(r"NDArray\[np\.[a-z]+\d+\]", ast.unparse(node.value))
    ]
    assert not wrong, "\n".join(wrong)


def test_rays_go_through_the_guard_of_directions(house: Any) -> None:
    """``query_ray`` clears components that are rounding, at which Embree misses triangles."""
    may = ("tracing/kernel/intersector.py", "loading/doctor.py")  # the second: a rate, along an axis
    wrong = [
        f"{module.where}:{node.lineno}"
        for module in house
        if not module.where.endswith(may)
        for node in ast.walk(module.tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "mi.Ray3f"
    ]
    assert not wrong, "\n".join(wrong)


def test_decibels_have_one_home(house: Any) -> None:
    """``core.units`` converts; closed forms, which share no code with what they check, may too."""
    by_hand = re.compile(
        r"\b[12]0(\.0)? \* (float\()?(np|math)\.log10\(|\b10(\.0)? \*\* \((0\.0?[15] \*|.+ / [12]0(\.0)?\)$)"
    )
    wrong = [
        f"{module.where}:{node.lineno} {ast.unparse(node)}"
        for module in house
        if module.name != "sarmitsuba.core.units" and not module.name.startswith("sarmitsuba.truth.theory")
        for node in ast.walk(module.tree)
        if isinstance(node, ast.BinOp) and by_hand.match(ast.unparse(node))
    ]
    assert not wrong, "\n".join(wrong)


def test_lists_of_public_names_stand_where_names_are_passed_on(house: Any) -> None:
    """A module's own public names are those without an underscore; ``__all__`` is for names from elsewhere."""
    wrong = []
    for module in house:
        names: set[str] = set()
        own: set[str] = set()
        for node in module.tree.body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                own.add(node.name)
            elif isinstance(node, (ast.Assign, ast.AnnAssign)):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                found = {n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)}
                own |= found
                if "__all__" in found and node.value is not None:
                    names = set(ast.literal_eval(node.value))
        if names and names <= own and not module.is_package:
            wrong.append(module.where)
    assert not wrong, "\n".join(wrong)


def test_any_stays_at_the_boundary(house: Any) -> None:
    counts: Counter[str] = Counter()
    for module in house:
        counts[module.room] += sum(
            isinstance(node, ast.Name) and node.id == "Any" for node in ast.walk(module.tree)
        )
    over = {room: f"{n} > {ANY.get(room, 0)}" for room, n in counts.items() if n > ANY.get(room, 0)}
    assert not over, str(over)


def trees_of_tests(pattern: str) -> Iterator[tuple[Path, ast.Module]]:
    """Of the tests whose text has what is looked for: parsing all others too takes seconds."""
    for path in sorted((ROOT / "tests").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if re.search(pattern, text):
            yield path, ast.parse(text)


def test_no_verdict_depends_on_the_clock() -> None:
    """A busy machine must not fail a test: budgets are counted in work, or the clock is injected."""
    clocks = {"time", "perf_counter", "monotonic", "process_time"}
    wrong = []
    for path, tree in trees_of_tests(rf"\btime\.({'|'.join(clocks)})\b|\btimeout="):
        for node in ast.walk(tree):
            read = (
                isinstance(node, ast.Attribute) and node.attr in clocks and ast.unparse(node.value) == "time"
            )
            if read or (isinstance(node, ast.keyword) and node.arg == "timeout"):
                wrong.append(f"{path.relative_to(ROOT)}:{node.lineno}: {ast.unparse(node)}")
    assert not wrong, "\n".join(wrong)


def test_no_test_replaces_the_insides_of_the_kernel() -> None:
    """What a test shows of the kernel, it shows through arguments and results."""
    wrong = []
    for path, tree in trees_of_tests("setattr"):
        inside = {
            alias.asname or alias.name.rpartition(".")[2]
            for node in ast.walk(tree)
            if isinstance(node, (ast.Import, ast.ImportFrom))
            for alias in node.names
            if f"{getattr(node, 'module', '')}.{alias.name}".startswith(
                ("sarmitsuba.tracing.kernel", ".sarmitsuba.tracing.kernel")
            )
        }
        for node in ast.walk(tree):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and node.func.attr == "setattr"
            ):
                owner = ast.unparse(node.args[0]).split(".")[0]
                if owner in inside or "sarmitsuba.tracing.kernel" in ast.unparse(node.args[0]):
                    wrong.append(f"{path.relative_to(ROOT)}:{node.lineno}: {ast.unparse(node)}")
    assert not wrong, "\n".join(wrong)


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


# a function that is called only a participle or a preposition leaves out what it does, and to what
PREPOSITIONS = (
    "of at without with in on by after before over under into between beyond about along across against toward "
    "towards per past within beside behind"
).split()
PARTICIPLE = re.compile(
    r"\w+ed|said|held|known|shown|drawn|taken|given|seen|made|found|kept|left|lost|met|lit|begun|built|sent"
)
# nouns and verbs that end alike
NOT_PARTICIPLES = {"seed", "speed", "feed", "need", "read", "embed", "proceed", "exceed", "bed"}


def test_functions_are_named_by_a_verb_and_its_object(house: Any) -> None:
    """Functions of modules; a constructor ``of`` or ``from_x`` is a method, and hooks begin with ``at_``."""
    wrong = []
    for module in house:
        for node in module.tree.body:
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("__"):
                words = node.name.strip("_").split("_")
                bare = len(words) == 1 and PARTICIPLE.fullmatch(words[0]) and words[0] not in NOT_PARTICIPLES
                if words[0] in PREPOSITIONS or bare:
                    wrong.append(f"{module.where}:{node.lineno} {node.name}")
    assert not wrong, "\n".join(wrong)
