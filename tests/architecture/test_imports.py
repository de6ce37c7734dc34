"""Imports point one way, in no circle, and leave Mitsuba and Dr.Jit to the rooms that trace."""

import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tools.house import list_rooms

ROOT = Path(__file__).parents[2]

# an importer stands above what it imports; rooms of one line may import each other as long as there is no circle
FLOORS = (
    ("", "__main__", "cli", "commands", "extend", "gradients", "plugins"),
    ("apps",),
    ("truth",),
    ("view",),
    ("analysis",),
    ("simulation",),
    ("tracing",),
    ("loading",),
    ("effects",),
    ("files",),
    ("signal",),
    ("scene",),
    ("radar",),
    ("machine",),
    ("core", "version"),
)
# folders of the top two levels that hold modules (tools/house.py)
MOST_ROOMS = 25
FLOOR = {room: i for i, rooms in enumerate(FLOORS) for room in rooms}
# folders that import nothing else of the room they are in
APART = (
    "sarmitsuba.analysis.polarimetry",
    "sarmitsuba.tracing.kernel.tubes",
    "sarmitsuba.truth.theory",
)
THEORY = "sarmitsuba.truth.theory"
# closed forms share no code with what they check
THEORY_MAY = {f"sarmitsuba.core.{name}" for name in ("arrays", "constants", "units")}
# rooms that may take them; tests, benchmarks and pages may too
THEORY_USERS = {"truth"}

# rooms that work on data from elsewhere too, and so need neither Mitsuba nor, but for focusing's kernel, Dr.Jit
DATA = {"effects", "files", "radar", "scene", "signal", "view"}
DATA_FOLDERS = (
    *(
        f"sarmitsuba.analysis.{name}"
        for name in (
            *(
                "account",
                "baseline",
                "carrier",
                "error_budget",
                "image_quality",
                "interferometry",
                "link_budget",
            ),
            *("point_quality", "polarimetry", "pulse_timing"),
        )
    ),
    "sarmitsuba.truth.theory",
)
# who may go through the door to Mitsuba and Dr.Jit
BACKEND_USERS = {
    "__main__",
    "analysis",
    "apps",
    "cli",
    "commands",
    "extend",
    "loading",
    "machine",
    "plugins",
    "signal",
    "simulation",
    "tracing",
    "truth",
}
FOREIGN = {"mitsuba", "drjit"}
# libraries, and parts of SciPy, that most runs do without: importing one takes up to 0.2 s of processor time
ON_USE = {
    "scipy.constants",
    "scipy.integrate",
    "scipy.interpolate",
    "scipy.io",
    "scipy.linalg",
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.signal",
    "scipy.sparse",
    "scipy.spatial",
    "scipy.stats",
    "trimesh",
}
# rooms that no run of ``render``, ``focus`` or ``explain`` imports
APART_FROM_RUNS = ("sarmitsuba.apps", "sarmitsuba.truth", "sarmitsuba.view.page")


def lies_in(name: str, folders: Iterable[str]) -> bool:
    """Whether a module lies in one of these folders."""
    return any(f"{name}.".startswith(f"{folder}.") for folder in folders)


def is_data(module: Any) -> bool:
    """Whether a module works on data, without Mitsuba."""
    in_room = module.room in DATA and not lies_in(module.name, ("sarmitsuba.view.page",))
    return in_room or lies_in(module.name, DATA_FOLDERS)


def test_rooms_are_few(house: Any) -> None:
    """Folders with modules of their own, at the top two levels."""
    counted = list_rooms(m.name for m in house if not m.is_package and m.room != "plugins")
    assert len(counted) <= MOST_ROOMS, sorted(counted)


def test_every_module_has_its_floor(house: Any) -> None:
    assert sorted({module.where for module in house if module.room not in FLOOR}) == []


def test_imports_point_down(house: Any) -> None:
    """Late imports and those for type checking too: knowing a name is knowing its room."""
    wrong = []
    for found in house.imports:
        if found.target not in house.modules:
            continue
        here, there = house.modules[found.source].room, house.modules[found.target].room
        if here != there and FLOOR.get(there, 0) < FLOOR.get(here, 0):
            wrong.append(f"{house.modules[found.source].where}:{found.line} imports {found.target}, above it")
    assert not wrong, "\n".join(wrong)


def test_folders_apart_import_nothing_else_of_their_room(house: Any) -> None:
    wrong, inside = [], set()
    for found in house.imports:
        for folder in APART:
            room = folder.rpartition(".")[0]
            if f"{found.source}.".startswith(f"{folder}."):
                inside.add(folder)
                if f"{found.target}.".startswith(f"{room}.") and not f"{found.target}.".startswith(
                    f"{folder}."
                ):
                    wrong.append(f"{house.modules[found.source].where}:{found.line} imports {found.target}")
    assert inside == set(APART) and not wrong, "\n".join(wrong)


def test_theory_shares_no_code_with_what_it_checks(house: Any) -> None:
    wrong = [
        f"{house.modules[found.source].where}:{found.line} imports {found.target}"
        for found in house.imports
        if lies_in(found.source, (THEORY,))
        and found.target in house.modules
        and not lies_in(found.target, THEORY_MAY | {THEORY})
    ]
    assert not wrong, "\n".join(wrong)


def test_only_what_is_checked_against_it_takes_theory(house: Any) -> None:
    """The program itself computes nothing by the closed forms that it is held against."""
    wrong = [
        f"{house.modules[found.source].where}:{found.line} imports {found.target}"
        for found in house.imports
        if lies_in(found.target, (THEORY,)) or (found.target, found.name) == ("sarmitsuba.truth", "theory")
        if house.modules[found.source].room not in THEORY_USERS
    ]
    assert not wrong, "\n".join(wrong)


def test_runs_import_a_library_when_they_use_it(house: Any) -> None:
    """``import scipy`` is enough: SciPy imports ``scipy.optimize`` when the name is first used."""
    wrong = [
        f"{house.modules[found.source].where}:{found.line} imports {found.target} at its top"
        for found in house.imports
        if found.when == "top"
        and not lies_in(found.source, APART_FROM_RUNS)
        and ON_USE & {found.target, f"{found.target}.{found.name}"}
    ]
    assert not wrong, "\n".join(wrong)


def test_no_circles(house: Any) -> None:
    """Between modules, whenever the import runs."""
    edges: dict[str, set[str]] = {module.name: set() for module in house}
    for found in house.imports:
        if found.target in edges and found.target != found.source:
            edges[found.source].add(found.target)
    assert circles(edges) == []


def circles(edges: dict[str, set[str]]) -> list[list[str]]:
    """Groups of more than one node that reach each other (Kosaraju's algorithm)."""
    order: list[str] = []
    seen: set[str] = set()
    for start in edges:
        stack = [(start, iter(sorted(edges[start])))] if start not in seen else []
        seen.add(start)
        while stack:
            node, rest = stack[-1]
            for child in rest:
                if child not in seen:
                    seen.add(child)
                    stack.append((child, iter(sorted(edges[child]))))
                    break
            else:
                order.append(node)
                stack.pop()
    back: dict[str, set[str]] = {node: set() for node in edges}
    for node, targets in edges.items():
        for target in targets:
            back[target].add(node)
    groups, placed = [], set()
    for node in reversed(order):
        group, todo = [], [node]
        while todo:
            here = todo.pop()
            if here not in placed:
                placed.add(here)
                group.append(here)
                todo += back[here]
        if len(group) > 1:
            groups.append(sorted(group))
    return sorted(groups)


def test_circles_are_found() -> None:
    edges = {"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a", "e"}, "e": set()}
    assert circles(edges) == [["a", "b", "c"]]
    assert circles({"a": {"b"}, "b": set()}) == []


def test_the_back_end_is_the_only_door(house: Any) -> None:
    """Mitsuba and Dr.Jit come from ``sarmitsuba.machine.backend``, which finds LLVM first."""
    wrong = [
        f"{house.modules[found.source].where}:{found.line} imports {found.target}"
        for found in house.imports
        if found.target.split(".")[0] in FOREIGN and found.source != "sarmitsuba.machine.backend"
    ]
    assert not wrong, "\n".join(wrong)


def test_only_rooms_that_trace_use_the_door(house: Any) -> None:
    wrong = [
        f"{house.modules[found.source].where}:{found.line}"
        for found in house.imports
        if found.target == "sarmitsuba.machine.backend"
        and house.modules[found.source].room not in BACKEND_USERS | {""}
    ]
    assert not wrong, "\n".join(wrong)


def test_data_rooms_do_not_reach_mitsuba(house: Any) -> None:
    """By the imports of what they import, and theirs, as far as they run."""
    wrong = []
    for module in house:
        if is_data(module):
            reached = {name.split(".")[0] for name in house.run_with(module.name)} & FOREIGN
            rooms = {
                house.modules[name].room
                for name in house.run_with(module.name)
                if name in house.modules and house.modules[name].room == "tracing"
            }
            wrong += [f"{module.where} reaches {name}" for name in sorted(reached | rooms)]
    assert not wrong, "\n".join(wrong)


def test_focusing_uses_dr_jit_but_not_mitsuba(house: Any) -> None:
    wrong = [
        f"{house.modules[found.source].where}:{found.line}"
        for found in house.imports
        if (found.target, found.name) == ("sarmitsuba.machine.backend", "mi")
        and house.modules[found.source].room == "signal"
    ]
    assert not wrong, "\n".join(wrong)


def loaded_by(names: list[str]) -> set[str]:
    """Which of Mitsuba, Dr.Jit and Matplotlib a fresh interpreter holds after importing modules."""
    code = (
        "import importlib, sys\n"
        f"for name in {names!r}:\n    importlib.import_module(name)\n"
        "print(*sorted({'mitsuba', 'drjit', 'matplotlib'} & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert run.returncode == 0, run.stderr
    return set(run.stdout.split())


def test_importing_the_data_rooms_leaves_mitsuba_alone(house: Any) -> None:
    """The same as above, seen in the running interpreter."""
    names = [module.name for module in house if is_data(module) and module.room != "view"]
    assert names and loaded_by(names) == set()


def test_importing_the_view_loads_no_more_than_matplotlib(house: Any) -> None:
    names = [module.name for module in house if module.room == "view" and is_data(module)]
    assert names and loaded_by(names) <= {"matplotlib"}


def test_importing_the_package_and_its_names_is_light() -> None:
    code = """
import sys, sarmitsuba
assert not {"mitsuba", "drjit", "matplotlib", "scipy"} & set(sys.modules)
for name in sarmitsuba.__all__:
    getattr(sarmitsuba, name)
assert callable(sarmitsuba.focus) and callable(sarmitsuba.simulate)
print(*sorted({"mitsuba", "drjit", "matplotlib"} & set(sys.modules)))
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert run.returncode == 0, run.stderr
    assert run.stdout.split() == []


def test_matplotlib_is_imported_by_the_view_alone(house: Any) -> None:
    wrong = [
        f"{house.modules[found.source].where}:{found.line}"
        for found in house.imports
        if found.target.split(".")[0] == "matplotlib" and house.modules[found.source].room != "view"
    ]
    assert not wrong, "\n".join(wrong)
