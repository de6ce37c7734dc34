"""What a scene file refers to: nothing outside its own folder, unless that is allowed, and no document type."""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.parsers import expat

from sarmitsuba.errors import SceneError
from sarmitsuba.loader.elements import Element
from sarmitsuba.loader.library import scenes_dir
from sarmitsuba.loader.maps import MAP_NAMES, map_file
from sarmitsuba.parameters import one_line

_REMEDY = "move it there, or allow it: --allow-outside (allow_outside=True)"
_MAX_INCLUDES = 1000


def check_document(path: Path, *, allow_outside: bool = False) -> None:
    """Look at a scene file and what it includes before the parser opens any of it.

    Parameters
    ----------
    path : of the scene file, which exists
    allow_outside : files may lie outside its folder

    Raises
    ------
    SceneError
        A file has a document type, includes what is no ordinary file, or, unless allowed, includes or searches outside
        the folder of the scene.
    """
    seen: set[Path] = set()
    waiting = [path]
    while waiting:
        file = waiting.pop()
        if file in seen:
            continue
        seen.add(file)
        if len(seen) > _MAX_INCLUDES:
            raise SceneError(f"{path.name}: more than {_MAX_INCLUDES} files are included; join some")
        for tag, name in _references(file):
            if not allow_outside and "$" in name:
                raise SceneError(
                    f'{file.name}: <{tag}> of "{one_line(name)}": a parameter could stand for any place; write the '
                    "name out, or allow it: --allow-outside (allow_outside=True)"
                )
            if not allow_outside and not is_inside(name, path.parent):
                raise SceneError(
                    f'{file.name}: <{tag}> of "{one_line(name)}" lies outside the folder of the scene; {_REMEDY}'
                )
            place = path.parent / name
            if tag == "include" and "$" not in name and _exists(place):
                if not place.is_file():
                    raise SceneError(f'{file.name}: includes "{one_line(name)}", which is no ordinary file')
                waiting.append(place)


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


def is_inside(name: str | Path, folder: Path) -> bool:
    """Whether a path, relative to the folder or absolute, ends in it after all links are followed."""
    try:
        place = os.path.realpath(folder / name)
    except (OSError, ValueError):  # longer than the system takes, or with a null character
        return ".." not in Path(name).parts and not Path(name).is_absolute()
    return Path(place).is_relative_to(os.path.realpath(folder))


def _exists(path: Path) -> bool:
    try:
        return os.path.lexists(path)
    except (OSError, ValueError):
        return False


def _references(path: Path) -> Sequence[tuple[str, str]]:
    """Tag and name of every ``include`` and ``path`` of a file.

    What is not well-formed is left to the parser, whose messages are better, as long as it cannot refer to a file: that
    one is lenient, and might see references where a strict one stops.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SceneError(f"{path}: cannot read the scene file: {error.strerror}") from error
    found: list[tuple[str, str]] = []
    has_type: list[str] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        if tag in ("include", "path"):
            found.append((tag, attributes.get("filename") or attributes.get("value") or ""))

    def document_type(name: str, *_: object) -> None:
        has_type.append(name)

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
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
    if broken and (b"\x00" in data or b"<include" in data or b"<path" in data):
        raise SceneError(f"{path.name}: malformed XML: {broken}; check that every element is closed")
    return found


__all__ = ["check_document", "check_files", "check_meshes", "is_inside"]
