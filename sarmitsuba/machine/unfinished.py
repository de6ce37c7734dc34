"""Files and folders of a run that a signal ends: what is removed, and what it resumes from."""

import json
import mmap
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sarmitsuba.core.errors import SarmitsubaError

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
    """What a run ended by a signal leaves: no half-written file, and how it resumes where parts are finished."""
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
