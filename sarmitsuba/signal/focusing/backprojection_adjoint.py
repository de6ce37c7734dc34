"""Compiled inner loop of backprojection's adjoint: every pixel's value added to the profiles of all pulses."""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING

from sarmitsuba.machine.backend import dr
from sarmitsuba.signal.focusing.backprojection_kernel import (
    LanePulse,
    ProfileBatch,
    Weighting,
)
from sarmitsuba.signal.focusing.device_complex import scaled, times, weighted_sum
from sarmitsuba.signal.focusing.lane_sight import LanePixels, Scales, Sight
from sarmitsuba.signal.raw.gridding import GriddingKernel

if TYPE_CHECKING:
    Complex = tuple[dr.ArrayBase, dr.ArrayBase]


def distribute(
    types: ModuleType,
    values: list[list[Complex]],
    middle: tuple[dr.ArrayBase, dr.ArrayBase, dr.ArrayBase],
    line: LanePixels,
    pulses: ProfileBatch,
    scales: Scales,
    kernel: GriddingKernel,
    weighting: Weighting,
    out: tuple[dr.ArrayBase, dr.ArrayBase],
) -> None:
    """Add pixels to the profiles of a batch: the adjoint of :func:`.backprojection_kernel.accumulate`.

    Parameters
    ----------
    types : array types, see :func:`sarmitsuba.machine.backend.arrays`
    values : of every pixel of a lane, of every layer, real and imaginary part, float32 arrays of one entry per lane
    middle, line, pulses, scales, kernel, weighting : as for ``accumulate``; the profiles of ``pulses`` are not read
    out : real and imaginary part of the profiles [layer, pulse, sample], float64, to which is added
    """
    lanes = len(values[0][0][0])

    def body(t: dr.ArrayBase) -> tuple[dr.ArrayBase]:
        pulse = LanePulse.of(types, t, middle, line, pulses, scales, kernel, weighting)
        pixels = values
        if line.checked or not weighting.uniform:
            pixels = [
                [scaled(pulse.amplitude(i), value) for value in layers] for i, layers in enumerate(values)
            ]
        if line.direct:
            phasors = pulse.sight.phasors(types, scales, pulse.weight)
            at_nodes = [
                [times(_conjugate(phasors[place]), value) for value in pixels[i]]
                for i, place in enumerate(line.places)
            ]
        else:
            at_nodes = _at_nodes(types, pulse.sight, scales, pulse.weight, pixels)
        for i, (sample, taps, layers) in enumerate(zip(pulse.samples, pulse.taps, at_nodes, strict=True)):
            active = pulse.valid[i] if pulse.valid else True
            for value in layers:
                for k, tap in enumerate(taps):
                    for part, target in zip(value, out, strict=True):
                        dr.scatter_reduce(
                            dr.ReduceOp.Add, target, types.Float64(tap * part), sample + k, active
                        )
                sample = sample + pulses.n_plane
        return (t + 1,)

    start = dr.zeros(types.UInt32, lanes)
    dr.while_loop(state=(start,), cond=lambda t: t < pulses.n_pulses, body=body, mode="symbolic")
    dr.eval(*out)


def _conjugate(value: Complex) -> Complex:
    return value[0], -value[1]


def _at_nodes(
    types: ModuleType, sight: Sight, scales: Scales, weight: dr.ArrayBase, pixels: list[list[Complex]]
) -> list[list[Complex]]:
    """Values of the nodes of all layers: the adjoint of :func:`.backprojection_kernel.between_nodes`."""
    line = sight.line
    middle = sight.middle_phasor(types, scales, weight)
    factors = [times(middle, bend) for bend in sight.bends(types, scales)]
    powers = sight.powers(types, scales)
    at = {place: i for i, place in enumerate(line.places)}
    k = line.n_nodes
    mixes = [line.mix(m) for m in range(line.n_pixels // 2 + 1)]
    nodes: list[list[Complex]] = [[] for _ in range(k)]
    for layer in range(len(pixels[0])):
        even, odd = [], []  # of the pixels at places m and -m
        for m, power in enumerate(powers):
            ahead = times(_conjugate(power), pixels[at[m]][layer]) if m in at else None
            behind = times(power, pixels[at[-m]][layer]) if m else None
            if ahead is None or behind is None:
                one = ahead or behind
                assert one is not None
                sign = 1.0 if ahead else -1.0
                even.append(one)
                odd.append((sign * one[0], sign * one[1]))
            else:
                even.append((ahead[0] + behind[0], ahead[1] + behind[1]))
                odd.append((ahead[0] - behind[0], ahead[1] - behind[1]))
        for j in range(k):
            pair = min(j, k - 1 - j)
            value = weighted_sum([mix[0][pair] for mix in mixes], even)
            if 2 * j + 1 != k:
                sign = 1.0 if j < k - 1 - j else -1.0
                skew = weighted_sum([sign * mix[1][pair] for mix in mixes], odd)
                value = value[0] + skew[0], value[1] + skew[1]
            nodes[j].append(times(_conjugate(factors[j]), value))
    return nodes
