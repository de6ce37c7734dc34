"""Journal file of arrays, each with a checksum, from which an interrupted run resumes.

Layout: the magic line, then records. A record is a header of fixed size (magic, lengths of label and payload, CRC-32 of
both), the label as JSON, and the bytes of the payload. A truncated or damaged record ends the journal, and so does one
that its program would not write: it and the following ones are dropped, earlier ones are kept.
"""

import json
import os
import struct
import sys
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.errors import OutputError
from sarmitsuba.machine.atomic import offer_resuming, open_own, reason_of, withdraw_resuming
from sarmitsuba.machine.encoding import json_value
from sarmitsuba.machine.regular_files import open_regular

MAGIC = b"sarmitsuba journal 1\n"
_RECORD = b"rec\n"
_HEADER = struct.Struct("<4sIQI")  # magic, bytes of the label, bytes of the payload, CRC-32
Label = Mapping[str, Any]
# bounds of what a label may hold, and of amplitudes
_LARGEST_COUNT, _LARGEST_NUMBER, _LONGEST_TEXT = 1 << 53, 1e30, 100_000
LARGEST_AMPLITUDE = 1e15


def fits(value: object, form: object) -> bool:
    """Whether a value of JSON has a form.

    Parameters
    ----------
    value : of a label
    form : ``int`` (a count from 0), ``float`` (finite), ``str``, ``bool``, ``None``, ``object`` (anything); ``[form]``
        a list of it, ``[a, b]`` of these; ``(a, b)`` one of these; ``{str: form}`` a table of it, ``{"x": form}`` with
        these names
    """
    if isinstance(form, tuple):
        return any(fits(value, each) for each in form)
    if isinstance(form, list):
        if not isinstance(value, list):
            return False
        forms = form * len(value) if len(form) == 1 else form
        return len(value) == len(forms) and all(map(fits, value, forms))
    if isinstance(form, dict):
        if not isinstance(value, dict):
            return False
        if str in form:
            return all(fits(each, form[str]) for each in value.values())
        return value.keys() == form.keys() and all(fits(value[name], each) for name, each in form.items())
    if form is None or form is bool:
        return isinstance(value, bool) if form else value is None
    if form is str:
        return isinstance(value, str) and len(value) <= _LONGEST_TEXT
    if isinstance(value, bool) or not isinstance(value, int | float):
        return form is object
    if form is int:
        return isinstance(value, int) and 0 <= value <= _LARGEST_COUNT
    return form is object or abs(value) <= _LARGEST_NUMBER


def is_echo(payload: bytes, count: int | None = None) -> bool:
    """Whether a payload is complex64 numbers (``count`` of them) within the bounds of echoes and images."""
    numbers = np.frombuffer(payload[: len(payload) // 8 * 8], dtype=np.complex64).view(np.float32)
    return (
        len(payload) == 4 * numbers.size
        and count in (None, numbers.size // 2)
        and (bool((np.abs(numbers) <= LARGEST_AMPLITUDE).all()))
    )


class Journal:
    """Open journal file.

    Parameters
    ----------
    path : file; created if missing, else its intact records are kept
    accept : of a label and the bytes of its payload: whether they are a record that the program writes; by label the
        types and bounds of all values, by payload type, shape and bounds
    resume : how the run resumes, for the message at its end by a signal

    Attributes
    ----------
    labels : of the records, in order

    Raises
    ------
    OutputError
        The file is not a journal, or error of the operating system: full disk, permissions, a missing folder.

    Notes
    -----
    A record is complete in the file when :meth:`append` returns, however the process ends. The system's cache is not
    flushed: after a power failure the checksums identify the complete records.
    """

    def __init__(
        self,
        path: Path | str,
        accept: Callable[[Label, bytes], bool],
        resume: str = "the same command resumes",
    ) -> None:
        self.path, self._accept, self._resume = Path(path), accept, resume
        self.labels: list[dict[str, Any]] = []
        self._payloads: list[tuple[int, int]] = []  # offset and bytes
        try:
            self._file: BinaryIO = open_own(self.path)
        except OSError as error:
            raise OutputError(f"{self.path}: cannot write: {reason_of(error)}") from error
        head = self._file.read(len(MAGIC))
        if (
            head != MAGIC[: len(head)]
        ):  # an incomplete magic line is left by a process killed while creating the journal
            self._file.close()
            raise OutputError(
                f"{self.path}: this file was not written by the program here, and would be lost; move it, or choose "
                "another -o"
            )
        self._end = len(MAGIC)
        if head == MAGIC:
            for label, offset, size in self._sound():
                self.labels.append(label)
                self._keep(offset, size)
                self._end = offset + size
            self._cut(self._end)
        else:
            self.clear()

    def _sound(self) -> Iterator[tuple[dict[str, Any], int, int]]:
        """Label of every record up to the first damaged one, with offset and size of its payload."""
        end = self.path.stat().st_size
        while True:
            header = self._file.read(_HEADER.size)
            if len(header) < _HEADER.size:
                return
            magic, n_label, n_payload, expected = _HEADER.unpack(header)
            offset = self._file.tell() + n_label
            if magic != _RECORD or offset + n_payload > end:  # checked before the data are read
                return
            text, payload = self._file.read(n_label), self._file.read(n_payload)
            if zlib.crc32(payload, zlib.crc32(text)) != expected:
                return
            try:
                label = json_value(text)
            except ValueError:
                return
            if not isinstance(label, dict) or not self._accept(label, payload):
                return
            yield label, offset, n_payload

    def append(self, label: Label, array: NDArray[Any]) -> None:
        """Add a record: a label of JSON values, and the bytes of an array.

        Raises
        ------
        OutputError
            The record cannot be written; earlier records are kept.
        """
        text = json.dumps(label).encode()
        payload = memoryview(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
        header = _HEADER.pack(_RECORD, len(text), len(payload), zlib.crc32(payload, zlib.crc32(text)))
        start = self._end
        self._write(header + text)
        self._write(payload)
        self.labels.append(dict(label))
        self._keep(start + len(header) + len(text), len(payload))

    def _keep(self, offset: int, size: int) -> None:
        """Note a payload; labels alone are no finished part."""
        self._payloads.append((offset, size))
        if size:
            offer_resuming(self.path, self._resume)

    def payload(self, index: int, dtype: type[np.generic]) -> NDArray[Any]:
        """The flat array of a record."""
        offset, size = self._payloads[index]
        out = np.empty(size // np.dtype(dtype).itemsize, dtype=dtype)
        self._file.seek(offset)
        self._file.readinto(out.view(np.uint8))  # type: ignore[attr-defined]
        return out

    def clear(self) -> None:
        """Drop every record."""
        self.labels, self._payloads = [], []
        withdraw_resuming(self.path)
        self._cut(0)
        self._end = 0
        self._write(MAGIC)

    def close(self) -> None:
        """Close the file; its records are kept."""
        self._file.close()

    def remove(self) -> None:
        """Close and delete it."""
        self.close()
        withdraw_resuming(self.path)
        self.path.unlink(missing_ok=True)

    def _write(self, data: bytes | memoryview) -> None:
        view, done = memoryview(data), 0
        try:
            self._file.seek(self._end)
            while done < len(view):
                done += self._file.write(view[done:])
        except OSError as error:
            raise OutputError(
                f"{self.path}: cannot write: {reason_of(error)}; finished parts are kept, and the same command "
                "continues from them"
            ) from error
        self._end += len(view)

    def _cut(self, size: int) -> None:
        """Truncate the file to a size."""
        try:
            self._file.truncate(size)
        except OSError as error:
            raise OutputError(f"{self.path}: cannot write: {reason_of(error)}") from error


def remove_journal(path: Path) -> None:
    """Delete a journal; other files and irregular files are kept."""
    try:
        if path.is_symlink():
            return
        with os.fdopen(open_regular(path, sys.maxsize), "rb") as file:
            head = file.read(len(MAGIC))
    except OSError:
        return
    if head == MAGIC[: len(head)]:
        withdraw_resuming(path)
        path.unlink(missing_ok=True)
