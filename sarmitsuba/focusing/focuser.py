"""What a focuser is: it says what it can focus, and makes the pixels and the facts that calibrate them."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.echo.raw import RawData
from sarmitsuba.errors import DataError
from sarmitsuba.focusing.options import OptionValue, WithOptions, option
from sarmitsuba.focusing.windows import Window
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.progress import Progress
from sarmitsuba.radar.radar import Radar
from sarmitsuba.registry import Registry

F64 = NDArray[np.float64]
C64 = NDArray[np.complex64]


@dataclass(frozen=True, eq=False)
class FocusTask:
    """What is to be focused, and where.

    Parameters
    ----------
    raw : range-compressed data
    grid : pixels wanted
    range_window, azimuth_window : over the bandwidth and over the pulse index
    progress : to be called now and then
    """

    raw: RawData
    grid: ImageGrid
    range_window: Window
    azimuth_window: Window
    progress: Progress


@dataclass(frozen=True, eq=False)
class Focused:
    """What a focuser hands back.

    Parameters
    ----------
    pixels : (n_layers, n_azimuth, n_range) complex64, m: square root of RCS at a point's peak, phase that of the
        point itself
    pulse_weights : function of scene points (..., 3), m, that gives the weight of every pulse in the pixel there,
        (..., n_pulses) float64, in any unit; the resolution cell, and so sigma0, follows from it
    """

    pixels: C64
    pulse_weights: Callable[[F64], F64]


@dataclass(frozen=True)
class Focuser(WithOptions, ABC):
    """A way to focus: a frozen dataclass whose fields are its options, each with a default.

    One with all defaults is registered in ``FOCUSERS``; ``Backprojection(interpolation="linear")`` is another.

    Attributes
    ----------
    name : what users write
    title : what it is for, one line
    """

    kind: ClassVar[str] = "focuser"
    name: ClassVar[str]
    title: ClassVar[str]

    def refusal(self, radar: Radar, grid: ImageGrid) -> str:
        """Why it cannot focus this radar's data on this grid; empty when it can."""
        return ""

    @abstractmethod
    def focus(self, task: FocusTask) -> Focused:
        """Focus; ``refusal`` has been asked before."""


FOCUSERS: Registry[Focuser] = Registry("focuser", "sarmitsuba.focusing.focusers")


def parse_focuser(text: str | Focuser) -> Focuser:
    """Read a focuser from its name and options, such as ``backprojection,interpolation=kernel:8``.

    Raises
    ------
    ExtensionError
        There is no focuser of that name.
    DataError
        Unknown option, or a value of the wrong type.
    """
    if isinstance(text, Focuser):
        return text
    name, *rest = text.strip().split(",")
    return FOCUSERS[name].with_texts(rest)


def check_focuser(focuser: Focuser, radar: Radar, grid: ImageGrid) -> None:
    """Raise a DataError where a focuser cannot do what is asked; it names the focusers that can."""
    reason = focuser.refusal(radar, grid)
    if reason:
        others = [f.name for f in FOCUSERS if f.name != focuser.name and not f.refusal(radar, grid)]
        remedy = f"; take focuser {' or '.join(others)}" if others else ""
        raise DataError(f"focuser {focuser.name}: {reason}{remedy}")


__all__ = [
    "FOCUSERS",
    "FocusTask",
    "Focused",
    "Focuser",
    "OptionValue",
    "check_focuser",
    "option",
    "parse_focuser",
]
