"""Exclusive writing in a folder, and removal of temporary files of killed writers."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sarmitsuba.core.errors import OutputError
from sarmitsuba.machine.atomic import process_of_part

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Lock a folder for this process, and remove temporary files of dead processes.

    The operating system releases the lock when the process ends, however it ends, without a lock file.

    Raises
    ------
    OutputError
        Another process holds the lock.

    Notes
    -----
    File systems and systems without such locks (some network drives, Windows) do not detect a second writer.
    """
    if fcntl is None:
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                raise OutputError(
                    f"{folder}: another run is writing into this folder; wait for its end, or choose another -o"
                ) from error
        _sweep(folder)
        yield
    finally:
        os.close(handle)


def _sweep(folder: Path) -> None:
    for path in folder.iterdir():
        process = process_of_part(path.name)
        if process is not None and not _alive(process):
            with suppress(
                OSError
            ):  # folders are not temporary files; files that cannot be removed are harmless
                path.unlink()


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)  # signal 0 only checks whether the process exists
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    return True
