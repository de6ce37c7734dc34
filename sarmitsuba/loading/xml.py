"""Scene files and dicts as trees of elements, read by Mitsuba's parser with every number in float64."""

import re
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import did_you_mean, one_line
from sarmitsuba.loading.elements import Element, plain_value
from sarmitsuba.loading.references import check_document, check_files
from sarmitsuba.loading.tables import plugin_tables
from sarmitsuba.machine import regular_files
from sarmitsuba.machine.backend import mi

_SOURCE = re.compile(r"\[[\w.]+\.cpp:\d+\] ?")
_UNRESOLVED = re.compile(r'unresolved reference to "([^"]*)"')
_ID = re.compile(r'<(\w+)\b[^<>]*?\bid="([^"]*)"')
_POSITION = re.compile(r" ?\((line \d+, col \d+)\)")
_NODE = re.compile(r'dictionary node "(.*)"')
# bounds of dicts: within each other, entries in all, and numbers in a list
_DEEPEST, _MOST_ENTRIES, _MOST_NUMBERS = 200, 1_000_000, 1_000_000
_PARSER_ERRORS = (RuntimeError, TypeError, ValueError, IndexError, KeyError, AttributeError)


def parse_file(path: Path, parameters: Mapping[str, str], *, allow_outside: bool = False) -> Element:
    """Read a scene file into elements.

    Parameters
    ----------
    path : XML file
    parameters : values of the file's ``$name`` parameters, without plugin overrides
    allow_outside : it may include files from outside its folder

    Returns
    -------
    the scene's element

    Raises
    ------
    SceneError : one line: place and kind of the error in the file, or a file that is not allowed
    """
    check_document(path, allow_outside=allow_outside)
    config = mi.parser.ParserConfig(mi.variant())
    config.unused_parameters = mi.LogLevel.Debug
    absolute = path.absolute()  # files that the parser finds are then named by absolute paths
    try:
        with _searching(absolute.parent):
            state = mi.parser.parse_file(config, str(absolute), **_list_allowed(parameters))
        if not allow_outside:
            check_files(path.name, [str(file) for file in state.files], path.parent)
        root = _tree(config, state, path.name, path.parent)
    except _PARSER_ERRORS as error:
        raise SceneError(_parser_message(str(error), path)) from None
    if root.kind != "scene":
        raise SceneError(f"{path.name}: the root element is <{root.kind}>, not <scene>; wrap it in <scene>")
    return root


def parse_dict(scene: dict[str, object], label: str) -> Element:
    """Read a dict as for `mi.load_dict` into elements; file names are relative to the working folder.

    Parameters
    ----------
    scene : as `check_dict` returns it, without any Mitsuba object in it, transforms and colours apart
    label : start of every error

    Raises
    ------
    SceneError : one line about the defect, and its place
    """
    config = mi.parser.ParserConfig(mi.variant())
    try:
        root = _tree(config, mi.parser.parse_dict(config, scene), label, Path())
    except _PARSER_ERRORS as error:
        what = _SOURCE.sub("", (str(error).strip() or "unreadable").split("\n")[-1])
        raise SceneError(f"{label}: {one_line(what, 200)}") from None
    if root.kind != "scene":
        raise SceneError(f'{label}: the outermost type is "{root.plugin}", not "scene"; wrap it in a scene')
    return root


def check_dict(scene: Mapping[str, object], label: str) -> dict[str, object]:
    """Copy of a dict for Mitsuba's parser, which ends the interpreter on some types, None among them.

    Raises
    ------
    SceneError : one line that names the key of a value of a foreign type, a key that is no text, or too deep nesting
    """
    copy: dict[str, object] = {}
    todo: list[tuple[str, Mapping[str, object], dict[str, object], int]] = [("", scene, copy, 1)]
    count = 0
    while todo:
        place, source, target, depth = todo.pop()
        if depth > _DEEPEST:
            raise SceneError(f"{label}: {one_line(place, 60)}: more than {_DEEPEST} dicts within each other")
        for key, value in source.items():
            count += 1
            here = f"{place}.{key}" if place else f"{key}"
            if not isinstance(key, str):
                raise SceneError(
                    f"{label}: the key {one_line(here, 60)} is no text; give every object a name"
                )
            if count > _MOST_ENTRIES:
                raise SceneError(f"{label}: more than {_MOST_ENTRIES} entries; put meshes into files")
            if isinstance(value, Mapping):
                inner: dict[str, object] = {}
                target[key] = inner
                todo.append((here, value, inner, depth + 1))
            elif (isinstance(value, str) or key != "type") and _is_known(value):
                target[key] = value
            else:
                raise SceneError(
                    f'{label}: "{one_line(here, 60)}" is of type {one_line(type(value).__name__, 60)}; give '
                    + (
                        "the name of a plugin"
                        if key == "type"
                        else "a number, text, a point, a transform or a dict"
                    )
                )
    return copy


def _is_known(value: object) -> bool:
    """Whether Mitsuba's parser takes a value of a dict, or refuses it with an exception."""
    if isinstance(value, list | tuple):
        return len(value) <= _MOST_NUMBERS and all(
            isinstance(v, bool | int | float | np.number) and _is_known(v) for v in value
        )
    if isinstance(value, int):
        return -(1 << 63) <= value < 1 << 63
    if isinstance(value, np.ndarray | np.generic):
        return value.dtype.kind in "biufU"
    return (
        isinstance(value, float | str)
        or type(value).__module__.partition(".")[0] in ("mitsuba", "drjit")
        or (isinstance(value, mi.Object))
    )


def read_text(path: Path) -> str:
    """Text of a scene file.

    Raises
    ------
    SceneError : it cannot be read
    """
    try:
        return regular_files.read_text(path)
    except OSError as error:
        raise SceneError(f"{path}: cannot read the scene file: {error.strerror}") from error


@contextmanager
def _searching(folder: Path) -> Iterator[None]:
    """Let Mitsuba search files in that folder only, not in the working folder."""
    before = mi.file_resolver()
    own = mi.FileResolver()
    own.clear()
    own.append(str(folder))
    mi.set_file_resolver(own)
    try:
        yield
    finally:
        mi.set_file_resolver(before)


def _list_allowed(parameters: Mapping[str, str]) -> dict[str, str]:
    for name in parameters:
        if name in ("config", "filename"):
            raise SceneError(f'parameter "{name}": this name is reserved; rename the parameter in the file')
    return dict(parameters)


def _tree(
    config: "mi.parser.ParserConfig", state: "mi.parser.ParserState", label: str, folder: Path
) -> Element:
    """Turn the parser's node list into elements that refer to each other."""
    mi.parser.transform_upgrade(config, state)
    mi.parser.transform_resolve_references(config, state)
    elements = []
    lines = _LineNumbers(state, label)
    for node in state.nodes:
        props = node.props
        plugin, name = props.plugin_name(), props.id()
        kind = _kind(str(node.type), plugin, label)
        if state.node_paths:  # of a dict
            place = _NODE.search(mi.parser.file_location(state, node))
            if place and place[1].endswith(f".{name}"):
                called, name = f'{kind} "{place[1]}"', ""  # a key such as "bsdf" is no name
            else:
                called = f'{kind} "{name}"' if name else f"{kind} {plugin}"
        else:
            called = f'{kind} "{name}"' if name else f"{kind} {plugin} ({lines.of(node)})"
        given = {key: props[key] for key in props.keys()}
        values = {
            key: plain_value(value)
            for key, value in given.items()
            if not isinstance(value, mi.Properties.ResolvedReference)
        }
        elements.append(Element(kind, plugin, name, f"{label}: {called}", folder, values))
    for node, element in zip(state.nodes, elements, strict=True):
        for key in node.props.keys():
            value = node.props[key]
            if isinstance(value, mi.Properties.ResolvedReference):
                element.children.append((key, elements[value.index()]))
    return elements[0]


class _LineNumbers:
    """Lines of the nodes of files; Mitsuba's search reads the file again for each node."""

    def __init__(self, state: "mi.parser.ParserState", name: str) -> None:
        self._state, self._name = state, name
        self._ends: dict[int, list[int]] = {}

    def of(self, node: "mi.parser.SceneNode") -> str:
        """Line of a node, from 1, and the file where it is not the scene file."""
        number = node.file_index
        if number not in self._ends:
            text = regular_files.read_bytes(str(self._state.files[number]))
            self._ends[number] = [found.start() for found in re.finditer(b"\n", text)]
        line = f"line {bisect_left(self._ends[number], node.offset) + 1}"
        name = Path(str(self._state.files[number])).name
        return line if name == self._name else f"{line} of {one_line(name)}"


def _kind(node_type: str, plugin: str, label: str) -> str:
    """Kind of a node; a dict does not state it for plugins that are not registered with Mitsuba."""
    kind = node_type.rpartition(".")[2].lower()
    if kind != "unknown":
        return kind
    known = plugin_tables()
    if plugin not in known:
        raise SceneError(f'{label}: there is no plugin "{one_line(plugin)}"{did_you_mean(plugin, known)}')
    return known[plugin].element


def _parser_message(text: str, path: Path) -> str:
    """One line from Mitsuba's message: file, place, error."""
    text = text.strip() or "unreadable"
    # the last line, unless the message quotes several lines of the file
    start = max(text.find("Error while loading"), text.find("Parsing of XML file"))
    last = " ".join(_SOURCE.sub("", text[start:] if start >= 0 else text.split("\n")[-1]).split())
    position = _POSITION.search(last)
    place = f" ({position.group(1)})" if position else ""
    what = _POSITION.sub("", last)
    match = re.match(r'Parsing of XML file ".*?" failed: (.*)', what)
    if match:
        return f"{path.name}{place}: malformed XML: {one_line(match.group(1), 200)}; check that every element is closed"
    match = re.match(r'Error while loading (?:XML file )?"?(.*?)"?: (.*)', what)
    file_name, what = (Path(match.group(1)).name, match.group(2)) if match else (path.name, what)
    remedy = ""
    if what.startswith("undefined parameter"):
        remedy = f"; give it a <default> or -D {what.rpartition('$')[2]}=value"
    unresolved = _UNRESOLVED.match(what)
    if unresolved:
        what = f'unresolved reference to "{unresolved.group(1)}"'
        remedy = did_you_mean(unresolved.group(1), _ids(path)) or "; give an object that id"
    return f"{file_name}{place}: {one_line(what, 200)}{remedy}"


def _ids(path: Path) -> list[str]:
    """Names that the objects of a file have, without those of its includes."""
    text = regular_files.read_bytes(str(path)).decode("utf-8", "replace")
    return [name for tag, name in _ID.findall(text) if tag != "ref"]
