"""Other focusers and interpolations for the same data and grid: stated errors and relative times."""

import math
from dataclasses import dataclass

from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.focuser import FOCUSERS, Focuser, parse_focuser
from sarmitsuba.signal.image.sar_image import ImageGrid

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
