"""Common parts of the NGA formats CPHD and SICD: dates, names of modes and polarisations, sarkit's errors."""

import datetime
import logging
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np

from sarmitsuba.core.errors import DataError
from sarmitsuba.machine.isolated import survive
from sarmitsuba.radar.utc import utc_of, utc_text

if TYPE_CHECKING:
    import lxml.etree

# element of a document as wrapped by sarkit: a mapping by the names of the standard
Element: TypeAlias = Any

T = TypeVar("T")

MODE_TYPES = {"spotlight": "SPOTLIGHT", "circular": "SPOTLIGHT", "stripmap": "STRIPMAP"}
OTHER_MODE = "DYNAMIC STRIPMAP"
POLARISATIONS = {"H": "H", "V": "V", "R": "RHC", "L": "LHC"}
LETTERS = {name: letter for letter, name in POLARISATIONS.items()}

# exceptions of sarkit and lxml for damaged files; those of lxml are syntax errors
_DAMAGED = (
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
    """Names in the standard of the transmitted and the received polarisation of a channel.

    Raises
    ------
    DataError
        The standard has no such polarisation.
    """
    if any(letter not in POLARISATIONS for letter in channel):
        raise DataError(f"{what}: channel {channel} has no name in the standard; leave it out, or write HDF5")
    return POLARISATIONS[channel[0]], POLARISATIONS[channel[1]]


def whole_microseconds(time: np.datetime64) -> datetime.datetime:
    """UTC time for sarkit, cut to microseconds; `set_utc` adds the rest."""
    cut: datetime.datetime = time.astype("datetime64[us]").item()
    return cut.replace(tzinfo=datetime.timezone.utc)


def set_utc(root: "lxml.etree._Element", path: str, time: np.datetime64) -> None:
    """Write a UTC time to the nanosecond into an element that exists, by its path of local names."""
    found = _element(root, path)
    assert found is not None
    found.text = utc_text(time)


def read_utc(root: "lxml.etree._Element", path: str) -> np.datetime64:
    """UTC time of an element, datetime64[ns].

    Raises
    ------
    ValueError
        It is missing or is not a date and time.
    """
    found = _element(root, path)
    return utc_of(None if found is None else found.text)


def _element(root: "lxml.etree._Element", path: str) -> "lxml.etree._Element | None":
    return root.find("/".join(f"{{*}}{name}" for name in path.split("/")))


@contextmanager
def plain_xml() -> Iterator[None]:
    """Context in which lxml, the XML reader of sarkit, expands no entities and opens no other files or addresses.

    jbpy's log messages about damaged NITF files are suppressed: the error is one line.
    """
    import lxml.etree

    log = logging.getLogger("jbpy")
    level = log.level
    log.setLevel(logging.CRITICAL + 1)

    before = lxml.etree.get_default_parser()
    strict = lxml.etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
    lxml.etree.set_default_parser(strict)
    try:
        yield
    finally:
        lxml.etree.set_default_parser(before)
        log.setLevel(level)


def refuse_document_type(tree: "lxml.etree._ElementTree", what: str) -> None:
    """Raise a DataError where a document has a document type: the standards have none, and it can hide content."""
    if tree.docinfo.internalDTD is not None or tree.docinfo.doctype:
        raise DataError(
            f"{what}: its document has a document type (<!DOCTYPE), which the standard does not allow"
        )


def read_apart(path: Path, kind: str, read: Callable[[], T]) -> T:
    """Result of ``read``, after a trial of it in a separate process.

    A document can state polynomials and channels that take any memory, whatever the size of the file.

    Raises
    ------
    DataError
        The file is damaged, or takes more time or memory than any intact file of its size.
    """
    try:
        survive(path, read)
    except DataError as error:
        raise DataError(f"{path}: cannot be read as {kind}: {error}") from None
    try:
        return read()
    except _DAMAGED as error:
        what = " ".join(str(error).split())[:200] or type(error).__name__
        raise DataError(f"{path}: cannot be read as {kind}: {what}") from error
