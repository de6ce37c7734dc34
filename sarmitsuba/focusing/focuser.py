"""Focusers: interface of the focusing algorithms, with their limits, stated errors and calibration."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sarmitsuba.arrays import C64, F64
from sarmitsuba.echo.raw_data import RawData
from sarmitsuba.errors import DataError
from sarmitsuba.focusing.memory_needs import backprojection_bytes
from sarmitsuba.focusing.options import OptionValue, WithOptions, option
from sarmitsuba.focusing.windows import Window
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.progress import Progress
from sarmitsuba.radar.radar import Radar
from sarmitsuba.registry import Registry


@dataclass(frozen=True, eq=False)
class FocusTask:
    """Input of a focuser: data, grid and windows.

    Parameters
    ----------
    raw : range-compressed data
    grid : pixels wanted
    range_window, azimuth_window : over the bandwidth and over the pulse index
    progress : called from time to time
    """

    raw: RawData
    grid: ImageGrid
    range_window: Window
    azimuth_window: Window
    progress: Progress


@dataclass(frozen=True, eq=False)
class Focused:
    """Output of a focuser.

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
    """Focusing algorithm: a frozen dataclass whose fields are its options, each with a default.

    One with all defaults is registered in ``FOCUSERS``; ``Backprojection(interpolation="linear")`` is another.

    Attributes
    ----------
    name : what users write
    title : what it is for, one line
    bistatic : whether it accepts data with a separate receiver
    """

    kind: ClassVar[str] = "focuser"
    name: ClassVar[str]
    title: ClassVar[str]
    bistatic: ClassVar[bool] = False

    def objection(self, radar: Radar, grid: ImageGrid) -> str:
        """Reason against this focuser: bistatic data that it does not accept, or its :meth:`refusal`."""
        radar = radar.start_stop()
        if radar.receiver is not None and not self.bistatic:
            return "the data are bistatic (separate receiver)"
        return self.refusal(radar, grid)

    def refusal(self, radar: Radar, grid: ImageGrid) -> str:
        """Reason why it cannot focus this radar's data on this grid; empty when it can."""
        return ""

    def error_db(self, radar: Radar, grid: ImageGrid) -> float:
        """Stated bound of the error against exact backprojection, dB; NaN where none is stated: never chosen."""
        return math.nan

    def cpu_seconds(self, radar: Radar, grid: ImageGrid) -> float:
        """Approximate processor time of one layer on one core, for comparison; here that of backprojection."""
        rate = PIXEL_PULSE_SECONDS * (OWN_APERTURES if np.isfinite(radar.half_aperture) else 1.0)
        if radar.antenna.pattern != "isotropic":
            rate += PATTERN_SECONDS
        pixels, pulses = float(np.prod(grid.shape)), radar.track.n_pulses
        profiles = PROFILE_SECONDS * pulses * radar.window.n_samples
        return CALL_SECONDS + profiles + (PIXEL_SECONDS + rate * pulses) * pixels

    def making_bytes(self, radar: Radar, grid: ImageGrid, n_layers: int) -> int:
        """Peak memory in bytes while the pixels are made, pixels included, raw data not."""
        return backprojection_bytes(radar, grid, n_layers)

    def resolved(self, radar: Radar, grid: ImageGrid) -> tuple["Focuser", str]:
        """The focuser that is used, and the reason of the choice; itself except for ``auto``."""
        return self, ""

    @abstractmethod
    def focus(self, task: FocusTask) -> Focused:
        """Focus; call ``objection`` before."""


# of one core, float64 ranges and a kernel of six taps (benchmarks/suite/focusers.py measures it), how many times that
# with apertures of the pixels' own, and what an antenna's pattern adds (benchmarks/suite/focuser_limits.py)
PIXEL_PULSE_SECONDS, OWN_APERTURES, PATTERN_SECONDS = 1.2e-9, 1.9, 1.9e-9
# processor seconds that dominate for small images: of a call, of a raw-data sample made into a profile, of a pixel in
# NumPy, and of the weight of a pulse at a node of the summed pattern weights (benchmarks/suite/focusers.py prints both)
CALL_SECONDS, PROFILE_SECONDS, PIXEL_SECONDS, WEIGHT_SECONDS = 0.01, 6e-8, 4e-7, 1.0e-7


FOCUSERS: Registry[Focuser] = Registry("focuser", Focuser, "sarmitsuba.focusing.focusers")


@dataclass(frozen=True)
class Auto(Focuser):
    """The fastest registered focuser with a wanted error; see :meth:`resolved`."""

    name: ClassVar[str] = "auto"
    title: ClassVar[str] = "the cheapest of these that does not refuse and states the wanted error"
    bistatic: ClassVar[bool] = True

    error: float = option(-50.0, "largest stated error against exact backprojection, dB")

    def refusal(self, radar: Radar, grid: ImageGrid) -> str:
        """Reason why no focuser is suitable; empty when one is."""
        found, reason = self._choose(radar, grid)
        return "" if found else reason

    def resolved(self, radar: Radar, grid: ImageGrid) -> tuple[Focuser, str]:
        """The focuser of least processor time among those that accept the data and state the wanted error.

        Raises
        ------
        DataError
            There is none.
        """
        found, reason = self._choose(radar, grid)
        if found is None:
            raise DataError(f"focuser auto: {reason}")
        return found, reason

    def focus(self, task: FocusTask) -> Focused:
        """Focus with the chosen focuser."""
        return self.resolved(task.raw.radar, task.grid)[0].focus(task)

    def _choose(self, radar: Radar, grid: ImageGrid) -> tuple[Focuser | None, str]:
        """The choice, or None, and the reasons for it and against the others."""
        able: list[tuple[float, str, Focuser]] = []
        against = []
        for focuser in FOCUSERS:
            refusal = focuser.objection(radar, grid)
            error = math.nan if refusal else focuser.error_db(radar, grid)
            if refusal:
                against.append(f"{focuser.name}: {refusal}")
            elif math.isnan(error):
                against.append(f"{focuser.name}: states no error here")
            elif error > self.error:
                against.append(f"{focuser.name}: {error:.0f} dB, {self.error:g} dB are wanted")
            else:
                seconds = focuser.cpu_seconds(radar, grid)
                able.append((seconds, f"{focuser.name} {error:.0f} dB, about {seconds:.2g} CPU s", focuser))
        if not able:
            return None, f"none states an error of {self.error:g} dB here; raise error. " + "; ".join(against)
        able.sort(key=lambda entry: entry[0])
        others = [text for _, text, _ in able[1:]]
        return able[0][2], "; ".join([able[0][1], *others, *against])


def parse_focuser(text: str | Focuser) -> Focuser:
    """Read a focuser from its name and options, such as ``backprojection,interpolation=kernel:8``.

    ``auto``, with the option ``error``, is a choice among them; it is in no registry.

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
    named = Auto() if name == Auto.name else FOCUSERS[name]
    return named.with_texts(rest)


def check_focuser(focuser: Focuser, radar: Radar, grid: ImageGrid) -> None:
    """Raise a DataError where a focuser cannot focus the data; it names the focusers that can."""
    reason = focuser.objection(radar, grid)
    if reason and focuser.name == Auto.name:
        raise DataError(f"focuser {focuser.name}: {reason}")
    if reason:
        others = [f.name for f in FOCUSERS if f.name != focuser.name and not f.objection(radar, grid)]
        remedy = f"; take focuser {' or '.join(others)}" if others else ""
        raise DataError(f"focuser {focuser.name}: {reason}{remedy}")


__all__ = [
    "CALL_SECONDS",
    "FOCUSERS",
    "PIXEL_PULSE_SECONDS",
    "PROFILE_SECONDS",
    "WEIGHT_SECONDS",
    "Auto",
    "FocusTask",
    "Focused",
    "Focuser",
    "OptionValue",
    "check_focuser",
    "option",
    "parse_focuser",
]
