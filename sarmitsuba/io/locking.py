"""One writer at a time in a folder, and what killed writers left behind there."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sarmitsuba.errors import OutputError
from sarmitsuba.io.atomic import process_of_part

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Hold a folder for this process; files that processes no longer alive left half written there are removed.

    The operating system gives the folder back when the process ends, however it ends, and no file marks it.

    Raises
    ------
    OutputError
        Another process holds it.

    Notes
    -----
    File systems and systems without such locks (some network drives, Windows) do not notice a second writer.
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
            with suppress(OSError):  # a folder is none of ours; what cannot be removed is in nobody's way
                path.unlink()


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)  # asks, and sends nothing
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    return True
