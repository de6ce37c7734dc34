"""Removal of unfinished files and folders when the process is terminated."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from sarmitsuba.errors import SarmitsubaError

_removals: dict[object, Callable[[], object]] = {}


@contextmanager
def removed_if_stopped(remove: Callable[[], object]) -> Iterator[None]:
    """Within the block, call ``remove`` if a signal ends the process."""
    key = object()
    _removals[key] = remove
    try:
        yield
    finally:
        _removals.pop(key, None)


def remove_unfinished() -> None:
    """Remove all unfinished files, newest first; called by the signal handler, raises no error."""
    while _removals:
        _, remove = _removals.popitem()
        try:
            remove()
        except (OSError, SarmitsubaError):
            continue
