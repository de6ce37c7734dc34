"""Polar grids of subimages, and the lanes of factorised backprojection's kernels: which samples, seen from where.

All positions are in a section's frame, see :class:`sarmitsuba.signal.focusing.factorised.division.Section`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.machine.backend import device_array, dr
from sarmitsuba.signal.focusing.backprojection_kernel import (
    Weighting,
    cis,
    dot,
    scale_complex,
    times,
)
from sarmitsuba.signal.focusing.factorised.division import Section, SubimageLevel
from sarmitsuba.signal.gridding import GriddingKernel

if TYPE_CHECKING:
    Complex = tuple[dr.ArrayBase, dr.ArrayBase]
    Vector = tuple[dr.ArrayBase, dr.ArrayBase, dr.ArrayBase]

# angles of a lane that forms subimages; they share the data read per pulse
ANGLES = 4
# neighbouring ranges computed before the next line of a subimage, so that the lines read stay in a core's cache
_BLOCK = 256


@dataclass(frozen=True)
class PolarAxes:
    """A level's polar grid, opaque.

    Parameters
    ----------
    start_range, range_step, drop : m, float64
    n_ranges : UInt32
    start_angle, angle_step : rad, float64
    n_angles : UInt32
    per_range, per_angle : one over the steps, float64
    """

    start_range: dr.ArrayBase
    range_step: dr.ArrayBase
    drop: dr.ArrayBase
    n_ranges: dr.ArrayBase
    start_angle: dr.ArrayBase
    angle_step: dr.ArrayBase
    n_angles: dr.ArrayBase
    per_range: dr.ArrayBase
    per_angle: dr.ArrayBase

    @classmethod
    def of(cls, types: ModuleType, section: Section, level: SubimageLevel) -> PolarAxes:
        """Grid of a level."""

        def real(value: float) -> dr.ArrayBase:
            return dr.opaque(types.Float64, value)

        return cls(
            start_range=real(section.start_range),
            range_step=real(section.range_step),
            drop=real(section.drop),
            n_ranges=dr.opaque(types.UInt32, section.n_ranges),
            start_angle=real(level.start_angle),
            angle_step=real(level.angle_step),
            n_angles=dr.opaque(types.UInt32, level.n_angles),
            per_range=real(1.0 / section.range_step),
            per_angle=real(1.0 / level.angle_step),
        )

    def position(self, types: ModuleType, column: dr.ArrayBase, angle: dr.ArrayBase) -> Vector:
        """Point of the image's plane, float64, m, at a range column and at an angle in samples (float64)."""
        distance = dr.fma(types.Float64(column), self.range_step, self.start_range)
        flat = dr.sqrt(dr.fma(distance, distance, -self.drop * self.drop))
        sin, cos = dr.sincos(dr.fma(angle, self.angle_step, self.start_angle))
        return flat * cos, flat * sin, -self.drop


@dataclass(frozen=True)
class Point:
    """Vector and distance from a group's centre to a point.

    Parameters
    ----------
    twice : minus twice the vector from the centre, float64, m
    distance : float64, m
    near : the same, float32
    square : of it, float32
    """

    twice: Vector
    distance: dr.ArrayBase
    near: dr.ArrayBase
    square: dr.ArrayBase

    @classmethod
    def of(cls, types: ModuleType, position: Vector, center: dr.ArrayBase) -> Point:
        """A point and a centre (three entries)."""
        x, y, z = (p - c for p, c in zip(position, center, strict=False))
        distance = dr.sqrt(dr.fma(x, x, dr.fma(y, y, z * z)))
        near = types.Float32(distance)
        return cls((-2.0 * x, -2.0 * y, -2.0 * z), distance, near, near * near)

    def farther(self, types: ModuleType, shift: dr.ArrayBase) -> tuple[dr.ArrayBase, dr.ArrayBase]:
        r"""Range from a place ``shift`` (x, y, z, square, m) off the centre minus that from it, and 1 / their sum.

        .. math:: D = \frac{|\delta|^2 - 2 q \cdot \delta}{R + \sqrt{R^2 + |\delta|^2 - 2 q \cdot \delta}}

        in float32, then one step of Newton's on :math:`D^2 + 2 R D` in float64: no float64 root, no float64 division.
        """
        x, y, z, square = shift
        gap = dr.fma(self.twice[0], x, dr.fma(self.twice[1], y, dr.fma(self.twice[2], z, square)))
        rough = types.Float32(gap)
        inverse = dr.rcp(self.near + dr.sqrt(self.square + rough))
        first = types.Float64(rough * inverse)
        left = dr.fma(-first, dr.fma(2.0, self.distance, first), gap)
        return dr.fma(left, types.Float64(inverse), first), inverse


@dataclass(frozen=True)
class GroupPulses:
    """Pulses of some groups, whole groups only.

    Parameters
    ----------
    n_pulses : per group, UInt32 opaque
    shifts : float64, per pulse x, y, z from the group's centre and their square
    starts : float64, per pulse the range of the first stored sample in profile samples
    axes : float32, ``AXES_STRIDE`` per pulse as in backprojection, in the section's frame
    profiles : complex64 as uint64, [layer, pulse, sample]
    n_stored, n_plane : UInt32 opaque: samples per pulse and per layer
    last : Int32 opaque: the largest sample from which all taps can be read
    per_metre, turns_per_metre, inverse_square : float64 opaque, see backprojection's ``Scales``
    """

    n_pulses: dr.ArrayBase
    shifts: dr.ArrayBase
    starts: dr.ArrayBase
    axes: dr.ArrayBase
    profiles: dr.ArrayBase
    n_stored: dr.ArrayBase
    n_plane: dr.ArrayBase
    last: dr.ArrayBase
    per_metre: dr.ArrayBase
    turns_per_metre: dr.ArrayBase
    inverse_square: dr.ArrayBase

    def seen_from(
        self,
        types: ModuleType,
        group: dr.ArrayBase,
        t: dr.ArrayBase,
        points: list[Point],
        weighting: Weighting,
        kernel: GriddingKernel,
    ) -> Iterator[tuple[Complex, list[dr.ArrayBase], dr.ArrayBase]]:
        """Of pulse ``t`` of a group at every point: factor of the echo, taps, and the first sample that they read."""
        Float, UInt32, Int32 = types.Float32, types.UInt32, types.Int32
        pulse = group * self.n_pulses + t
        shift = dr.gather(types.Array4f64, self.shifts, pulse)
        start = dr.gather(types.Float64, self.starts, pulse)
        axes = [
            dr.gather(types.Array4f, self.axes, 4 * pulse + i) for i in range(1 if weighting.uniform else 4)
        ]
        row = Int32(pulse * self.n_stored)
        for point in points:
            further, _ = point.farther(types, shift)
            distance = point.near + Float(further)
            position = dr.fma(point.distance + further, self.per_metre, -start)
            whole = dr.floor(position)
            sample = Int32(whole)
            held = (sample >= 0) & (sample < self.last)
            gain = axes[0][3] * distance * distance * Float(self.inverse_square)
            if not weighting.uniform:
                near = dr.rcp(distance)
                u = [Float(dr.fma(-0.5, v, -s)) * near for v, s in zip(point.twice, shift, strict=False)]
                w, g = one_weight(types, weighting, tuple(u), near, axes)
                gain = gain * w * g
            gain = dr.select(held, gain, 0.0)
            factor = scale_complex(gain, cis(types, further * self.turns_per_metre))
            taps = kernel.taps(Float(position - whole), dr)
            yield factor, taps, UInt32(row + dr.select(held, sample, 0))


@dataclass(frozen=True)
class FormLanes:
    """Lanes of :func:`form`: each has one range and ``ANGLES`` neighbouring angles of a group's subimage.

    Parameters
    ----------
    group : of the lane, UInt32
    points : its samples
    place : of its first sample in the subimages [group, angle, range], UInt32
    inside : whether it counts
    size : number of lanes
    """

    group: dr.ArrayBase
    points: list[Point]
    place: dr.ArrayBase
    inside: dr.ArrayBase
    size: int

    @classmethod
    def of(
        cls,
        types: ModuleType,
        polar: PolarAxes,
        n_lines: int,
        centers: dr.ArrayBase,
        first: dr.ArrayBase,
        n_ranges: int,
    ) -> FormLanes:
        """Lanes; parameters as for :func:`form`."""
        line, column, inside, n_lanes = lines_and_columns(types, n_lines, polar.n_ranges, n_ranges)
        chunks = polar.n_angles // ANGLES
        group = line // chunks
        angle = (line - group * chunks) * ANGLES
        center = dr.gather(types.Array4f64, centers, group)
        points = [
            Point.of(types, polar.position(types, column, types.Float64(angle + k)), center)
            for k in range(ANGLES)
        ]
        place = ((first + group) * polar.n_angles + angle) * polar.n_ranges + column
        return cls(group, points, place, inside, n_lanes)


def lines_and_columns(
    types: ModuleType, n_lines: int, last: dr.ArrayBase, n_ranges: int
) -> tuple[dr.ArrayBase, dr.ArrayBase, dr.ArrayBase, int]:
    """Line and range column of every lane, whether it counts, and the number of lanes.

    All lines of a block of columns come before the next block. Columns of the last block stop at ``n_ranges``, which
    ``last`` is as an opaque number; results of the lanes beyond do not count.
    """
    n_lanes = -(-n_ranges // _BLOCK) * n_lines * _BLOCK
    lane = dr.arange(types.UInt32, n_lanes)
    row, lines = lane // _BLOCK, dr.opaque(types.UInt32, n_lines)
    block = row // lines
    column = block * _BLOCK + (lane - row * _BLOCK)
    return row - block * lines, dr.minimum(column, last - 1), column < last, n_lanes


def one_weight(
    types: ModuleType,
    weighting: Weighting,
    u: tuple[dr.ArrayBase, ...],
    inverse: dr.ArrayBase,
    axes: list[dr.ArrayBase],
) -> tuple[dr.ArrayBase, dr.ArrayBase]:
    """Band's weight w and the antenna's amplitude g of one pulse, in the direction u at 1 / ``inverse`` metres."""
    azimuth, elevation, boresight, forward = axes
    w, g = types.Float32(1.0), types.Float32(1.0)
    if weighting.band is not None:
        sine = dot(u, forward)
        per_step = weighting.band.per_step(sine, inverse, elevation[3], boresight[3])
        offset = sine - forward[3]
        w = weighting.band.share(offset, per_step) * weighting.band.shape(types, offset)
    if weighting.beam is not None:
        amplitude = weighting.beam.two_way_amplitude(dot(u, azimuth), dot(u, elevation))
        g = dr.select(dot(u, boresight) > 0.0, amplitude, 0.0)
    return w, g


@dataclass(frozen=True)
class MergeLanes:
    """Lanes of :func:`merge`: each has one range and as many angles of a wider subimage as refine one interval.

    Parameters
    ----------
    low : grid of the narrower subimages
    ratio : angles of a lane
    merged : narrower groups per wider one, UInt32 opaque
    group, chunk, column : wider group, interval and range of the lane
    points : in the lane's middle, at its first and its last angle
    place : of its first sample in the wider subimages
    stride : from one angle to the next there
    inside : whether it counts
    size : number of lanes
    """

    low: PolarAxes
    ratio: int
    merged: dr.ArrayBase
    group: dr.ArrayBase
    chunk: dr.ArrayBase
    column: dr.ArrayBase
    points: list[Point]
    place: dr.ArrayBase
    stride: dr.ArrayBase
    inside: dr.ArrayBase
    size: int

    @classmethod
    def of(
        cls,
        types: ModuleType,
        below: tuple[PolarAxes, SubimageLevel],
        above: tuple[PolarAxes, SubimageLevel],
        centers: dr.ArrayBase,
        n_ranges: int,
    ) -> MergeLanes:
        """Lanes; parameters as for :func:`merge`."""
        (low, low_level), (high, high_level) = below, above
        ratio = low_level.ratio
        merged = dr.opaque(types.UInt32, low_level.n_groups // high_level.n_groups)
        n_lines = high_level.n_groups * (high_level.n_angles // ratio)
        line, column, inside, n_lanes = lines_and_columns(types, n_lines, high.n_ranges, n_ranges)
        chunks = high.n_angles // ratio
        group = line // chunks
        chunk = line - group * chunks
        center = dr.gather(types.Array4f64, centers, group)
        # the phase is a parabola in angle over the chunk
        half = 0.5 * (ratio - 1)
        points = [
            Point.of(
                types, high.position(types, column, dr.fma(types.Float64(chunk), float(ratio), at)), center
            )
            for at in (half, 0.0, 2.0 * half)
        ]
        place = (group * high.n_angles + chunk * ratio) * high.n_ranges + column
        return cls(low, ratio, merged, group, chunk, column, points, place, high.n_ranges, inside, n_lanes)

    def child(
        self, types: ModuleType, c: dr.ArrayBase, shifts: dr.ArrayBase, turns_per_metre: dr.ArrayBase
    ) -> tuple[list[Complex], dr.ArrayBase]:
        """Phasors of the lane's angles for its group's narrower group c, and the first sample that it reads there."""
        child = self.group * self.merged + c
        shift = dr.gather(types.Array4f64, shifts, child)
        middle, start, end = (point.farther(types, shift)[0] * turns_per_metre for point in self.points)
        half = 0.5 * (self.ratio - 1)
        slope = (end - start) * (0.5 / half)
        bend = types.Float32(end + start - 2.0 * middle) * (0.5 / half**2)
        index = (child * self.low.n_angles + self.chunk) * self.low.n_ranges + self.column
        return _parabola(types, middle, slope, bend, self.ratio), index


def _parabola(
    types: ModuleType, middle: dr.ArrayBase, slope: dr.ArrayBase, bend: dr.ArrayBase, ratio: int
) -> list[Complex]:
    """Phasors of ``ratio`` places about the middle, whose turns are a parabola."""
    center = cis(types, middle)
    step = cis(types, slope)
    half_step = cis(types, 0.5 * slope)
    change = cis(types, types.Float64(2.0 * bend))
    # places are odd halves: the two next to the middle, then outwards with ratios that change by a constant factor
    bow = cis(types, types.Float64(0.25 * bend))
    out: dict[int, Complex] = {}
    for sign in (1.0, -1.0):
        ratio_out = times((step[0], sign * step[1]), change)
        value = times(times(center, bow), (half_step[0], sign * half_step[1]))
        for m in range(ratio // 2):
            place = ratio // 2 + m if sign > 0 else ratio // 2 - 1 - m
            out[place] = value
            if m + 1 < ratio // 2:
                value = times(value, ratio_out)
                ratio_out = times(ratio_out, change)
    return [out[j] for j in range(ratio)]


def quads(types: ModuleType, vectors: F64, *, squares: bool) -> dr.ArrayBase:
    """Vectors (..., 3) as four float64 each, with their squares or zero."""
    last = np.sum(vectors**2, axis=-1) if squares else np.zeros(vectors.shape[:-1])
    return device_array(types.Float64, np.concatenate([vectors, last[..., None]], axis=-1))
