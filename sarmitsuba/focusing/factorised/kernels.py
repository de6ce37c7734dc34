"""The compiled steps of factorised backprojection: pulses to subimages, and subimages to wider ones.

All positions are in a section's frame, see :class:`sarmitsuba.focusing.factorised.division.Section`; subimages are
complex64 in arrays [group, angle, range], one 8-byte word a sample, which is one load.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.arrays import F64
from sarmitsuba.backend import device_array, dr
from sarmitsuba.echo.gridding import GriddingKernel
from sarmitsuba.focusing.backprojection_kernel import (
    AXES_STRIDE,
    Weighting,
    dot,
)
from sarmitsuba.focusing.device_complex import cis, scaled, times
from sarmitsuba.focusing.factorised.division import Section, SubimageLevel
from sarmitsuba.focusing.factorised.sampling import TAPS, refinement_weights

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


def packed(types: ModuleType, value: Complex) -> dr.ArrayBase:
    """A complex number as one word."""
    re, im = (types.UInt64(dr.reinterpret_array(types.UInt32, part)) for part in value)
    return re | (im << 32)


def unpacked(types: ModuleType, word: dr.ArrayBase) -> Complex:
    """The complex number in a word."""
    return (
        dr.reinterpret_array(types.Float32, types.UInt32(word)),
        dr.reinterpret_array(types.Float32, types.UInt32(word >> 32)),
    )


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


def form(
    types: ModuleType,
    polar: PolarAxes,
    n_lines: int,
    centers: dr.ArrayBase,
    pulses: GroupPulses,
    kernel: GriddingKernel,
    n_layers: int,
    weighting: Weighting,
    out: list[dr.ArrayBase],
    first: dr.ArrayBase,
    n_ranges: int,
) -> None:
    r"""Subimages of groups of pulses, each without the carrier of its group's centre.

    .. math:: b_g(p) = \sum_{t \in g} w_t g_t \frac{R_t^2}{R_0^2} s_t(R_t) e^{+j 4 \pi f_c (R_t - R_g) / c}

    Parameters
    ----------
    types : array types
    polar : grid of the subimages
    n_lines : groups x (angles / ``ANGLES``)
    centers : float64, four per group: x, y, z, 0
    pulses : see there
    kernel : interpolation of the profiles
    n_layers : layers
    weighting : antenna and aperture
    out : one array of words per layer, [group, angle, range]
    first : group in ``out`` of the first one, UInt32 opaque
    n_ranges : of the subimages
    """
    Float, Float64, UInt32, Int32 = types.Float32, types.Float64, types.UInt32, types.Int32
    line, column, inside, n_lanes = _lines_and_columns(types, n_lines, polar.n_ranges, n_ranges)
    chunks = polar.n_angles // ANGLES
    group = line // chunks
    angle = (line - group * chunks) * ANGLES
    center = dr.gather(types.Array4f64, centers, group)
    points = [
        Point.of(types, polar.position(types, column, Float64(angle + k)), center) for k in range(ANGLES)
    ]

    def body(t: dr.ArrayBase, *old: dr.ArrayBase) -> tuple[dr.ArrayBase, ...]:
        acc = list(old)
        pulse = group * pulses.n_pulses + t
        shift = dr.gather(types.Array4f64, pulses.shifts, pulse)
        start = dr.gather(Float64, pulses.starts, pulse)
        axes = [
            dr.gather(types.Array4f, pulses.axes, 4 * pulse + i) for i in range(1 if weighting.uniform else 4)
        ]
        row = Int32(pulse * pulses.n_stored)
        for k, point in enumerate(points):
            further, _ = point.farther(types, shift)
            distance = point.near + Float(further)
            position = dr.fma(point.distance + further, pulses.per_metre, -start)
            whole = dr.floor(position)
            sample = Int32(whole)
            held = (sample >= 0) & (sample < pulses.last)
            gain = axes[0][3] * distance * distance * Float(pulses.inverse_square)
            if not weighting.uniform:
                near = dr.rcp(distance)
                u = [Float(dr.fma(-0.5, v, -s)) * near for v, s in zip(point.twice, shift, strict=False)]
                w, g = _weights(types, weighting, tuple(u), near, axes)
                gain = gain * w * g
            gain = dr.select(held, gain, 0.0)
            factor = scaled(gain, cis(types, further * pulses.turns_per_metre))
            taps = kernel.taps(Float(position - whole), dr)
            index = UInt32(row + dr.select(held, sample, 0))
            for layer in range(n_layers):
                re, im = Float(0.0), Float(0.0)
                for i, tap in enumerate(taps):
                    a, b = unpacked(types, dr.gather(types.UInt64, pulses.profiles, index + i))
                    re, im = dr.fma(tap, a, re), dr.fma(tap, b, im)
                value = times((re, im), factor)
                j = 2 * (k * n_layers + layer)
                acc[j], acc[j + 1] = acc[j] + value[0], acc[j + 1] + value[1]
                index = index + pulses.n_plane
        return (t + 1, *acc)

    zeros = [dr.zeros(Float, n_lanes) for _ in range(2 * ANGLES * n_layers)]
    _, *sums = dr.while_loop(
        state=(UInt32(0), *zeros), cond=lambda t, *_: t < pulses.n_pulses, body=body, mode="symbolic"
    )
    place = ((first + group) * polar.n_angles + angle) * polar.n_ranges + column
    _write(types, out, sums, place, polar.n_ranges, inside)


def _lines_and_columns(
    types: ModuleType, n_lines: int, last: dr.ArrayBase, n_ranges: int
) -> tuple[dr.ArrayBase, dr.ArrayBase, dr.ArrayBase, int]:
    """Line and range column of every lane, whether it counts, and the number of lanes.

    All lines of a block of columns come before the next block. Columns of the last block stop at ``n_ranges``, which
    ``last`` is as an opaque number; what the lanes beyond compute does not count.
    """
    n_lanes = -(-n_ranges // _BLOCK) * n_lines * _BLOCK
    lane = dr.arange(types.UInt32, n_lanes)
    row, lines = lane // _BLOCK, dr.opaque(types.UInt32, n_lines)
    block = row // lines
    column = block * _BLOCK + (lane - row * _BLOCK)
    return row - block * lines, dr.minimum(column, last - 1), column < last, n_lanes


def _write(
    types: ModuleType,
    out: list[dr.ArrayBase],
    sums: list[dr.ArrayBase],
    place: dr.ArrayBase,
    n_ranges: int | dr.ArrayBase,
    inside: dr.ArrayBase,
) -> None:
    """Write a lane's sums, real and imaginary parts by angle and layer, to its angles, ``n_ranges`` places apart."""
    for j in range(0, len(sums), 2):
        angle, layer = divmod(j // 2, len(out))
        dr.scatter(
            out[layer],
            packed(types, (sums[j], sums[j + 1])),
            place + angle * n_ranges,
            active=inside,
            mode=dr.ReduceMode.NoConflicts,
        )


def _weights(
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


def sum_weights(
    types: ModuleType,
    points: F64,
    positions: F64,
    axes: dr.ArrayBase,
    weighting: Weighting,
) -> F64:
    r"""Summed weight of all pulses at points (n, 3), :math:`\sum_t w_t g_t^2`, (n,).

    Parameters
    ----------
    types : array types
    points, positions : (n, 3) of the points and (n_pulses, 3) of the antenna, m, in one frame
    axes : float32, ``AXES_STRIDE`` per pulse, in that frame
    weighting : antenna and aperture
    """
    Float, UInt32 = types.Float32, types.UInt32
    place = [device_array(types.Float64, points[:, axis]) for axis in range(3)]
    antenna = quads(types, positions, squares=False)
    n_pulses = dr.opaque(UInt32, len(positions))

    def body(t: dr.ArrayBase, total: dr.ArrayBase) -> tuple[dr.ArrayBase, ...]:
        center = dr.gather(types.Array4f64, antenna, t)
        line = [Float(p - c) for p, c in zip(place, center, strict=False)]
        inverse = dr.rsqrt(dr.fma(line[0], line[0], dr.fma(line[1], line[1], line[2] * line[2])))
        rows = [dr.gather(types.Array4f, axes, 4 * t + i) for i in range(4)]
        w, g = _weights(types, weighting, tuple(v * inverse for v in line), inverse, rows)
        return t + 1, dr.fma(rows[0][3] * w, g * g, total)

    _, total = dr.while_loop(
        state=(UInt32(0), dr.zeros(Float, len(points))),
        cond=lambda t, _: t < n_pulses,
        body=body,
        mode="symbolic",
    )
    return np.asarray(total.numpy(), dtype=np.float64)


def merge(
    types: ModuleType,
    below: tuple[PolarAxes, SubimageLevel],
    above: tuple[PolarAxes, SubimageLevel],
    shifts: dr.ArrayBase,
    centers: dr.ArrayBase,
    turns_per_metre: dr.ArrayBase,
    upsampling: float,
    images: list[dr.ArrayBase],
) -> list[dr.ArrayBase]:
    r"""Wider subimages as sums of narrower ones, refined in angle, from their own carriers to the common one.

    .. math:: b_G(p) = \sum_{g \in G} e^{j 4 \pi f_c (R_g - R_G) / c} \sum_k w_k(p) b_g(p_k)

    Parameters
    ----------
    types : array types
    below, above : grids of the narrower and the wider subimages
    shifts : float64, per narrower group x, y, z from the wider one's centre, and their square
    centers : float64, four per wider group
    turns_per_metre : float64 opaque, 2 fc / c
    upsampling : that the weights are made for
    images : per layer, words [group, angle, range]
    """
    Float, Float64, UInt32 = types.Float32, types.Float64, types.UInt32
    (low, low_level), (high, high_level) = below, above
    n_ranges = len(images[0]) // (low_level.n_groups * low_level.n_angles)
    ratio, n_layers = low_level.ratio, len(images)
    merged = dr.opaque(UInt32, low_level.n_groups // high_level.n_groups)
    n_lines = high_level.n_groups * (high_level.n_angles // ratio)
    line, column, inside, n_lanes = _lines_and_columns(types, n_lines, high.n_ranges, n_ranges)
    chunks = high.n_angles // ratio
    group = line // chunks
    chunk = line - group * chunks
    center = dr.gather(types.Array4f64, centers, group)
    # the phase is a parabola in angle over the chunk
    half = 0.5 * (ratio - 1)
    points = [
        Point.of(types, high.position(types, column, dr.fma(Float64(chunk), float(ratio), place)), center)
        for place in (half, 0.0, 2.0 * half)
    ]
    weights = refinement_weights(upsampling, ratio)

    def body(c: dr.ArrayBase, *old: dr.ArrayBase) -> tuple[dr.ArrayBase, ...]:
        acc = list(old)
        child = group * merged + c
        shift = dr.gather(types.Array4f64, shifts, child)
        middle, start, end = (point.farther(types, shift)[0] * turns_per_metre for point in points)
        slope = (end - start) * (0.5 / half)
        bend = Float(end + start - 2.0 * middle) * (0.5 / half**2)
        phasors = _parabola(types, middle, slope, bend, ratio)
        index = (child * low.n_angles + chunk) * low.n_ranges + column
        for layer in range(n_layers):
            samples = [
                unpacked(types, dr.gather(types.UInt64, images[layer], index + k * low.n_ranges))
                for k in range(TAPS)
            ]
            pairs = [(samples[k], samples[TAPS - 1 - k]) for k in range(TAPS // 2)]
            sums = [(a[0] + b[0], a[1] + b[1]) for a, b in pairs]
            differences = [(a[0] - b[0], a[1] - b[1]) for a, b in pairs]
            for j in range(ratio // 2):
                even = [0.5 * (weights[j][k] + weights[j][TAPS - 1 - k]) for k in range(TAPS // 2)]
                odd = [0.5 * (weights[j][k] - weights[j][TAPS - 1 - k]) for k in range(TAPS // 2)]
                e, o = _mix(even, sums), _mix(odd, differences)
                for place, value in (
                    (j, (e[0] + o[0], e[1] + o[1])),
                    (ratio - 1 - j, (e[0] - o[0], e[1] - o[1])),
                ):
                    i = 2 * (place * n_layers + layer)
                    p = phasors[place]
                    acc[i] = dr.fma(value[0], p[0], dr.fma(-value[1], p[1], acc[i]))
                    acc[i + 1] = dr.fma(value[0], p[1], dr.fma(value[1], p[0], acc[i + 1]))
        return (c + 1, *acc)

    zeros = [dr.zeros(Float, n_lanes) for _ in range(2 * ratio * n_layers)]
    _, *sums = dr.while_loop(
        state=(UInt32(0), *zeros), cond=lambda c, *_: c < merged, body=body, mode="symbolic"
    )
    size = high_level.n_groups * high_level.n_angles * n_ranges
    out = [dr.zeros(types.UInt64, size) for _ in images]
    dr.make_opaque(out)
    place = (group * high.n_angles + chunk * ratio) * high.n_ranges + column
    _write(types, out, sums, place, high.n_ranges, inside)
    dr.eval(out)
    return out


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


def _mix(weights: list[float], values: list[Complex]) -> Complex:
    re, im = weights[0] * values[0][0], weights[0] * values[0][1]
    for weight, value in zip(weights[1:], values[1:], strict=True):
        re, im = dr.fma(weight, value[0], re), dr.fma(weight, value[1], im)
    return re, im


def quads(types: ModuleType, vectors: F64, *, squares: bool) -> dr.ArrayBase:
    """Vectors (..., 3) as four float64 each, with their squares or zero."""
    last = np.sum(vectors**2, axis=-1) if squares else np.zeros(vectors.shape[:-1])
    return device_array(types.Float64, np.concatenate([vectors, last[..., None]], axis=-1))


__all__ = [
    "ANGLES",
    "AXES_STRIDE",
    "GroupPulses",
    "PolarAxes",
    "form",
    "merge",
    "packed",
    "quads",
    "sum_weights",
    "unpacked",
]
