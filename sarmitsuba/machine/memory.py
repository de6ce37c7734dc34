"""Memory of the process: present, peak and available."""

import ctypes
import os
import sys
import threading
from functools import lru_cache
from pathlib import Path

from sarmitsuba.core.errors import ResourceError

# share of the free memory usable by a run: other programs need some, and the prediction is uncertain
USABLE = 0.9
_CGROUPS = (
    # version 2: limit, use, statistics with the part of the use that is cache
    (
        "/sys/fs/cgroup/memory.max",
        "/sys/fs/cgroup/memory.current",
        "/sys/fs/cgroup/memory.stat",
        "inactive_file",
    ),
    # version 1
    (
        "/sys/fs/cgroup/memory/memory.limit_in_bytes",
        "/sys/fs/cgroup/memory/memory.usage_in_bytes",
        "/sys/fs/cgroup/memory/memory.stat",
        "total_inactive_file",
    ),
)


def peak_memory() -> int:
    """Peak memory of the process so far, bytes; 0 if unknown (Windows)."""
    try:  # unlike ru_maxrss, not inherited by started programs on Linux
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))
    except (OSError, ValueError, StopIteration):
        pass
    try:
        import resource
    except ImportError:
        return 0
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(most if sys.platform == "darwin" else most * 1024)


def held_memory() -> int:
    """Present memory of the process, bytes; its peak if unknown."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return peak_memory()
    return pages * os.sysconf("SC_PAGE_SIZE")


def free_memory() -> int | None:
    """Memory available to the process in the machine or its container, bytes; None if unknown."""
    found = [
        value for value in (_machine(), *(_container(*files) for files in _CGROUPS)) if value is not None
    ]
    return min(found) if found else None


def check_fits(what: str, wanted: int, remedy: str) -> None:
    """Raise an error for a step that needs more memory than is available.

    Parameters
    ----------
    what : consumer of the memory, start of the error message
    wanted : bytes in addition to the present memory
    remedy : end of the error message

    Raises
    ------
    ResourceError
        It does not fit.
    """
    free = free_memory()
    if free is not None and wanted > USABLE * free:
        raise ResourceError(
            f"{what} needs {format_bytes(wanted)} of memory, and {format_bytes(free)} are free; {remedy}"
        )


def format_bytes(value: float) -> str:
    """Number of bytes as text with a unit: ``1.5 GB``."""
    for unit, size in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if value >= size:
            return f"{value / size:.3g} {unit}" if value < 1e3 * size else f"{value / size:.0f} {unit}"
    return f"{value / 1e3:.3g} kB"


def _machine() -> int | None:
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    except (OSError, ValueError, IndexError):
        pass
    try:  # total memory, if the system does not state the free memory
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None


def _container(limit: str, use: str, statistics: str, cache: str) -> int | None:
    try:
        bound, used = (int(Path(file).read_text(encoding="ascii")) for file in (limit, use))
        rows = (line.split() for line in Path(statistics).read_text(encoding="ascii").splitlines())
        reclaimable = next((int(row[1]) for row in rows if row[0] == cache), 0)
    except (OSError, ValueError, IndexError):  # "max", or no such container
        return None
    return max(0, bound - used + reclaimable)


# glibc: largest number of heaps, by its function mallopt, and where a user sets it
_ARENA_MAX = -8
_ARENA_VARIABLES = {"MALLOC_ARENA_MAX": "", "GLIBC_TUNABLES": "glibc.malloc.arena_max"}


@lru_cache(maxsize=1)
def share_one_heap() -> None:
    """Let threads that start later allocate from one heap, unless the user has set the number of heaps.

    glibc gives each thread a heap, up to eight for a processor, and returns little of the memory that threads have
    freed: a process grows towards the sum of the largest use of each heap. Other systems are left as they are.
    """
    if any(name in os.environ and text in os.environ[name] for name, text in _ARENA_VARIABLES.items()):
        return
    if sys.platform == "linux" and hasattr(library := ctypes.CDLL(None), "mallopt"):
        library.mallopt(_ARENA_MAX, 1)


# address space, bytes: libraries and kernels reserve 0.7 GB with two threads, each further one its stack; with less
# they end the process with a signal
_LEAST_ADDRESSES, _ADDRESSES_PER_THREAD = 1_000_000_000, 16_000_000
# open files that a run needs: streams, pipes, libraries, results and their journals
_LEAST_FILES = 32
# limit of processes and threads below which it is tried whether enough can be started
_FEW_THREADS = 10_000


def check_limits() -> None:
    """Raise a ResourceError where libraries would end the process for a limit of the system, before they are loaded.

    NumPy's linear algebra and Dr.Jit each start a thread for every processor.
    """
    if sys.platform == "win32":
        return
    import resource

    count = os.cpu_count() or 1
    most, need = resource.getrlimit(resource.RLIMIT_AS)[0], _LEAST_ADDRESSES + _ADDRESSES_PER_THREAD * count
    if most != resource.RLIM_INFINITY and most < need:
        raise ResourceError(
            f"the address space is limited to {most / 1e6:.0f} MB, of {need / 1e6:.0f} MB needed; raise it (ulimit -v)"
        )
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if most != resource.RLIM_INFINITY and most < _LEAST_FILES:
        raise ResourceError(f"{most} files may be open, of {_LEAST_FILES} needed; raise it (ulimit -n)")
    most = resource.getrlimit(resource.RLIMIT_NPROC)[0]
    if most == resource.RLIM_INFINITY or most > _FEW_THREADS:
        return
    wanted, go = 2 * count + 2, threading.Event()
    started: list[threading.Thread] = []
    try:
        for _ in range(wanted):
            thread = threading.Thread(target=go.wait)
            thread.start()
            started.append(thread)
    except RuntimeError:
        raise ResourceError(
            f"{len(started)} of {wanted} threads can be started: the limit of processes is {most}; raise it (ulimit -u)"
        ) from None
    finally:
        go.set()
        for thread in started:
            thread.join()
