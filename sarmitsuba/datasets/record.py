"""Finished samples as records of a journal: facts as JSON, arrays as bytes behind each other."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.datasets.sample import Sample, SampleObject
from sarmitsuba.io.encoding import to_json
from sarmitsuba.io.journal import Journal

_IMAGE = "image"
# of a sample that are arrays, or files of their own
_APART = ("image", "layers", "raw")


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


def packed(sample: Sample) -> tuple[JsonTable, NDArray[np.uint8]]:
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


def append(journal: Journal, sample: Sample) -> int:
    """Add a sample to a journal; its bytes."""
    label, data = packed(sample)
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
