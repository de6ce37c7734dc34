"""HDF5 files of this program: their head, guarded writing, reading of untrusted ones, and the grid of an image."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

import h5py
import numpy as np
from h5py._objects import phil as h5py_lock

from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.files import groups
from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.machine.guarded import GuardedFile
from sarmitsuba.machine.isolated import survive
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.version import __version__

FORMAT_VERSION = 3
CONVENTION = "time exp(+j w t); a point at slant range R has the phase exp(-j 4 pi center_frequency R / c)"
FRAME = "the scene file's own: x east, y north, z up, metres; its origin on the Earth is in the group anchor"
_POSITION = {
    "slant": "pixel (a, r): (origin x, origin y, height) + azimuth[a] along + sqrt(range[r]^2 - h^2) across, "
    "h = origin z - height",
    "ground": "pixel (a, r): (origin x, origin y, height) + azimuth[a] along + range[r] across",
}

T = TypeVar("T")


def write_hdf5(path: Path | str, content: str, fill: Callable[[h5py.File], None]) -> None:
    """Write a file atomically."""
    with atomic_path(path) as temporary, GuardedFile(temporary) as guarded:
        try:
            with h5py.File(guarded, "w") as file:
                file.attrs["format"] = f"sarmitsuba {content}"
                file.attrs["format_version"] = FORMAT_VERSION
                file.attrs["software"] = f"sarmitsuba {__version__}"
                file.attrs["phase_convention"] = CONVENTION
                file.attrs["frame"] = FRAME
                fill(file)
        finally:
            if guarded.error is not None:
                raise guarded.error


def read_hdf5(path: Path | str, content: str, wanted: str, load: Callable[[h5py.File, bool], T]) -> T:
    """Result of ``load`` for the file with its planes, after a trial without them in a separate process."""
    path = Path(path)
    if not os.path.isfile(path):
        raise DataError(f"{path}: no such file; give the {wanted} file written by `sarmitsuba render`")

    def read(planes: bool) -> T:
        with h5py.File(path, "r") as file:
            found = file.attrs.get("format")
            if found != f"sarmitsuba {content}":
                raise DataError(f"holds {found or 'other HDF5 data'}, not {wanted} of sarmitsuba")
            version = int(file.attrs.get("format_version", 0))
            if version != FORMAT_VERSION:
                remedy = "update sarmitsuba" if version > FORMAT_VERSION else "simulate again"
                raise DataError(f"format version {version}, this program reads {FORMAT_VERSION}; {remedy}")
            return load(file, planes)

    try:
        with h5py_lock:  # must not be held by another thread at the fork
            survive(path, lambda: read(planes=False))
        return read(planes=True)
    except (
        ArithmeticError,
        AttributeError,
        DataError,
        LookupError,
        MemoryError,
        OSError,
        RadarError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as error:  # exceptions of h5py and HDF5 for damaged files
        reason = one_line(error, 300)
        raise DataError(f"{path}: cannot read {wanted}: {reason or type(error).__name__}") from error


def write_grid(file: h5py.File, grid: ImageGrid) -> None:
    """Write the grid of an image, in the frame of the scene's file, and the anchor of that frame."""
    grid = grid.in_frame(np.zeros(3))
    group = file.create_group("grid")
    group.attrs["position"] = _POSITION[grid.kind]
    groups.write_fields(group, grid, leave_out=("offset", "anchor"))
    groups.write_fields(file.create_group("anchor"), grid.anchor)


def read_grid(file: h5py.File) -> ImageGrid:
    """Read the grid of an image.

    Raises
    ------
    DataError
        It is none.
    """
    anchor = groups.read_fields(groups.group_of(file, "anchor"), Anchor)
    grid = groups.read_fields(groups.group_of(file, "grid"), ImageGrid, offset=np.zeros(3), anchor=anchor)
    check_shape("grid", {"origin": (3,), "along": (3,), "across": (3,)}, grid)
    if grid.kind not in _POSITION or grid.azimuth.ndim != 1 or grid.range.ndim != 1:
        raise DataError(f"/grid: kind {grid.kind!r} with axes {grid.azimuth.shape} and {grid.range.shape}")
    return grid


def check_shape(where: str, shapes: Mapping[str, tuple[int, ...]], found: object) -> None:
    """Raise a DataError for arrays of other shapes; ``where``: group that they were read from."""
    for name, shape in shapes.items():
        has = getattr(found, name).shape
        if has != shape:
            raise DataError(f"/{where}/{name} has the shape {has}, not {shape}")
