"""MATLAB files with phase histories, in the layout of the public AFRL Gotcha volumetric data set; see docs/files.md.

A struct ``data`` holds, per file (one degree of azimuth there), ``fp`` (frequency x pulse), ``freq``, the antenna's
``x``, ``y``, ``z`` and the motion-compensation range ``r0`` per pulse.
"""

import os
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.files.formats import FORMATS, FileFormat
from sarmitsuba.files.phase_history import PhaseHistory, join_parts, load_mat, raw_of
from sarmitsuba.machine.isolated import survive
from sarmitsuba.radar.polarisation import CHANNELS
from sarmitsuba.signal.raw_data import AutofocusRecords, RawData

_STRUCT = "data"
_NEEDED = ("fp", "freq", "x", "y", "z", "r0")
_PER_PULSE = ("x", "y", "z", "r0", "th", "phi")
_RECORDS = ("r_correct", "ph_correct")  # m and rad, per pulse
# names of a second antenna's coordinates: of the transmitter or of the receiver; x, y, z are those of the other antenna
_TRANSMITTER = (("xt", "yt", "zt"), ("tx", "ty", "tz"))
_RECEIVER = (("xr", "yr", "zr"), ("rx", "ry", "rz"))
_CHANNEL = re.compile(rf"(?:^|[_\-.])({'|'.join(CHANNELS)})$", re.IGNORECASE)


def read_raw(path: Path) -> RawData:
    """Read one file, or a folder of files in natural order of their names, per polarisation.

    The polarisation is the ending of the file's name, ``_HH``, ``_HV``, ``_RH`` ...; without it VV.

    Raises
    ------
    DataError
        A file is damaged, or a field is missing or does not fit the others.
    """
    files = sorted(path.glob("*.mat"), key=_natural) if os.path.isdir(path) else [path]
    if not files:
        raise DataError(f"{path}: no .mat file in this folder")
    parts: dict[str, list[PhaseHistory]] = {}
    for file in files:
        history = read_history(file)
        parts.setdefault(history.channel, []).append(history)
    return raw_of([join_parts(channel) for channel in parts.values()])


def read_history(path: Path) -> PhaseHistory:
    """Phase history of one file."""
    if not os.path.isfile(path):
        raise DataError(f"{path}: no such file; give a MATLAB file with phase histories, or a folder of them")
    try:
        survive(path, lambda: _history(path))
    except DataError as error:
        raise DataError(f"{path}: cannot be read as a MATLAB file: {error}") from None
    return _history(path)


def _history(path: Path) -> PhaseHistory:
    fields = _fields(path)
    missing = [name for name in _NEEDED if name not in fields]
    if missing:
        raise DataError(
            f"{path}: {_STRUCT} has no {', '.join(missing)}; it has {', '.join(sorted(fields)) or 'no fields'}"
        )
    second = _second_antenna(path, fields)
    numbers = {
        name: _numbers(path, name, fields[name]) for name in {*_NEEDED, *_PER_PULSE, *second} & set(fields)
    }
    samples = numbers["fp"]
    if samples.ndim != 2 or not np.iscomplexobj(samples):
        raise DataError(
            f"{path}: fp is {samples.dtype} of shape {samples.shape}, not complex frequency x pulse"
        )
    for name in (*_PER_PULSE, *second):
        if name in numbers and numbers[name].size != samples.shape[1]:
            raise DataError(
                f"{path}: {name} has {numbers[name].size} values, fp has {samples.shape[1]} pulses"
            )
    frequency = _real(path, "freq", numbers["freq"])
    # row, column, or one column per pulse
    frequency = frequency.ravel() if min(frequency.shape, default=1) == 1 else frequency
    first, other = (
        np.stack([_real(path, name, numbers[name]).ravel() for name in names], axis=1) if names else None
        for names in (("x", "y", "z"), second)
    )
    assert first is not None
    if second in _TRANSMITTER and other is not None:
        first, other = other, first
    found = _CHANNEL.search(path.stem)
    history = PhaseHistory(
        samples=samples,
        frequency=frequency,
        position=first,
        reference_range=_real(path, "r0", numbers["r0"]).ravel(),
        channel=found.group(1).upper() if found else "VV",
        source=path.name,
        receiver=other,
        records=_records(path, fields["af"], samples.shape[1]) if "af" in fields else None,
    )
    history.check()
    return history


def _records(path: Path, value: object, n_pulses: int) -> AutofocusRecords:
    """Autofocus records of the struct ``data.af``."""
    struct = np.asarray(value)
    if struct.dtype.names is None or struct.size != 1 or not set(_RECORDS) <= set(struct.dtype.names):
        raise DataError(
            f"{path}: af is not a struct of one element with {' and '.join(_RECORDS)}; leave it out"
        )
    cell = struct.reshape(-1)[0]
    found = []
    for name in _RECORDS:
        array = _real(path, f"af.{name}", _numbers(path, f"af.{name}", cell[name])).ravel()
        if array.size != n_pulses or not np.isfinite(array).all():
            raise DataError(
                f"{path}: af.{name} has {int(np.isfinite(array).sum())} finite values, fp has {n_pulses} pulses; give "
                "one for each, or leave af out"
            )
        found.append(array)
    return AutofocusRecords(*found)


def _second_antenna(path: Path, fields: Mapping[str, object]) -> tuple[str, ...]:
    """Names of the second antenna's coordinates; empty if one antenna transmits and receives."""
    found = [names for names in (*_TRANSMITTER, *_RECEIVER) if any(name in fields for name in names)]
    if not found:
        return ()
    missing = [name for name in found[0] if name not in fields]
    if len(found) > 1 or missing:
        there = ", ".join(name for names in found for name in names if name in fields)
        raise DataError(
            f"{path}: {there}: beside x, y, z one more antenna is supported, a transmitter (xt, yt, zt) or a receiver "
            "(xr, yr, zr), with all three coordinates"
        )
    return found[0]


def _fields(path: Path) -> dict[str, object]:
    """Fields of the struct ``data``."""
    content = load_mat(path, [_STRUCT])
    struct = content.get(_STRUCT)
    if not isinstance(struct, np.ndarray) or struct.dtype.names is None or struct.size != 1:
        raise DataError(f"{path}: has no struct {_STRUCT!r} of one element")
    cell = struct.reshape(-1)[0]
    return {name: cell[name] for name in struct.dtype.names}


def _numbers(path: Path, name: str, value: object) -> NDArray[np.number]:
    """Array of numbers; a cell of one element is replaced by its content."""
    array = np.asarray(value)
    while array.dtype == object and array.size == 1:
        array = np.asarray(array.reshape(-1)[0])
    if array.dtype.kind not in "fciu":
        raise DataError(f"{path}: {name} holds {array.dtype}, not numbers")
    return array


def _real(path: Path, name: str, array: NDArray[np.number]) -> F64:
    if np.iscomplexobj(array):
        raise DataError(f"{path}: {name} is complex; real numbers are needed")
    return np.asarray(array, dtype=np.float64)


def _natural(path: Path) -> tuple[tuple[int, str], ...]:
    """Sorting key in which ``az2`` comes before ``az10``."""
    parts = re.split(r"(\d+)", path.name)
    return tuple((int(part), "") if part.isdigit() else (-1, part) for part in parts)


FORMATS.register(
    FileFormat(
        "matlab",
        "external phase histories, one MATLAB file or a folder of them; read only",
        (".mat",),
        read_raw=read_raw,
        folders=True,
    )
)
