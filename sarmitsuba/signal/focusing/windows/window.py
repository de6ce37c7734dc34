"""Window functions and their text form."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import did_you_mean
from sarmitsuba.core.registry import Registry


@dataclass(frozen=True)
class WindowParameter:
    """Parameter of a window.

    Parameters
    ----------
    name : for help and messages, one word
    default, low, high : value when none is given, and its bounds
    doc : meaning and unit
    whole : integers only
    """

    name: str
    default: float
    low: float
    high: float
    doc: str
    whole: bool = False

    def check(self, value: float) -> str:
        """Error in a value; empty when it is valid."""
        if not self.low <= value <= self.high or (self.whole and value != int(value)):
            number = "a whole number" if self.whole else "a number"
            return f"{self.name} must be {number} within {self.low:g} .. {self.high:g}"
        return ""


@dataclass(frozen=True)
class WindowFamily:
    """Window family, such as ``taylor``: function and parameters.

    Parameters
    ----------
    name : first word of the window's text, lower case
    doc : purpose in one line
    function : ``function(u, *parameters)``, weight at ``|u| <= 1/2``; u is float64 of any shape. The level is
        arbitrary: images are calibrated with the sum of the weights
    parameters : in the order in which the text gives them
    """

    name: str
    doc: str
    function: Callable[..., F64]
    parameters: tuple[WindowParameter, ...] = ()

    @property
    def syntax(self) -> str:
        """Text form of the window, e.g. ``taylor[:N_BAR[:LEVEL_DB]]``."""
        names = [parameter.name.upper() for parameter in self.parameters]
        return self.name + "".join(f"[:{name}" for name in names) + "]" * len(names)


WINDOWS: Registry[WindowFamily] = Registry("window", WindowFamily, "sarmitsuba.signal.focusing.windows")


@dataclass(frozen=True)
class Window:
    r"""A symmetric weighting ``w(u)`` over ``|u| <= 1/2``, zero outside.

    The built-in ones are unity at the centre, but for Taylor's, which has unit mean.

    Parameters
    ----------
    name : of a family in ``WINDOWS``
    parameters : all that the family takes, in its order
    """

    name: str
    parameters: tuple[float, ...] = ()

    def __call__(self, u: ArrayLike) -> F64:
        """Evaluate at ``u`` (any shape), where the band or aperture is ``-1/2 <= u <= 1/2``."""
        x = np.asarray(u, dtype=np.float64)
        weight = WINDOWS[self.name].function(x, *self.parameters)
        return np.where(np.abs(x) <= 0.5, weight, 0.0)

    def aperture(self, n: int) -> F64:
        """Weights of ``n`` samples that fill the aperture, (n,): sample i is at ``u = (i + 1/2) / n - 1/2``."""
        return self((np.arange(n) + 0.5) / n - 0.5)

    @property
    def broadening(self) -> float:
        r"""Noise-equivalent width of the impulse response in cells, :math:`\int w^2 / (\int w)^2`."""
        w = self((np.arange(4096) + 0.5) / 4096 - 0.5)
        return float((w**2).mean() / w.mean() ** 2)

    def __str__(self) -> str:
        return ":".join([self.name, *(f"{p:g}" for p in self.parameters)])


def parse_window(text: str | Window) -> Window:
    """Read a window from its name and colon-separated parameters, such as ``taylor:4:-35``.

    Missing parameters have their default; ``WINDOWS`` has the names, and ``sarmitsuba focus --help``
    lists them with their parameters.

    Raises
    ------
    DataError
        Unknown name, too many parameters, or a parameter out of bounds.
    """
    if isinstance(text, Window):
        return text
    name, *rest = text.strip().lower().split(":")
    if name not in WINDOWS:
        raise DataError(
            f"window {text!r}: unknown{did_you_mean(name, WINDOWS.names)}; choose one of "
            f"{', '.join(f.syntax for f in WINDOWS)}"
        )
    family = WINDOWS[name]
    try:
        given = tuple(float(item) for item in rest)
    except ValueError:
        raise DataError(f"window {text!r}: parameters must be numbers, as in {family.syntax}") from None
    if len(given) > len(family.parameters):
        raise DataError(f"window {text!r}: too many parameters; it is written {family.syntax}")
    parameters = given + tuple(parameter.default for parameter in family.parameters[len(given) :])
    for parameter, value in zip(family.parameters, parameters, strict=True):
        wrong = parameter.check(value)
        if wrong:
            raise DataError(f"window {text!r}: {wrong}")
    return Window(name, parameters)
