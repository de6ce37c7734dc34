"""Removal of unfinished files and folders when the process is terminated."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from sarmitsuba.errors import SarmitsubaError

_removals: dict[object, Callable[[], object]] = {}


@contextmanager
def removed_if_stopped(remove: Callable[[], object]) -> Iterator[None]:
    """Within the block, ``remove`` is called where a signal ends the process; afterwards it is the caller's."""
    key = object()
    _removals[key] = remove
    try:
        yield
    finally:
        _removals.pop(key, None)


def remove_unfinished() -> None:
    """Remove all of it, the newest first; called by who handles the signal, and never returns an error."""
    while _removals:
        _, remove = _removals.popitem()
        try:
            remove()
        except (OSError, SarmitsubaError):
            continue
