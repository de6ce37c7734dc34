"""Files appear whole or not at all: write beside the target, then rename."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sarmitsuba.errors import OutputError


@contextmanager
def atomic_path(target: Path | str) -> Iterator[Path]:
    """Yield a temporary path in the target's folder; rename it to ``target`` when the block ends well.

    Whatever ends the block otherwise (Ctrl-C included) removes the temporary file and leaves an older
    ``target`` as it was.

    Raises
    ------
    OutputError
        The operating system refused: full disk, permissions, a missing folder.
    """
    target = Path(target)
    # the suffix stays: some writers choose the format by it
    temporary = target.with_name(f".{target.stem}.{os.getpid()}.part{target.suffix}")
    try:
        temporary.unlink(missing_ok=True)  # a link there would be written through
        yield temporary
        os.replace(temporary, target)
    except OSError as error:
        raise OutputError(f"{target}: cannot write: {reason_of(error)}") from error
    finally:
        temporary.unlink(missing_ok=True)


def make_folder(folder: Path | str) -> Path:
    """Create a folder and its parents, or raise an OutputError."""
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot create the folder: {reason_of(error)}") from error
    return folder


def reason_of(error: OSError) -> str:
    """One line, with a remedy where there is an obvious one; HDF5 hides the number in its text."""
    text = error.strerror or str(error)
    if error.errno in (errno.ENOSPC, errno.EDQUOT) or "errno = 28" in str(error):
        return "no space left on the disk; free some or choose another output folder"
    if error.errno == errno.EFBIG or "errno = 27" in str(error):
        return "the file is larger than this system or user may write"
    return " ".join(text.split())


__all__ = ["atomic_path", "make_folder", "reason_of"]
