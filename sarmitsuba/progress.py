"""How long-running stages tell their caller where they are."""

from collections.abc import Mapping
from typing import Protocol


class Progress(Protocol):
    """Callback of a stage: ``progress(stage, done, total, info)``.

    Call it whenever a batch is done, a few times per second at most. It may raise (KeyboardInterrupt), and the
    stage must then leave nothing half done behind.

    Parameters
    ----------
    stage : short name of the stage, e.g. ``trace``; a new name ends the stage before
    done, total : work done and all work, in any unit of the stage's own, ``0 <= done <= total``
    info : figures worth showing beside the bar, by name with unit, e.g. ``{"rays/s": 4.1e6}``
    """

    def __call__(self, stage: str, done: float, total: float, info: Mapping[str, float], /) -> None:
        """Report."""
        ...


def silent(stage: str, done: float, total: float, info: Mapping[str, float], /) -> None:
    """Report to nobody."""


__all__ = ["Progress", "silent"]
