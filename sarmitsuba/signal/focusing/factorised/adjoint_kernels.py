"""Compiled adjoints of the steps of factorised backprojection: wider subimages to narrower ones, and to pulses.

Subimages and profiles to which is added are pairs of float64 arrays, real and imaginary part, one pair a layer.
"""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING

from sarmitsuba.machine.backend import dr
from sarmitsuba.signal.focusing.backprojection_kernel import Weighting
from sarmitsuba.signal.focusing.device_complex import scaled, times, weighted_sum
from sarmitsuba.signal.focusing.factorised.division import SubimageLevel
from sarmitsuba.signal.focusing.factorised.polar_lanes import (
    ANGLES,
    FormLanes,
    GroupPulses,
    MergeLanes,
    PolarAxes,
)
from sarmitsuba.signal.focusing.factorised.resampling import add
from sarmitsuba.signal.focusing.factorised.sampling import TAPS, refinement_weights
from sarmitsuba.signal.raw.gridding import GriddingKernel

if TYPE_CHECKING:
    Complex = tuple[dr.ArrayBase, dr.ArrayBase]


def _read(types: ModuleType, image: Complex, index: dr.ArrayBase, inside: dr.ArrayBase) -> Complex:
    """Sample of a subimage in single precision; zero in lanes that do not count."""
    re, im = (types.Float32(dr.gather(types.Float64, part, index, inside)) for part in image)
    return re, im


def adjoint_form(
    types: ModuleType,
    polar: PolarAxes,
    n_lines: int,
    centers: dr.ArrayBase,
    pulses: GroupPulses,
    kernel: GriddingKernel,
    weighting: Weighting,
    images: list[Complex],
    first: dr.ArrayBase,
    n_ranges: int,
    out: list[Complex],
) -> None:
    """Adjoint of :func:`sarmitsuba.signal.focusing.factorised.kernels.form`: add subimages to the profiles of a batch.

    Parameters
    ----------
    types, polar, n_lines, centers, pulses, kernel, weighting, first, n_ranges : as for ``form``
    images : subimages [group, angle, range]
    out : profiles [pulse, sample]
    """
    lanes = FormLanes.of(types, polar, n_lines, centers, first, n_ranges)
    values = [
        [_read(types, image, lanes.place + k * polar.n_ranges, lanes.inside) for image in images]
        for k in range(ANGLES)
    ]

    def body(t: dr.ArrayBase) -> tuple[dr.ArrayBase]:
        seen = pulses.seen_from(types, lanes.group, t, lanes.points, weighting, kernel)
        for layers, (factor, taps, index) in zip(values, seen, strict=True):
            for value, target in zip(layers, out, strict=True):
                turned = times((factor[0], -factor[1]), value)
                for i, tap in enumerate(taps):
                    add(types, target, scaled(tap, turned), index + i, lanes.inside)
        return (t + 1,)

    start = dr.zeros(types.UInt32, lanes.size)
    dr.while_loop(state=(start,), cond=lambda t: t < pulses.n_pulses, body=body, mode="symbolic")
    dr.eval(out)


def adjoint_merge(
    types: ModuleType,
    below: tuple[PolarAxes, SubimageLevel],
    above: tuple[PolarAxes, SubimageLevel],
    shifts: dr.ArrayBase,
    centers: dr.ArrayBase,
    turns_per_metre: dr.ArrayBase,
    upsampling: float,
    images: list[Complex],
) -> list[Complex]:
    """Adjoint of :func:`sarmitsuba.signal.focusing.factorised.kernels.merge`: narrower subimages from wider ones."""
    low, level = below
    n_ranges = len(images[0][0]) // (above[1].n_groups * above[1].n_angles)
    ratio = level.ratio
    lanes = MergeLanes.of(types, below, above, centers, n_ranges)
    weights = refinement_weights(upsampling, ratio)
    size = level.n_groups * level.n_angles * n_ranges
    out = [(dr.zeros(types.Float64, size), dr.zeros(types.Float64, size)) for _ in images]
    dr.make_opaque(out)
    values = [
        [_read(types, image, lanes.place + j * lanes.stride, lanes.inside) for j in range(ratio)]
        for image in images
    ]

    def body(c: dr.ArrayBase) -> tuple[dr.ArrayBase]:
        phasors, index = lanes.child(types, c, shifts, turns_per_metre)
        for angles, target in zip(values, out, strict=True):
            turned = [times((p[0], -p[1]), value) for p, value in zip(phasors, angles, strict=True)]
            for k in range(TAPS):
                # the second half of the angles has the weights of the first, mirrored
                taps = [weights[j][k] for j in range(ratio // 2)]
                taps += [weights[j][TAPS - 1 - k] for j in reversed(range(ratio // 2))]
                add(types, target, weighted_sum(taps, turned), index + k * low.n_ranges, lanes.inside)
        return (c + 1,)

    start = dr.zeros(types.UInt32, lanes.size)
    dr.while_loop(state=(start,), cond=lambda c: c < lanes.merged, body=body, mode="symbolic")
    dr.eval(out)
    return out
