"""Generation of a data set: samples by processes or a cluster, and the files about them.

An interrupted generation continues from a journal. Files for detectors are 8-bit pictures of the logarithm of
intensity and COCO annotations of each part; the data card states distributions, physics, errors, seeds, versions and
licence.
"""

import hashlib
import json
import math
import multiprocessing
import multiprocessing.connection
import multiprocessing.resource_tracker
import os
import re
import signal
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from threading import Thread
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.analysis.label_sight import GROUND_CLASSES
from sarmitsuba.apps.dataset_draw import Drawer
from sarmitsuba.apps.dataset_recipe import PART_NAMES, Fixed, Recipe
from sarmitsuba.apps.dataset_sample import SHAPES, Sample, make_sample
from sarmitsuba.apps.dataset_store import JsonTable, SampleForm, SampleRecord, append, records, write_store
from sarmitsuba.core.arrays import C64
from sarmitsuba.core.errors import DataError, ResourceError, SarmitsubaError
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.core.registry import load_extension
from sarmitsuba.core.units import db_from_power
from sarmitsuba.files import write_raw
from sarmitsuba.files.coco import run_lengths
from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.machine.journal import Journal
from sarmitsuba.machine.output import OutputFolder
from sarmitsuba.machine.regular_files import read_bytes, read_text
from sarmitsuba.simulation.execution.fingerprint import program_hash
from sarmitsuba.version import __version__

# share of the pixels that are as bright as the brightest
_BRIGHTEST = 1e-3


def grey_levels(image: C64, range_db: float) -> NDArray[np.uint8]:
    """Grey levels (rows, columns) of the channels' mean intensity (channels, rows, columns).

    255 is the intensity that a thousandth of the pixels exceeds, 0 is ``range_db`` below it.
    """
    power = (image.real.astype(np.float64) ** 2 + image.imag.astype(np.float64) ** 2).mean(axis=0)
    top = float(np.quantile(power, 1.0 - _BRIGHTEST)) or float(power.max()) or 1.0
    level = db_from_power(np.maximum(power / top, 1e-30))
    return np.asarray(np.clip(np.round(255.0 * (1.0 + level / range_db)), 0, 255).astype(np.uint8))


def write_picture(path: Path, levels: NDArray[np.uint8]) -> None:
    """Write a PNG."""
    from PIL import Image

    with atomic_path(path) as temporary:
        Image.fromarray(levels).save(temporary, format="PNG")


def picture_name(number: int, tile: int) -> str:
    """File name of the picture of a tile."""
    return f"picture_{number:07d}_{tile:04d}.png"


# share of the power of a tile's brightest pixel from which on a pixel is bright
BRIGHT = 0.01


class DetectionDocuments:
    """COCO documents, filled sample by sample.

    Parameters
    ----------
    recipe : of the samples
    classes : semantic classes

    Notes
    -----
    Shapes are annotated by their pixels in the layer ``shape``, or else ``instance``, where the recipe asks for it;
    without, by the bounds of their vertices within the image. With ``boxes = "echoes"`` they are
    annotated by the pixels of their echoes, within a resolution cell of them.
    Shapes of scene files are annotated where [classes] gives
    them a class that is no ground. ``iscrowd`` is 0: each annotation is one shape, also
    those whose masks are run lengths, which pycocotools reads either way and detectors drop where it is 1.
    """

    def __init__(self, recipe: Recipe, classes: Sequence[str]) -> None:
        self._recipe, self._category = recipe, {name: i for i, name in enumerate(classes, 1)}
        self.documents: dict[str, dict[str, Any]] = {
            part: {
                "info": {
                    "description": recipe.text("dataset", "title") or recipe.path.stem,
                    "version": __version__,
                },
                "licenses": [{"id": 1, "name": recipe.text("dataset", "licence"), "url": ""}],
                "images": [],
                "categories": [{"id": i, "name": name} for name, i in self._category.items()],
                "annotations": [],
            }
            for part in PART_NAMES
        }
        self.outside: list[float] = []
        self.brightest_outside = 0

    def add(self, record: SampleRecord, first_row: int) -> None:
        """Add the tiles of a sample, whose first one is the stored image ``first_row``."""
        document = self.documents[record.label["part"]]
        rows, columns = self._recipe.tile
        for tile, (top, left) in enumerate(self._recipe.corners):
            number = first_row + tile
            document["images"].append(
                {
                    "id": number,
                    "file_name": picture_name(record.label["number"], tile),
                    "height": rows,
                    "width": columns,
                    "license": 1,
                }
            )
            shown = self._masks(record.layers)
            window = None if shown is None else shown[top : top + rows, left : left + columns]
            drawn = {one["name"] for one in record.objects}
            others = [
                {"name": name, "semantic_class": kind, "code": code}
                for code, name, kind in record.label["named_shapes"]
                if kind and kind not in GROUND_CLASSES and name not in drawn
            ]
            boxes = []
            for one in (*record.objects, *others):
                found = (
                    _outline_box(one["box"], (top, left), (rows, columns))
                    if window is None and "box" in one
                    else _outline_mask(window == one["code"])
                    if window is not None and one["code"]
                    else None
                )
                if found is not None:
                    boxes.append(found["bbox"])
                    document["annotations"].append(
                        {
                            "id": len(document["annotations"]) + 1,
                            "image_id": number,
                            "category_id": self._category[one["semantic_class"]],
                            "iscrowd": 0,
                            "name": one["name"],
                            **({"aspect_deg": one["aspect_deg"]} if "aspect_deg" in one else {}),
                            **found,
                        }
                    )
            self._count_outside(record.image[:, top : top + rows, left : left + columns], boxes)

    def _masks(self, layers: Mapping[str, NDArray[np.generic]]) -> NDArray[np.generic] | None:
        """Codes of shapes by pixel; None without such a layer."""
        order = SHAPES[::-1] if self._recipe.boxes_of_echoes else SHAPES
        name = next((name for name in order if name in layers), None)
        if name is None:
            return None
        here = layers.get(f"{name}_here")
        return layers[name] if here is None else np.where(here != 0, layers[name], 0)

    def _count_outside(self, image: NDArray[np.generic], boxes: Sequence[Sequence[float]]) -> None:
        """Note the share of the bright energy of a tile outside of all boxes; tiles without boxes do not count."""
        power = np.square(np.abs(image), dtype=np.float64).sum(axis=0)
        if not boxes or not power.any():
            return
        inside = np.zeros(power.shape, dtype=bool)
        for x, y, width, height in boxes:
            inside[int(y) : math.ceil(y + height), int(x) : math.ceil(x + width)] = True
        bright = power >= BRIGHT * power.max()
        self.outside.append(float(power[bright & ~inside].sum() / power[bright].sum()))
        self.brightest_outside += not inside.flat[int(np.argmax(power))]


def _outline_mask(mask: NDArray[np.bool_]) -> JsonTable | None:
    """Box, area and run lengths of a mask; None where it is empty."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not rows.size:
        return None
    box = [columns[0], rows[0], columns[-1] - columns[0] + 1, rows[-1] - rows[0] + 1]
    return {"bbox": [int(v) for v in box], "area": int(mask.sum()), "segmentation": run_lengths(mask)}


def _outline_box(
    box: Sequence[float | None], corner: tuple[int, int], size: tuple[int, int]
) -> JsonTable | None:
    """Box of vertices within a tile, from the corner of its first pixel; None where it lies outside."""
    if any(value is None for value in box):
        return None
    bounds = np.array(box, dtype=np.float64) - np.array([*corner, *corner]) + np.array([0.0, 0.0, 1.0, 1.0])
    top, left = np.maximum(bounds[:2], 0.0)
    bottom, right = np.minimum(bounds[2:], size)
    if bottom <= top or right <= left:
        return None
    x, y, width, height = (round(float(v), 3) for v in (left, top, right - left, bottom - top))
    corners = [x, y, x + width, y, x + width, y + height, x, y + height]
    return {"bbox": [x, y, width, height], "area": round(width * height, 3), "segmentation": [corners]}


# bins of a histogram, width of its longest bar, notes and failures shown
_BINS, _BAR, _SHOWN = 10, 30, 12


def data_card(
    recipe: Recipe,
    labels: Sequence[JsonTable],
    mesh_parts: Mapping[str, str],
    documents: DetectionDocuments,
) -> str:
    """Markdown text of the data card.

    Parameters
    ----------
    recipe : of the data set
    labels : facts of every sample, in order of their numbers
    mesh_parts : part of every mesh; empty where parts are by scene
    documents : of all samples
    """
    title = recipe.text("dataset", "title") or recipe.path.stem
    parts = Counter(label["part"] for label in labels)
    tiles = len(recipe.corners)
    lines = [
        f"# {title}",
        "",
        f"{len(labels)} simulated images of {recipe.shape[0]} x {recipe.shape[1]} pixels"
        + (f", {tiles} tiles of {recipe.tile[0]} x {recipe.tile[1]} each" if tiles > 1 else "")
        + f", channels {', '.join(labels[0]['channels'])}; simulated by sarmitsuba {__version__}, not measured.",
        "",
        f"- recipe: `{recipe.path.name}`, SHA-256 {recipe.digest}",
        f"- seed: {recipe.seed}; sample n is made again by `python -m sarmitsuba dataset RECIPE --sample n -o OUT`",
        f"- licence: {recipe.text('dataset', 'licence') or 'not stated'}",
        "- parts by "
        + recipe.text("parts", "by")
        + ": "
        + ", ".join(f"{name} {parts.get(name, 0)}" for name in PART_NAMES),
        "",
    ]
    if mesh_parts:
        lines += ["## Meshes of the parts", ""]
        for part in PART_NAMES:
            names = [name for name, of in mesh_parts.items() if of == part]
            lines.append(f"- {part}: {', '.join(names) or 'none'}")
        lines.append("")
    lines += _shapes(labels) + _describe_draws(recipe, labels) + _physics(labels) + _errors(recipe, labels)
    lines += _describe_boxes(recipe, documents) + _failures(labels)
    lines += ["## Recipe", "", "```toml", read_text(recipe.path).rstrip(), "```", ""]
    return "\n".join(lines)


def _shapes(labels: Sequence[JsonTable]) -> list[str]:
    kinds = Counter(one["semantic_class"] for label in labels for one in label["objects"])
    if not kinds:
        return []
    lines = ["## Shapes", "", "| class | shapes |", "|---|---|"]
    lines += [f"| {kind} | {count} |" for kind, count in sorted(kinds.items())]
    angles = [one["aspect_deg"] for label in labels for one in label["objects"] if one["instance"]]
    return [*lines, "", *(_histogram("aspect_deg of shapes from meshes", angles) if angles else [])]


def _describe_draws(recipe: Recipe, labels: Sequence[JsonTable]) -> list[str]:
    lines = ["## Drawn values", ""]
    for name in labels[0]["facts"]:
        values = [label["facts"].get(name) for label in labels]
        section, _, key = name.partition(".")
        kind = recipe.sections[section].drawn.get(key) if section in recipe.sections else None
        if len(set(map(str, values))) == 1:
            if kind is not None and key in recipe.sections[section].given:
                lines += [f"- {name} = {values[0]}", ""]
            continue
        how = "" if kind is None or isinstance(kind, Fixed) else f" ({kind})"
        if any(isinstance(v, str | bool) for v in values):
            counts = Counter(str(v) for v in values)
            lines += [f"**{name}**{how}", "", "| value | samples |", "|---|---|"]
            lines += [f"| {value} | {count} |" for value, count in sorted(counts.items())] + [""]
        else:
            lines += _histogram(f"{name}{how}", [float(v) for v in values if v is not None])
    return lines


def _histogram(name: str, values: Sequence[float]) -> list[str]:
    """Table of counts, with the mean and the standard deviation."""
    spread = float(np.ptp(values))
    # values that differ by rounding alone have one bin
    distinct = len(set(values)) if spread > 1e-9 * float(np.abs(values).max()) else 1
    counts, edges = np.histogram(values, bins=min(_BINS, distinct))
    most = max(int(counts.max()), 1)
    lines = [
        f"**{name}**: mean {np.mean(values):.4g}, standard deviation {np.std(values):.4g}",
        "",
        "| from | to | samples | |",
        "|---|---|---|---|",
    ]
    for low, high, count in zip(edges[:-1], edges[1:], counts, strict=True):
        lines.append(f"| {low:.4g} | {high:.4g} | {count} | {'#' * round(_BAR * int(count) / most)} |")
    return [*lines, ""]


def _physics(labels: Sequence[JsonTable]) -> list[str]:
    """Effects and in how many samples each was on."""
    on = Counter[str]()
    known: dict[str, None] = {}
    for label in labels:
        for name, state in label["physics"].items():
            known[name] = None
            on[name] += _is_on(state)
    lines = ["## Physics", "", "| effect | samples with it on |", "|---|---|"]
    lines += [f"| {name} | {on[name]} of {len(labels)} |" for name in known]
    notes = Counter(note for label in labels for note in label["notes"])
    if notes:
        lines += ["", "Notes and warnings, with the number of samples:", ""]
        lines += [f"- {count}: {note}" for note, count in notes.most_common(_SHOWN)]
        if len(notes) > _SHOWN:
            lines.append(f"- {len(notes) - _SHOWN} more kinds of notes are not listed")
    return [*lines, ""]


def _is_on(state: object) -> bool:
    return bool(state.get("on")) if isinstance(state, Mapping) else bool(state)


def _errors(recipe: Recipe, labels: Sequence[JsonTable]) -> list[str]:
    lines = ["## Stated errors", ""]
    measured = [value for label in labels for value in label["sampling_error_db"].values()]
    every = recipe.whole("dataset", "error_every")
    if measured:
        lines += [
            f"Error by ray sampling, measured on every sample whose number is a multiple of {every} (energy of the "
            "error over that of the image, from a second image with other rays):",
            "",
            *_histogram("sampling error, dB", measured),
        ]
    else:
        lines += ["Error by ray sampling: not measured; `error_every` in [dataset] measures it.", ""]
    omitted = [value for label in labels for value in label["omitted_db"].values()]
    if omitted:
        lines += [
            "Error by theory: waves that metal sends and the program does not follow, energy over that of the image:",
            "",
            *_histogram("energy of omitted waves, dB", omitted),
        ]
    return lines


def _describe_boxes(recipe: Recipe, documents: DetectionDocuments) -> list[str]:
    """How much of the bright energy lies outside of the boxes."""
    lines = ["## Boxes", ""]
    if recipe.boxes_of_echoes:
        kinds = ", ".join(recipe.mechanisms) or "all mechanisms"
        lines += [f"COCO's boxes and masks bound the echoes of shapes: {kinds}.", ""]
    else:
        lines += [
            'COCO\'s boxes and masks bound surfaces; echoes of several bounces lie elsewhere. `boxes = "echoes"` in '
            "[labels] bounds echoes.",
            "",
        ]
    if not documents.outside:
        return [*lines, "No image has a box.", ""]
    n = len(documents.outside)
    return [
        *lines,
        f"Outside of all boxes lie {100.0 * float(np.mean(documents.outside)):.1f} % of the bright energy (pixels to "
        f"{-10.0 * math.log10(BRIGHT):.0f} dB below the brightest; mean of {n} images with boxes), and the brightest "
        f"pixel of {documents.brightest_outside} of {n}.",
        "",
    ]


def _failures(labels: Sequence[JsonTable]) -> list[str]:
    reasons = Counter(reason for label in labels for reason in label["failures"])
    if not reasons:
        return ["## Failed draws", "", "None.", ""]
    lines = ["## Failed draws", "", f"{sum(reasons.values())} draws failed and were replaced:", ""]
    lines += [f"- {count}: {reason}" for reason, count in reasons.most_common(_SHOWN)]
    if len(reasons) > _SHOWN:
        lines.append(f"- {len(reasons) - _SHOWN} more kinds are not listed")
    return [*lines, ""]


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
    """Cost of a run, known before it.

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
    ready : called before the first sample with the cost of the run
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
        temporary.write_text(data_card(recipe, labels, mesh_parts, documents), encoding="utf-8")
    with atomic_path(folder / STORE) as temporary:
        write_store(temporary, recipe, drawer.classes, journal)
