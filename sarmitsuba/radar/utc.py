"""Absolute time: UTC to the nanosecond, in texts by ISO 8601 and as NumPy's datetime64."""

import datetime
import re

import numpy as np

from sarmitsuba.core.parameters import printable

# UTC of a track's time zero where nothing else is given: simulated flights have no date
DEFAULT_EPOCH = np.datetime64("2000-01-01T00:00:00", "ns")
_FORMAT = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d{1,12}))?(?:Z|\+00:00)?")
# years that 64 bits of nanoseconds hold, with a margin for times of a track
_YEARS = (1900, 2200)


def utc_of(value: object) -> np.datetime64:
    """UTC, datetime64[ns], of an ISO 8601 text, a ``datetime`` with a time zone, or a ``datetime64``.

    Raises
    ------
    ValueError
        It is none of these, has no or another time zone, or lies outside the years 1900 to 2200.

    Notes
    -----
    Days have 86 400 s: a leap second has no name, and times that count across one are a second off.
    """
    if isinstance(value, datetime.datetime):
        if value.tzinfo is None:
            raise ValueError(f"{value} has no time zone; give UTC, such as tzinfo=datetime.timezone.utc")
        value = value.astimezone(datetime.timezone.utc).replace(tzinfo=None).isoformat()
    if isinstance(value, np.datetime64):
        if np.isnat(value):
            raise ValueError("the time is NaT")
        _check_year(int(value.astype("datetime64[Y]").astype(int)) + 1970, str(value))
        return np.datetime64(str(value), "ns")
    match = _FORMAT.fullmatch(value.strip()) if isinstance(value, str) else None
    shown = printable(str(value))[:60]
    if match is None:
        raise ValueError(f'"{shown}" is not a UTC date and time such as 2024-05-01T06:00:00.5Z')
    _check_year(int(match[1][:4]), shown)
    try:
        whole = np.datetime64(match[1], "ns")
    except ValueError:
        raise ValueError(f'"{shown}" is not a date and time of the calendar') from None
    return whole + np.timedelta64(int((match[2] or "").ljust(9, "0")[:9]), "ns")


def utc_text(time: np.datetime64) -> str:
    """ISO 8601 text of a UTC time, with as many digits of the second as it needs."""
    text = str(time.astype("datetime64[ns]"))
    return text.rstrip("0").rstrip(".") + "Z"


def utc_after(epoch: np.datetime64, seconds: float) -> np.datetime64:
    """UTC so many seconds after an epoch, to the nanosecond."""
    whole = int(np.floor(seconds))
    return epoch + np.timedelta64(whole, "s") + np.timedelta64(round((seconds - whole) * 1e9), "ns")


def seconds_of(text: str, first: str) -> float:
    """Time of a file's entry in s: a number as it is, a date and time since that of the first entry."""
    if is_number(text) and is_number(first):
        return float(text)
    return float((utc_of(text) - utc_of(first)) / np.timedelta64(1, "ns")) * 1e-9


def epoch_of_stamp(first: str) -> np.datetime64:
    """UTC of time zero of entries that begin with this one: its own if it is a date, else the default."""
    return DEFAULT_EPOCH if is_number(first) else utc_of(first)


def is_number(text: str) -> bool:
    """Whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def is_time(text: str) -> bool:
    """Whether a file's entry is a number or a date and time."""
    try:
        seconds_of(text, text)
    except ValueError:
        return False
    return True


def _check_year(year: int, shown: str) -> None:
    if not _YEARS[0] <= year <= _YEARS[1]:
        raise ValueError(f'"{shown}" is not within the years {_YEARS[0]} to {_YEARS[1]}')
