"""Compiled last step of factorised backprojection: interpolation of a section's subimage at the pixels."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING

from sarmitsuba.machine.backend import dr
from sarmitsuba.signal.focusing.backprojection_kernel import cis, scale_complex, times
from sarmitsuba.signal.focusing.factorised.kernels import pack_complex, unpack_complex
from sarmitsuba.signal.focusing.factorised.polar_lanes import PolarAxes
from sarmitsuba.signal.focusing.factorised.sampling import TAPS, row_polynomials
from sarmitsuba.signal.gridding import GriddingKernel

if TYPE_CHECKING:
    Complex = tuple[dr.ArrayBase, dr.ArrayBase]
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


def _row_places(
    types: ModuleType, polar: PolarAxes, pixels: Pixels, n_lanes: int, kernel: GriddingKernel
) -> tuple[dr.ArrayBase, list[dr.ArrayBase]]:
    """First sample of the subimage that a lane of :func:`interpolate_rows` reads, and its taps, ``n_ranges`` apart."""
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
    return UInt32(low) * polar.n_ranges + column, taps


def interpolate_rows(
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
    Float = types.Float32
    base, taps = _row_places(types, polar, pixels, n_lanes, kernel)
    out = []
    for image in images:
        re, im, index = Float(0.0), Float(0.0), base
        for tap in taps:
            v = unpack_complex(types, dr.gather(types.UInt64, image, index))
            re, im = dr.fma(tap, v[0], re), dr.fma(tap, v[1], im)
            index = index + polar.n_ranges
        out.append(pack_complex(types, (re, im)))
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


@dataclass(frozen=True)
class PixelReads:
    """Samples that each pixel reads of a subimage, or of one on rows.

    Parameters
    ----------
    base : first sample
    along_angle, along_range : taps, ``n_ranges`` apart and next to each other
    phasor : of the carrier; zero where the subimage does not contain the pixel
    """

    base: dr.ArrayBase
    along_angle: list[dr.ArrayBase]
    along_range: list[dr.ArrayBase]
    phasor: tuple[dr.ArrayBase, dr.ArrayBase]

    @classmethod
    def of(
        cls,
        types: ModuleType,
        polar: PolarAxes,
        pixels: Pixels,
        n_lanes: int,
        turns_per_metre: dr.ArrayBase,
        kernel: GriddingKernel,
        on_rows: float,
    ) -> PixelReads:
        """Parameters as for :func:`resample`."""
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
        phasor = scale_complex(dr.select(inside, Float(1.0), 0.0), cis(types, distance * turns_per_metre))
        return cls(base, along_angle, along_range, phasor)


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

    ``on_rows``: upsampling of the subimage where ``images`` are those of :func:`interpolate_rows` and range alone is
    interpolated, by least squares over the band; else 0.
    """
    Float = types.Float32
    reads = PixelReads.of(types, polar, pixels, n_lanes, turns_per_metre, kernel, on_rows)
    phasor = reads.phasor
    out = []
    for layer, image in enumerate(images):
        re, im = Float(0.0), Float(0.0)
        index = reads.base
        for outer in reads.along_angle:
            a, b = Float(0.0), Float(0.0)
            for i, tap in enumerate(reads.along_range):
                v = unpack_complex(types, dr.gather(types.UInt64, image, index + i))
                a, b = dr.fma(tap, v[0], a), dr.fma(tap, v[1], b)
            re, im = (a, b) if on_rows else (dr.fma(outer, a, re), dr.fma(outer, b, im))
            index = index + polar.n_ranges
        out.append(dr.fma(re, phasor[0], dr.fma(-im, phasor[1], state[2 * layer])))
        out.append(dr.fma(re, phasor[1], dr.fma(im, phasor[0], state[2 * layer + 1])))
    return out


def adjoint_resample(
    types: ModuleType,
    polar: PolarAxes,
    pixels: Pixels,
    n_lanes: int,
    turns_per_metre: dr.ArrayBase,
    kernel: GriddingKernel,
    values: list[Complex],
    out: list[Complex],
    on_rows: float,
) -> None:
    """Adjoint of :func:`resample`: add pixels (float32 pairs of each layer) to the subimage (float64 pairs)."""
    reads = PixelReads.of(types, polar, pixels, n_lanes, turns_per_metre, kernel, on_rows)
    back = reads.phasor[0], -reads.phasor[1]
    for value, target in zip(values, out, strict=True):
        turned = times(back, value)
        index = reads.base
        for outer in reads.along_angle:
            for i, tap in enumerate(reads.along_range):
                add(types, target, scale_complex(outer * tap, turned), index + i)
            index = index + polar.n_ranges
    dr.eval(out)


def adjoint_along_rows(
    types: ModuleType,
    polar: PolarAxes,
    pixels: Pixels,
    n_lanes: int,
    kernel: GriddingKernel,
    values: list[Complex],
    out: list[Complex],
) -> None:
    """Adjoint of :func:`interpolate_rows`: add samples on rows (float64 pairs of each layer) to the subimage."""
    base, taps = _row_places(types, polar, pixels, n_lanes, kernel)
    for value, target in zip(values, out, strict=True):
        index = base
        for tap in taps:
            add(types, target, scale_complex(types.Float64(tap), value), index)
            index = index + polar.n_ranges
    dr.eval(out)


def add(
    types: ModuleType,
    target: Complex,
    value: Complex,
    index: dr.ArrayBase,
    active: dr.ArrayBase | bool = True,
) -> None:
    """Add complex numbers to float64 pairs at places that several lanes may share."""
    for memory, part in zip(target, value, strict=True):
        dr.scatter_reduce(dr.ReduceOp.Add, memory, types.Float64(part), index, active)
