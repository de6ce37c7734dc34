"""Atomic writing of files, beside the target and renamed; and removal of files of a run that a signal ends."""

import errno
import itertools
import json
import mmap
import os
import re
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import BinaryIO

from sarmitsuba.core.errors import OutputError, SarmitsubaError
from sarmitsuba.machine.regular_files import check_text

# bytes of the list that both processes see: a mark, and the paths as JSON up to the first null character
_SHARED = 1 << 16

_removals: dict[object, Callable[[], object]] = {}
_paths: dict[object, str] = {}
_shared: mmap.mmap | None = None
# how a run resumes, by the file of finished parts
_resuming: dict[str, str] = {}


@contextmanager
def removed_if_stopped(remove: Callable[[], object], path: Path | None = None) -> Iterator[None]:
    """Within the block, call ``remove`` if a signal ends the process.

    Parameters
    ----------
    remove : raises nothing but OSError and errors of this package
    path : file, or folder if empty, that is removed even where the process cannot call ``remove`` any more
    """
    key = object()
    _removals[key] = remove
    if path is not None and _shared is not None:
        _paths[key] = os.path.abspath(path)
        _write_shared()
    try:
        yield
    finally:
        _removals.pop(key, None)
        if _paths.pop(key, None) is not None:
            _write_shared()


def remove_unfinished() -> None:
    """Remove all unfinished files, newest first; called by the signal handler, raises no error."""
    while _removals:
        _, remove = _removals.popitem()
        try:
            remove()
        except (OSError, SarmitsubaError):
            continue


def offer_resuming(path: Path, how: str = "the same command resumes") -> None:
    """Keep how the run resumes from a file of finished parts, for the message at its end by a signal."""
    _resuming[os.path.abspath(path)] = how


def withdraw_resuming(path: Path | None = None) -> None:
    """Forget a file of finished parts, which is gone or empty; None: those of an earlier run, before a new one."""
    if path is None:
        _resuming.clear()
    else:
        _resuming.pop(os.path.abspath(path), None)


def describe_end() -> str:
    """State of a run ended by a signal: no half-written file, and the remedy where parts are finished."""
    return "; ".join(["no half-written file was left behind", *dict.fromkeys(_resuming.values())])


def share_unfinished() -> mmap.mmap:
    """Memory for this process and those that it forks: whether it answers (first byte), and paths to be removed."""
    global _shared
    _shared = mmap.mmap(-1, _SHARED)
    return _shared


def _write_shared() -> None:
    assert _shared is not None
    text = json.dumps(list(_paths.values())).encode()
    if len(text) < _SHARED - 2:
        _shared[1 : len(text) + 2] = text + b"\0"


def remove_shared(shared: mmap.mmap) -> None:
    """Remove the paths of a list; raises no error."""
    text = shared[1:].partition(b"\0")[0]
    try:
        paths = json.loads(text) if text else []
    except ValueError:  # ended in the midst of writing it
        return
    for path in reversed(paths):
        with suppress(OSError):
            os.rmdir(path) if os.path.isdir(path) and not os.path.islink(path) else os.unlink(path)


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
