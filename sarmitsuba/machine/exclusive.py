"""Lock of the back end: one thread at a time records or evaluates Dr.Jit arrays; and the effect of a fork on both."""

import functools
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import ParamSpec, TypeVar

from sarmitsuba.core.errors import BackendError

P = ParamSpec("P")
T = TypeVar("T")

_lock = threading.RLock()
_depth = 0  # depth of nested calls in the thread that holds the lock
_holder = 0  # identity of that thread
_threads = 0  # threads of Dr.Jit to return to when the outermost call ends; 0: they were not changed
_lost = ""  # why this process cannot compute with Dr.Jit; empty: it can
_paused = 0  # threads of Dr.Jit to return to after a fork; 0: they were not ended
_held = False  # whether the forking thread has the lock
_trial = False  # whether the fork is one of `fork_for_trial`
_forking = threading.Lock()  # one fork at a time: the marks above are those of its thread


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
                if drjit is not None and hasattr(drjit, "sync_thread") and not _lost:
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
    if drjit is None or _lost or _holder != threading.get_ident() or one == (drjit.thread_count() <= 1):
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
        if drjit is None or _lost:
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


def check_backend_kept() -> None:
    """Raise a BackendError in a process whose back end was lost by a fork."""
    if _lost:
        raise BackendError(
            f"{_lost}; start processes with multiprocessing's 'spawn' or 'forkserver', or fork before the first "
            "simulation"
        )


def fork_for_trial() -> int:
    """``os.fork`` of a process that will not compute with Dr.Jit, whose threads go on in this one."""
    global _trial
    with backend_lock():
        _trial = True
        try:
            return os.fork()
        finally:
            _trial = False


def _prepare_fork() -> None:
    """End the threads of Dr.Jit, which a fork does not copy, unless another thread is computing."""
    global _held, _paused
    _forking.acquire()
    _held = _lock.acquire(blocking=False)
    drjit = sys.modules.get("drjit")
    if drjit is None or _trial or _lost or not _held or _depth or not hasattr(drjit, "thread_count"):
        return
    if drjit.thread_count() > 1:
        drjit.sync_thread()
        _paused = int(drjit.thread_count())
        drjit.set_thread_count(1)


def _resume() -> None:
    """Start the threads of Dr.Jit again in the parent."""
    global _held, _paused
    if _paused:
        sys.modules["drjit"].set_thread_count(_paused)
    if _held:
        _lock.release()
    _held, _paused = False, 0
    _forking.release()


def _begin_child() -> None:
    """Renew the locks, and start the threads of Dr.Jit again where none was computing."""
    global _lock, _forking, _lost, _held, _trial, _depth, _holder, _threads, _paused
    mitsuba, drjit = sys.modules.get("mitsuba"), sys.modules.get("drjit")
    if drjit is not None and hasattr(drjit, "thread_count") and not _lost:
        variant = mitsuba.variant() if mitsuba is not None and hasattr(mitsuba, "variant") else None
        if (variant or "").startswith("cuda_"):
            _lost = "this process was forked from one that uses the GPU, which CUDA does not allow"
        elif _trial or not _held or _depth:
            _lost = "this process was forked while Dr.Jit computed, whose threads are not copied"
        elif _paused:
            drjit.set_thread_count(_paused)
    _lock, _forking = threading.RLock(), threading.Lock()
    _held, _trial, _depth, _holder, _threads, _paused = False, False, 0, 0, 0, 0


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_prepare_fork, after_in_parent=_resume, after_in_child=_begin_child)
