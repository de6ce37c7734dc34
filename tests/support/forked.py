"""What processes of every start method are asked for, and a loader of samples as PyTorch's: workers with queues."""

import hashlib
import multiprocessing
import multiprocessing.context
import sys
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.queues import Queue
from pathlib import Path
from typing import Any

import numpy as np

import sarmitsuba
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.raw_data import RawData

SMALL = {
    "slant_range": "1000",
    "azimuth_resolution": "2",
    "range_film.image_extent_azimuth": "4",
    "range_film.image_extent_range": "4",
}


def small_scene() -> Scene:
    return sarmitsuba.load_scene("point", parameters=SMALL)


def small_raw() -> RawData:
    return sarmitsuba.simulate(small_scene())


def fill(folder: Path) -> None:
    """Files that the functions below read."""
    raw = small_raw()
    sarmitsuba.write_raw(raw, folder / "raw.h5")
    sarmitsuba.write_image(sarmitsuba.focus(raw), folder / "image.h5")


def _digest(data: np.ndarray | bytes) -> str:
    return hashlib.sha256(
        data if isinstance(data, bytes) else np.ascontiguousarray(data).tobytes()
    ).hexdigest()


def _picture(folder: Path) -> str:
    sarmitsuba.read_image(folder / "image.h5").plot(folder / f"{__name__}.png")
    return _digest((folder / f"{__name__}.png").read_bytes())


FUNCTIONS: dict[str, Callable[[Path], str]] = {
    "load_scene": lambda folder: small_scene().name,
    "simulate": lambda folder: _digest(small_raw().data),
    "link_budget": lambda folder: str(sarmitsuba.link_budget(small_scene())),
    "read_raw": lambda folder: _digest(sarmitsuba.read_raw(folder / "raw.h5").data),
    "read_image": lambda folder: _digest(sarmitsuba.read_image(folder / "image.h5").data),
    "focus": lambda folder: _digest(sarmitsuba.focus(sarmitsuba.read_raw(folder / "raw.h5")).data),
    "omega_k": lambda folder: _digest(
        sarmitsuba.focus(sarmitsuba.read_raw(folder / "raw.h5"), focuser="omega_k").data
    ),
    "picture": _picture,
}


def answers(names: Sequence[str], folder: Path) -> list[str]:
    """One line for every function: a digest of what it returned, or its error."""
    found = []
    for name in names:
        try:
            found.append(FUNCTIONS[name](folder))
        except sarmitsuba.SarmitsubaError as error:
            found.append(f"error: {error}")
    return found


def in_process(context: multiprocessing.context.BaseContext, names: Sequence[str], folder: Path) -> list[str]:
    """The answers of a process that the context starts."""
    with context.Pool(1) as pool:
        return pool.apply(answers, (names, folder))


class Loader:
    """Samples made by workers, as ``torch.utils.data.DataLoader`` does it.

    A worker is a daemon with a queue of its own of places; results come back by one queue in any order and are given
    out in the order of places.
    """

    def __init__(self, sample: Callable[[int], np.ndarray], count: int, workers: int, method: str) -> None:
        self._sample, self._count, self._workers = sample, count, workers
        self._context: Any = multiprocessing.get_context(method)

    def __iter__(self) -> Iterator[np.ndarray]:
        results = self._context.Queue()
        asked = [self._context.Queue() for _ in range(self._workers)]
        processes = [
            self._context.Process(target=_work, args=(self._sample, own, results), daemon=True)
            for own in asked
        ]
        for process in processes:
            process.start()
        for place in range(self._count):
            asked[place % self._workers].put(place)
        for own in asked:
            own.put(None)
        found: dict[int, np.ndarray] = {}
        for place in range(self._count):
            while place not in found:
                number, sample = results.get()
                found[number] = sample
            yield found.pop(place)
        for process in processes:
            process.join()


def _work(sample: Callable[[int], np.ndarray], asked: "Queue[int | None]", results: "Queue[object]") -> None:
    for place in iter(asked.get, None):
        results.put((place, sample(place)))


METHODS = ("spawn",) if sys.platform == "win32" else ("fork", "forkserver", "spawn")
