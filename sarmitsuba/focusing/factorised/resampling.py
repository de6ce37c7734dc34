"""Compiled last step of factorised backprojection: interpolation of a section's subimage at the pixels."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING

from sarmitsuba.backend import dr
from sarmitsuba.echo.gridding import GriddingKernel
from sarmitsuba.focusing.device_complex import cis, scaled
from sarmitsuba.focusing.factorised.kernels import PolarAxes, packed, unpacked
from sarmitsuba.focusing.factorised.sampling import TAPS, row_polynomials

if TYPE_CHECKING:
    Vector = tuple[dr.ArrayBase, dr.ArrayBase, dr.ArrayBase]


@dataclass(frozen=True)
class Pixels:
    """Consecutive rows of the image, in a section's frame.

    Parameters
    ----------
    n_columns : UInt32 opaque
    per_column : one over it, float64 opaque
    corner, along, across : three float64 opaque each, m: of the first row, a step to the next, a unit vector
    distances : float64, across-track distance of every column, m
    """

    n_columns: dr.ArrayBase
    per_column: dr.ArrayBase
    corner: Vector
    along: Vector
    across: Vector
    distances: dr.ArrayBase


def along_rows(
    types: ModuleType,
    polar: PolarAxes,
    pixels: Pixels,
    n_lanes: int,
    kernel: GriddingKernel,
    images: list[dr.ArrayBase],
) -> list[dr.ArrayBase]:
    r"""A section's subimage, interpolated in angle, at the ranges of its samples on rows of the image.

    On a row :math:`q + c u`, u a horizontal unit vector, the range R is at
    :math:`c = -q \cdot u + \sqrt{(q \cdot u)^2 - |q|^2 + R^2}`.

    Returns
    -------
    per layer, words [row, range]
    """
    Float, Float64, UInt32, Int32 = types.Float32, types.Float64, types.UInt32, types.Int32
    lane = dr.arange(UInt32, n_lanes)
    # an integer division is not vectorised
    row = UInt32((Float64(lane) + 0.5) * dr.rcp(Float64(polar.n_ranges)))
    column = lane - row * polar.n_ranges
    x, y, z = (dr.fma(Float64(row), a, base) for a, base in zip(pixels.along, pixels.corner, strict=True))
    ahead = dr.fma(x, pixels.across[0], dr.fma(y, pixels.across[1], z * pixels.across[2]))
    distance = dr.fma(Float64(column), polar.range_step, polar.start_range)
    square = dr.fma(distance, distance, dr.fma(ahead, ahead, -dr.fma(x, x, dr.fma(y, y, z * z))))
    across = dr.sqrt(dr.maximum(square, 0.0)) - ahead
    x, y = dr.fma(across, pixels.across[0], x), dr.fma(across, pixels.across[1], y)
    angle = (dr.atan2(Float(y), Float(x)) - Float(polar.start_angle)) * Float(polar.per_angle)
    first = dr.floor(angle)
    low = Int32(first) - kernel.lead
    # ranges that no pixel of the row has may lie beyond the subimage
    low = dr.clip(low, 0, Int32(polar.n_angles) - kernel.width)
    taps = kernel.taps(angle - first, dr)
    base = UInt32(low) * polar.n_ranges + column
    out = []
    for image in images:
        re, im, index = Float(0.0), Float(0.0), base
        for tap in taps:
            v = unpacked(types, dr.gather(types.UInt64, image, index))
            re, im = dr.fma(tap, v[0], re), dr.fma(tap, v[1], im)
            index = index + polar.n_ranges
        out.append(packed(types, (re, im)))
    dr.eval(out)
    return out


def _row_taps(fraction: dr.ArrayBase, upsampling: float) -> list[dr.ArrayBase]:
    """Least-squares weights of the neighbours of a place between two samples, first neighbour first."""
    t = fraction - 0.5
    square = t * t
    taps: dict[int, dr.ArrayBase] = {}
    for k, parts in enumerate(row_polynomials(upsampling)):
        even, odd = (_horner(part, square) for part in parts)
        taps[k], taps[TAPS - 1 - k] = dr.fma(odd, t, even), dr.fma(-odd, t, even)
    return [taps[k] for k in range(TAPS)]


def _horner(coefficients: tuple[float, ...], x: dr.ArrayBase) -> dr.ArrayBase:
    value: dr.ArrayBase | float = coefficients[-1]
    for c in coefficients[-2::-1]:
        value = dr.fma(x, value, c)
    return value


def resample(
    types: ModuleType,
    polar: PolarAxes,
    pixels: Pixels,
    n_lanes: int,
    turns_per_metre: dr.ArrayBase,
    kernel: GriddingKernel,
    images: list[dr.ArrayBase],
    state: list[dr.ArrayBase],
    on_rows: float,
) -> list[dr.ArrayBase]:
    r"""Add a section's subimage, whose interpolation is corrected beforehand, to pixels: :math:`I += b e^{j k R_0}`.

    ``on_rows``: upsampling of the subimage where ``images`` are those of :func:`along_rows` and range alone is
    interpolated, by least squares over the band; else 0.
    """
    Float, UInt32, Int32 = types.Float32, types.UInt32, types.Int32
    lane = dr.arange(UInt32, n_lanes)
    # an integer division is not vectorised
    row = UInt32((types.Float64(lane) + 0.5) * pixels.per_column)
    across = dr.gather(types.Float64, pixels.distances, lane - row * pixels.n_columns)
    down = types.Float64(row)
    x, y, z = (
        dr.fma(down, a, dr.fma(across, c, base))
        for a, c, base in zip(pixels.along, pixels.across, pixels.corner, strict=True)
    )
    distance = dr.sqrt(dr.fma(x, x, dr.fma(y, y, z * z)))
    column = (distance - polar.start_range) * polar.per_range
    first_column = dr.floor(column)
    fraction = Float(column - first_column)
    lead, width = (TAPS // 2 - 1, TAPS) if on_rows else (kernel.lead, kernel.width)
    low_column = Int32(first_column) - lead
    inside = (low_column >= 0) & (low_column <= Int32(polar.n_ranges) - width)
    line, along_angle = row, [Float(1.0)]
    if not on_rows:
        angle = (dr.atan2(Float(y), Float(x)) - Float(polar.start_angle)) * Float(polar.per_angle)
        first_angle = dr.floor(angle)
        low_angle = Int32(first_angle) - kernel.lead
        inside &= (low_angle >= 0) & (low_angle <= Int32(polar.n_angles) - width)
        line, along_angle = UInt32(low_angle), kernel.taps(angle - first_angle, dr)
    base = dr.select(inside, line * polar.n_ranges + UInt32(low_column), 0)
    along_range = _row_taps(fraction, on_rows) if on_rows else kernel.taps(fraction, dr)
    phasor = scaled(dr.select(inside, Float(1.0), 0.0), cis(types, distance * turns_per_metre))
    out = []
    for layer, image in enumerate(images):
        re, im = Float(0.0), Float(0.0)
        index = base
        for outer in along_angle:
            a, b = Float(0.0), Float(0.0)
            for i, tap in enumerate(along_range):
                v = unpacked(types, dr.gather(types.UInt64, image, index + i))
                a, b = dr.fma(tap, v[0], a), dr.fma(tap, v[1], b)
            re, im = (a, b) if on_rows else (dr.fma(outer, a, re), dr.fma(outer, b, im))
            index = index + polar.n_ranges
        out.append(dr.fma(re, phasor[0], dr.fma(-im, phasor[1], state[2 * layer])))
        out.append(dr.fma(re, phasor[1], dr.fma(im, phasor[0], state[2 * layer + 1])))
    return out
