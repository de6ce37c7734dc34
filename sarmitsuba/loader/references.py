"""What a scene file refers to: nothing outside its own folder, unless that is allowed, and no document type."""

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.parsers import expat

from sarmitsuba.errors import SceneError
from sarmitsuba.loader.elements import Element
from sarmitsuba.loader.library import scenes_dir
from sarmitsuba.loader.maps import MAP_NAMES, map_file
from sarmitsuba.parameters import one_line
from sarmitsuba.regular_files import check_regular, is_inside, read_bytes

_REMEDY = "move it there, or allow it: --allow-outside (allow_outside=True)"
_MAX_INCLUDES = 1000
# tags that name a file or folder in an attribute "value" or "filename"
_PLACES = ("include", "path")
_FILE_ATTRIBUTE = re.compile(rb"\bfilename\s*=")
# elements within each other: scenes have four or five; Mitsuba's parser calls itself for each, and the stack ends
_DEEPEST = 200
# bytes of a scene file, and of a spectrum that one names
_LARGEST_SCENE = 1 << 28
_LARGEST_SPECTRUM = 1 << 20


def check_document(path: Path, *, allow_outside: bool = False) -> None:
    """Look at a scene file and what it includes before the parser opens any of it.

    Parameters
    ----------
    path : of the scene file, which exists
    allow_outside : files may lie outside its folder

    Raises
    ------
    SceneError
        A file has a document type, names what is not there or no ordinary file, or, unless allowed, includes or
        searches outside the folder of the scene.
    """
    seen: set[Path] = set()
    waiting = [path]
    folders = [path.parent]  # that the parser searches; never the one that the program runs in
    while waiting:
        file = waiting.pop()
        if file in seen:
            continue
        seen.add(file)
        if len(seen) > _MAX_INCLUDES:
            raise SceneError(f"{path.name}: more than {_MAX_INCLUDES} files are included; join some")
        for tag, name in _references(file):
            what = f'{file.name}: <{tag}> of "{one_line(name)}"'
            if not allow_outside and "$" in name:
                raise SceneError(
                    f"{what}: a parameter could stand for any place; write the name out, or allow it: --allow-outside "
                    "(allow_outside=True)"
                )
            places = [place for folder in folders if _exists(place := folder / name)]
            if not allow_outside and not all(is_inside(one, path.parent) for one in [Path(name), *places]):
                raise SceneError(f"{what} lies outside the folder of the scene; {_REMEDY}")
            if tag == "path":
                folders.append(path.parent / name)
            elif places:
                _check_named(places, what, _LARGEST_SCENE if tag == "include" else _LARGEST_SPECTRUM)
                waiting += places if tag == "include" else []
            elif "$" not in name:
                raise SceneError(f"{what}: there is no such file beside the scene; check the name")


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
    inside: dict[Path, bool] = {}
    shipped = scenes_dir()  # meshes that scenes made from shipped ones go on naming
    for element in elements:
        name = element.values.get("filename")
        if element.kind != "shape" or not isinstance(name, str):
            continue
        path = element.folder / name
        # thousands of files of one folder are resolved once, unless they are links
        plain = ".." not in path.parts and not os.path.islink(path) if _exists(path) else False
        if plain and path.parent not in inside:
            inside[path.parent] = any(is_inside(path.parent, one) for one in (element.folder, shipped))
        if not (inside[path.parent] if plain else is_inside(name, element.folder)):
            raise SceneError(
                f'{element.where}: mesh file "{one_line(name)}" lies outside the folder of the scene; {_REMEDY}'
            )


def _check_named(places: Iterable[Path], what: str, most: int) -> None:
    """Raise a SceneError where Mitsuba's parser would open what is no ordinary file, or a large one."""
    for place in places:
        try:
            check_regular(place, most)
        except OSError as error:
            raise SceneError(f"{what}: {error.strerror}") from error


def _exists(path: Path) -> bool:
    try:
        return os.path.lexists(path)
    except (OSError, ValueError):
        return False


def _references(path: Path) -> Sequence[tuple[str, str]]:
    """Tag and name of every element that names a file or a folder in its attributes.

    These are ``include``, ``path``, ``spectrum`` and whatever else has an attribute ``filename``, which Mitsuba's
    parser opens while it reads; files that a ``<string>`` names are checked later, by their use.

    What is not well-formed is left to the parser, whose messages are better, as long as it cannot refer to a file: that
    one is lenient, and might see references where a strict one stops.
    """
    try:
        data = read_bytes(path, _LARGEST_SCENE)
    except OSError as error:
        raise SceneError(f"{path}: cannot read the scene file: {error.strerror}") from error
    found: list[tuple[str, str]] = []
    has_type: list[str] = []
    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _DEEPEST:
            raise SceneError(
                f"{path.name} (line {parser.CurrentLineNumber}): more than {_DEEPEST} elements within each other; "
                "close them"
            )
        named = attributes.get("filename") or (attributes.get("value") if tag in _PLACES else None)
        if named or tag in _PLACES:
            found.append((tag, named or ""))

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    def document_type(name: str, *_: object) -> None:
        has_type.append(name)

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = document_type
    # entities are neither read nor expanded
    parser.SetParamEntityParsing(expat.XML_PARAM_ENTITY_PARSING_NEVER)
    broken = ""
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        broken = one_line(error, 100)
    if has_type or b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise SceneError(
            f"{path.name}: holds a document type or entities (<!DOCTYPE, <!ENTITY), which a scene needs not and which "
            "can hide what it is made of; remove them"
        )
    if broken and (
        b"\x00" in data or b"<include" in data or b"<path" in data or _FILE_ATTRIBUTE.search(data)
    ):
        raise SceneError(f"{path.name}: malformed XML: {broken}; check that every element is closed")
    return found


__all__ = ["check_document", "check_files", "check_meshes"]
