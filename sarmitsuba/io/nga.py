"""What the NGA's formats CPHD and SICD share: dates, names of modes and polarisations, and how sarkit fails."""

import datetime
import struct
from typing import Any, TypeAlias

from sarmitsuba.errors import DataError

# an element of a document, as sarkit wraps it: a mapping by the names of the standard
Element: TypeAlias = Any

# simulated flights have no date of their own
EPOCH = datetime.datetime(2000, 1, 1, tzinfo=datetime.timezone.utc)
MODE_TYPES = {"spotlight": "SPOTLIGHT", "circular": "SPOTLIGHT", "stripmap": "STRIPMAP"}
OTHER_MODE = "DYNAMIC STRIPMAP"
POLARISATIONS = {"H": "H", "V": "V", "R": "RHC", "L": "LHC"}
LETTERS = {name: letter for letter, name in POLARISATIONS.items()}

# what sarkit and lxml raise for a damaged file; lxml's own errors are syntax errors
DAMAGED = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    MemoryError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
)


def polarisations(channel: str, what: str) -> tuple[str, str]:
    """The standard's names of what a channel transmits and receives.

    Raises
    ------
    DataError
        It has none.
    """
    if any(letter not in POLARISATIONS for letter in channel):
        raise DataError(f"{what}: channel {channel} has no name in the standard; leave it out, or write HDF5")
    return POLARISATIONS[channel[0]], POLARISATIONS[channel[1]]


def said(error: BaseException) -> str:
    """A library's message in one line."""
    return " ".join(str(error).split())[:200] or type(error).__name__


__all__ = ["DAMAGED", "EPOCH", "LETTERS", "MODE_TYPES", "OTHER_MODE", "Element", "polarisations", "said"]
