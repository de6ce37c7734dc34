"""Conversion of metadata to plain JSON values, and reading of untrusted JSON."""

import dataclasses
import json
import math
from collections.abc import Callable, Mapping
from pathlib import PurePath
from typing import Any

import numpy as np

# characters of the longest integer of 64 bits
_LONGEST_WHOLE = 20

Json = dict[str, "Json"] | list["Json"] | str | int | float | bool | None


def to_json(value: object, *, strict: bool = False) -> Json:
    """Convert ``value`` to dict, list, str, int, float, bool and None.

    Parameters
    ----------
    value : mappings, sequences, dataclasses, NumPy values, complex numbers (as ``[re, im]``), paths
    strict : write NaN and infinities as text, since the JSON standard has no such numbers
    """

    def convert(item: object) -> Json:
        if item is None or isinstance(item, (bool, int)):
            return item
        if isinstance(item, str):  # a file name may not be valid UTF-8
            return item if item.isascii() else item.encode("utf-8", "replace").decode("utf-8")
        if isinstance(item, float):
            return item if math.isfinite(item) or not strict else str(item)
        if isinstance(item, complex):
            return [convert(item.real), convert(item.imag)]
        if isinstance(item, np.ndarray):
            return convert(item.tolist())
        if isinstance(item, np.generic):
            return convert(item.item())
        if isinstance(item, Mapping):
            return {str(convert(str(key))): convert(entry) for key, entry in item.items()}
        if isinstance(item, (list, tuple, set, frozenset)):
            return [convert(entry) for entry in item]
        if dataclasses.is_dataclass(item) and not isinstance(item, type):
            return {field.name: convert(getattr(item, field.name)) for field in dataclasses.fields(item)}
        return convert(str(item.as_posix() if isinstance(item, PurePath) else item))

    return convert(value)


def json_value(text: str | bytes, refuse: Callable[[str], object] | None = None) -> Any:
    """Value of an untrusted JSON text; a whole number beyond 64 bits is a float, infinite where it is larger still.

    Parameters
    ----------
    text : in UTF-8
    refuse : called with ``NaN``, ``Infinity`` or ``-Infinity``, which are no JSON; None: they are read as floats

    Raises
    ------
    ValueError
        It is malformed, not UTF-8, or nested too deeply.
    """
    try:
        return json.loads(text, parse_int=_whole, parse_constant=refuse)
    except RecursionError:
        raise ValueError("its entries are nested too deeply") from None


def _whole(digits: str) -> int | float:
    return bound_to_64_bits(int(digits)) if len(digits) <= _LONGEST_WHOLE else float(digits)


def bound_to_64_bits(value: int) -> int | float:
    """The number as it is, or as a float: NumPy and formats of files take no integer of more than 64 bits."""
    if -(2**63) <= value < 2**64:
        return value
    return float(value) if abs(value) < 2**1000 else math.copysign(math.inf, 1 if value > 0 else -1)
