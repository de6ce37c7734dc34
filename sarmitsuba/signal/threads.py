"""Parallel evaluation of many small matrix products: a thread pool with single-threaded BLAS."""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache
from typing import Protocol


class _BlasController(Protocol):
    """Interface of ``threadpoolctl.ThreadpoolController`` that is used."""

    def limit(self, *, limits: int, user_api: str) -> AbstractContextManager[object]:
        """Context in which libraries are limited to a number of threads."""
        ...


def n_threads() -> int:
    """Number of CPUs available to the process."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def parallel_map(function: Callable[[int], None], arguments: Iterable[int]) -> None:
    """Call ``function`` for each argument in a thread pool; the calls must be independent.

    OpenBLAS splits even small products over its threads, which then wait for each other spinning: slower than one
    thread on an idle machine (18 ms against 30 for a block of 64 pulses) and ten times slower on a busy one. So BLAS
    is limited to one thread (where ``threadpoolctl`` is installed) and the calls are distributed.
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
    """Thread pool of the process, started once; not inherited by a fork."""
    return ThreadPoolExecutor(n_threads())


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Context in which BLAS has one thread; without ``threadpoolctl`` nothing changes."""
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
