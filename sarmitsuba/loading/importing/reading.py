"""Safe reading of untrusted JSON and XML: sizes, numbers and entities are checked."""

import xml.etree.ElementTree as ET
import xml.parsers.expat
from pathlib import Path

from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.machine import regular_files
from sarmitsuba.machine.encoding import json_value
from sarmitsuba.machine.memory import check_fits

# bytes of memory for a byte of text: of JSON a pair of one-digit numbers, [1,1], takes 6 and 80 in memory; of XML an
# empty element, <a/>, 4 and 120
_UNPACKED_JSON, _UNPACKED_XML = 14, 30


class _PrologError(Exception):
    """Raised at the end of the prolog, to stop its separate reading."""


def read_bytes(path: Path) -> bytes:
    """Content of a file.

    Raises
    ------
    SceneError : it cannot be read, is no regular file, or is larger than `regular_files.LARGEST`
    """
    try:
        return regular_files.read_bytes(path)
    except OSError as error:
        raise SceneError(
            f"{one_line(path.name)}: cannot be read: {error.strerror}; check the path"
        ) from error


def read_json(path: Path) -> object:
    """JSON content of a file; NaN and infinity are errors.

    Raises
    ------
    SceneError : it is malformed, nested too deep or holds NaN
    """

    def refuse(constant: str) -> float:
        raise SceneError(f"{path.name}: holds {constant}, which is no JSON number; export it again")

    text = read_bytes(path)
    check_fits(f"{path.name}: reading its JSON", _UNPACKED_JSON * len(text), "cut out a part")
    try:
        content: object = json_value(text, refuse)
    except UnicodeDecodeError as error:
        raise SceneError(f"{path.name}: is not UTF-8 text; export it again") from error
    except ValueError as error:
        raise SceneError(f"{path.name}: malformed JSON: {one_line(error)}; export it again") from error
    return content


def read_xml(path: Path) -> ET.Element:
    """Root element of an XML file without a document type (which could define entities).

    Raises
    ------
    SceneError : it is malformed, or declares a document type
    """
    content = read_bytes(path)
    check_fits(f"{path.name}: reading its XML", _UNPACKED_XML * len(content), "cut out a part")
    prolog = xml.parsers.expat.ParserCreate()

    def refuse(*_: object) -> None:
        raise SceneError(f"{path.name}: declares a document type (DOCTYPE), which is not allowed; remove it")

    def stop(*_: object) -> None:
        raise _PrologError

    prolog.StartDoctypeDeclHandler = refuse
    prolog.StartElementHandler = stop
    try:
        try:
            prolog.Parse(content, True)
        except _PrologError:  # a document type can only precede the root element
            return ET.fromstring(content)
        raise SceneError(f"{path.name}: holds no element; export it again")
    except (ET.ParseError, xml.parsers.expat.ExpatError, ValueError, LookupError) as error:
        raise SceneError(f"{path.name}: malformed XML: {one_line(error)}; export it again") from error
