"""Focusers: interface of the focusing algorithms, with their options, limits, memory, stated errors and calibration.

Options are the fields of a frozen dataclass, each with a default and a line of help.
"""

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np

from sarmitsuba.core.arrays import C64, F64, LinearMap
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import BOOLEANS, did_you_mean, is_finite
from sarmitsuba.core.progress import Progress
from sarmitsuba.core.registry import Registry
from sarmitsuba.machine.memory import check_fits
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.raw_data import RawData

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
                guess = did_you_mean(name, self.options)
                raise DataError(
                    f"{self.kind} {self.name}: option {name!r} is unknown{guess}; it takes {takes}"
                )
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


Optioned = TypeVar("Optioned", bound=WithOptions)


def parse_optional(text: str | Optioned | None, registry: Registry[Optioned]) -> Optioned | None:
    """Read an entry of a registry from its name and options, such as ``notch,threshold=6``; None and ``none``: none.

    Raises
    ------
    ExtensionError
        There is no entry of that name.
    DataError
        Unknown option, or a value of the wrong type.
    """
    if not isinstance(text, str):
        return text
    name, *rest = text.strip().split(",")
    return None if name == "none" and not rest else registry[name].with_texts(rest)


def _takes(field: "dataclasses.Field[OptionValue]") -> str:
    """Values that an option accepts, for messages."""
    choices, within = field.metadata.get("choices", ()), field.metadata.get("within")
    if choices:
        *most, last = (str(choice) for choice in choices)
        return f"{', '.join(most)} or {last}"
    text = "finite" if within is None else f"from {within[0]:g} to {within[1]:g}"
    return f"{text}, or 0" if field.metadata.get("automatic") else text


# pixels of a backprojection tile; bytes per pixel for its place in the image; per line for the position in NumPy (three
# times while it is made) and on the device
TILE_PIXELS, TILE_BYTES, LINE_BYTES = 1 << 20, 24, 88
# bytes per pixel and layer of the sums, before and after a batch of pulses
SUMS = 24
# bytes of a range-compressed sample as an upsampled profile, of those of one batch of pulses at most, and their copies
PROFILE, BATCH, COPIES = 32, 5 << 20, 5
# bytes per pixel and layer of the finished image, and of error bars, files and pictures
PIXEL, FINISHING = 8, 16
# bytes per pixel: while a look is planned, and of its plan and one layer's field
LOOK_PIXEL, LOOK_FIELD = 60, 44
# bytes per cell of the grid of several looks, while its impulse response is made
LOOK_CELL = 40


def backprojection_bytes(radar: Radar, grid: ImageGrid, n_layers: int, per_line: int = 1) -> int:
    """Peak memory in bytes of backprojection with ``per_line`` pixels in a line, pixels included.

    Raw data are not included.
    """
    pixels, samples = int(np.prod(grid.shape)), n_layers * radar.track.n_pulses * radar.window.n_samples
    tile = min(pixels, TILE_PIXELS) * (TILE_BYTES + LINE_BYTES // per_line + SUMS * min(n_layers, 4))
    return PIXEL * pixels * n_layers + tile + COPIES * min(PROFILE * samples, BATCH)


def focusing_bytes(grid: ImageGrid, n_layers: int, making: int) -> int:
    """Peak memory in bytes of making and storing an image; ``making``: while its pixels are made."""
    return max(making, (PIXEL + FINISHING) * int(np.prod(grid.shape)) * n_layers)


def look_bytes(grid: ImageGrid, n_layers: int, n_cells: int) -> int:
    """Bytes of an image made from looks, its plan and their grid's cells included."""
    each = max(LOOK_PIXEL, LOOK_FIELD + PIXEL * n_layers, (PIXEL + FINISHING) * n_layers)
    return max(int(np.prod(grid.shape)) * each, LOOK_CELL * n_cells)


def check_image_fits(grid: ImageGrid, n_layers: int, making: int) -> None:
    """Raise a ResourceError for an image that does not fit into memory; ``making`` as in :func:`focusing_bytes`.

    Raises
    ------
    ResourceError
        It does not fit.
    """
    rows, columns = grid.shape
    check_fits(
        f"image: {rows} x {columns} pixels in {n_layers} layers",
        focusing_bytes(grid, n_layers, making),
        "make its extents smaller or its pixel spacings wider",
    )


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
    name : in the user's input
    title : purpose, one line
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
        return FOCUSERS[EXACT].cpu_seconds(radar, grid)

    def making_bytes(self, radar: Radar, grid: ImageGrid, n_layers: int) -> int:
        """Peak memory in bytes while the pixels are made, pixels included, raw data not."""
        return backprojection_bytes(radar, grid, n_layers)

    def resolved(
        self, radar: Radar, grid: ImageGrid, data_error_db: Callable[[], float] = lambda: math.nan
    ) -> tuple["Focuser", str]:
        """The focuser that is used, and the reason of the choice; itself except for ``auto``.

        ``data_error_db`` gives the error of the echoes themselves, see
        :func:`sarmitsuba.signal.focusing.focus.data_error_db`; it is called where the choice depends on it.
        """
        return self, ""

    def imaging(self, task: FocusTask) -> LinearMap:
        """Linear map from range-compressed data to pixels, with its adjoint; call ``objection`` before.

        Of data (n_layers, n_pulses, n_samples) of the task's radar, whose own data do not count, to pixels (n_layers,
        n_azimuth, n_range), both complex64. A focuser without one is no linear operator for
        :func:`sarmitsuba.focusing_operator`.

        Raises
        ------
        DataError
            The focuser has none.
        """
        raise DataError(
            f"focuser {self.name}: it states no adjoint, so that it is no linear operator; take {EXACT}"
        )

    @abstractmethod
    def focus(self, task: FocusTask) -> Focused:
        """Focus; call ``objection`` before."""


FOCUSERS: Registry[Focuser] = Registry("focuser", Focuser, "sarmitsuba.signal.focusing.focusers")


# processor seconds of a call, and of the weight of a pulse at a node of the summed pattern weights
# (benchmarks/suite/focusers.py prints both)
CALL_SECONDS, WEIGHT_SECONDS = 0.01, 1.0e-7
EXACT, FAST = "backprojection", "factorised"
"""Names of the reference and of the fast form of the same sum."""
DEFAULT = "auto"
"""The focuser where none is named."""
ERROR_DB = (-300.0, 0.0)
"""Bounds of a wanted error, dB."""
# errors of the fast form in the default choice, dB: below the data's own error, where that is not known, and at most
_BELOW_DB, _UNKNOWN_DB, _MOST_DB = -20.0, -60.0, -50.0
# processor seconds of one layer, and share, that the fast form must save: a small image keeps the plain sum's bits; and
# products of pixels and pulses that take less in any geometry
_SAVES, _SHARE, _SMALL = 0.5, 0.25, 4e7
_EXACT_AS_SMALL = f"{EXACT}, exact: the image is small"


@dataclass(frozen=True)
class Auto(Focuser):
    """The default: backprojection, or its factorised form; with an ``error``, the fastest of all; see `resolved`."""

    name: ClassVar[str] = DEFAULT
    title: ClassVar[str] = (
        "backprojection, or its factorised form where that saves time and errs by 20 dB less than the data; with "
        "error, the cheapest of all that does not refuse and states it"
    )
    bistatic: ClassVar[bool] = True

    error: float = option(
        0.0, "largest stated error against exact backprojection, dB; 0 = from the data's own", within=ERROR_DB
    )

    def refusal(self, radar: Radar, grid: ImageGrid) -> str:
        """Reason why no focuser is suitable; empty when one is."""
        if self.error == 0.0:
            return FOCUSERS[EXACT].refusal(radar, grid)
        found, reason = self._choose(radar, grid)
        return "" if found else reason

    def resolved(
        self, radar: Radar, grid: ImageGrid, data_error_db: Callable[[], float] = lambda: math.nan
    ) -> tuple[Focuser, str]:
        """The focuser used, and why, in one line.

        Without an ``error``: the factorised form of backprojection where it saves half a second of processor time and
        a quarter, and states an error 20 dB below that of the data (-60 dB where that is not known, never above -50
        dB); else backprojection. With one: the focuser of least processor time among those that accept the data and
        state that error.

        Raises
        ------
        DataError
            There is none.
        """
        if self.error == 0.0:
            return _sum_of_pulses(radar, grid, data_error_db)
        found, reason = self._choose(radar, grid)
        if found is None:
            raise DataError(f"focuser auto: {reason}")
        return found, reason

    def imaging(self, task: FocusTask) -> LinearMap:
        """Linear map of the chosen focuser."""
        return self.resolved(task.raw.radar, task.grid)[0].imaging(task)

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


def _sum_of_pulses(radar: Radar, grid: ImageGrid, data_error_db: Callable[[], float]) -> tuple[Focuser, str]:
    """Backprojection or its factorised form, and why."""
    exact, fast = FOCUSERS[EXACT], FOCUSERS[FAST]
    if float(np.prod(grid.shape)) * radar.track.n_pulses < _SMALL:
        return exact, _EXACT_AS_SMALL
    seconds = exact.cpu_seconds(radar, grid)
    if seconds < _SAVES:
        return exact, _EXACT_AS_SMALL
    own_db = data_error_db()
    needed = _UNKNOWN_DB if math.isnan(own_db) else min(own_db + _BELOW_DB, _MOST_DB)
    if needed == -math.inf:
        return exact, f"{EXACT}, exact: the echoes have no error of their own"
    refusal = ""
    for wanted in dict.fromkeys((min(needed, _UNKNOWN_DB), needed)):  # the smaller error takes hardly longer
        option = fast.with_options({"error": f"{wanted:g}"})
        refusal = option.objection(radar, grid)
        if refusal:
            continue
        error, other = option.error_db(radar, grid), option.cpu_seconds(radar, grid)
        if not error <= needed:
            stated = "no error is stated here" if math.isnan(error) else f"at most {error:.0f} dB"
            refusal = f"{stated}, {needed:.0f} dB are needed"
        elif other > min(seconds - _SAVES, seconds * (1.0 - _SHARE)):
            refusal = f"about {other:.2g} instead of {seconds:.2g} CPU s per layer"
        else:
            own = "" if math.isnan(own_db) else f", the data's own is {own_db:.0f} dB"
            return option, (
                f"{FAST} backprojection, at most {error:.0f} dB{own}, about {other:.2g} instead of {seconds:.2g} CPU s "
                "per layer"
            )
    return exact, f"{EXACT}, exact: not {FAST} ({refusal.partition(';')[0]})"


def parse_focuser(text: str | Focuser) -> Focuser:
    """Read a focuser from its name and options, such as ``backprojection,interpolation=kernel:8``.

    ``auto`` is a choice among them, with the option ``error`` among all; it is in no registry.

    Raises
    ------
    ExtensionError
        There is no focuser of that name.
    DataError
        Unknown option, or a value of the wrong type or out of its bounds.
    """
    if isinstance(text, Focuser):
        return text
    name, *rest = text.strip().split(",")
    named = Auto() if name == Auto.name else FOCUSERS[name]
    return named.with_texts(rest)


def check_focuser(focuser: Focuser, radar: Radar, grid: ImageGrid) -> None:
    """Raise a DataError where a focuser cannot focus the data; it names the focusers that can."""
    reason = focuser.objection(radar, grid)
    if reason and focuser.name == Auto.name and focuser.options["error"]:
        raise DataError(f"focuser {focuser.name}: {reason}")
    if reason:
        name = EXACT if focuser.name == Auto.name else focuser.name
        others = [f.name for f in FOCUSERS if f.name != name and not f.objection(radar, grid)]
        remedy = f"; take focuser {' or '.join(others)}" if others else ""
        raise DataError(f"focuser {name}: {reason}{remedy}")
