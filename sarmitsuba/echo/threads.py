"""Many small matrix products at once: own threads, each with a single-threaded BLAS."""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache
from typing import Protocol


class _BlasController(Protocol):
    """What ``threadpoolctl.ThreadpoolController`` is used for."""

    def limit(self, *, limits: int, user_api: str) -> AbstractContextManager[object]:
        """Hold libraries to a number of threads meanwhile."""
        ...


def n_threads() -> int:
    """CPUs this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def parallel_map(function: Callable[[int], None], arguments: Iterable[int]) -> None:
    """Call ``function`` once per argument; the calls must not depend on each other.

    OpenBLAS splits even small products over its threads, which then wait for each other spinning: slower than
    one thread on an idle machine (18 ms against 30 for a block of 64 pulses) and ten times slower on a busy
    one. So BLAS is held to one thread (where ``threadpoolctl`` is there to do it) and the calls are spread.
    """
    if _controller() is None:
        for argument in arguments:
            function(argument)
        return
    with one_blas_thread():
        todo = list(arguments)
        if len(todo) == 1:
            function(todo[0])
            return
        for future in [_pool(os.getpid()).submit(function, argument) for argument in todo]:
            future.result()


@lru_cache(maxsize=1)
def _pool(process: int) -> ThreadPoolExecutor:
    """Threads of this process, started once: a fork does not take them along."""
    return ThreadPoolExecutor(n_threads())


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Hold BLAS to one thread meanwhile; without ``threadpoolctl`` nothing changes."""
    controller = _controller()
    if controller is None:
        yield
        return
    with controller.limit(limits=1, user_api="blas"):
        yield


@lru_cache(maxsize=1)
def _controller() -> _BlasController | None:
    try:
        from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped,unused-ignore]
    except ImportError:
        return None
    found: _BlasController = ThreadpoolController()
    return found
