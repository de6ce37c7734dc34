"""Registry of the file formats of raw data and images, found by name or by the file's suffix."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.core.registry import Registry
from sarmitsuba.machine.regular_files import describe_missing
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.validity import check_radar, check_request
from sarmitsuba.signal.image import SarImage, check_image
from sarmitsuba.signal.raw_data import RawData

Content = Literal["raw", "image"]


@dataclass(frozen=True)
class FileFormat:
    """File format with its write and read functions; None: not available.

    Writers should use :func:`sarmitsuba.machine.atomic.atomic_path`, so that a file appears completely or not at all;
    readers raise a ``DataError`` for a file that is damaged or of another format.

    Parameters
    ----------
    name : e.g. ``hdf5``
    doc : purpose in one line
    suffixes : of its files, lower case, with the dot
    write_raw, read_raw : functions for raw data
    write_image, read_image : functions for images
    folders : whether ``read_raw`` also accepts a folder of files of one recording
    per_channel : whether an image of several channels is written to one file per channel, ``NAME_HH.suffix``
    objection : reason, with a remedy, why an image of a radar on a kind of grid (``slant``, ``ground``) cannot be
        written, for checks before a run; empty where it can
    """

    name: str
    doc: str
    suffixes: tuple[str, ...]
    write_raw: Callable[[Path, RawData], None] | None = None
    read_raw: Callable[[Path], RawData] | None = None
    write_image: Callable[[Path, SarImage], None] | None = None
    read_image: Callable[[Path], SarImage] | None = None
    folders: bool = False
    per_channel: bool = False
    objection: Callable[[Radar, str], str] | None = None

    def names(self, stem: str, channels: Sequence[str]) -> tuple[str, ...]:
        """File names for an image of these channels."""
        ends = [f"_{channel}" for channel in channels] if self.per_channel and len(channels) > 1 else [""]
        return tuple(f"{stem}{end}{self.suffixes[0]}" for end in ends)

    def holds(self, content: Content) -> bool:
        """Whether it can write or read that content."""
        both = {"raw": (self.write_raw, self.read_raw), "image": (self.write_image, self.read_image)}
        return any(both[content])


FORMATS: Registry[FileFormat] = Registry("file format", FileFormat, "sarmitsuba.files.catalog")


def find_format(path: Path, content: Content, name: str | None = None) -> FileFormat:
    """Format of the given name, or of the path's suffix.

    Raises
    ------
    DataError
        No format for that content.
    """
    known = [entry for entry in FORMATS if entry.holds(content)]
    suffixes = {path.suffix.lower()}
    if content == "raw" and os.path.isdir(path):
        known = [entry for entry in known if entry.folders]
        suffixes = {member.suffix.lower() for member in path.iterdir()}
        if name is None and os.path.isfile(path / "raw.h5"):
            raise DataError(f"{path}: is the folder of a run; give its file {path / 'raw.h5'}")
        if name is None and not any(suffixes & set(entry.suffixes) for entry in known):
            raise DataError(
                f"{path}: is a folder without any {' or '.join(s for entry in known for s in entry.suffixes)} file"
            )
    for entry in known:
        if entry.name == name or (name is None and suffixes & set(entry.suffixes)):
            return entry
    choices = ", ".join(f"{entry.name} ({' '.join(entry.suffixes)})" for entry in known)
    asked = f"format {name!r}" if name else f"suffix {path.suffix!r}"
    raise DataError(f"{path}: no {content} format for the {asked}; there are {choices}")


def write_raw(raw: RawData, path: Path | str, *, format: str | None = None) -> None:
    """Write raw data in the format of that name, or of the path's suffix."""
    path = Path(path)
    entry = find_format(path, "raw", format)
    if entry.write_raw is None:
        raise DataError(f"{path}: the format {entry.name} can be read but not written")
    entry.write_raw(path, raw)


def write_image(image: SarImage, path: Path | str, *, format: str | None = None) -> None:
    """Write an image in the format of that name, or of the path's suffix."""
    path = Path(path)
    entry = find_format(path, "image", format)
    if entry.write_image is None:
        raise DataError(f"{path}: the format {entry.name} can be read but not written")
    entry.write_image(path, image)


def read_raw(path: Path | str, *, format: str | None = None) -> RawData:
    """Read raw data.

    Raises
    ------
    DataError
        The format cannot be read, or a number of the radar or of the image request is out of bounds.
    """
    path = Path(path)
    _check_there(path)
    entry = find_format(path, "raw", format)
    if entry.read_raw is None:
        raise DataError(f"{path}: the format {entry.name} can be written but not read; read the HDF5 file")
    raw = entry.read_raw(path)
    with _naming(path):
        check_radar(raw.radar)
        if raw.flown is not None:
            check_radar(replace(raw.radar, track=raw.flown, recorded=None))
        if raw.request is not None:
            check_request(raw.request)
    return raw


def read_image(path: Path | str, *, format: str | None = None) -> SarImage:
    """Read an image.

    Raises
    ------
    DataError
        The format cannot be read, or a number of the grid or of the calibration is out of bounds.
    """
    path = Path(path)
    _check_there(path)
    entry = find_format(path, "image", format)
    if entry.read_image is None:
        raise DataError(f"{path}: the format {entry.name} can be written but not read; read the HDF5 file")
    image = entry.read_image(path)
    with _naming(path):
        check_image(image)
    return image


def _check_there(path: Path) -> None:
    if not os.path.exists(path):  # also for names that the system rejects
        raise DataError(f"{path}: {describe_missing(path)}")


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Add the file's name to errors about its numbers."""
    try:
        yield
    except (RadarError, DataError) as error:
        raise DataError(f"{path}: {error}") from None
