"""Finished samples as records of a journal: facts as JSON, arrays as bytes behind each other."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.apps.datasets.sample import Sample, SampleObject
from sarmitsuba.machine.encoding import to_json
from sarmitsuba.machine.journal import Journal, Label, fits, is_echo

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
    """What the records of one data set are like; as `accept` of its journal.

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
