"""How much memory there is, and what is refused."""

import ctypes
import os
import subprocess
import sys
from pathlib import Path

import pytest

from sarmitsuba.core.errors import ResourceError
from sarmitsuba.machine import memory


def test_what_does_not_fit_is_refused_with_figure_and_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "free_memory", lambda: 2_000_000_000)
    memory.check_fits("box: this run", 1_700_000_000, "buy more")
    with pytest.raises(ResourceError) as caught:
        memory.check_fits("box: this run", 1_900_000_000, "buy more")
    assert str(caught.value) == "box: this run needs 1.9 GB of memory, and 2 GB are free; buy more"
    monkeypatch.setattr(memory, "free_memory", lambda: None)
    memory.check_fits("box: this run", 10**18, "buy more")


def test_the_memory_of_a_container_counts(tmp_path: Path) -> None:
    limit, use, statistics = (tmp_path / name for name in ("max", "current", "stat"))
    statistics.write_text("anon 5\ninactive_file 300\n")
    use.write_text("1000\n")
    files = (str(limit), str(use), str(statistics), "inactive_file")
    assert memory._container(*files) is None
    limit.write_text("4000\n")
    assert memory._container(*files) == 3300
    limit.write_text("max\n")
    assert memory._container(*files) is None


def test_this_process_holds_what_it_allocates() -> None:
    before = memory.held_memory()
    block = bytearray(80_000_000)
    assert memory.held_memory() - before > 70_000_000  # tol: freed pages of others may be used
    assert memory.peak_memory() >= before
    del block


@pytest.mark.parametrize(
    ("value", "text"), [(1.5e3, "1.5 kB"), (2e6, "2 MB"), (1.234e9, "1.23 GB"), (4e15, "4000 TB")]
)
def test_bytes_for_people(value: float, text: str) -> None:
    assert memory.format_bytes(value) == text


HEAPS = """
import ctypes, re, sys, threading
from sarmitsuba.machine.memory import share_one_heap
share_one_heap()
library = ctypes.CDLL(None)
library.fopen.restype = ctypes.c_void_p
together = threading.Barrier(4)
def use():
    block = ctypes.create_string_buffer(50_000)
    together.wait()
for thread in (threads := [threading.Thread(target=use) for _ in range(4)]):
    thread.start()
for thread in threads:
    thread.join()
file = ctypes.c_void_p(library.fopen(sys.argv[1].encode(), b"w"))
library.malloc_info(0, file)
library.fclose(file)
print(len(re.findall("<heap nr", open(sys.argv[1]).read())))
"""


@pytest.mark.skipif(
    sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "malloc_info"),
    reason="heaps are counted by glibc",
)
@pytest.mark.parametrize(("given", "expected"), [({}, 1), ({"MALLOC_ARENA_MAX": "3"}, 3)])
def test_threads_share_one_heap_unless_the_user_sets_how_many(
    tmp_path: Path, given: dict[str, str], expected: int
) -> None:
    left = {name: text for name, text in os.environ.items() if name not in memory._ARENA_VARIABLES}
    command = [sys.executable, "-c", HEAPS, str(tmp_path / "heaps.xml")]
    done = subprocess.run(command, env=left | given, capture_output=True, text=True, check=True)
    assert int(done.stdout) == expected
