"""Check of what a user's stage returns: the kernel records only values of the same kinds as before."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import TypeVar

from sarmitsuba.core.registry import checked_type
from sarmitsuba.machine.backend import dr, mi

Value = TypeVar("Value")


def like(found: Value, before: Value, optional: tuple[str, ...] = ()) -> Value:
    """What a stage returned, if each part has the type and length of that part before.

    Parameters
    ----------
    found, before : dataclasses of Dr.Jit arrays, tuples and further dataclasses
    optional : attributes that may be None, before or after

    Raises
    ------
    TypeError
        A part is of another type: Dr.Jit would refuse it later, without a name.
    ValueError
        A tuple has another number of entries, or an array is neither as wide as the kernel nor one value.
    """
    checked_type(found, type(before))
    _check(found, before, "", _width(before), optional)
    return found


def as_wide(found: Value, before: object) -> Value:
    """What a stage returned, if it is one value or as wide as the kernel's values ``before``."""
    _check_width(found, "the factor", _width(before))
    return found


def _check(found: object, before: object, name: str, width: int, optional: tuple[str, ...]) -> None:
    if found is before or (name in optional and (found is None or before is None)):
        return
    if type(found) is not type(before) and (name or not isinstance(found, type(before))):
        raise TypeError(f"{name} is {type(found).__name__}, not {type(before).__name__}")
    if is_dataclass(before):
        for part in fields(before):
            inner = f"{name}.{part.name}" if name else part.name
            _check(getattr(found, part.name), getattr(before, part.name), inner, width, optional)
    elif isinstance(before, tuple) and isinstance(found, tuple):
        if len(found) != len(before):
            raise ValueError(f"{name} has {len(found)} entries, not {len(before)}")
        for i, (a, b) in enumerate(zip(found, before, strict=True)):
            _check(a, b, f"{name}[{i}]", width, optional)
    else:
        _check_width(found, name, width)


def _check_width(found: object, name: str, width: int) -> None:
    if not dr.is_array_v(found):
        return
    n = dr.width(found)
    if n not in (1, width):
        raise ValueError(
            f"{name} has {n} values; the kernel has {width} lanes: one value for each, or one for all"
        )


def _width(value: object) -> int:
    """Largest width of the Dr.Jit arrays in a value."""
    if dr.is_array_v(value):
        return int(dr.width(value))
    if is_dataclass(value):
        return max((_width(getattr(value, part.name)) for part in fields(value)), default=1)
    return max(map(_width, value), default=1) if isinstance(value, tuple) else 1


def lost_where_not_finite(finite: mi.Bool, amplitude: mi.Complex2f) -> mi.Complex2f:
    """Amplitude that is NaN where an echo has a place that is not finite: sums of power then show it."""
    nan = mi.Complex2f(dr.nan, dr.nan)
    return dr.select(finite | (dr.squared_norm(amplitude) == 0.0), amplitude, nan)
