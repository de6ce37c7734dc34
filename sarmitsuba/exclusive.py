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


@contextmanager
def backend_lock() -> Iterator[None]:
    """Lock the back end for the calling thread; other threads wait. Calls may be nested.

    Notes
    -----
    Dr.Jit records per thread but shares variables, and a thread does not wait for kernels launched by another: the
    outermost call therefore ends after all launched work is complete. Processes share nothing and need no lock.
    """
    global _depth
    with _lock:
        _depth += 1
        try:
            yield
        finally:
            _depth -= 1
            if _depth == 0:
                drjit = sys.modules.get("drjit")
                if drjit is not None and hasattr(drjit, "sync_thread"):
                    drjit.sync_thread()


def exclusive(function: Callable[P, T]) -> Callable[P, T]:
    """Decorator: only one thread at a time executes any of the decorated functions."""

    @functools.wraps(function)
    def alone(*args: P.args, **kwargs: P.kwargs) -> T:
        with backend_lock():
            return function(*args, **kwargs)

    return alone
