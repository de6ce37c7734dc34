"""Checks of a scene file's references: no file outside its folder, unless allowed, and no document type.

File names, parameters and sizes are read as Mitsuba's parser reads them.
"""

import os
import re
import stat
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.loading.elements import Element
from sarmitsuba.loading.library import scenes_dir, shipped_radar
from sarmitsuba.loading.maps import MAP_NAMES, map_file
from sarmitsuba.machine.regular_files import check_regular, is_inside, read_bytes

# bytes of a scene file
LARGEST_SCENE = 1 << 28
# tags that name a file or folder in an attribute "value" or "filename"
# files of modellers, which have exports of their own
_MODELS = (".blend", ".usd", ".usda", ".usdc", ".usdz", ".fbx", ".dae", ".3ds", ".skp")
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
        if path.suffix.lower() in _MODELS:
            raise SceneError(
                f"{name}: models of this format are not read; export it as glTF (.glb), in metres"
            )
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


_REMEDY = "move it there, or allow it: --allow-outside (allow_outside=True)"
_MAX_INCLUDES = 1000
# tags that bring in other files, or folders to search
_FOLLOWED = ("include", "path")
# files that include each other in a row, as Mitsuba's parser has it
_MAX_DEPTH = 15
_MOST_LOOKUPS = 1_000_000
# bounds of the expanded document: repeated elements, and bytes beyond those of the files
_MOST_REPEATED, _MOST_EXPANDED = 100_000, 1 << 24
# bytes of a spectrum that a scene names
_LARGEST_SPECTRUM = 1 << 20


def check_document(path: Path, *, allow_outside: bool = False, strict: bool = False) -> None:
    """Check a scene file and its includes before the parser opens them.

    Parameters
    ----------
    path : of the scene file, which exists
    allow_outside : files may lie outside its folder
    strict : malformed files are refused, not left to the parser

    Raises
    ------
    SceneError
        A file is not in UTF-8, has a document type, names a missing or no ordinary file, or, unless allowed,
        includes or searches outside the folder of the scene; or expanding every include and parameter would exceed the
        bounds.

    Notes
    -----
    Which of several files of one name the parser takes depends on the ``<path>`` elements and the folders of the
    including files so far: all of them are checked and counted. Includes whose name holds a parameter are not followed.
    """
    _Included(path, allow_outside, strict).checked_files()


def document_files(path: Path, *, allow_outside: bool = False, strict: bool = False) -> list[Path]:
    """Files of a scene, checked as by :func:`check_document`, which has the parameters.

    Returns
    -------
    the file, included files and every file that any of them names, once each, by the scene's folder with its links
    followed; files that ``<string>`` elements name may be missing
    """
    included = _Included(path, allow_outside, strict)
    found = included.checked_files()
    found += [included.folder / name for text in included.texts.values() for name in text.strings if name]
    return list(dict.fromkeys(found))


class _Included:
    """A scene file and everything that it may include, by places with all links followed.

    Parameters
    ----------
    path : of the scene file
    allow_outside : files may lie outside its folder
    strict : malformed files are refused
    """

    def __init__(self, path: Path, allow_outside: bool, strict: bool) -> None:
        self.root, self.name, self.folder = _real(path), path.name, _real(path.parent)
        self.allow_outside, self.strict = allow_outside, strict
        self.texts = {self.root: read_scene_text(path, strict=strict)}
        self.found: dict[str, list[Path]] = {}  # places by name of an include
        self.below: dict[Path, list[Path]] = {}  # includes of every file, repeated ones included
        self._lookups = 0
        # folders that the parser searches, in any order; never the working folder
        self.folders = {self.folder: None}
        known = (0, 0)
        while known != (known := (len(self.texts), len(self.folders))):
            for text in list(self.texts.values()):
                for tag, name in dict.fromkeys(text.references):
                    if tag in _FOLLOWED:
                        self._follow(tag, self.checked(text, tag, name))

    def _follow(self, tag: str, places: Sequence[Path]) -> None:
        for place in places:
            self.folders[_real(place if tag == "path" else place.parent)] = None
            file = _real(place)
            if tag == "include" and file not in self.texts:
                self.texts[file] = read_scene_text(place, strict=self.strict)
            if max(len(self.texts), len(self.folders)) > _MAX_INCLUDES + 1:
                raise SceneError(f"{self.name}: more than {_MAX_INCLUDES} files are included; join some")

    def places(self, name: str) -> list[Path]:
        """Places of a file name."""
        self._lookups += len(self.folders)
        if self._lookups > _MOST_LOOKUPS:
            raise SceneError(f"{self.name}: names too many files in too many folders; use fewer folders")
        # the parser uses the bytes of the name, independent of the system's encoding
        native = os.fsdecode(name.encode("utf-8")) if os.name == "posix" else name
        return [place for folder in self.folders if _exists(place := folder / native)]

    def checked(self, text: SceneText, tag: str, name: str) -> list[Path]:
        """Places of a file name; raise a SceneError where one is not allowed."""
        what = f'{text.path.name}: <{tag}> of "{one_line(name)}"'
        if not self.allow_outside and "$" in name:
            raise SceneError(
                f"{what}: a parameter could stand for any place; write the name out, or allow it: --allow-outside "
                "(allow_outside=True)"
            )
        places = self.places(name)
        if not self.allow_outside and not all(is_inside(one, self.folder) for one in places or [Path(name)]):
            raise SceneError(f"{what} lies outside the folder of the scene; {_REMEDY}")
        if tag != "path":
            if not places and "$" not in name:
                raise SceneError(
                    f"{what}: there is no such file beside the scene; {shipped_radar(name) or 'check the name'}"
                )
            _check_named(places, what, LARGEST_SCENE if tag == "include" else _LARGEST_SPECTRUM)
        return places

    def checked_files(self) -> list[Path]:
        """Files that the parser reads; raise a SceneError where one is not allowed, or all expand beyond the bounds."""
        found = [self.folder / self.name, *[text.path for text in self.texts.values()][1:]]
        for text in self.texts.values():
            for tag, name in dict.fromkeys(text.references):
                places = self.checked(text, tag, name)
                found += places if tag not in _FOLLOWED else []
                if tag == "include":
                    self.found[name] = list(map(_real, places))
        self._check_expanded()
        return found

    def _check_expanded(self) -> None:
        """Raise a SceneError where expanded includes and parameters exceed the bounds.

        How often each file is read is the sum over those that include it, along the graph of includes; nothing is
        expanded.
        """
        order: list[Path] = []  # every file after those that it includes
        lengths: dict[str, int] = {}
        self._walk(self.root, [], order, lengths)
        times = dict.fromkeys(self.texts, 0)
        times[self.root] = 1
        for file in reversed(order):
            for place in self.below[file]:
                times[place] += times[file]
        inclusions = sum(times.values()) - 1
        if inclusions > _MAX_INCLUDES:
            raise SceneError(
                f"{self.name}: its includes expand to {_many(inclusions)} files, more than the bound "
                f"{_MAX_INCLUDES}; join some"
            )
        texts = self.texts
        elements = sum((times[file] - 1) * texts[file].elements for file in order)
        size = sum(times[file] * texts[file].expand(lengths) - texts[file].size for file in order)
        if elements > _MOST_REPEATED or size > _MOST_EXPANDED:
            raise SceneError(
                f"{self.name}: its includes and $ parameters written out come to {_many(elements)} more elements and "
                f"{_many(size)} more bytes than the files have; at most {_MOST_REPEATED} and {_MOST_EXPANDED} are taken"
            )

    def _walk(self, file: Path, above: list[Path], order: list[Path], lengths: dict[str, int]) -> None:
        """List the files in order, the included ones first, and the lengths of their parameters."""
        if file in above or len(above) >= _MAX_DEPTH:
            what = "includes itself" if file in above else f"more than {_MAX_DEPTH} files include each other"
            raise SceneError(f"{self.texts[file].path.name}: {what}; take the include out")
        if file in order:
            return
        below = []
        for name, value in self.texts[file].steps:
            if name is not None:  # default of a parameter; of several with one name the longest counts
                lengths[name] = max(lengths.get(name, 0), substituted_length(value, lengths))
                continue
            for place in self.found[value]:
                below.append(place)
                self._walk(place, [*above, file], order, lengths)
        order.append(file)
        self.below[file] = below


def check_files(label: str, files: Iterable[str], folder: Path) -> None:
    """Raise a SceneError where the parser has found an included file elsewhere than in the folder."""
    for file in files:
        if not is_inside(file, folder):
            raise SceneError(
                f'{label}: includes "{one_line(file)}" outside the folder of the scene; {_REMEDY}'
            )


def check_meshes(elements: Iterable[Element]) -> None:
    """Raise a SceneError where a shape names a mesh, or a map a bitmap, outside the scene's folder, unless shipped."""
    elements = list(elements)
    for texture in (child for e in elements for name, child in e.children if name in MAP_NAMES):
        file = map_file(texture)
        if file is not None and not any(is_inside(file, one) for one in (texture.folder, scenes_dir())):
            raise SceneError(
                f'{texture.where}: bitmap "{one_line(file.name)}" lies outside the folder of the scene; {_REMEDY}'
            )
    inside: dict[str, bool] = {}
    shipped = scenes_dir()  # meshes that copies of shipped scenes refer to
    for element in elements:
        name = element.values.get("filename")
        if element.kind != "shape" or not isinstance(name, str):
            continue
        path = os.path.join(element.folder, name)
        parent = os.path.dirname(path)
        # a folder is resolved once for all its files that are not links
        plain = ".." not in path and _plainly_there(path)
        if plain and parent not in inside:
            inside[parent] = any(is_inside(parent, one) for one in (element.folder, shipped))
        if not (inside[parent] if plain else is_inside(name, element.folder)):
            raise SceneError(
                f'{element.where}: mesh file "{one_line(name)}" lies outside the folder of the scene; {_REMEDY}'
            )


def _check_named(places: Iterable[Path], what: str, most: int) -> None:
    """Raise a SceneError where Mitsuba's parser would open a file that is not regular, or too large."""
    for place in places:
        try:
            check_regular(place, most)
        except OSError as error:
            raise SceneError(f"{what}: {error.strerror}") from error


def _plainly_there(path: str) -> bool:
    """Whether there is a file of that name that is not a link."""
    try:
        return not stat.S_ISLNK(os.lstat(path).st_mode)
    except (OSError, ValueError):
        return False


def _exists(path: Path) -> bool:
    try:
        return os.path.lexists(path)
    except (OSError, ValueError):
        return False


def _real(path: Path) -> Path:
    return Path(os.path.realpath(path))


def _many(number: int) -> str:
    return str(number) if number < 10**9 else f"1e{len(str(number)) - 1}"
