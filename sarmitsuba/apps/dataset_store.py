"""HDF5 file of a data set (images, labels, drawn values, shapes), and the records from which it is made.

A finished sample is a record of a journal: facts as JSON, arrays as bytes behind each other.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from sarmitsuba.apps.dataset_recipe import PART_NAMES, Recipe
from sarmitsuba.apps.dataset_sample import Sample, SampleObject
from sarmitsuba.machine.encoding import to_json
from sarmitsuba.machine.journal import Journal, Label, fits, is_echo
from sarmitsuba.machine.regular_files import read_text
from sarmitsuba.version import __version__

_IMAGE = "image"
# of a sample that are arrays, or files of their own
_APART = ("image", "layers", "raw")


_OBJECT = {
    **{"name": str, "semantic_class": str, "instance": str, "code": int, "position": [(float, None)] * 3},
    **{"heading_deg": float, "aspect_deg": float, "scale": float, "box": [(float, None)] * 4},
    **{"visible_share": (float, None), "energy_share": (float, None)},
}
_LAYER = {"unit": str, "description": str, "parts": [str], "codes": [[int, str]]}
_FORM = {
    **{"number": int, "part": str, "attempt": int, "failures": [str], "channels": [str], "notes": [str]},
    **{
        "layer_facts": {str: _LAYER},
        "named_shapes": [[int, str, str]],
        "objects": [_OBJECT],
        "seconds": float,
    },
    **{"facts": {str: (float, str, bool, None)}, "physics": {str: object}, "sampling_error_db": {str: float}},
    **{"omitted_db": {str: float}, "arrays": [[str, str, [int]]]},
}
# kinds of NumPy's types that images and labels have
_KINDS = "biufc"


# names and values of JSON, read back
JsonTable = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class SampleRecord:
    """A sample as read back.

    Parameters
    ----------
    label : its facts
    arrays : image and layers of labels, by name
    """

    label: JsonTable
    arrays: Mapping[str, NDArray[np.generic]]

    @property
    def image(self) -> NDArray[np.generic]:
        """(channels, rows, columns) complex64."""
        return self.arrays[_IMAGE]

    @property
    def layers(self) -> dict[str, NDArray[np.generic]]:
        """Labels by name."""
        return {name: values for name, values in self.arrays.items() if name != _IMAGE}

    @property
    def objects(self) -> Sequence[JsonTable]:
        """Shapes."""
        found: Sequence[JsonTable] = self.label["objects"]
        return found


def pack_sample(sample: Sample) -> tuple[JsonTable, NDArray[np.uint8]]:
    """Label and bytes of a sample."""
    arrays = {_IMAGE: sample.image, **sample.layers}
    label = {f.name: getattr(sample, f.name) for f in fields(sample) if f.name not in _APART}
    label["objects"] = [_plain(shape) for shape in sample.objects]
    label["arrays"] = [[name, a.dtype.str, list(a.shape)] for name, a in arrays.items()]
    parts = [np.ascontiguousarray(a).reshape(-1).view(np.uint8) for a in arrays.values()]
    plain = to_json(label)
    assert isinstance(plain, dict)
    return plain, np.concatenate(parts)


def _plain(shape: SampleObject) -> JsonTable:
    out = dict(vars(shape))
    for name in ("position", "box"):
        out[name] = [None if math.isnan(v) else float(v) for v in out[name]]
    for name in ("visible_share", "energy_share"):
        out[name] = None if math.isnan(out[name]) else out[name]
    return out


@dataclass(eq=False)
class SampleForm:
    """Form of the records of one data set; as `accept` of its journal.

    Parameters
    ----------
    numbers, parts, classes : that there are
    shape : rows and columns of an image
    """

    numbers: int
    parts: Sequence[str]
    classes: Sequence[str]
    shape: tuple[int, int]
    _first: JsonTable | None = None

    def __call__(self, label: Label, payload: bytes) -> bool:
        """Whether a record is a sample of this data set, with the layers of the first one."""
        if not fits(label, _FORM) or label["number"] >= self.numbers or label["part"] not in self.parts:
            return False
        kinds = {one["semantic_class"] for one in label["objects"]}
        if not kinds <= set(self.classes) or not self._has_arrays(label["arrays"], payload):
            return False
        name, kind, shape = label["arrays"][0]
        size = 8 * math.prod(shape)
        if name != _IMAGE or kind != "<c8" or shape != [len(label["channels"]), *self.shape]:
            return False
        if {name for name, *_ in label["arrays"][1:]} != label["layer_facts"].keys():
            return False
        if self._first is not None and label["arrays"][1:] != self._first["arrays"][1:]:
            return False
        self._first = self._first or label
        return is_echo(payload[:size])

    def _has_arrays(self, arrays: Sequence[tuple[str, str, list[int]]], payload: bytes) -> bool:
        """Whether the arrays have types of numbers, the image's size, and the payload's length together."""
        size = 0
        for i, (_, kind, shape) in enumerate(arrays):
            try:
                dtype = np.dtype(kind)
            except TypeError:
                return False
            if dtype.kind not in _KINDS or tuple(shape[:2] if i else shape[1:]) != self.shape:
                return False
            size += dtype.itemsize * math.prod(shape)
        return bool(arrays) and size == len(payload)


def append(journal: Journal, sample: Sample) -> int:
    """Add a sample to a journal; its bytes."""
    label, data = pack_sample(sample)
    journal.append(label, data)
    return int(data.nbytes)


def read_record(journal: Journal, index: int) -> SampleRecord:
    """Sample of a place in a journal."""
    label = journal.labels[index]
    data = journal.payload(index, np.uint8)
    arrays: dict[str, NDArray[np.generic]] = {}
    start = 0
    for name, kind, shape in label["arrays"]:
        size = np.dtype(kind).itemsize * math.prod(shape)
        arrays[name] = data[start : start + size].view(kind).reshape(shape)
        start += size
    return SampleRecord(label, arrays)


FILE_KIND = "sarmitsuba dataset"
# zip level of labels: they shrink to a tenth, and complex images do not shrink
_ZIP = 4
_OBJECT_NUMBERS = {
    "position": ("m", "middle of the shape's bounds, frame of the scene", 3),
    "heading_deg": ("deg", "direction of the shape's x axis, from east to north", 1),
    "aspect_deg": ("deg", "direction of the radar from the shape's x axis, seen from above", 1),
    "scale": ("1", "factor of the mesh's lengths", 1),
    "box": ("pixel", "first row and column, last row and column of its vertices in the image; NaN: none", 4),
    "visible_share": ("1", "share of its surface that the antenna sees; NaN without a layer of echoes", 1),
    "energy_share": ("1", "share of the energy of one look's image; NaN without a layer of echoes", 1),
}


def records(journal: Journal, numbers: Sequence[int] | None = None) -> Iterator[SampleRecord]:
    """Finished samples in order of their numbers."""
    place = {label["number"]: i for i, label in enumerate(journal.labels) if "number" in label}
    for number in sorted(place) if numbers is None else numbers:
        yield read_record(journal, place[number])


def write_store(path: Path, recipe: Recipe, classes: Sequence[str], journal: Journal) -> None:
    """Write the samples of a journal; the same bytes in whatever order they were made.

    Parameters
    ----------
    path : of the file, written from its start
    recipe : of the samples
    classes : semantic classes of its shapes
    journal : of finished samples
    """
    first = next(records(journal))
    count = sum("number" in label for label in journal.labels)
    with h5py.File(path, "w") as file:
        file.attrs["kind"], file.attrs["version"] = FILE_KIND, __version__
        file.attrs["recipe"], file.attrs["recipe_sha256"] = read_text(recipe.path), recipe.digest
        file.attrs["seed"], file.attrs["licence"] = recipe.seed, recipe.text("dataset", "licence")
        file.attrs["classes"] = list(classes)
        file.attrs["parts"] = list(PART_NAMES)
        _make_arrays(file, recipe, first, count * len(recipe.corners))
        table = _Columns(classes)
        shapes: list[tuple[int, int, str, str]] = []
        row = 0
        for record in records(journal):
            shapes += [(record.label["number"], *shape) for shape in record.label["named_shapes"]]
            for tile, (top, left) in enumerate(recipe.corners):
                window = (slice(top, top + recipe.tile[0]), slice(left, left + recipe.tile[1]))
                file["images"][row] = record.image[:, window[0], window[1]]
                for name, values in record.layers.items():
                    file[f"labels/{name}"][row] = values[window]
                table.add(record, row, tile, (top, left))
                row += 1
        table.write(file)
        if shapes:
            _write_shapes(file, shapes)


def _make_arrays(file: h5py.File, recipe: Recipe, first: SampleRecord, rows: int) -> None:
    tile = recipe.tile
    _add(
        file,
        "images",
        "m",
        "square root of radar cross section: row, channel, azimuth, range",
        shape=(rows, first.image.shape[0], *tile),
        chunks=(1, first.image.shape[0], *tile),
        dtype=np.complex64,
    )
    for name, values in first.layers.items():
        shape, facts = (*tile, *values.shape[2:]), first.label["layer_facts"][name]
        made = _add(
            file,
            f"labels/{name}",
            facts["unit"],
            f"{facts['description']} (docs/labels.md): row, azimuth, range",
            shape=(rows, *shape),
            chunks=(1, *shape),
            dtype=values.dtype,
            compression="gzip",
            compression_opts=_ZIP,
        )
        if facts["parts"]:
            made.attrs["parts"] = list(facts["parts"])
        if facts["codes"]:
            made.attrs["codes"] = np.array([code for code, _ in facts["codes"]], dtype=np.int32)
            made.attrs["names"] = [text for _, text in facts["codes"]]


def _write_shapes(file: h5py.File, shapes: Sequence[tuple[int, int, str, str]]) -> None:
    """Names of the codes in layers of shapes, sample by sample."""
    sample, code, name, kind = zip(*shapes, strict=True)
    meanings = {"sample": "number of the sample", "code": "in its layers of shapes"}
    for column, values in (("sample", sample), ("code", code)):
        _add(file, f"shapes/{column}", "", meanings[column], data=np.array(values, dtype=np.int32))
    _add(file, "shapes/name", "", "of the shape in the scene", data=_texts(name))
    _add(file, "shapes/class", "", "semantic class, empty without one", data=_texts(kind))


def _add(group: h5py.Group, name: str, unit: str, description: str, **how: object) -> h5py.Dataset:
    made = group.create_dataset(name, **how)
    made.attrs["unit"], made.attrs["description"] = unit, description
    return made


class _Columns:
    """Columns of rows and of shapes."""

    def __init__(self, classes: Sequence[str]) -> None:
        self._code = {name: i for i, name in enumerate(classes)}
        self._rows: dict[str, list[object]] = {
            name: [] for name in ("sample", "tile", "first_row", "first_column", "part", "target_class")
        }
        self._instance: list[str] = []
        self._channels: list[str] = []
        self._facts: list[JsonTable] = []
        self._objects: dict[str, list[object]] = {
            name: [] for name in ("row", "class", "instance", "name", "code", *_OBJECT_NUMBERS)
        }

    def add(self, record: SampleRecord, row: int, tile: int, corner: tuple[int, int]) -> None:
        """One stored image."""
        label = record.label
        target = next((o for o in record.objects if o["instance"]), None)
        values = {
            "sample": label["number"],
            "tile": tile,
            "first_row": corner[0],
            "first_column": corner[1],
            "part": PART_NAMES.index(label["part"]),
            "target_class": self._code[target["semantic_class"]] if target else -1,
        }
        for name, value in values.items():
            self._rows[name].append(value)
        self._channels.append(",".join(label["channels"]))
        self._instance.append(target["instance"] if target else "")
        self._facts.append(label["facts"])
        for one in record.objects:
            shift = np.array([corner[0], corner[1]] * 2)
            box = np.array([np.nan if v is None else v for v in one["box"]]) - shift
            self._objects["row"].append(row)
            self._objects["class"].append(self._code[one["semantic_class"]])
            for name in ("instance", "name", "code", "position", "heading_deg", "aspect_deg", "scale"):
                self._objects[name].append(one[name])
            self._objects["box"].append(box)
            for name in ("visible_share", "energy_share"):
                self._objects[name].append(np.nan if one[name] is None else one[name])

    def write(self, file: h5py.File) -> None:
        """All columns."""
        meanings = {
            "sample": "number of the sample",
            "tile": "number of the tile in its image",
            "first_row": "first row of the tile in its image",
            "first_column": "first column of the tile in its image",
            "part": "index into the attribute parts",
            "target_class": "index into the attribute classes of the first shape of a mesh; -1: none",
        }
        for name, meaning in meanings.items():
            _add(file, f"rows/{name}", "", meaning, data=np.array(self._rows[name], dtype=np.int32))
        _add(file, "rows/target_instance", "", "mesh of the first shape", data=_texts(self._instance))
        _add(
            file, "rows/channels", "", "polarisations of images, in their order", data=_texts(self._channels)
        )
        for name in self._facts[0]:
            values = [facts.get(name) for facts in self._facts]
            text = any(isinstance(v, str) for v in values)
            data = (
                _texts(["" if v is None else str(v) for v in values])
                if text
                else np.array([np.nan if v is None else float(v) for v in values])
            )
            _add(file, f"drawn/{name}", "", "parameter of the recipe, or fact of the image", data=data)
        self._write_objects(file.create_group("objects"))

    def _write_objects(self, group: h5py.Group) -> None:
        rows = self._objects
        codes = {
            "row": "place of the image in images",
            "class": "index into the attribute classes",
            "code": "of the shape in layers of shapes; 0 without such a layer",
        }
        for name, meaning in codes.items():
            _add(group, name, "", meaning, data=np.array(rows[name], dtype=np.int32))
        for name, meaning in (("instance", "mesh in the folder"), ("name", "in the scene")):
            _add(group, name, "", meaning, data=_texts([str(value) for value in rows[name]]))
        for name, (unit, meaning, parts) in _OBJECT_NUMBERS.items():
            data = np.array(rows[name], dtype=np.float64)
            _add(group, name, unit, meaning, data=data.reshape(-1, parts) if parts > 1 else data)


def _texts(values: Sequence[str]) -> NDArray[np.object_]:
    return np.array(list(values), dtype=h5py.string_dtype())
