"""The lock of the back end, and the number of threads within it."""

import threading
from collections.abc import Iterator

import pytest

from sarmitsuba.backend import dr, ensure_backend
from sarmitsuba.exclusive import backend_lock, take_threads, threads


@pytest.fixture
def pool() -> Iterator[int]:
    """Two threads at least, as before the test afterwards."""
    ensure_backend()
    before = int(dr.thread_count())
    dr.set_thread_count(3)
    yield 3
    dr.set_thread_count(before)


def test_one_thread_lasts_until_the_outermost_call_ends(pool: int) -> None:
    with pytest.raises(ValueError, match="stop"), backend_lock():
        with backend_lock():
            take_threads(one=True)
            take_threads(one=True)
        assert dr.thread_count() == 1 and threads() == pool
        take_threads(one=False)
        assert dr.thread_count() == pool
        take_threads(one=True)
        raise ValueError("stop")
    assert dr.thread_count() == pool == threads()


def test_threads_are_left_alone_outside_the_lock(pool: int) -> None:
    take_threads(one=True)
    assert dr.thread_count() == pool
    with backend_lock():
        other = threading.Thread(target=take_threads, kwargs={"one": True})
        other.start()
        other.join()
        assert dr.thread_count() == pool
        take_threads(one=False)
        assert dr.thread_count() == pool
    dr.set_thread_count(1)  # a user's own choice stays
    with backend_lock():
        take_threads(one=True)
        take_threads(one=False)
    assert dr.thread_count() == 1
