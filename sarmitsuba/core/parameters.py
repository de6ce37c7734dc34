"""Declarative tables of parameters (kind, unit, default, bounds, meaning) for validation and documentation."""

import difflib
import functools
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Literal, TypeVar

from sarmitsuba.core.errors import ExtensionError, SarmitsubaError, SceneError

Kind = Literal["float", "integer", "string", "boolean", "integer or auto", "ignored"]
Value = float | int | str | bool
Choices = tuple[str, ...] | Callable[[], tuple[str, ...]]

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T")
D = TypeVar("D", bound="DataclassInstance")
# most names listed by an error; longer lists are on the page
MOST_NAMED, PAGE = 40, "docs/scene_format.md"
# least magnitude of a number other than 0, whose fourth power is still a normal one
TINY = 1e-60
_PARAM = "param"  # key in the metadata of a field

# accepted spellings of true and false
BOOLEANS = {
    **dict.fromkeys(("true", "on", "yes", "1"), True),
    **dict.fromkeys(("false", "off", "no", "0"), False),
}


@dataclass(frozen=True)
class Param:
    """Declaration of one parameter of a plugin.

    Parameters
    ----------
    name : as in the XML file
    kind : its XML element; ``integer or auto`` also accepts the string ``auto`` (read as 0); ``ignored`` is accepted in
        any form and has no effect
    default : value when absent; None: absence has its own meaning, also selected by the string ``auto``
    doc : meaning, one sentence
    unit : SI unit, ``deg`` or ``dB``; empty: none
    minimum, maximum : inclusive bounds
    positive : whether the minimum itself is excluded
    choices : allowed strings, or a function that returns them (names in a registry, which extensions may add to)
    auto : whether the default 0 means automatic
    python : whether errors give an example in Python instead of XML
    option : whether it is an option of the command line; errors give its bounds
    synonym : the allowed string meant by another one, empty where none is
    """

    name: str
    kind: Kind
    default: Value | None
    doc: str
    unit: str = ""
    minimum: float = -math.inf
    maximum: float = math.inf
    positive: bool = False
    choices: Choices = ()
    auto: bool = False
    python: bool = False
    option: bool = False
    synonym: Callable[[str], str] | None = None

    @property
    def tag(self) -> str:
        """XML element of the parameter."""
        return {"integer or auto": "integer", "ignored": "float"}.get(self.kind, self.kind)

    @property
    def allowed(self) -> tuple[str, ...]:
        """Allowed strings at present; empty: all strings."""
        return self.choices() if callable(self.choices) else self.choices

    def convert(self, value: object, where: str, error: type[SarmitsubaError]) -> Value | None:
        """Convert ``value`` to the parameter's type, or raise ``error`` with one line."""
        if self.kind == "ignored":
            return self.default
        if self.kind == "boolean":
            if not isinstance(value, bool):
                raise self._wrong_type(value, where, error)
            return value
        if self.kind == "string":
            return self._string(value, where, error)
        if self.default is None and isinstance(value, str):
            value = None if value == "auto" else _as_number(value, float)
        if self.default is None and value is None:
            return None
        return self._number(value, where, error)

    def parse(self, text: str, where: str, error: type[SarmitsubaError]) -> Value | None:
        """Value of a text, as in a command-line override."""
        value: object = text
        if self.kind == "boolean":
            value = BOOLEANS.get(text.strip().lower(), text)
        elif self.kind in ("integer", "integer or auto"):
            value = _as_number(text, int)
        elif self.kind == "float":
            value = _as_number(text, float)
        return self.convert(value, where, error)

    def check_option(self, option: str, value: object, where: str) -> None:
        """Raise a SceneError with one line if a command-line option is out of bounds; None is accepted."""
        if value is not None:
            replace(self, name=option, option=True).convert(value, where, SceneError)

    def _number(self, value: object, where: str, error: type[SarmitsubaError]) -> Value:
        if self.kind == "integer or auto" and isinstance(value, str):
            value = 0 if value == "auto" else _as_number(value, int)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._wrong_type(value, where, error)
        if self.kind != "float" and not isinstance(value, int):
            raise self._wrong_type(value, where, error)
        if not is_finite(value):
            said = value if isinstance(value, float) else "an integer of hundreds of digits"
            raise error(f"{where}: {self.name} = {said} is not a finite number; {self._remedy()}")
        if 0.0 < abs(value) < TINY:  # powers of it underflow
            raise error(
                f"{where}: {self.name} = {_text(value, self.unit)} is nearer to 0 than {TINY:g}; {self._remedy()}"
            )
        low = value <= self.minimum if self.positive else value < self.minimum
        if low or value > self.maximum:
            side = "above" if value > self.maximum else "not above" if self.positive else "below"
            bound = self.maximum if value > self.maximum else self.minimum
            raise error(
                f"{where}: {self.name} = {_text(value, self.unit)} is {side} the bound "
                f"{_text(bound, self.unit)}; {self._remedy()}"
            )
        return float(value) if self.kind == "float" else value

    def _string(self, value: object, where: str, error: type[SarmitsubaError]) -> str:
        if not isinstance(value, str):
            raise self._wrong_type(value, where, error)
        if "\0" in value:
            raise error(
                f'{where}: {self.name} = "{printable(one_line(value))}" holds the character NUL; leave it out'
            )
        if self.choices and value not in self.allowed:
            meant = self.synonym(value) if self.synonym else ""
            if meant:
                return meant
            raise error(
                f'{where}: {self.name} = "{one_line(value)}" is not one of {", ".join(self.allowed)}'
                f"{did_you_mean(value, self.allowed)}"
                + ("; an extension's are known with --extension FILE" if callable(self.choices) else "")
            )
        return value

    def _wrong_type(self, value: object, where: str, error: type[SarmitsubaError]) -> SarmitsubaError:
        shown = f'"{one_line(value)}"' if isinstance(value, str) else one_line(value)
        return error(f"{where}: {self.name} = {shown} is not of type {self.kind}; {self._remedy()}")

    def _remedy(self) -> str:
        example = self.default if self.default != "" or not self.choices else self.allowed[0]
        if example is None:
            example = 0.0
        if self.option:
            return f"give {self.bounds_text()}"
        if self.python:
            return f"give {self.bounds_text()}, for example {self.name}={example!r}"
        if isinstance(example, bool):
            example = "true" if example else "false"
        elif not isinstance(example, str):
            example = f"{example:g}"
        return f'give {self.bounds_text()}, for example <{self.tag} name="{self.name}" value="{example}"/>'

    def bounds_text(self) -> str:
        """Bounds or choices as text."""
        unit = f" {self.unit}" if self.unit else ""
        if self.choices:
            return "one of " + ", ".join(self.allowed)
        if self.kind == "boolean":
            return "true or false"
        if self.kind == "string":
            return "a text"
        if self.kind == "ignored":
            return "anything"
        noun = "an integer" if self.kind.startswith("integer") else "a number"
        low, high = math.isfinite(self.minimum), math.isfinite(self.maximum)
        if low and high:
            from_ = "above" if self.positive else "from"
            text = f"{noun} {from_} {_compact(self.minimum)} to {_compact(self.maximum)}{unit}"
        elif low:
            text = f"{noun} {'above' if self.positive else 'of at least'} {_compact(self.minimum)}{unit}"
        elif high:
            text = f"{noun} of at most {_compact(self.maximum)}{unit}"
        else:
            text = f"{noun}{f' in{unit}' if unit else ''}"
        takes_auto = self.kind == "integer or auto" or (self.kind == "float" and self.default is None)
        return text + (' or "auto"' if takes_auto else "")


@dataclass(frozen=True)
class ParamTable:
    """All parameters of one plugin.

    Parameters
    ----------
    plugin : name in the XML ``type`` attribute
    element : XML element (``sensor``, ``film``, ``integrator``, ``bsdf``)
    doc : description of the plugin, one or two sentences
    params : parameters of the plugin
    more : function that returns additional parameters, those of registered modes or laws
    error : class of its errors
    hints : remedies for parameter names of Mitsuba that do not apply here
    """

    plugin: str
    element: str
    doc: str
    params: tuple[Param, ...]
    error: type[SarmitsubaError] = SceneError
    hints: Mapping[str, str] = field(default_factory=dict)
    more: Callable[[], tuple[Param, ...]] = tuple

    @property
    def rows(self) -> tuple[Param, ...]:
        """All parameters, including additional ones.

        Raises
        ------
        ExtensionError : an additional parameter has the name of another one
        """
        rows = (*self.params, *self.more())
        if len({p.name for p in rows}) < len(rows):
            names = [p.name for p in rows]
            twice = next(name for name in names if names.count(name) > 1)
            raise ExtensionError(f"{self.plugin} already has a parameter {twice!r}; choose another name")
        return rows

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.rows)

    def __getitem__(self, name: str) -> Param:
        """Parameter of that name."""
        for param in self.rows:
            if param.name == name:
                return param
        raise KeyError(name)

    def defaults(self) -> dict[str, Value | None]:
        """Defaults by parameter name."""
        return {p.name: p.default for p in self.rows}

    def read(
        self, given: Mapping[str, object], where: str, *, python: bool = False, nested: Sequence[str] = ()
    ) -> dict[str, Value | None]:
        """Validate given values and fill in defaults.

        Parameters
        ----------
        given : values by name, typed by the XML parser
        where : start of every error message, for example ``scene.xml: sensor "radar"``
        python : whether errors give examples in Python instead of XML
        nested : names of elements that may be nested, as suggestions for unknown names

        Returns
        -------
        values of all parameters of the table by name

        Raises
        ------
        ``self.error`` with one line on an unknown name, a wrong type or a value out of bounds
        """
        for name in given:
            self.check_name(name, where, nested)
        rows = tuple(replace(p, python=True) for p in self.rows) if python else self.rows
        return {
            p.name: p.convert(given[p.name], where, self.error) if p.name in given else p.default
            for p in rows
        }

    def check_name(self, name: str, where: str, nested: Sequence[str] = ()) -> None:
        """Raise unless ``name`` is a parameter."""
        if name in self.names:
            return
        if name in self.hints:
            raise self.error(f'{where}: unknown parameter "{one_line(name)}"; {self.hints[name]}')
        known = ", ".join(self.names) if len(self.names) <= MOST_NAMED else f"those of {PAGE}"
        guess = did_you_mean(name, (*nested, *self.names)) or f"; {self.plugin} knows {known}"
        raise self.error(f'{where}: unknown parameter "{one_line(name)}"{guess}')

    def markdown(self) -> str:
        """Table of parameters in Markdown; the unit is that of the bounds."""
        rows = ["| parameter | type | default | bounds | meaning |", "|---|---|---|---|---|"]
        read = [p for p in self.rows if p.kind != "ignored"]
        for p in read:
            default = (
                ""
                if p.default in ("", None)
                else str(p.default).lower()
                if p.kind == "boolean"
                else _compact(p.default)
                if isinstance(p.default, float)
                else f"{p.default}"
            )
            bounds = "" if p.kind in ("string", "boolean") and not p.choices else p.bounds_text()
            for words in ("a number ", "an integer ", "from ", "one of "):
                bounds = bounds.removeprefix(words)
            rows.append(
                f"| `{p.name}` | {p.kind} | {'automatic' if p.auto else default} | {bounds} | {p.doc} |"
            )
        if ignored := [p for p in self.rows if p.kind == "ignored"]:
            rows.append(f"| {', '.join(f'`{p.name}`' for p in ignored)} | ignored | | | {ignored[0].doc} |")
        return "\n".join(rows)


def declare_field(
    default: T,
    doc: str,
    unit: str = "",
    minimum: float = -math.inf,
    maximum: float = math.inf,
    *,
    positive: bool = False,
    choices: Choices = (),
    auto: bool = False,
) -> T:
    """Field of a dataclass that also declares a `Param` of its name, type and default, with meaning and bounds."""
    kinds: dict[type, Kind] = {bool: "boolean", int: "integer", str: "string"}
    param = Param(
        "", kinds.get(type(default), "float"), None, doc, unit, minimum, maximum, positive, choices, auto
    )
    made: T = field(default=default, metadata={_PARAM: param})
    return made


def params_of(description: type) -> tuple[Param, ...]:
    """Parameters of a dataclass from its fields made by `described`."""
    return tuple(
        replace(f.metadata[_PARAM], name=f.name, default=f.default)
        for f in fields(description)
        if _PARAM in f.metadata
    )


def fill_description(description: D, values: Mapping[str, object]) -> D:
    """Copy of a dataclass with validated values for its fields."""
    return replace(description, **values)


def is_finite(value: float) -> bool:
    """Whether a number is finite, and fits into a float64 (integers of 400 digits do not)."""
    return abs(value) <= sys.float_info.max


def float_value(values: Mapping[str, Value | None], name: str) -> float:
    """Validated value of a numeric parameter."""
    value = values[name]
    assert isinstance(value, int | float), name
    return float(value)


def string_value(values: Mapping[str, Value | None], name: str) -> str:
    """Validated value of a string parameter."""
    value = values[name]
    assert isinstance(value, str), name
    return value


def knows_its_fields(cls: type[D]) -> type[D]:
    """Class decorator of a dataclass: an unknown field is refused with the nearest known one."""
    given = cls.__init__
    known = [f.name for f in fields(cls)]

    @functools.wraps(given)
    def checked(self: D, *values: object, **named: object) -> None:
        unknown = [name for name in named if name not in known]
        if unknown:
            guess = did_you_mean(unknown[0], known) or f"; it knows {', '.join(known)}"
            raise SceneError(f'{cls.__name__}: unknown parameter "{unknown[0]}"{guess}')
        given(self, *values, **named)

    setattr(cls, "__init__", checked)  # noqa: B010 - of a class by name
    return cls


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``; did you mean "..."?`` when a known name is close to ``name``, else an empty string."""
    close = difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.6)
    return f'; did you mean "{close[0]}"?' if close else ""


def printable(name: str, limit: int = 200) -> str:
    """Name for any file format, terminal and picture: unprintable characters become question marks."""
    return one_line("".join(c if c.isprintable() else "?" for c in name), limit)


def one_line(value: object, limit: int = 60) -> str:
    """Text of a value on one line, shortened."""
    text = " ".join(str(value).split())
    return text if len(text) <= limit else text[: limit - 3] + "..."


def _as_number(text: str, kind: type[int] | type[float]) -> object:
    try:
        return kind(text)
    except ValueError:
        return text


def _compact(value: float) -> str:
    return f"{value:.7g}"


def _text(value: float, unit: str) -> str:
    return f"{_compact(value)} {unit}".strip()
