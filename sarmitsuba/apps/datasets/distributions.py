"""Distributions of a recipe's parameters: uniform, normal, choice, grid, or one value."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import Param, Value, did_you_mean, is_finite, one_line
from sarmitsuba.core.registry import Registry

# trials of a normal draw within the parameter's bounds; more are needed only where these hold less than 1 %
_TRIALS = 1000
# most levels of a grid, and values of a choice
_MOST_LEVELS = 1_000_000


class DrawnValue(ABC):
    """Distribution of one parameter, checked against its bounds."""

    @property
    def levels(self) -> int:
        """Number of values of a grid, gone through in turn; 1: drawn at random."""
        return 1

    @property
    def texts(self) -> tuple[str, ...]:
        """All texts that may be drawn."""
        return ()

    @abstractmethod
    def draw(self, generator: np.random.Generator, level: int) -> Value | None:
        """One value; ``level`` is the place in a grid, 0 to ``levels - 1``."""

    @abstractmethod
    def __str__(self) -> str:
        """The distribution, for the data card."""


@dataclass(frozen=True)
class Fixed(DrawnValue):
    """One value for all draws."""

    value: Value | None

    def draw(self, generator: np.random.Generator, level: int) -> Value | None:
        """See the base class."""
        return self.value

    @property
    def texts(self) -> tuple[str, ...]:
        """See the base class."""
        return (self.value,) if isinstance(self.value, str) else ()

    def __str__(self) -> str:
        return "automatic" if self.value is None else _format_value(self.value)


@dataclass(frozen=True)
class Uniform(DrawnValue):
    """Equal density from ``low`` to ``high``; integers with both ends."""

    low: float
    high: float
    whole: bool

    def draw(self, generator: np.random.Generator, level: int) -> Value:
        """See the base class."""
        if self.whole:
            return int(generator.integers(int(self.low), int(self.high), endpoint=True))
        return float(generator.uniform(self.low, self.high))

    def __str__(self) -> str:
        return f"uniform from {self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class Normal(DrawnValue):
    """Normal distribution cut off at the parameter's bounds; integers are rounded."""

    mean: float
    sigma: float
    low: float
    high: float
    whole: bool

    def draw(self, generator: np.random.Generator, level: int) -> Value:
        """See the base class.

        Raises
        ------
        DataError
            A thousand values lie out of bounds.
        """
        for _ in range(_TRIALS):
            value = float(generator.normal(self.mean, self.sigma))
            value = float(round(value)) if self.whole else value
            if self.low <= value <= self.high:
                return int(value) if self.whole else value
        raise DataError(f"{self}: {_TRIALS} draws lie outside {self.low:g} to {self.high:g}")

    def __str__(self) -> str:
        return f"normal of mean {self.mean:g} and standard deviation {self.sigma:g}"


@dataclass(frozen=True)
class Choice(DrawnValue):
    """Equally probable values."""

    values: tuple[Value | None, ...]

    def draw(self, generator: np.random.Generator, level: int) -> Value | None:
        """See the base class."""
        return self.values[int(generator.integers(len(self.values)))]

    @property
    def texts(self) -> tuple[str, ...]:
        """See the base class."""
        return tuple(value for value in self.values if isinstance(value, str))

    def __str__(self) -> str:
        return f"one of {', '.join(_format_value(v) for v in self.values)}"


@dataclass(frozen=True)
class Grid(DrawnValue):
    """Equally spaced values with both ends, each in turn."""

    low: float
    high: float
    count: int
    whole: bool

    @property
    def levels(self) -> int:
        """See the base class."""
        return self.count

    def draw(self, generator: np.random.Generator, level: int) -> Value:
        """See the base class."""
        share = level / (self.count - 1) if self.count > 1 else 0.0
        value = self.low + share * (self.high - self.low)
        return round(value) if self.whole else value

    def __str__(self) -> str:
        return f"grid of {self.count} values from {self.low:g} to {self.high:g}"


class Distribution(ABC):
    """Kind of distribution, by its name in a recipe: ``{ uniform = [0, 360] }``.

    Attributes
    ----------
    name : in a recipe
    form : of its list
    """

    name: ClassVar[str]
    form: ClassVar[str]

    @abstractmethod
    def read(self, values: Sequence[object], param: Param, where: str) -> DrawnValue:
        """The distribution of a parameter from the list in a recipe.

        Raises
        ------
        DataError
            A value is out of the parameter's bounds or of the wrong type, or the list has another form.
        """

    def _numbers(self, values: Sequence[object], param: Param, where: str, checked: int) -> list[float]:
        """Numbers of a list; the first ``checked`` are values of the parameter."""
        shown = one_line(list(values))
        if param.kind not in ("float", "integer", "integer or auto"):
            raise DataError(f"{where}: {param.name} is of type {param.kind}; draw it by choice = [...]")
        if len(values) != self.form.count(",") + 1:
            raise DataError(f"{where}: {param.name}: {self.name} = {shown} is not of the form {self.form}")
        out: list[float] = []
        for i, value in enumerate(values):
            if isinstance(value, bool) or not isinstance(value, int | float) or not is_finite(value):
                raise DataError(f"{where}: {param.name}: {self.name} = {shown} does not hold numbers alone")
            out.append(float(value))
            if i < checked:
                param.convert(value, where, DataError)
        return out


DISTRIBUTIONS: Registry[Distribution] = Registry("distribution", Distribution)


class _UniformKind(Distribution):
    name, form = "uniform", "[low, high]"

    def read(self, values: Sequence[object], param: Param, where: str) -> DrawnValue:
        """See the base class."""
        low, high = self._numbers(values, param, where, 2)
        if low > high:
            raise DataError(
                f"{where}: {param.name}: uniform = [{low:g}, {high:g}] falls; give the lower end first"
            )
        return Uniform(low, high, param.kind != "float")


class _NormalKind(Distribution):
    name, form = "normal", "[mean, standard deviation]"

    def read(self, values: Sequence[object], param: Param, where: str) -> DrawnValue:
        """See the base class."""
        mean, sigma = self._numbers(values, param, where, 1)
        if sigma < 0.0:
            raise DataError(
                f"{where}: {param.name}: normal has the standard deviation {sigma:g}; give at least 0"
            )
        # where the minimum itself is no value, the next number above it is
        low = math.nextafter(param.minimum, math.inf) if param.positive else param.minimum
        return Normal(mean, sigma, low, param.maximum, param.kind != "float")


class _ChoiceKind(Distribution):
    name, form = "choice", "[value, value ...]"

    def read(self, values: Sequence[object], param: Param, where: str) -> DrawnValue:
        """See the base class."""
        if not 1 <= len(values) <= _MOST_LEVELS:
            raise DataError(f"{where}: {param.name}: choice of {len(values)} values; give at least one")
        return Choice(tuple(param.convert(value, where, DataError) for value in values))


class _GridKind(Distribution):
    name, form = "grid", "[first, last, number of values]"

    def read(self, values: Sequence[object], param: Param, where: str) -> DrawnValue:
        """See the base class."""
        low, high, count = self._numbers(values, param, where, 2)
        if count != round(count) or not 1 <= count <= _MOST_LEVELS:
            raise DataError(
                f"{where}: {param.name}: a grid of {count:g} values; give an integer from 1 to {_MOST_LEVELS}"
            )
        return Grid(low, high, int(count), param.kind != "float")


for _kind in (_UniformKind(), _NormalKind(), _ChoiceKind(), _GridKind()):
    DISTRIBUTIONS.register(_kind)


def read_drawn(value: object, param: Param, where: str) -> DrawnValue:
    """Distribution of a parameter as a recipe gives it: a value, or a table of one distribution.

    Raises
    ------
    DataError
        One line: an unknown distribution, a wrong type, or a value out of bounds.
    """
    param = replace(param, python=True)
    if not isinstance(value, Mapping):
        return Fixed(param.convert(value, where, DataError))
    known = DISTRIBUTIONS.names
    if len(value) != 1:
        raise DataError(f"{where}: {param.name} = {one_line(dict(value))}: give one of {', '.join(known)}")
    ((name, values),) = value.items()
    if name not in DISTRIBUTIONS:
        guess = did_you_mean(name, known) or f"; choose one of {', '.join(known)}"
        raise DataError(f'{where}: {param.name}: unknown distribution "{one_line(name)}"{guess}')
    kind = DISTRIBUTIONS[name]
    if not isinstance(values, list | tuple):
        raise DataError(
            f"{where}: {param.name}: {name} = {one_line(values)} is no list; give {name} = {kind.form}"
        )
    return kind.read(values, param, where)


def _format_value(value: Value | None) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:g}" if isinstance(value, float) else str(value)
