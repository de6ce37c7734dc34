"""Comparison of all focusers on the same data and grid against the most exact one: errors, stated errors and times."""

import math
import time
from dataclasses import dataclass

from sarmitsuba.core.constants import DEFAULT_WINDOW
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.core.timing import Clock
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.focus import focus
from sarmitsuba.signal.focusing.focuser import FOCUSERS, Focuser, parse_focuser
from sarmitsuba.signal.focusing.range_compression import range_compress
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.metrics import coherence, image_error_db
from sarmitsuba.signal.raw_data import RawData


@dataclass(frozen=True, eq=False)
class FocuserResult:
    """Result of one focuser.

    Parameters
    ----------
    name : of the focuser
    refusal : reason why it did not focus; empty when it did
    image : None where it refused
    seconds : elapsed
    error_db : of the image against the reference, over all layers; NaN where it refused, -inf for the reference
    coherence : with the reference
    """

    name: str
    refusal: str
    image: SarImage | None
    seconds: float
    error_db: float
    coherence: float

    def as_dict(self) -> dict[str, object]:
        """JSON-able, without the image."""
        if self.refusal:
            return {"focuser": self.name, "refusal": self.refusal}
        finite = self.error_db > float("-inf")
        return {
            "focuser": self.name,
            "seconds": self.seconds,
            "error_db": self.error_db if finite else None,
            "coherence": self.coherence,
        }


def compare_focusers(
    raw: RawData,
    grid: ImageGrid,
    *,
    window: str | Window = DEFAULT_WINDOW,
    reference: str = "backprojection",
    progress: Progress = silent,
    clock: Clock = time.perf_counter,
) -> tuple[FocuserResult, ...]:
    """Focus with every registered focuser that does not refuse.

    Parameters
    ----------
    raw : data
    grid : common to all
    window : in range and azimuth
    reference : focuser that the others are compared with; it must not refuse
    progress : called by each in turn
    clock : time source, s

    Returns
    -------
    the reference first, then the others in order of registration

    Raises
    ------
    DataError
        The reference refuses.
    """
    raw = range_compress(raw, method="flat")
    grid = grid.in_frame(raw.radar.offset)

    def run(focuser: Focuser) -> tuple[SarImage | None, str, float]:
        start = clock()
        try:
            image = focus(
                raw, grid, focuser=focuser, range_window=window, azimuth_window=window, progress=progress
            )
        except DataError as error:  # it accepts neither the track nor the straightened one
            reason = str(error).removeprefix(f"focuser {focuser.name}: ").partition("; take focuser")[0]
            return None, reason, 0.0
        return image, "", clock() - start

    exact, refusal, seconds = run(FOCUSERS[reference])
    if exact is None:
        raise DataError(f"focuser {reference}: {refusal}; the others have nothing to be compared with")
    results = [FocuserResult(reference, "", exact, seconds, float("-inf"), 1.0)]
    for focuser in FOCUSERS:
        if focuser.name == reference:
            continue
        image, refusal, seconds = run(focuser)
        error, similar = float("nan"), float("nan")
        if image is not None:
            error = image_error_db(image.data, exact.data)
            similar = coherence(image.data, exact.data)
        results.append(FocuserResult(focuser.name, refusal, image, seconds, error, similar))
    return tuple(results)


# processor time of backprojection by interpolation, relative to kernel:6 (benchmarks/suite/focusers.py)
INTERPOLATIONS = {"linear": 0.6, "kernel:4": 0.8, "kernel": 1.0, "kernel:8": 1.25}


@dataclass(frozen=True)
class Alternative:
    """A focuser in place of the one that was used.

    Parameters
    ----------
    focuser : name with options, as for ``--focuser``
    error_db : stated error against exact backprojection, dB
    time : processor time relative to that of the focuser in use
    """

    focuser: str
    error_db: float
    time: float


def alternatives(used: str | Focuser, radar: Radar, grid: ImageGrid) -> tuple[Alternative, ...]:
    """Focusers that accept these data and state an error: interpolations of backprojection, and other algorithms.

    Parameters
    ----------
    used : focuser of the image
    radar, grid : of the data and of the image

    Notes
    -----
    Times are those of models of each focuser (``cpu_seconds``), on one core; only their ratio is used.
    """
    radar = radar.start_stop()
    used = parse_focuser(used).resolved(radar, grid)[0]
    seconds = _seconds(used, radar, grid)
    found = []
    exact = FOCUSERS["backprojection"]
    each = [exact.with_texts([f"interpolation={name}"]) for name in INTERPOLATIONS]
    named = [f"backprojection,interpolation={name}" for name in INTERPOLATIONS]
    others = [focuser for focuser in FOCUSERS if focuser.name != exact.name]
    for focuser, name in zip([*each, *others], [*named, *(f.name for f in others)], strict=True):
        if focuser == used or focuser.objection(radar, grid):
            continue
        error = focuser.error_db(radar, grid)
        if not math.isnan(error):
            found.append(Alternative(name, error, _seconds(focuser, radar, grid) / seconds))
    return tuple(found)


def _seconds(focuser: Focuser, radar: Radar, grid: ImageGrid) -> float:
    taps = INTERPOLATIONS.get(str(focuser.options.get("interpolation", "kernel")), 1.0)
    return taps * focuser.cpu_seconds(radar, grid)
