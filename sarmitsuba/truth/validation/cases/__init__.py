"""Validation cases, one topic per file; each file registers its cases in ``CASES``."""

from collections.abc import Callable
from dataclasses import dataclass

from sarmitsuba.core.registry import Registry
from sarmitsuba.truth.validation.comparison import Case


@dataclass(frozen=True)
class CaseEntry:
    """Entry of a case in the registry.

    Parameters
    ----------
    name : on the command line, and of the plot's file
    topic : section of the page, see ``comparison.TOPICS``
    build : function that runs the simulator and returns the case; with True, for fewer bands, angles and looks
    """

    name: str
    topic: str
    build: Callable[[bool], Case]


CASES: Registry[CaseEntry] = Registry("validation case", CaseEntry, "sarmitsuba.truth.validation.cases")
__all__ = ["CASES", "CaseEntry"]
