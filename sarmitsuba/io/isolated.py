"""Readers of foreign code tried in a process of their own first, because a damaged file can take them down."""

import faulthandler
import os
import signal
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

from sarmitsuba.errors import DataError

# s of CPU time: a hundred times what any sound file needs, and the share of a large one
_LEAST_LIMIT = 5
_BYTES_PER_SECOND = 5e6


def survive(path: Path, read: Callable[[], object]) -> None:
    """Read in a forked process, and refuse the file when that dies or never ends.

    libhdf5 loops for ever on some damaged attributes and SciPy's reader of MATLAB files reads through pointers that it
    never set; neither can be stopped from within. Errors of the trial are no matter: the caller reads again, and words
    them. Where there is no ``fork`` (Windows), nothing is tried.

    Parameters
    ----------
    path : of the file
    read : reads it; must not need any other thread of this process, nor a device

    Raises
    ------
    DataError
        The process was ended by a signal, or took more CPU time than any sound file of that size.
    """
    if sys.platform == "win32":
        return
    limit = int(_LEAST_LIMIT + path.stat().st_size / _BYTES_PER_SECOND)
    with warnings.catch_warnings():
        # Python 3.12 warns of forking beside threads: the child uses none, and takes no lock of theirs
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        _try(read, limit)
    status = None
    try:
        _, status = os.waitpid(child, 0)
    finally:
        if status is None:  # Ctrl-C
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
    if not os.WIFSIGNALED(status):
        return
    number = os.WTERMSIG(status)
    what = "never ends" if number == signal.SIGXCPU else f"crashes ({signal.Signals(number).name})"
    raise DataError(f"the file is damaged: its reader {what}; copy or make it again")


def _try(read: Callable[[], object], limit: int) -> None:
    """Body of the child; does not return."""
    import resource

    try:
        faulthandler.disable()
        for number in (signal.SIGXCPU, signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT, signal.SIGINT):
            signal.signal(number, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.getrlimit(resource.RLIMIT_CPU)[1]))
        read()
    finally:
        # whatever was raised, and nothing of the parent's is flushed or closed twice
        os._exit(0)


__all__ = ["survive"]
