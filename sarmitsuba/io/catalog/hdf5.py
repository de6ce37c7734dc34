"""HDF5 files of raw data and images, with every number needed to use them again.

HDF5 because it is a published standard that MATLAB, Julia, IDL, C and Python read without this package,
stores its own structure and units, and reads a range of pulses without the rest (chunks). Complex numbers are
the usual compound of ``r`` and ``i``.

The layout mirrors the dataclasses: a dataclass is a group whose attribute ``class`` names it, its fields are
datasets of the same names with an attribute ``unit``; ``layers`` is a group of equally long columns;
``metadata`` is JSON.
"""

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from sarmitsuba.echo.raw import Layer, RawData
from sarmitsuba.errors import DataError
from sarmitsuba.image.sar_image import ImageGrid, SarImage
from sarmitsuba.io.atomic import atomic_path
from sarmitsuba.io.encoding import to_json
from sarmitsuba.io.formats import FORMATS, FileFormat
from sarmitsuba.io.guarded import GuardedFile
from sarmitsuba.radar.antenna import Antenna, Pointing
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.waveform import Waveform

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

FORMAT_VERSION = 1
CONVENTION = "time exp(+j w t); a point at slant range R has the phase exp(-j 4 pi center_frequency R / c)"

_CLASSES = {
    cls.__name__: cls
    for cls in (Antenna, ImageGrid, Pointing, Radar, RawData, ReceiveWindow, SarImage, Track, Waveform)
}

_UNITS = {
    "aim_point": "m",
    "along": "1",
    "across": "1",
    "azimuth": "m",
    "azimuth_axis": "1",
    "azimuth_beamwidth": "rad",
    "azimuth_resolution_cell": "m",
    "bandwidth": "Hz",
    "boresight": "1",
    "center_frequency": "Hz",
    "elevation_axis": "1",
    "elevation_beamwidth": "rad",
    "gain": "1",
    "half_aperture": "1",
    "height": "m",
    "incidence_angle": "rad",
    "losses": "1",
    "noise_temperature": "K",
    "origin": "m",
    "position": "m",
    "pulse_width": "s",
    "range": "m",
    "range_resolution_cell": "m",
    "sample_spacing": "m",
    "start_range": "m",
    "time": "s",
    "transmit_power": "W",
    "velocity": "m/s",
    "wavelength": "m",
}
_DATA = {  # axes and unit of the large array
    "RawData": ("layer, pulse, fast sample", "sqrt(W)"),
    "SarImage": ("layer, azimuth, range", "m (square root of the radar cross section)"),
}
_CHUNK_BYTES = 1 << 20  # HDF5's default chunk cache holds one such chunk

T = TypeVar("T", RawData, SarImage)


def write(path: Path | str, content: RawData | SarImage) -> None:
    """Write raw data or an image; the file appears whole or not at all."""
    with atomic_path(path) as temporary, GuardedFile(temporary) as guarded:
        try:
            with h5py.File(guarded, "w") as file:
                file.attrs["format"] = f"sarmitsuba {type(content).__name__}"
                file.attrs["format_version"] = FORMAT_VERSION
                file.attrs["phase_convention"] = CONVENTION
                _write_dataclass(file, content)
        finally:
            if guarded.error is not None:
                raise guarded.error


def read_raw(path: Path | str) -> RawData:
    """Read raw data written by :func:`write`."""
    return _read(path, RawData)


def read_image(path: Path | str) -> SarImage:
    """Read an image written by :func:`write`."""
    return _read(path, SarImage)


def _read(path: Path | str, cls: type[T]) -> T:
    path = Path(path)
    wanted = "raw data" if cls is RawData else "an image"
    if not path.is_file():
        raise DataError(f"{path}: no such file; give the {wanted} file that `sarmitsuba render` wrote")
    try:
        with h5py.File(path, "r") as file:
            found = file.attrs.get("class")
            if found != cls.__name__:
                raise DataError(f"{path}: holds {found or 'other HDF5 data'}, not {wanted} of sarmitsuba")
            version = int(file.attrs.get("format_version", 0))
            if version > FORMAT_VERSION:
                raise DataError(
                    f"{path}: format version {version} is newer than {FORMAT_VERSION}; update sarmitsuba"
                )
            value = _read_dataclass(file)
    except (OSError, KeyError, TypeError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise DataError(f"{path}: cannot read {wanted}: {reason}") from error
    assert isinstance(value, cls)
    return value


def _write_dataclass(group: h5py.Group, content: "DataclassInstance") -> None:
    group.attrs["class"] = type(content).__name__
    for field in dataclasses.fields(content):
        value = getattr(content, field.name)
        if value is None:
            continue
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            _write_dataclass(group.create_group(field.name), value)
        elif field.name == "layers":
            _write_layers(group.create_group("layers"), value)
        elif isinstance(value, Mapping):
            group[field.name] = json.dumps(to_json(value))
            group[field.name].attrs["encoding"] = "JSON"
        elif isinstance(value, (tuple, list)):
            group[field.name] = list(value)
        elif isinstance(value, np.ndarray) and value.ndim == 3:
            _write_samples(group, field.name, value, type(content).__name__)
        else:
            group[field.name] = value
        if field.name in _UNITS:
            group[field.name].attrs["unit"] = _UNITS[field.name]


def _write_samples(group: h5py.Group, name: str, value: NDArray[np.generic], class_name: str) -> None:
    row_bytes = max(1, value.shape[2] * value.itemsize)
    rows = int(np.clip(_CHUNK_BYTES // row_bytes, 1, max(1, value.shape[1])))
    chunks = (1, rows, value.shape[2]) if value.size else None
    # not compressed: echoes and speckle are noise to a byte compressor
    dataset = group.create_dataset(name, data=value, chunks=chunks)
    dataset.attrs["axes"], dataset.attrs["unit"] = _DATA.get(class_name, ("", ""))


def _write_layers(group: h5py.Group, layers: tuple[Layer, ...]) -> None:
    for field in dataclasses.fields(Layer):
        group[field.name] = [getattr(layer, field.name) for layer in layers]


def _read_dataclass(group: h5py.Group) -> object:
    cls = _CLASSES[group.attrs["class"]]
    names = {field.name for field in dataclasses.fields(cls)}
    values: dict[str, Any] = {name: _read_value(name, item) for name, item in group.items() if name in names}
    return cls(**values)


def _read_value(name: str, item: h5py.Group | h5py.Dataset) -> Any:
    if name == "layers":
        columns = {column: _plain(dataset) for column, dataset in item.items()}
        return tuple(
            Layer(**dict(zip(columns, row, strict=True))) for row in zip(*columns.values(), strict=True)
        )
    if isinstance(item, h5py.Group):
        return _read_dataclass(item)
    if item.attrs.get("encoding") == "JSON":
        return json.loads(item.asstr()[()])
    return _plain(item)


def _plain(dataset: h5py.Dataset) -> Any:
    """A scalar as Python's own type, texts as str, anything else as the array it was."""
    if h5py.check_string_dtype(dataset.dtype) is not None:
        texts = dataset.asstr()[()]
        return texts if isinstance(texts, str) else tuple(str(text) for text in texts)
    value = dataset[()]
    return value.item() if dataset.shape == () else value


FORMATS.register(
    FileFormat(
        "hdf5",
        "everything, to be read again; the standard of scientific data",
        (".h5", ".hdf5"),
        write_raw=write,
        read_raw=read_raw,
        write_image=write,
        read_image=read_image,
    )
)

__all__ = ["CONVENTION", "FORMAT_VERSION", "read_image", "read_raw", "write"]
