"""Fixtures of all tests."""

import importlib
import os
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import matplotlib
import pytest

from sarmitsuba.machine.backend import prepare_llvm

matplotlib.use("Agg")


def one_core() -> None:
    """Keep a worker of pytest-xdist on a core of its own: Dr.Jit's and BLAS's threads then do not crowd each other."""
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    if worker.startswith("gw") and hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[int(worker[2:]) % len(cores)]})


# both before Dr.Jit is first imported, which a test may do before any library code runs: it counts cores and reads
# the path of LLVM then
one_core()
prepare_llvm()


@pytest.fixture(scope="session")
def benchmark_script() -> Callable[[str], ModuleType]:
    """Imports a module of ``benchmarks`` by its name."""
    folder = Path(__file__).parents[1] / "benchmarks"

    def load(name: str) -> ModuleType:
        (path,) = folder.glob(f"*/{name}.py")
        return importlib.import_module(f"benchmarks.{path.parent.name}.{name}")

    return load
