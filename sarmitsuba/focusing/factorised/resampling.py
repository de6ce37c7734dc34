"""Compiled last step of factorised backprojection: interpolation of a section's subimage at the pixels."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING

from sarmitsuba.backend import dr
from sarmitsuba.echo.gridding import GriddingKernel
from sarmitsuba.focusing.device_complex import cis, scaled
from sarmitsuba.focusing.factorised.kernels import PolarAxes, unpacked

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


def resample(
    types: ModuleType,
    polar: PolarAxes,
    pixels: Pixels,
    n_lanes: int,
    turns_per_metre: dr.ArrayBase,
    kernel: GriddingKernel,
    images: list[dr.ArrayBase],
    state: list[dr.ArrayBase],
) -> list[dr.ArrayBase]:
    r"""Add a section's subimage, whose interpolation is corrected beforehand, to pixels: :math:`I += b e^{j k R_0}`."""
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
    angle = (dr.atan2(Float(y), Float(x)) - Float(polar.start_angle)) * Float(polar.per_angle)
    first_column, first_angle = dr.floor(column), dr.floor(angle)
    lead, width = kernel.lead, kernel.width
    low_angle, low_column = Int32(first_angle) - lead, Int32(first_column) - lead
    inside = (low_angle >= 0) & (low_angle <= Int32(polar.n_angles) - width)
    inside &= (low_column >= 0) & (low_column <= Int32(polar.n_ranges) - width)
    base = dr.select(inside, UInt32(low_angle) * polar.n_ranges + UInt32(low_column), 0)
    along_range = kernel.taps(Float(column - first_column), dr)
    along_angle = kernel.taps(angle - first_angle, dr)
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
            re, im = dr.fma(outer, a, re), dr.fma(outer, b, im)
            index = index + polar.n_ranges
        out.append(dr.fma(re, phasor[0], dr.fma(-im, phasor[1], state[2 * layer])))
        out.append(dr.fma(re, phasor[1], dr.fma(im, phasor[0], state[2 * layer + 1])))
    return out
