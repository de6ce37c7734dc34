"""A scene file as a tree of plain elements, read by Mitsuba's own parser with every number in float64."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sarmitsuba.backend import ensure_backend
from sarmitsuba.errors import SceneError
from sarmitsuba.parameters import ParamTable, did_you_mean, one_line

_SOURCE = re.compile(r"\[[\w.]+\.cpp:\d+\] ?")
_POSITION = re.compile(r" ?\((line \d+, col \d+)\)")


class Opaque:
    """Stands for a value that has no meaning for a radar: a colour, a spectrum, a texture."""

    def __init__(self, kind: str) -> None:
        self.kind = kind

    def __str__(self) -> str:
        return f"a {self.kind}"


@dataclass(frozen=True, eq=False)
class Element:
    """One object of the scene file.

    Parameters
    ----------
    kind : ``scene``, ``sensor``, ``film``, ``integrator``, ``bsdf``, ``shape`` or another XML tag, lower case
    plugin : its ``type`` attribute
    id : its ``id`` attribute, or empty
    where : start of every error about it: ``scene.xml: sensor "radar"``
    folder : that its file names are relative to
    values : name to float, int, bool, str, (3,) or (4, 4) float64 array, or `Opaque`
    children : argument name and element; references are resolved: one element may be at several places
    """

    kind: str
    plugin: str
    id: str
    where: str
    folder: Path
    values: Mapping[str, Any]
    children: list[tuple[str, "Element"]] = field(default_factory=list)

    def child(self, kind: str) -> "Element | None":
        """First child of a kind."""
        return next((element for _, element in self.children if element.kind == kind), None)

    def of_kind(self, kind: str) -> Iterator["Element"]:
        """Children of a kind, in order."""
        return (element for _, element in self.children if element.kind == kind)

    def given(self) -> dict[str, Any]:
        """Values together with the named children (a texture where a number belongs has to be refused)."""
        named = {name: Opaque(child.kind) for name, child in self.children if not name.startswith("_arg_")}
        return {**self.values, **named}


@dataclass(frozen=True)
class Overrides:
    """Values given on the command line for parameters of plugins: ``sar_path.max_depth=5``.

    Parameters
    ----------
    entries : plugin or id, parameter and text
    """

    entries: tuple[tuple[str, str, str], ...] = ()

    def read(
        self, element: Element, table: ParamTable, skip: tuple[str, ...] = ()
    ) -> tuple[dict[str, Any], frozenset[str]]:
        """Return validated parameters of an element and the names that are given.

        Parameters
        ----------
        element : its values and named children
        table : of its plugin
        skip : names of children that are no parameters
        """
        given = {name: value for name, value in element.given().items() if name not in skip}
        for prefix, name, text in self.entries:
            if prefix in (element.plugin, element.id):
                where = f"-D {prefix}.{name}={text}"
                table.check_name(name, where)
                given[name] = table[name].parse(text, where, table.error)
        return table.read(given, element.where), frozenset(given)


def parse_scene(path: Path, parameters: Mapping[str, str]) -> Element:
    """Read a scene file into elements.

    Parameters
    ----------
    path : XML file
    parameters : values of the file's ``$name`` parameters, without plugin overrides

    Returns
    -------
    the scene's element

    Raises
    ------
    SceneError : one line about what is malformed, and where
    """
    _read_text(path)
    variant = ensure_backend().variant
    import mitsuba as mi

    config = mi.parser.ParserConfig(variant)
    config.unused_parameters = mi.LogLevel.Debug
    try:
        state = mi.parser.parse_file(config, str(path), **_allowed(parameters))
        mi.parser.transform_upgrade(config, state)
        mi.parser.transform_resolve_references(config, state)
        root = _tree(mi, state, path)
    except (RuntimeError, TypeError, ValueError, IndexError, KeyError, AttributeError) as error:
        raise SceneError(_parser_message(str(error), path)) from None
    if root.kind != "scene":
        raise SceneError(f"{path.name}: the root element is <{root.kind}>, not <scene>; wrap it in <scene>")
    return root


def split_parameters(
    parameters: Mapping[str, str], tables: Mapping[str, ParamTable]
) -> tuple[dict[str, str], Overrides]:
    """Separate values for ``$name`` in the file from overrides of plugin parameters, which hold a dot."""
    plain: dict[str, str] = {}
    entries = []
    for key, value in parameters.items():
        prefix, dot, name = key.rpartition(".")
        if not dot:
            plain[key] = str(value)
            continue
        if prefix in tables:
            tables[prefix].check_name(name, f"-D {key}={value}")
        entries.append((prefix, name, str(value)))
    return plain, Overrides(tuple(entries))


def check_used(
    plain: Mapping[str, str], overrides: Overrides, files: list[Path], ids: set[str], plugins: set[str]
) -> None:
    """Raise when a parameter given by name has no effect anywhere.

    Parameters
    ----------
    plain, overrides : as from `split_parameters`
    files : scene and radar file
    ids : of all elements
    plugins : names of the tables
    """
    texts = "\n".join(_read_text(path) for path in files)
    known = set(re.findall(r"\$\{?(\w+)", texts)) | set(re.findall(r'<default\s+name="(\w+)"', texts))
    for name, value in plain.items():
        if name not in known and "<include" not in texts:
            listed = (
                "the file has " + ", ".join(f"${k}" for k in sorted(known)) if known else "the file has none"
            )
            raise SceneError(
                f'{files[0].name}: parameter "{name}" = {one_line(value)} is not used; {listed} '
                "(parameters of plugins are given as plugin.name)"
            )
    for prefix, name, text in overrides.entries:
        if prefix not in ids | plugins:
            guess = (
                did_you_mean(prefix, ids | plugins) or f"; give one of {', '.join(sorted(plugins))}, or an id"
            )
            raise SceneError(f'{files[0].name}: -D {prefix}.{name}={text}: no plugin or id "{prefix}"{guess}')


def walk(root: Element) -> Iterator[Element]:
    """Every element below and with ``root``, each once."""
    seen: set[int] = set()
    stack = [root]
    while stack:
        element = stack.pop()
        if id(element) in seen:
            continue
        seen.add(id(element))
        yield element
        stack.extend(child for _, child in reversed(element.children))


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise SceneError(f"{path}: cannot read the scene file: {error.strerror}") from error


def _allowed(parameters: Mapping[str, str]) -> dict[str, str]:
    for name in parameters:
        if name in ("config", "filename"):
            raise SceneError(f'parameter "{name}": this name is reserved; rename the parameter in the file')
    return dict(parameters)


def _tree(mi: Any, state: Any, path: Path) -> Element:
    """Turn the parser's node list into elements that refer to each other."""

    def line(node: Any) -> str:
        match = _POSITION.search(mi.parser.file_location(state, node))
        return f" ({match.group(1).split(',')[0]})" if match else ""

    elements = []
    for node in state.nodes:
        props = node.props
        kind = str(node.type).rpartition(".")[2].lower()
        plugin, name = props.plugin_name(), props.id()
        label = f'{kind} "{name}"' if name else f"{kind} {plugin}{line(node)}"
        values = {
            key: plain_value(props[key])
            for key in props.keys()
            if not isinstance(props[key], mi.Properties.ResolvedReference)
        }
        elements.append(Element(kind, plugin, name, f"{path.name}: {label}", path.parent, values))
    for node, element in zip(state.nodes, elements, strict=True):
        for key in node.props.keys():
            value = node.props[key]
            if isinstance(value, mi.Properties.ResolvedReference):
                element.children.append((key, elements[value.index()]))
    return elements[0]


def plain_value(value: Any) -> Any:
    """Python or NumPy value of a property."""
    if isinstance(value, bool | int | float | str):
        return value
    kind = type(value).__name__
    if "Transform" in kind:
        return np.array(value.matrix, dtype=np.float64)
    if kind.startswith("Array3"):
        return np.array([float(value[i]) for i in range(3)])
    return Opaque("colour" if "Color" in kind else kind.lower())


def _parser_message(text: str, path: Path) -> str:
    """One line out of Mitsuba's message: file, place, what."""
    last = _SOURCE.sub("", text.strip().split("\n")[-1] if text.strip() else "unreadable")
    position = _POSITION.search(last)
    place = f" ({position.group(1)})" if position else ""
    what = _POSITION.sub("", last)
    match = re.match(r'Parsing of XML file ".*?" failed: (.*)', what)
    if match:
        return f"{path.name}{place}: malformed XML: {match.group(1)}; check that every element is closed"
    match = re.match(r'Error while loading (?:XML file )?"?(.*?)"?: (.*)', what)
    file_name, what = (Path(match.group(1)).name, match.group(2)) if match else (path.name, what)
    remedy = ""
    if what.startswith("undefined parameter"):
        remedy = f"; give it a <default> or -D {what.rpartition('$')[2]}=value"
    return f"{file_name}{place}: {one_line(what, 200)}{remedy}"


__all__ = [
    "Element",
    "Opaque",
    "Overrides",
    "check_used",
    "parse_scene",
    "plain_value",
    "split_parameters",
    "walk",
]
