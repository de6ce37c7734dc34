"""Trial of file readers of other libraries in a separate process, since a damaged file can crash them."""

import faulthandler
import os
import signal
import sys
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

from sarmitsuba.core.errors import DataError, ResourceError
from sarmitsuba.machine.atomic import removed_if_stopped
from sarmitsuba.machine.exclusive import backend_lock, fork_for_trial
from sarmitsuba.machine.regular_files import most_unpacked

# allowed CPU time, s: a hundred times that of any intact file, plus a share by the size of the file
_LEAST_LIMIT = 5
_BYTES_PER_SECOND = 5e6
# allowed elapsed time per CPU time: a blocked reader uses no CPU time
_PATIENCE = 20
_OUT_OF_MEMORY = 3


def survive(source: Path | int, read: Callable[[], object]) -> None:
    """Try a reader in a forked process; raise a DataError if it crashes, hangs or needs excessive memory.

    libhdf5 loops forever on some damaged attributes, and SciPy's reader of MATLAB files uses uninitialised pointers;
    neither can be stopped within a process. Exceptions of the trial are ignored: the caller reads again and reports
    them. Without ``fork`` (Windows) there is no trial.

    Parameters
    ----------
    source : the file, or the bytes to be converted
    read : reads the file; must not need another thread of this process, nor a device

    Raises
    ------
    DataError
        The process was ended by a signal, hung, or used more CPU time or memory than any intact file of that size.
    ResourceError
        No further process may be started.
    """
    if sys.platform == "win32":
        return
    size = source if isinstance(source, int) else source.stat().st_size
    limit, memory = int(_LEAST_LIMIT + size / _BYTES_PER_SECOND), most_unpacked(size)
    # forking stops the threads of linear algebra, and blocks while another thread uses them; filters of warnings are
    # shared by all threads
    with backend_lock(), warnings.catch_warnings():
        # Python 3.12 warns of forking beside threads: the child uses none, and takes no lock of theirs
        warnings.simplefilter("ignore", DeprecationWarning)
        # so does JAX, where it is loaded
        warnings.filterwarnings("ignore", r"os\.fork\(\) was called", RuntimeWarning)
        try:
            child = fork_for_trial()
        except OSError as error:  # a limit of processes, or no memory for one
            raise ResourceError(
                f"files are tried in a process of their own first, and none can be started: {error.strerror}; raise "
                "the limit of processes (ulimit -u) or free memory"
            ) from error
        if child == 0:
            _try(read, limit, memory)
    status = None
    try:
        with removed_if_stopped(partial(os.kill, child, signal.SIGKILL)):
            _, status = os.waitpid(child, 0)
    finally:
        if status is None:  # Ctrl-C
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
    if os.WIFEXITED(status) and os.WEXITSTATUS(status) == _OUT_OF_MEMORY:
        raise DataError(
            f"the file unpacks to more than {memory / 1e6:.0f} MB, {memory / max(size, 1):.0f} times its size; it is "
            "damaged or malicious"
        )
    if not os.WIFSIGNALED(status):
        return
    number = os.WTERMSIG(status)
    what = (
        "never ends"
        if number in (signal.SIGXCPU, signal.SIGALRM)
        else f"crashes ({signal.Signals(number).name})"
    )
    raise DataError(f"the file is damaged: its reader {what}; copy or make it again")


def _try(read: Callable[[], object], limit: int, memory: int) -> None:
    """Body of the child process; does not return."""
    import resource

    try:
        faulthandler.disable()
        for number in (
            signal.SIGXCPU,
            signal.SIGALRM,
            signal.SIGSEGV,
            signal.SIGBUS,
            signal.SIGABRT,
            signal.SIGINT,
            signal.SIGTERM,
        ):
            signal.signal(number, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.getrlimit(resource.RLIMIT_CPU)[1]))
        signal.setitimer(signal.ITIMER_REAL, _PATIENCE * limit)
        # not the address space, much of which is reserved by the threads' arenas and never written
        most = _writable_bytes() + memory
        resource.setrlimit(resource.RLIMIT_DATA, (most, resource.getrlimit(resource.RLIMIT_DATA)[1]))
        read()
    finally:
        # whatever was raised, and nothing of the parent's is flushed or closed twice
        os._exit(_OUT_OF_MEMORY if _is_memory_error(sys.exc_info()[1]) else 0)


def _is_memory_error(error: BaseException | None) -> bool:
    """Whether an error was caused by a MemoryError."""
    while error is not None:
        if isinstance(error, MemoryError):
            return True
        error = error.__cause__ or error.__context__
    return False


def _writable_bytes() -> int:
    """Writable memory of the process, bytes; without /proc unknown, and there is no limit."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5])
    except OSError:
        return 1 << 62
    return pages * os.sysconf("SC_PAGE_SIZE")
