"""Options of focusers and autofocusers: the fields of a frozen dataclass, each with a default and a line of help."""

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import BOOLEANS, is_finite

if TYPE_CHECKING:
    from typing_extensions import Self

OptionValue = str | int | float | bool


def option(
    default: Any,
    doc: str,
    *,
    within: tuple[float, float] | None = None,
    automatic: bool = False,
    choices: tuple[OptionValue, ...] = (),
) -> Any:
    """Field of a focuser's dataclass: an option of type str, int, float or bool, with its one line of help.

    ``within`` bounds a number, both ends included; with ``automatic`` 0 is accepted as well. ``choices`` are all values
    accepted. Numbers are finite in any case.
    """
    return dataclasses.field(
        default=default, metadata={"doc": doc, "within": within, "automatic": automatic, "choices": choices}
    )


@dataclass(frozen=True)
class WithOptions:
    """A frozen dataclass whose fields are its options, see :func:`option`.

    Attributes
    ----------
    kind : word for it in messages
    name : in commands and calls
    title : purpose in one line
    """

    kind: ClassVar[str]
    name: ClassVar[str]
    title: ClassVar[str]

    def __post_init__(self) -> None:
        """Check every option's value.

        Raises
        ------
        DataError
            One is not finite, out of its bounds or not among its choices.
        """
        for field in dataclasses.fields(self):
            value, takes = getattr(self, field.name), _takes(field)
            choices, within = field.metadata.get("choices", ()), field.metadata.get("within")
            right = value in choices if choices else True
            if right and isinstance(value, int | float) and not isinstance(value, bool):
                right = is_finite(value) and (within is None or within[0] <= value <= within[1])
                right |= value == 0 and bool(field.metadata.get("automatic"))
            if not right:
                shown = f"{value:g}" if isinstance(value, float) else repr(value)
                raise DataError(f"{self.kind} {self.name}: {field.name} = {shown} must be {takes}")

    @property
    def options(self) -> dict[str, OptionValue]:
        """Options by name, with their values."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    def with_options(self, texts: Mapping[str, str]) -> "Self":
        """A copy with options read from text.

        Raises
        ------
        DataError
            Unknown option, or a value of the wrong type or out of its bounds.
        """
        values: dict[str, OptionValue] = {}
        for name, text in texts.items():
            if name not in self.options:
                takes = ", ".join(self.options) or "none"
                raise DataError(f"{self.kind} {self.name}: option {name!r} is unknown; it takes {takes}")
            kind = type(self.options[name])
            try:
                values[name] = BOOLEANS[text.lower()] if kind is bool else kind(text)
            except (KeyError, ValueError):
                raise DataError(
                    f"{self.kind} {self.name}: {name} = {text!r} is not of type {kind.__name__}"
                ) from None
        return dataclasses.replace(self, **values)

    def with_texts(self, texts: Iterable[str]) -> "Self":
        """A copy with options read from texts such as ``interpolation=kernel:8``; raises as :meth:`with_options`."""
        pairs = [item.partition("=") for item in texts]
        return self.with_options({key.strip(): value.strip() for key, _, value in pairs})

    @property
    def help(self) -> str:
        """Title and options, for help texts."""
        options = [
            f"{field.name}={field.default} ({field.metadata.get('doc', '')})"
            for field in dataclasses.fields(self)
        ]
        return "; options ".join([self.title, ", ".join(options)]) if options else self.title


def _takes(field: "dataclasses.Field[OptionValue]") -> str:
    """Values that an option accepts, for messages."""
    choices, within = field.metadata.get("choices", ()), field.metadata.get("within")
    if choices:
        *most, last = (str(choice) for choice in choices)
        return f"{', '.join(most)} or {last}"
    text = "finite" if within is None else f"from {within[0]:g} to {within[1]:g}"
    return f"{text}, or 0" if field.metadata.get("automatic") else text
