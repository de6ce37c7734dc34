"""Generation of a data set: samples by processes or a cluster, resumed from a journal, and its files."""

import hashlib
import json
import multiprocessing
import multiprocessing.connection
import multiprocessing.resource_tracker
import os
import re
import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from threading import Thread
from typing import Protocol

import numpy as np

from sarmitsuba.apps.datasets.card import data_card
from sarmitsuba.apps.datasets.detection import DetectionDocuments, picture_name
from sarmitsuba.apps.datasets.draw import Drawer
from sarmitsuba.apps.datasets.pictures import grey_levels, write_picture
from sarmitsuba.apps.datasets.recipe import PART_NAMES
from sarmitsuba.apps.datasets.record import SampleForm, append
from sarmitsuba.apps.datasets.sample import Sample, make_sample
from sarmitsuba.apps.datasets.store import records, write_store
from sarmitsuba.core.errors import DataError, ResourceError, SarmitsubaError
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.core.registry import load_extension
from sarmitsuba.files import write_raw
from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.machine.journal import Journal
from sarmitsuba.machine.output import OutputFolder
from sarmitsuba.machine.regular_files import read_bytes
from sarmitsuba.simulation.execution.fingerprint import program_hash

STORE, CARD, JOURNAL = "dataset.h5", "datacard.md", "samples.journal"
# names in the folder of a data set
DATASET_FILES = re.compile(
    r"dataset\.h5|datacard\.md|samples\.journal|annotations_(train|validation|test)\.json|"
    r"picture_\d{7}_\d{4}\.png|raw_\d{7}\.h5"
)
# most bytes of an extension
_MOST_TEXT = 10_000_000


class SampleWorkers(Protocol):
    """Workers of a cluster, such as `sarmitsuba.apps.cluster.DaskWorkers`."""

    def spread(
        self, make: Callable[[], Drawer], use: Callable[[Drawer, int], Sample], tasks: Sequence[int]
    ) -> Iterator[Sample]:
        """Run tasks with a tool that every worker creates once; results in order of completion."""
        ...


@dataclass(frozen=True)
class GenerationPlan:
    """What a run will take, known before it.

    Parameters
    ----------
    samples, rows : simulated and stored images
    left : samples that are still to be made
    bytes_needed : on the disk while it runs, at least: the journal, and then the file beside it
    """

    samples: int
    rows: int
    left: int
    bytes_needed: float


def run_mark(drawer: Drawer, extensions: Sequence[str] = ()) -> str:
    """Hash of all that decides the bits of the samples: recipe, meshes, files that it names, extensions, program."""
    state = hashlib.sha256(json.dumps([program_hash(), drawer.recipe.digest]).encode())
    for mesh in drawer.meshes:
        state.update(mesh.name.encode() + mesh.vertices.tobytes() + mesh.faces.tobytes())
    for name in drawer.files:
        state.update(name.encode() + drawer.file_hash(name).encode())
    for name in extensions:
        state.update(name.encode() + (read_bytes(Path(name), _MOST_TEXT) if os.path.isfile(name) else b""))
    return state.hexdigest()


def image_bytes(drawer: Drawer) -> float:
    """Bytes of all images of one channel, of the journal and the file: the least that a data set takes."""
    recipe = drawer.recipe
    pixels = (
        recipe.samples * recipe.shape[0] * recipe.shape[1] + recipe.rows * recipe.tile[0] * recipe.tile[1]
    )
    return 8.0 * pixels


def file_names(drawer: Drawer, numbers: Sequence[int]) -> list[str]:
    """Names of all files of a data set."""
    recipe = drawer.recipe
    names = [STORE, CARD, JOURNAL, *(f"annotations_{part}.json" for part in PART_NAMES)]
    if recipe.flag("output", "pictures"):
        names += [picture_name(n, tile) for n in numbers for tile in range(len(recipe.corners))]
    if recipe.flag("output", "raw"):
        names += [f"raw_{n:07d}.h5" for n in numbers]
    return names


def generate(
    drawer: Drawer,
    folder: OutputFolder,
    *,
    numbers: Sequence[int] | None = None,
    processes: int = 1,
    workers: SampleWorkers | None = None,
    extensions: Sequence[str] = (),
    force: bool = False,
    ready: Callable[[GenerationPlan], None] | None = None,
    progress: Progress = silent,
) -> Path:
    """Make a data set, or go on with one; its file.

    Parameters
    ----------
    drawer : of the recipe
    folder : of the results
    numbers : of the samples; None: all of the recipe
    processes : on this machine; the bits do not depend on it
    workers : of a cluster, in place of processes
    extensions : the user's modules, which every process loads
    force : replace the results of another recipe
    ready : called before the first sample with what the run takes
    progress : called after every sample

    Raises
    ------
    DataError
        A sample number is not in the recipe; [classes] names no shape of it; all draws of a sample failed.
    OutputError
        The folder holds other results, or the data do not fit on the disk.
    ResourceError
        A process was ended.
    """
    recipe = drawer.recipe
    wanted = list(range(recipe.samples)) if numbers is None else sorted(set(numbers))
    for number in wanted:
        if not 0 <= number < recipe.samples:
            raise DataError(
                f"{recipe.path.name}: there is no sample {number}; give 0 to {recipe.samples - 1} "
                "([dataset]: samples)"
            )
    parts = drawer.parts.of_meshes  # refuses classes with too few meshes
    drawer.check_classes()
    names = file_names(drawer, wanted)
    which = "all" if numbers is None else f"{wanted}"
    mark = hashlib.sha256(f"{run_mark(drawer, extensions)} {which}".encode()).hexdigest()
    folder.check(mark, names, force=force)
    if folder.run_hash != mark:
        folder.clear(mark)
    if folder.owns(STORE) and not folder.owns(JOURNAL):
        return folder.path / STORE
    folder.check_space(image_bytes(drawer) * len(wanted) / recipe.samples)
    folder.announce(*names)
    form = SampleForm(recipe.samples, PART_NAMES, drawer.classes, recipe.shape)
    with closing(Journal(folder.path / JOURNAL, form)) as journal:
        done = {label["number"] for label in journal.labels}
        left = [number for number in wanted if number not in done]
        share = len(left) / recipe.samples
        if ready:
            ready(
                GenerationPlan(
                    len(wanted), len(wanted) * len(recipe.corners), len(left), image_bytes(drawer) * share
                )
            )
        measured = False
        for sample in _make_samples(drawer, left, processes, workers, extensions):
            _write_beside(drawer, folder.path, sample)  # first: what is in the journal is complete
            size = append(journal, sample)
            done.add(sample.number)
            _check_channels(journal)
            if not measured:
                # now with the labels and channels: the journal's rest, and the file
                folder.check_space(float(size) * (len(wanted) - len(done) + len(wanted)))
                measured = True
            progress("samples", float(len(done)), float(len(wanted)), {})
        _write_files(drawer, folder.path, journal, parts)
    (folder.path / JOURNAL).unlink()
    folder.enter(*names)
    return folder.path / STORE


def _check_channels(journal: Journal) -> None:
    """Raise a DataError where the last sample has another number of channels than the first."""
    first, last = journal.labels[0], journal.labels[-1]
    if len(first["channels"]) != len(last["channels"]):
        raise DataError(
            f"dataset: sample {last['number']} has the channels {', '.join(last['channels'])}, sample "
            f"{first['number']} {', '.join(first['channels'])}; draw scenes of as many channels, or give polarisation "
            "in [radar]"
        )


def _make_samples(
    drawer: Drawer,
    numbers: Sequence[int],
    processes: int,
    workers: SampleWorkers | None,
    extensions: Sequence[str],
) -> Iterator[Sample]:
    """Samples in order of completion."""
    if workers is not None:
        yield from workers.spread(partial(_same, drawer), make_sample, numbers)
    elif processes == 1 or len(numbers) < 2:
        yield from (make_sample(drawer, number) for number in numbers)
    else:
        yield from _make_by_processes(drawer, numbers, processes, extensions)


def _same(drawer: Drawer) -> Drawer:
    return drawer


def _work(pipe: "multiprocessing.connection.Connection", drawer: Drawer, extensions: tuple[str, ...]) -> None:
    """Body of a process: the samples of the numbers that come, until the pipe is closed; an error is the last."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where it cannot be blocked; the parent ends this process
    Thread(target=_end_with_parent, daemon=True).start()
    try:
        for extension in extensions:
            load_extension(extension, again=False)
        while True:
            pipe.send(make_sample(drawer, pipe.recv()))
    except (EOFError, BrokenPipeError):
        return
    except (SarmitsubaError, MemoryError) as error:
        pipe.send(error)
    except (
        ArithmeticError,
        AssertionError,
        AttributeError,
        ImportError,
        LookupError,
        OSError,
        RuntimeError,
        TypeError,
        ValueError,
    ):  # the program's own: the parent shows where
        pipe.send(RuntimeError(traceback.format_exc()))


def _end_with_parent() -> None:
    """Wait for the end of the process that gives tasks, which may be killed without ending this one."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Context in which a process starts that Ctrl-C does not reach, not even while it imports modules."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    multiprocessing.resource_tracker.ensure_running()  # whose start would let them through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _make_by_processes(
    drawer: Drawer, numbers: Sequence[int], processes: int, extensions: Sequence[str]
) -> Iterator[Sample]:
    """Samples by processes, each of which is given one number after the other through a pipe.

    The queues of `concurrent.futures` have named semaphores, which a process that is killed leaves in the system.
    """
    context = multiprocessing.get_context("spawn")
    workers = {}
    todo = iter(numbers)
    try:
        for number in islice(todo, processes):
            here, there = context.Pipe()
            process = context.Process(target=_work, args=(there, drawer, tuple(extensions)))
            with _interrupts_blocked():
                process.start()
            there.close()
            workers[here] = process
            here.send(number)
        busy = set(workers)
        while busy:
            for pipe in busy.intersection(multiprocessing.connection.wait(busy)):
                result = pipe.recv()
                if isinstance(result, Exception):
                    raise result
                try:
                    pipe.send(next(todo))
                except StopIteration:
                    busy.remove(pipe)
                yield result
    except (EOFError, ConnectionError):
        raise ResourceError(
            "dataset: a process was ended by the system, most often for memory; finished samples are kept, and the "
            "same command continues from them: give fewer --jobs"
        ) from None
    finally:
        for pipe, process in workers.items():
            pipe.close()
            process.terminate()
        for process in workers.values():
            process.join()


def _write_beside(drawer: Drawer, folder: Path, sample: Sample) -> None:
    """Files of one sample."""
    recipe = drawer.recipe
    if sample.raw is not None:
        write_raw(sample.raw, folder / f"raw_{sample.number:07d}.h5")
    if recipe.flag("output", "pictures"):
        levels = grey_levels(sample.image, recipe.real("output", "picture_range_db"))
        for tile, (top, left) in enumerate(recipe.corners):
            cut = levels[top : top + recipe.tile[0], left : left + recipe.tile[1]]
            write_picture(folder / picture_name(sample.number, tile), np.ascontiguousarray(cut))


def _write_files(drawer: Drawer, folder: Path, journal: Journal, mesh_parts: dict[str, str]) -> None:
    """The files of the whole data set, from the journal."""
    recipe = drawer.recipe
    documents = DetectionDocuments(recipe, drawer.classes)
    tiles = len(recipe.corners)
    labels = []
    for i, record in enumerate(records(journal)):
        documents.add(record, i * tiles)
        labels.append(record.label)
    for part, document in documents.documents.items():
        with atomic_path(folder / f"annotations_{part}.json") as temporary:
            temporary.write_text(json.dumps(document), encoding="utf-8")
    with atomic_path(folder / CARD) as temporary:
        temporary.write_text(data_card(recipe, labels, mesh_parts), encoding="utf-8")
    with atomic_path(folder / STORE) as temporary:
        write_store(temporary, recipe, drawer.classes, journal)
