"""File names, parameters and sizes in the text of a scene file, read as Mitsuba's parser reads them."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.machine.regular_files import read_bytes

# bytes of a scene file
LARGEST_SCENE = 1 << 28
# tags that name a file or folder in an attribute "value" or "filename"
_PLACES = ("include", "path")
_FILE_ATTRIBUTE = re.compile(rb"\bfilename\s*=")
# largest nesting of elements: scenes have four or five; Mitsuba's parser is recursive, and its stack overflows
_DEEPEST = 200
_DECLARATION = re.compile(rb"^(?:\xef\xbb\xbf)?\s*<\?xml(.*?)(?:\?>|$)", re.DOTALL)
_ENCODING = re.compile(rb"encoding\s*=\s*[\"']?([^\"'\s?]*)")
# Mitsuba's parser reads bytes as UTF-8, or as Latin-1 if that is declared, whatever else a declaration says
_ENCODINGS = (b"utf-8", b"utf8", b"us-ascii", b"ascii")
_FILE_NAME = re.compile(r"filename|\w+_file")
_NAME = re.compile(r"[\w.-]{1,100}")
_REFERENCE = re.compile(r"\$([\w.-]{0,100})")


@dataclass
class SceneText:
    """References of a scene file to other files, and its size.

    Parameters
    ----------
    path : of the file
    size : bytes
    elements : in the file itself
    references : tag and name of every element that names a file or a folder in its attributes, in order
    strings : file names in ``<string>`` elements, in order
    steps : (name, value) of every ``<default>`` and (None, file name) of every ``<include>``, in order
    substituted : values of attributes that hold ``$`` parameters
    """

    path: Path
    size: int
    elements: int = 0
    references: list[tuple[str, str]] = field(default_factory=list)
    strings: list[str] = field(default_factory=list)
    steps: list[tuple[str | None, str]] = field(default_factory=list)
    substituted: list[str] = field(default_factory=list)

    def expand(self, lengths: Mapping[str, int]) -> int:
        """Bytes with every parameter expanded."""
        return self.size + sum(substituted_length(value, lengths) for value in self.substituted)


def substituted_length(value: str, lengths: Mapping[str, int]) -> int:
    """Largest number of characters of a value with its parameters expanded."""
    total = len(value)
    for found in _REFERENCE.finditer(value):
        word = found[1]
        total += max((lengths.get(word[: i + 1], 0) for i in range(len(word))), default=0)
    return total


def read_scene_text(path: Path, *, strict: bool = False) -> SceneText:
    """Read the references and the size of a scene file.

    References are ``include``, ``path``, ``spectrum`` and any other element with an attribute ``filename``, which
    Mitsuba's parser opens while it reads; files that a ``<string>`` names are checked later, by their use.

    Malformed files are left to Mitsuba's parser, whose messages are better, unless they may refer to files: that parser
    is lenient, and might see references where a strict one stops. With ``strict`` they are refused.

    Raises
    ------
    SceneError
        The file cannot be read, is not in UTF-8, has a document type, or is malformed and may refer to files.
    """
    try:
        data = read_bytes(path, LARGEST_SCENE)
    except OSError as error:
        raise SceneError(f"{path}: cannot read the scene file: {error.strerror}") from error
    reader = _Reader(path, data)
    if path.suffix.lower() == ".xml":
        _check_encoding(data, path.name)
    broken = reader.read()
    if path.suffix.lower() != ".xml" and reader.root == "scene":
        _check_encoding(data, path.name)
    if reader.root not in ("scene", "") or (not reader.root and path.suffix.lower() != ".xml"):
        what = f"<{one_line(reader.root)}> is" if reader.root else "it is"
        name = one_line(path.name)
        raise SceneError(
            f"{name}: {what} not a scene; city data, terrain and meshes become one by python -m sarmitsuba import "
            f"{name} -o {one_line(path.stem)}.xml; echoes and images are read by the commands focus and view"
        )
    if reader.has_type or b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise SceneError(
            f"{path.name}: holds a document type or entities (<!DOCTYPE, <!ENTITY), which are not allowed in a scene "
            "because they can hide its content; remove them"
        )
    risky = b"<include" in data or b"<path" in data or b"<default" in data or _FILE_ATTRIBUTE.search(data)
    if broken and (risky or strict):
        raise SceneError(f"{path.name}: malformed XML: {broken}; check that every element is closed")
    return reader.text


class _Reader:
    """Reads the elements of a file, in order, into a `SceneText`."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.text, self.has_type, self.root = SceneText(path, len(data)), False, ""
        self._data, self._depth = data, 0
        self._parameters = b"$" in data or b"&#" in data
        self._parser = parser = expat.ParserCreate("UTF-8")  # independent of the declared encoding
        parser.StartElementHandler, parser.EndElementHandler = self._start, self._end
        parser.StartDoctypeDeclHandler = self._document_type
        # entities are neither read nor expanded
        parser.SetParamEntityParsing(expat.XML_PARAM_ENTITY_PARSING_NEVER)

    def read(self) -> str:
        """Read the file; the parser's message where it is malformed, else empty."""
        try:
            self._parser.Parse(self._data, True)
        except (expat.ExpatError, ValueError, LookupError) as error:
            return one_line(error, 100)
        return ""

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        text = self.text
        self.root = self.root or tag
        self._depth += 1
        text.elements += 1
        if self._depth > _DEEPEST:
            raise SceneError(f"{self._place()}: elements are nested more than {_DEEPEST} deep; close them")
        if tag in _PLACES:
            named = [attributes[key] for key in ("filename", "value") if key in attributes] or [""]
            text.references += [(tag, name) for name in named]
            text.steps += [(None, name) for name in named if tag == "include"]
        elif attributes.get("filename"):
            text.references.append((tag, attributes["filename"]))
        elif tag == "string" and _FILE_NAME.fullmatch(attributes.get("name", "")):
            text.strings.append(attributes.get("value", ""))
        elif tag == "default" and "name" in attributes:
            name, value = attributes["name"], attributes.get("value", "")
            if not _NAME.fullmatch(name) or "\\$" in value:
                raise SceneError(
                    f'{self._place()}: <default> "{one_line(name)}": a name is 1 to 100 letters, digits, _, - and ., '
                    "and its value holds no escaped $; rename it"
                )
            text.steps.append((name, value))
        if self._parameters:
            text.substituted.extend(value for value in attributes.values() if "$" in value)

    def _end(self, _: str) -> None:
        self._depth -= 1

    def _document_type(self, *_: object) -> None:
        self.has_type = True

    def _place(self) -> str:
        return f"{self.text.path.name} (line {self._parser.CurrentLineNumber})"


def _check_encoding(data: bytes, name: str) -> None:
    """Raise a SceneError where two parsers could decode the bytes differently."""
    declaration = _DECLARATION.match(data[:1000])
    found = _ENCODING.search(declaration[1]) if declaration else None
    declared = found[1].lower() if found else b"utf-8"
    if declared not in _ENCODINGS or b"\x00" in data or data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        what = "null characters or UTF-16" if declared in _ENCODINGS else one_line(declared.decode("latin-1"))
        raise SceneError(f"{name}: a scene file is in UTF-8, this one holds {what}; save it in UTF-8")
