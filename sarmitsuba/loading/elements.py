"""Objects of a scene as a tree of plain elements, read from a file, a dict or a loaded scene."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64


class Opaque:
    """Placeholder of a value without a meaning for a radar: a colour, a spectrum, a texture."""

    def __init__(self, kind: str) -> None:
        self.kind = kind

    def __str__(self) -> str:
        return f"a {self.kind}"


# types of an element's property: numbers, text, a (3,) point or a (4, 4) transform
Property = float | int | bool | str | F64 | Opaque


@dataclass(frozen=True, eq=False)
class Element:
    """One object of the scene file.

    Parameters
    ----------
    kind : ``scene``, ``sensor``, ``film``, ``integrator``, ``bsdf``, ``shape`` or another XML tag, lower case
    plugin : its ``type`` attribute
    id : its ``id`` attribute, or empty
    where : start of every error about it: ``scene.xml: sensor "radar"``
    folder : base of its relative file names
    values : name to float, int, bool, str, (3,) or (4, 4) float64 array, or `Opaque`
    children : argument name and element; references are resolved: one element may be at several places
    """

    kind: str
    plugin: str
    id: str
    where: str
    folder: Path
    values: Mapping[str, Property]
    children: list[tuple[str, "Element"]] = field(default_factory=list)

    def child(self, kind: str) -> "Element | None":
        """First child of a kind."""
        return next((element for _, element in self.children if element.kind == kind), None)

    def of_kind(self, kind: str) -> Iterator["Element"]:
        """Children of a kind, in order."""
        return (element for _, element in self.children if element.kind == kind)

    def given(self) -> dict[str, Property]:
        """Values together with the named children (a texture in place of a number is an error)."""
        named = {name: Opaque(child.kind) for name, child in self.children if not name.startswith("_arg_")}
        return {**self.values, **named}


def walk(root: Element) -> Iterator[Element]:
    """Every element at and below ``root``, each once."""
    seen: set[int] = set()
    stack = [root]
    while stack:
        element = stack.pop()
        if id(element) in seen:
            continue
        seen.add(id(element))
        yield element
        stack.extend(child for _, child in reversed(element.children))


def plain_value(value: object) -> Property:
    """Python or NumPy value of one of Mitsuba's properties."""
    if isinstance(value, bool | int | float | str):
        return value
    kind = type(value).__name__
    if "Transform" in kind:
        return np.array(value.matrix, dtype=np.float64)  # type: ignore[attr-defined]  # of Mitsuba
    if isinstance(value, np.ndarray) or kind.startswith(("Array3", "ScalarVector3", "ScalarPoint3")):
        return np.array(value, dtype=np.float64)
    return Opaque("colour" if "Color" in kind else kind.lower())
