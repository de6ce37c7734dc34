"""Parameters given by the caller: values of a file's ``$name``, and overrides such as ``sar_path.max_depth=5``."""

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import ParamTable, Value, did_you_mean, one_line
from sarmitsuba.loading.elements import Element, Property

Given = Property | Value | None


@dataclass(frozen=True)
class Overrides:
    """Overrides of plugin parameters, such as ``sar_path.max_depth=5``.

    Parameters
    ----------
    entries : plugin or id, parameter and text
    """

    entries: tuple[tuple[str, str, str], ...] = ()

    def given(self, element: Element, table: ParamTable, skip: tuple[str, ...] = ()) -> dict[str, Given]:
        """Parameters that an element or an override gives, not yet validated.

        Parameters
        ----------
        element : its values and named children
        table : of its plugin
        skip : names of children that are no parameters

        Raises
        ------
        ``table.error`` : an override has an unknown name or cannot be read
        """
        given: dict[str, Given] = {name: v for name, v in element.given().items() if name not in skip}
        for prefix, name, text in self.entries:
            if prefix in (element.plugin, element.id):
                where = f"-D {prefix}.{name}={text}"
                table.check_name(name, where)
                given[name] = table[name].parse(text, where, table.error)
        return given

    def read(
        self, element: Element, table: ParamTable, skip: tuple[str, ...] = ()
    ) -> tuple[dict[str, Value | None], frozenset[str]]:
        """Return validated parameters of an element and the names that are given, less children to ``skip``."""
        given = self.given(element, table, skip)
        return table.read(given, element.where, nested=skip), frozenset(given)


def split_parameters(
    parameters: Mapping[str, str], tables: Mapping[str, ParamTable]
) -> tuple[dict[str, str], Overrides]:
    """Separate values for ``$name`` in the file from overrides of plugin parameters, which hold a dot.

    Raises
    ------
    SceneError : a name is no text, or a value neither text nor a number
    """
    if not isinstance(parameters, Mapping):
        raise SceneError(
            f"parameters is of type {type(parameters).__name__}; give a dict of names and values"
        )
    plain: dict[str, str] = {}
    entries = []
    for key, value in parameters.items():
        if not isinstance(key, str) or not isinstance(value, str | int | float | np.generic):
            raise SceneError(
                f"parameters: {one_line(key, 60)} = {one_line(value, 60)}: a name is text, a value text or a number"
            )
        prefix, dot, name = key.rpartition(".")
        if not dot:
            plain[key] = str(value)
            continue
        if prefix in tables:
            tables[prefix].check_name(name, f"-D {key}={value}")
        entries.append((prefix, name, str(value)))
    return plain, Overrides(tuple(entries))


def _hint(name: str, tables: Mapping[str, ParamTable]) -> str:
    """Parameter of a plugin that a plain name means, or may mean."""
    homes = {
        parameter: plugin for plugin, table in reversed(list(tables.items())) for parameter in table.names
    }
    if name in homes:
        return f"give {homes[name]}.{name}"
    close = difflib.get_close_matches(name, homes, n=1, cutoff=0.75)
    return (
        f"did you mean {homes[close[0]]}.{close[0]}?"
        if close
        else "parameters of plugins are given as plugin.name"
    )


def check_used(
    plain: Mapping[str, str],
    overrides: Overrides,
    label: str,
    texts: Sequence[str],
    ids: Mapping[str, str],
    tables: Mapping[str, ParamTable],
) -> None:
    """Raise when a parameter given by name has no effect anywhere.

    Parameters
    ----------
    plain, overrides : as from `split_parameters`
    label : start of every error
    texts : of scene and radar file; none for a scene that is no file
    ids : of all elements, with their plugins
    tables : of the plugins, by name
    """
    plugins = set(tables)
    text = "\n".join(texts)
    known = set(re.findall(r"\$\{?(\w+)", text)) | set(re.findall(r'<default\s+name="(\w+)"', text))
    for name, value in plain.items():
        if name not in known and "<include" not in text:
            listed = (
                "the file has " + ", ".join(f"${k}" for k in sorted(known))
                if known
                else "the file has none"
                if texts
                else "only a file has any"
            )
            hint = _hint(name, tables)
            raise SceneError(
                f'{label}: parameter "{name}" = {one_line(value)} is not used; {listed} ({hint})'
            )
    for prefix, name, value in overrides.entries:
        takes = plugins | {key for key, plugin in ids.items() if plugin in plugins}
        if prefix not in takes:
            what = f'no plugin or id "{prefix}"'
            if prefix in ids:
                what = f'"{prefix}" is a {ids[prefix]}, whose values only the file changes'
            guess = did_you_mean(prefix, takes) or f"; give one of {', '.join(sorted(plugins))}, or an id"
            raise SceneError(f"{label}: -D {prefix}.{name}={value}: {what}{guess}")
