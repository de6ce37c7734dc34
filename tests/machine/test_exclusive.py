"""The lock of the back end, the number of threads within it, and what a fork leaves of both."""

import multiprocessing
import sys
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.machine.backend import dr, ensure_backend
from sarmitsuba.machine.exclusive import backend_lock, take_threads, threads
from tests.support import forked


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


# ---- processes ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Raw data and an image, made in this process before any other."""
    folder = tmp_path_factory.mktemp("forked")
    forked.fill(folder)
    return folder


def _check(method: str, names: list[str], files: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python 3.12 warns of every fork beside threads
        found = forked.in_process(multiprocessing.get_context(method), names, files)
    for name, one, other in zip(names, found, forked.answers(names, files), strict=True):
        assert one == other, f"{name} by {method}"


@pytest.mark.skipif(sys.platform == "win32", reason="no fork")
def test_a_forked_process_simulates_reads_and_focuses_after_its_parent_did(files: Path) -> None:
    _check("fork", ["simulate", "read_image", "omega_k"], files)


@pytest.mark.slow
@pytest.mark.parametrize("method", forked.METHODS)
@pytest.mark.parametrize("name", forked.FUNCTIONS)
def test_every_function_answers_alike_in_processes_of_every_start_method(
    method: str, name: str, files: Path
) -> None:
    _check(method, [name], files)


def _sample(place: int) -> np.ndarray:
    raw = sarmitsuba.simulate(sarmitsuba.load_scene("point", parameters=forked.SMALL), seed=place)
    return raw.data


@pytest.mark.parametrize(
    "method", ["fork", *(pytest.param(m, marks=pytest.mark.slow) for m in forked.METHODS if m != "fork")]
)
def test_a_loader_with_workers_makes_the_samples_of_one_process(method: str, files: Path) -> None:
    if method not in forked.METHODS:
        pytest.skip("no fork")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        for place, data in enumerate(forked.Loader(_sample, 3, 2, method)):
            np.testing.assert_array_equal(data, _sample(place))


@pytest.mark.skipif(sys.platform == "win32", reason="no fork")
def test_forked_while_a_thread_computes_it_reads_and_refuses_to_simulate_in_one_line(
    files: Path,
) -> None:
    names = ["read_image", "omega_k", "simulate"]
    wanted = forked.answers(names[:-1], files)
    entered, leave = threading.Event(), threading.Event()

    def compute() -> None:
        with backend_lock():
            entered.set()
            leave.wait()

    other = threading.Thread(target=compute)
    other.start()
    entered.wait()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            found = forked.in_process(multiprocessing.get_context("fork"), names, files)
    finally:
        leave.set()
        other.join()
    assert found[:-1] == wanted
    assert "forked while Dr.Jit computed" in found[-1] and "spawn" in found[-1]
    assert forked.answers(["simulate"], files)[0][:5] != "error"  # and this process goes on
