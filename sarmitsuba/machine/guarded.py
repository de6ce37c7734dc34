"""File object for libraries that crash on write errors: the first error is stored instead of raised."""

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING

from sarmitsuba.machine.atomic import open_own

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer


class GuardedFile(io.RawIOBase):
    """Random-access file whose writes appear to succeed; the first failure is stored in ``error``.

    HDF5 1.14 crashes the process if a write fails while chunks are still unwritten (observed with a file size limit).
    With this file it finishes, and the caller raises ``error`` afterwards.

    Parameters
    ----------
    path : file to create or overwrite
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.error: OSError | None = None
        self._opened = False  # also where opening fails, after which Python closes the object
        self._file = open_own(path)
        self._opened = True
        self._file.truncate(0)

    def write(self, data: "ReadableBuffer") -> int:
        """Write all of ``data``; discard it after a failure."""
        view = memoryview(data).cast("B")
        done = 0
        try:
            while self.error is None and done < len(view):
                done += self._file.write(view[done:]) or 0
        except OSError as error:
            self.error = error
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the file's length."""
        length = self._file.tell() if size is None else size
        try:
            if self.error is None:
                self._file.truncate(length)
        except OSError as error:
            self.error = error
        return length

    def readinto(self, buffer: "WriteableBuffer") -> int:
        """Fill ``buffer`` from the current position, with zeros past the end."""
        view = memoryview(buffer).cast("B")
        data = self._file.read(len(view))
        count = len(data)
        view[:count] = data
        view[count:] = bytes(len(view) - count)
        return len(view)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Return the current position."""
        return self._file.tell()

    def readable(self) -> bool:
        """Return True."""
        return True

    def writable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def close(self) -> None:
        """Close the file."""
        if self._opened and not self.closed:
            self._file.close()
        super().close()
