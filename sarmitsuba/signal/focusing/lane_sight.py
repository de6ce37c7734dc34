"""Pixels that share a lane of the back end, and a pulse's line of sight to them (Dr.Jit)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.machine.backend import dr
from sarmitsuba.signal.focusing.device_complex import TWO_PI, cis, scaled, times

if TYPE_CHECKING:
    Complex = tuple[dr.ArrayBase, dr.ArrayBase]


@dataclass(frozen=True)
class Scales:
    """Numbers of the geometry, float64 opaque.

    Parameters
    ----------
    per_metre : profile samples per m of slant range
    turns_per_metre : turns of the carrier's phase per m of slant range, 2 fc / c
    inverse_square : 1 / R_0^2, 1 / m^2
    """

    per_metre: dr.ArrayBase
    turns_per_metre: dr.ArrayBase
    inverse_square: dr.ArrayBase


@dataclass(frozen=True)
class LanePixels:
    """Equally spaced pixels of one lane, whose ranges and echoes are expanded about a few of them.

    Parameters
    ----------
    n_pixels : in the lane; the range is expanded about pixel ``n_pixels // 2``
    n_nodes : places where the profiles are interpolated; the pixels' values follow by the polynomial through them
        (directly, where there are as many nodes as pixels)
    step : from one pixel to the next, x, y, z, m, float64 opaque
    checked : whether a pixel may lie outside the receive window; else no sample is tested
    """

    n_pixels: int
    n_nodes: int
    step: tuple[dr.ArrayBase, dr.ArrayBase, dr.ArrayBase]
    checked: bool

    @property
    def places(self) -> list[int]:
        """Places of the pixels from the middle one, in steps."""
        return list(range(-(self.n_pixels // 2), self.n_pixels - self.n_pixels // 2))

    @property
    def bends(self) -> tuple[int, ...]:
        """Places where the weights are evaluated, between which they are parabolas."""
        return (0,) if self.n_pixels == 1 else (0, -(self.n_pixels // 2), self.n_pixels // 2)

    @property
    def direct(self) -> bool:
        """Whether the profiles are interpolated at every pixel."""
        return self.n_nodes >= self.n_pixels

    @property
    def nodes(self) -> tuple[float, ...]:
        """Places where the profiles are interpolated: Chebyshev's points."""
        if self.direct:
            return tuple(float(place) for place in self.places)
        return _chebyshev_points(self.n_pixels, self.n_nodes)

    def mix(self, place: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Weights of the sums and of the differences of opposite nodes in the polynomial's value at a place.

        Nodes j and k - 1 - j are opposite; a middle one counts as a sum. Places m and -m take the same weights, the
        differences' with the other sign.
        """
        return _polynomial_weights(self.nodes, place)


@lru_cache(maxsize=64)
def _chebyshev_points(n_pixels: int, n_nodes: int) -> tuple[float, ...]:
    """Chebyshev's points over a line of pixels, in steps from its middle."""
    x = np.cos(np.pi * (np.arange(n_nodes) + 0.5) / n_nodes)
    return tuple(float(v) for v in 0.5 * n_pixels * x)


@lru_cache(maxsize=1024)
def _polynomial_weights(places: tuple[float, ...], place: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Weights of :meth:`LanePixels.mix` of the polynomial through values at ``places``."""
    nodes, k = np.array(places), len(places)
    lagrange = [
        float(np.prod((place - np.delete(nodes, j)) / (nodes[j] - np.delete(nodes, j)))) for j in range(k)
    ]
    even = [0.5 * (lagrange[j] + lagrange[k - 1 - j]) for j in range((k + 1) // 2)]
    odd = [0.5 * (lagrange[j] - lagrange[k - 1 - j]) for j in range(k // 2)]
    if k % 2:
        even[-1] = lagrange[k // 2]
    return tuple(even), tuple(odd)


@dataclass(frozen=True)
class Sight:
    """One pulse's line of sight to the middle of every lane's pixels.

    Parameters
    ----------
    line : pixels of the lane
    delta : x, y, z from antenna to pixel, float64, m
    square, distance, inverse : of its length, float64
    slope : m of range per pixel, float64
    bend : m of range per pixel squared, float32
    """

    line: LanePixels
    delta: tuple[dr.ArrayBase, dr.ArrayBase, dr.ArrayBase]
    square: dr.ArrayBase
    distance: dr.ArrayBase
    inverse: dr.ArrayBase
    slope: dr.ArrayBase
    bend: dr.ArrayBase

    @classmethod
    def of(cls, types: ModuleType, line: LanePixels, delta: tuple[dr.ArrayBase, ...]) -> Sight:
        """Range and its expansion."""
        dx, dy, dz = delta
        sx, sy, sz = line.step
        square = dr.fma(dx, dx, dr.fma(dy, dy, dz * dz))
        distance = dr.sqrt(square)
        inverse = dr.rcp(distance)
        slope = dr.fma(dx, sx, dr.fma(dy, sy, dz * sz)) * inverse
        step = dr.fma(sx, sx, dr.fma(sy, sy, sz * sz))
        bend = types.Float32(0.5 * dr.fma(-slope, slope, step) * inverse)
        return cls(line, (dx, dy, dz), square, distance, inverse, slope, bend)

    def received_at(self, other: Sight) -> Sight:
        """Bistatic slant range, half the path over the pixel to the receiver, and product of both ranges."""
        assert self.line.n_pixels == 1
        square, distance = self.distance * other.distance, 0.5 * (self.distance + other.distance)
        return replace(self, square=square, distance=distance)

    def direction(self, types: ModuleType, place: int) -> tuple[dr.ArrayBase, ...]:
        """Unit vector, float32, to the pixel ``place`` steps from the middle one."""
        d = [
            types.Float32(dr.fma(float(place), s, v)) for v, s in zip(self.delta, self.line.step, strict=True)
        ]
        scale = dr.rsqrt(dr.fma(d[0], d[0], dr.fma(d[1], d[1], d[2] * d[2])))
        return tuple(v * scale for v in d)

    def middle_phasor(self, types: ModuleType, scales: Scales, weight: dr.ArrayBase) -> Complex:
        r""":math:`w (R^2 / R_0^2) e^{+j 4 \pi f_c R / c}` of the middle pixel."""
        gain = weight * types.Float32(self.square * scales.inverse_square)
        return scaled(gain, cis(types, self.distance * scales.turns_per_metre))

    def bends(self, types: ModuleType, scales: Scales) -> list[Complex]:
        """Ratio of a node's phasor to the middle pixel's, without the phase linear in the place."""
        Float = types.Float32
        tilt = Float(2.0 * self.slope * self.inverse)
        curve = dr.fma(2.0 * self.bend, Float(self.inverse), 0.25 * tilt * tilt)
        turns = self.bend * Float(scales.turns_per_metre)
        out = []
        for x in self.line.nodes:
            # to third order in the place: -slope bend x^3 / R
            sin, cos = dr.sincos(turns * dr.fma(-0.5 * TWO_PI * x**3, tilt, TWO_PI * x * x))
            out.append(scaled(dr.fma(x, dr.fma(x, curve, tilt), 1.0), (cos, sin)))
        return out

    def powers(self, types: ModuleType, scales: Scales) -> list[Complex]:
        """Phasors of the phase linear in the place, of the places 0 ... ``n_pixels // 2``."""
        out = [(types.Float32(1.0), types.Float32(0.0)), cis(types, self.slope * scales.turns_per_metre)]
        for m in range(2, self.line.n_pixels // 2 + 1):
            out.append(times(out[m // 2], out[m - m // 2]))
        return out

    def phasors(self, types: ModuleType, scales: Scales, weight: dr.ArrayBase) -> dict[int, Complex]:
        r"""Of every pixel of the lane, :math:`w (R^2 / R_0^2) e^{+j 4 \pi f_c R / c}` by its place.

        Phase and log magnitude are parabolas in the place, so the ratio of neighbours changes by a constant factor:
        outwards from the middle, two complex products per pixel.
        """
        Float = types.Float32
        out = {0: self.middle_phasor(types, scales, weight)}
        if self.line.n_pixels == 1:
            return out
        odd = cis(types, self.slope * scales.turns_per_metre)
        even = cis(types, types.Float64(self.bend) * scales.turns_per_metre)
        # ln R^2 = ln R_0^2 + 2 a m + (2 bend / R - a^2) m^2, a = slope / R
        a = Float(self.slope * self.inverse)
        curve = dr.fma(2.0 * self.bend, Float(self.inverse), -a * a)
        change = scaled(dr.fma(2.0 * curve, 1.0 + curve, 1.0), times(even, even))
        for sign in (1, -1):
            power = dr.fma(2.0 * sign, a, curve)
            ratio = scaled(dr.fma(power, dr.fma(0.5, power, 1.0), 1.0), times((odd[0], sign * odd[1]), even))
            value = out[0]
            for place in self.line.places[::sign]:
                if place * sign > 0:
                    value = times(value, ratio)
                    ratio = times(ratio, change)
                    out[place] = value
        return out


def parabola(line: LanePixels, values: list[dr.ArrayBase]) -> list[dr.ArrayBase]:
    """Values at all pixels of a line of a function known at its nodes."""
    if line.n_pixels == 1:
        return values
    middle, low, high = values
    half = line.n_pixels // 2
    slope = (high - low) * (0.5 / half)
    bend = (high + low - 2.0 * middle) * (0.5 / half**2)
    return [dr.fma(float(m), dr.fma(float(m), bend, slope), middle) for m in line.places]
