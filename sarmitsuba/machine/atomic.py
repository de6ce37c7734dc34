"""Atomic writing of files: write beside the target, then rename."""

import errno
import itertools
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import BinaryIO

from sarmitsuba.core.errors import OutputError
from sarmitsuba.machine.regular_files import check_text
from sarmitsuba.machine.unfinished import removed_if_stopped

# follow no links and wait for no pipes, where the system supports it
_UNLINKED = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
# pattern of the names of temporary files
_PART = re.compile(r"\.sarmitsuba-part-(\d+)-\d+(\..*)?")
_count = itertools.count()


def part_name(suffix: str = "") -> str:
    """New name of a temporary file of this process."""
    return f".sarmitsuba-part-{os.getpid()}-{next(_count)}{suffix}"


def process_of_part(name: str) -> int | None:
    """Process id in the name of a temporary file; None for all other names."""
    match = _PART.fullmatch(name)
    return int(match[1]) if match else None


@contextmanager
def atomic_path(target: Path | str, within: Path | None = None) -> Iterator[Path]:
    """Yield a temporary path; rename it to ``target`` when the block ends without an error.

    Any other end of the block (Ctrl-C included) removes the temporary file and leaves an older ``target`` unchanged.

    Parameters
    ----------
    target : file to write
    within : folder of the temporary file, on the same disk (default: the target's)

    Raises
    ------
    OutputError
        Error of the operating system: full disk, permissions, a missing folder.
    """
    target = Path(target)
    check_text(target)
    # the suffix is kept: some writers choose the format by it
    temporary = (within or target.parent) / part_name(target.suffix)
    try:
        # another user of the folder could have placed a link there, which writers would follow
        temporary.unlink(missing_ok=True)
        with removed_if_stopped(partial(temporary.unlink, missing_ok=True), temporary):
            yield temporary
            os.replace(temporary, target)
    except OSError as error:
        raise OutputError(f"{target}: cannot write: {reason_of(error)}") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def open_own(path: Path) -> BinaryIO:
    """Open a regular file for reading and writing, created if missing; links and pipes are refused.

    Raises
    ------
    OSError
        The operating system's error; ``ELOOP`` for a link.
    """
    handle = os.open(path, os.O_RDWR | os.O_CREAT | _UNLINKED, 0o666)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "it is not a regular file; remove it, or choose another -o")
    return os.fdopen(handle, "r+b", buffering=0)


def make_folder(folder: Path | str) -> Path:
    """Create a folder and its parents, or raise an OutputError."""
    folder = Path(folder)
    check_text(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot create the folder: {reason_of(error)}") from error
    return folder


def reason_of(error: OSError) -> str:
    """Message in one line, with a remedy for common errors; HDF5 states the error number only in its text."""
    text = error.strerror or str(error)
    if error.errno in (errno.ENOSPC, errno.EDQUOT) or "errno = 28" in str(error):
        return "no space left on the disk; free some or choose another output folder"
    if error.errno == errno.EFBIG or "errno = 27" in str(error):
        return "the file exceeds the size limit of the system or the user"
    if error.errno == errno.ENAMETOOLONG:
        return "the name is longer than the system allows; choose a shorter one"
    return " ".join(text.split())
