"""Lock of the back end: one thread at a time in functions that record or evaluate Dr.Jit arrays."""

import functools
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

_lock = threading.RLock()
_depth = 0  # depth of nested calls in the thread that holds the lock
_holder = 0  # identity of that thread
_threads = 0  # threads of Dr.Jit to return to when the outermost call ends; 0: they were not changed


@contextmanager
def backend_lock() -> Iterator[None]:
    """Lock the back end for the calling thread; other threads wait. Calls may be nested.

    Notes
    -----
    Dr.Jit records per thread but shares variables, and a thread does not wait for kernels launched by another: the
    outermost call therefore ends after all launched work is complete. Processes share nothing and need no lock.
    """
    global _depth, _holder, _threads
    with _lock:
        _depth += 1
        _holder = threading.get_ident()
        try:
            yield
        finally:
            _depth -= 1
            if _depth == 0:
                drjit = sys.modules.get("drjit")
                if drjit is not None and hasattr(drjit, "sync_thread"):
                    drjit.sync_thread()
                    if _threads:
                        drjit.set_thread_count(_threads)
                _holder = _threads = 0


def threads() -> int:
    """Number of threads that the back end may use, as it was set outside of locked calls."""
    drjit = sys.modules.get("drjit")
    return _threads or (max(1, int(drjit.thread_count())) if drjit is not None else 1)


def take_threads(one: bool) -> None:
    """Let the back end compute in the calling thread alone, or in all threads again.

    Lasts until the outermost locked call of the calling thread ends; does nothing in a thread that has not locked the
    back end.

    Notes
    -----
    One thread is for short work: after every launch the waiting threads of Dr.Jit's pool keep their processors busy for
    milliseconds, and each has its own copy of the grid that echoes are added to.
    """
    global _threads
    drjit = sys.modules.get("drjit")
    if drjit is None or _holder != threading.get_ident() or one == (drjit.thread_count() <= 1):
        return
    if one or _threads:
        drjit.sync_thread()
        wanted, _threads = (1, threads()) if one else (_threads, 0)
        drjit.set_thread_count(wanted)


@contextmanager
def single_threaded() -> Iterator[None]:
    """Lock the back end, which computes in the calling thread alone until the block ends.

    Sums over many rays then have one order, so that results do not depend on the number of processors.
    """
    with backend_lock():
        drjit = sys.modules.get("drjit")
        if drjit is None:
            yield
            return
        drjit.sync_thread()
        before = drjit.thread_count()
        drjit.set_thread_count(1)
        try:
            yield
        finally:
            drjit.sync_thread()
            drjit.set_thread_count(before)


def exclusive(function: Callable[P, T]) -> Callable[P, T]:
    """Decorator: only one thread at a time executes any of the decorated functions."""

    @functools.wraps(function)
    def alone(*args: P.args, **kwargs: P.kwargs) -> T:
        with backend_lock():
            return function(*args, **kwargs)

    return alone
