"""The compiled steps of factorised backprojection: pulses to subimages, and subimages to wider ones.

All positions are in a section's frame, see :class:`sarmitsuba.signal.focusing.factorised.division.Section`; subimages
are complex64 in arrays [group, angle, range], one 8-byte word a sample, which is one load.
"""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.machine.backend import device_array, dr
from sarmitsuba.signal.focusing.backprojection_kernel import Weighting, times
from sarmitsuba.signal.focusing.factorised.division import SubimageLevel
from sarmitsuba.signal.focusing.factorised.polar_lanes import (
    ANGLES,
    FormLanes,
    GroupPulses,
    MergeLanes,
    PolarAxes,
    one_weight,
    quads,
)
from sarmitsuba.signal.focusing.factorised.sampling import TAPS, refinement_weights
from sarmitsuba.signal.gridding import GriddingKernel

if TYPE_CHECKING:
    Complex = tuple[dr.ArrayBase, dr.ArrayBase]


def pack_complex(types: ModuleType, value: Complex) -> dr.ArrayBase:
    """A complex number as one word."""
    re, im = (types.UInt64(dr.reinterpret_array(types.UInt32, part)) for part in value)
    return re | (im << 32)


def unpack_complex(types: ModuleType, word: dr.ArrayBase) -> Complex:
    """The complex number in a word."""
    return (
        dr.reinterpret_array(types.Float32, types.UInt32(word)),
        dr.reinterpret_array(types.Float32, types.UInt32(word >> 32)),
    )


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
    Float = types.Float32
    lanes = FormLanes.of(types, polar, n_lines, centers, first, n_ranges)

    def body(t: dr.ArrayBase, *old: dr.ArrayBase) -> tuple[dr.ArrayBase, ...]:
        acc = list(old)
        seen = pulses.seen_from(types, lanes.group, t, lanes.points, weighting, kernel)
        for k, (factor, taps, index) in enumerate(seen):
            for layer in range(n_layers):
                re, im = Float(0.0), Float(0.0)
                for i, tap in enumerate(taps):
                    a, b = unpack_complex(types, dr.gather(types.UInt64, pulses.profiles, index + i))
                    re, im = dr.fma(tap, a, re), dr.fma(tap, b, im)
                value = times((re, im), factor)
                j = 2 * (k * n_layers + layer)
                acc[j], acc[j + 1] = acc[j] + value[0], acc[j + 1] + value[1]
                index = index + pulses.n_plane
        return (t + 1, *acc)

    zeros = [dr.zeros(Float, lanes.size) for _ in range(2 * ANGLES * n_layers)]
    _, *sums = dr.while_loop(
        state=(types.UInt32(0), *zeros), cond=lambda t, *_: t < pulses.n_pulses, body=body, mode="symbolic"
    )
    _write(types, out, sums, lanes.place, polar.n_ranges, lanes.inside)


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
            pack_complex(types, (sums[j], sums[j + 1])),
            place + angle * n_ranges,
            active=inside,
            mode=dr.ReduceMode.NoConflicts,
        )


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
        w, g = one_weight(types, weighting, tuple(v * inverse for v in line), inverse, rows)
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
    UInt32 = types.UInt32
    (low, low_level), (_, high_level) = below, above
    n_ranges = len(images[0]) // (low_level.n_groups * low_level.n_angles)
    ratio, n_layers = low_level.ratio, len(images)
    lanes = MergeLanes.of(types, below, above, centers, n_ranges)
    weights = refinement_weights(upsampling, ratio)

    def body(c: dr.ArrayBase, *old: dr.ArrayBase) -> tuple[dr.ArrayBase, ...]:
        acc = list(old)
        phasors, index = lanes.child(types, c, shifts, turns_per_metre)
        for layer in range(n_layers):
            samples = [
                unpack_complex(types, dr.gather(types.UInt64, images[layer], index + k * low.n_ranges))
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

    zeros = [dr.zeros(types.Float32, lanes.size) for _ in range(2 * ratio * n_layers)]
    _, *sums = dr.while_loop(
        state=(UInt32(0), *zeros), cond=lambda c, *_: c < lanes.merged, body=body, mode="symbolic"
    )
    size = high_level.n_groups * high_level.n_angles * n_ranges
    out = [dr.zeros(types.UInt64, size) for _ in images]
    dr.make_opaque(out)
    _write(types, out, sums, lanes.place, lanes.stride, lanes.inside)
    dr.eval(out)
    return out


def _mix(weights: list[float], values: list[Complex]) -> Complex:
    re, im = weights[0] * values[0][0], weights[0] * values[0][1]
    for weight, value in zip(weights[1:], values[1:], strict=True):
        re, im = dr.fma(weight, value[0], re), dr.fma(weight, value[1], im)
    return re, im
