"""HDF5 files of an image's labels; layout in docs/files.md."""

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.errors import DataError
from sarmitsuba.files import hdf5_file as groups
from sarmitsuba.files.hdf5_file import read_grid, read_hdf5, write_grid, write_hdf5
from sarmitsuba.machine.regular_files import check_unpacked
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.pixel_labels import LabelLayer, LabelledInstance, Labels

_NAME = re.compile(r"[A-Za-z]\w{0,63}", re.ASCII)
# (unit, description) of the columns of instances that are numbers
_COLUMNS: Mapping[str, tuple[str, str]] = {
    "number": ("1", "code of the instance in layers of instances"),
    "box": ("1", "first row, first column, last row, last column; -1: nothing of it is seen"),
    "oriented_box": ("1", "row and column of the corners of the smallest rectangle about it; NaN: unseen"),
    "pixels": ("1", "number of pixels that it dominates"),
    "shadow_pixels": ("1", "number of pixels in its shadow"),
    "visible_share": ("1", "share of its surface that the antenna sees, by area"),
    "energy_share": ("1", "share of the energy of the image"),
}
_TEXTS = ("name", "material", "semantic_class")
_WIDTHS: Mapping[str, tuple[int, ...]] = {"box": (4,), "oriented_box": (4, 2)}


def write_labels(labels: Labels, path: Path | str) -> None:
    """Write labels, positions in the frame of the scene's file.

    Raises
    ------
    DataError
        A layer's name is not a letter followed by up to 63 letters, digits and underscores.
    OutputError
        The file cannot be written.
    """
    for name in labels.layers:
        if not _NAME.fullmatch(name):
            raise DataError(f'labels: layer "{name}": give a name of letters, digits and underscores')

    def fill(file: h5py.File) -> None:
        write_grid(file, labels.grid)
        for axis in ("azimuth", "range"):
            file[f"grid/{axis}"].make_scale(axis)
        group = file.create_group("labels")
        group.attrs["description"] = "labels of the image's pixels; names of codes in the group codes"
        for name, layer in labels.layers.items():
            _write_layer(file, name, layer)
        table = file.create_group("instances")
        for column, (unit, description) in _COLUMNS.items():
            rows = np.array([getattr(one, column) for one in labels.instances])
            table[column] = rows.reshape(-1, *_WIDTHS.get(column, ()))
            table[column].attrs["unit"], table[column].attrs["description"] = unit, description
        for column in _TEXTS:
            _write_texts(table, column, [getattr(one, column) for one in labels.instances])
        _write_texts(file, "notes", labels.notes)

    write_hdf5(path, "labels", fill)


def _write_layer(file: h5py.File, name: str, layer: LabelLayer) -> None:
    made = file["labels"].create_dataset(
        name, data=layer.values, compression="gzip", shuffle=True, chunks=True if layer.values.size else None
    )
    axes = ("azimuth", "range", "part")[: layer.values.ndim]
    made.attrs["axes"], made.attrs["unit"], made.attrs["description"] = (
        ", ".join(axes),
        layer.unit or "1",
        layer.description,
    )
    if layer.parts:
        made.attrs["parts"] = list(layer.parts)
    for i, axis in enumerate(axes):
        made.dims[i].label = axis
        if i < 2:
            made.dims[i].attach_scale(file[f"grid/{axis}"])
    if layer.codes:
        group = file.create_group(f"codes/{name}")
        group["value"] = np.array(list(layer.codes), dtype=np.int64)
        _write_texts(group, "name", list(layer.codes.values()))


def _write_texts(group: h5py.Group, name: str, texts: Sequence[str]) -> None:
    group.create_dataset(
        name, data=[text.encode("utf-8", "replace") for text in texts], dtype=h5py.string_dtype()
    )


def read_labels(path: Path | str) -> Labels:
    """Read labels written by :func:`write_labels`.

    Raises
    ------
    DataError
        The file is missing, holds something else, is damaged or unsafe: one line.
    """

    def load(file: h5py.File, _planes: bool) -> Labels:
        grid = read_grid(file)
        group = groups.group_of(file, "labels")
        sets = [groups.dataset(group, str(name)) for name in group]
        size = sum(math.prod(one.shape) * one.dtype.itemsize for one in sets)
        check_unpacked(size, file.id.get_filesize())
        layers = {str(name): _read_layer(file, str(name), grid) for name in group}
        table = groups.group_of(file, "instances")
        texts = {column: _texts(table, column) for column in _TEXTS}
        columns = {column: groups.dataset(table, column)[()] for column in _COLUMNS}
        count = len(texts["name"])
        for column, rows in columns.items():
            if rows.dtype.kind not in "fiu" or rows.shape != (count, *_WIDTHS.get(column, ())):
                raise DataError(f"/instances/{column} is {rows.dtype} of shape {rows.shape}")
        if any(len(rows) != count for rows in texts.values()):
            raise DataError("/instances: columns of several lengths")
        instances = tuple(_instance(columns, texts, i) for i in range(count))
        return Labels(grid, layers, instances, _texts(file, "notes"))

    return read_hdf5(path, "labels", "labels", load)


def _read_layer(file: h5py.File, name: str, grid: ImageGrid) -> LabelLayer:
    if not _NAME.fullmatch(name):
        raise DataError(f"/labels: {name[:64]!r} is no name of a layer")
    found = groups.dataset(file["labels"], name)
    if found.dtype.kind not in "fiu" or found.shape[:2] != grid.shape:
        raise DataError(f"/labels/{name} is {found.dtype} of shape {found.shape}, on a grid of {grid.shape}")
    (unit,), (description,) = (_text_attribute(found, key) for key in ("unit", "description"))
    parts = _text_attribute(found, "parts") if "parts" in found.attrs else ()
    codes: dict[int, str] = {}
    if groups.has(file, "codes") and groups.has(groups.group_of(file, "codes"), name):
        group = groups.group_of(groups.group_of(file, "codes"), name)
        values, names = groups.numbers(group, "value"), _texts(group, "name")
        if values.shape != (len(names),):
            raise DataError(f"/codes/{name}: {values.shape} values and {len(names)} names")
        codes = {int(value): text for value, text in zip(values, names, strict=True)}
    return LabelLayer(found[()], "" if unit == "1" else unit, description, codes, parts)


def _text_attribute(found: h5py.Dataset, key: str) -> tuple[str, ...]:
    value = np.atleast_1d(found.attrs.get(key))
    if not all(isinstance(text, str) for text in value.tolist()):
        raise DataError(f"{found.name} has no attribute {key}, or it is not a text")
    return tuple(str(text) for text in value.tolist())


def _texts(group: h5py.Group, name: str) -> tuple[str, ...]:
    rows = np.atleast_1d(groups.dataset(group, name).asstr()[()])
    if rows.ndim != 1:
        raise DataError(f"{group.name.rstrip('/')}/{name} is not a list of texts")
    return tuple(str(text) for text in rows.tolist())


def _instance(
    columns: Mapping[str, NDArray[np.generic]], texts: Mapping[str, tuple[str, ...]], i: int
) -> LabelledInstance:
    box = tuple(int(value) for value in columns["box"][i])
    given: dict[str, object] = {name: rows[i] for name, rows in texts.items()}
    for field in dataclasses.fields(LabelledInstance):
        if field.name in columns and field.name not in _WIDTHS:
            given[field.name] = columns[field.name][i].item()
    return LabelledInstance(
        **given,  # type: ignore[arg-type]  # columns of the declared types
        box=box,  # type: ignore[arg-type]  # four, by its width
        oriented_box=np.asarray(columns["oriented_box"][i], dtype=np.float64),
    )
