"""The file formats of raw data and images, one module each, found by name or by the file's suffix."""

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from sarmitsuba.echo.raw import RawData
from sarmitsuba.errors import DataError
from sarmitsuba.image.sar_image import SarImage


@dataclass(frozen=True)
class FileFormat:
    """A way to write one kind of content; the module is imported on first use.

    Parameters
    ----------
    name : e.g. ``hdf5``
    content : ``raw`` or ``image``
    suffixes : of its files, lower case, with the dot
    module : where the functions live
    writer : name of a function ``(path, content) -> None``
    reader : name of a function ``(path) -> content``; empty when the format is only written
    """

    name: str
    content: Literal["raw", "image"]
    suffixes: tuple[str, ...]
    module: str
    writer: str = "write"
    reader: str = ""


FORMATS: tuple[FileFormat, ...] = (
    FileFormat("hdf5", "raw", (".h5", ".hdf5"), "sarmitsuba.io.hdf5", reader="read_raw"),
    FileFormat("hdf5", "image", (".h5", ".hdf5"), "sarmitsuba.io.hdf5", reader="read_image"),
    FileFormat("openexr", "image", (".exr",), "sarmitsuba.io.openexr"),
)


def find_format(path: Path, content: Literal["raw", "image"], name: str | None = None) -> FileFormat:
    """Format of the given name, or the one that the path's suffix tells."""
    known = [f for f in FORMATS if f.content == content]
    for entry in known:
        if entry.name == name or (name is None and path.suffix.lower() in entry.suffixes):
            return entry
    choices = ", ".join(f"{entry.name} ({' '.join(entry.suffixes)})" for entry in known)
    asked = f"format {name!r}" if name else f"suffix {path.suffix!r}"
    raise DataError(f"{path}: no {content} format for the {asked}; there are {choices}")


def write_raw(raw: RawData, path: Path | str, *, format: str | None = None) -> None:
    """Write raw data in the format of that name, or of the path's suffix."""
    _write(raw, Path(path), find_format(Path(path), "raw", format))


def write_image(image: SarImage, path: Path | str, *, format: str | None = None) -> None:
    """Write an image in the format of that name, or of the path's suffix."""
    _write(image, Path(path), find_format(Path(path), "image", format))


def read_raw(path: Path | str, *, format: str | None = None) -> RawData:
    """Read raw data."""
    value = _read(Path(path), find_format(Path(path), "raw", format))
    assert isinstance(value, RawData)
    return value


def read_image(path: Path | str, *, format: str | None = None) -> SarImage:
    """Read an image."""
    value = _read(Path(path), find_format(Path(path), "image", format))
    assert isinstance(value, SarImage)
    return value


def _write(content: RawData | SarImage, path: Path, entry: FileFormat) -> None:
    getattr(importlib.import_module(entry.module), entry.writer)(path, content)


def _read(path: Path, entry: FileFormat) -> Any:
    if not entry.reader:
        raise DataError(f"{path}: the format {entry.name} can be written but not read; read the HDF5 file")
    return getattr(importlib.import_module(entry.module), entry.reader)(path)


__all__ = ["FORMATS", "FileFormat", "find_format", "read_image", "read_raw", "write_image", "write_raw"]
