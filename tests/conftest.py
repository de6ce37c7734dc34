"""Fixtures of all tests."""

import importlib
import os
from collections.abc import Callable, Iterator
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
def benchmark_script() -> Iterator[Callable[[str], ModuleType]]:
    """Imports a script of ``benchmarks`` by its name."""
    with pytest.MonkeyPatch.context() as patch:
        for folder in ("studies", "suite", "support"):
            patch.syspath_prepend(str(Path(__file__).parents[1] / "benchmarks" / folder))
        yield importlib.import_module
