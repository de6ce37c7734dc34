"""Complex numbers as pairs of Dr.Jit arrays."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING

from sarmitsuba.machine.backend import dr

if TYPE_CHECKING:
    Complex = tuple[dr.ArrayBase, dr.ArrayBase]

TWO_PI = 6.283185307179586


def cis(types: ModuleType, turns: dr.ArrayBase) -> Complex:
    """Cosine and sine of float64 turns, which are reduced before they are rounded to float32."""
    sin, cos = dr.sincos(types.Float32(turns - dr.round(turns)) * TWO_PI)
    return cos, sin


def times(a: Complex, b: Complex) -> Complex:
    """Product of complex numbers."""
    return dr.fma(a[0], b[0], -(a[1] * b[1])), dr.fma(a[0], b[1], a[1] * b[0])


def scaled(factor: dr.ArrayBase, a: Complex) -> Complex:
    """A complex number times a real one."""
    return factor * a[0], factor * a[1]


def weighted_sum(weights: Sequence[float], values: list[Complex]) -> Complex:
    """Sum of complex numbers, weighted with literals; zero where there are none."""
    re, im = 0.0, 0.0
    for weight, value in zip(weights, values, strict=True):
        re, im = dr.fma(weight, value[0], re), dr.fma(weight, value[1], im)
    return re, im
