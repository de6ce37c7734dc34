"""Records what the trace kernel adds up: every contribution with its number of the ray, and where each ray hit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.backend import dr, mi
from sarmitsuba.trace.arrays import device_array

if TYPE_CHECKING:
    from sarmitsuba.trace.kernel import LaneArrays
    from sarmitsuba.trace.state import Contribution, Hit, RayState

F64 = NDArray[np.float64]
NO_FACE = 0xFFFFFFFF


class Sieve(Protocol):
    """What is recorded."""

    def passes(self, contribution: Contribution) -> mi.Bool:
        """Lanes whose contribution is."""


@dataclass(frozen=True, eq=False)
class Gate:
    """What is recorded of each pulse: slant ranges and range rates about given ones.

    Parameters
    ----------
    slant_range, range_rate : (n_pulses,) float64, m and m/s
    half_range, half_rate : (n_pulses,) float64, farthest from them, m and m/s
    """

    slant_range: F64
    range_rate: F64
    half_range: F64
    half_rate: F64

    def passes(self, contribution: Contribution) -> mi.Bool:
        """Lanes whose contribution lies within."""
        pulse, active = contribution.pulse, contribution.active
        middle_r, half_r, middle_s, half_s = (
            dr.gather(mi.Float64, device_array(mi.Float64, x), pulse, active)
            for x in (self.slant_range, self.half_range, self.range_rate, self.half_rate)
        )
        near = dr.abs(contribution.slant_range - middle_r) <= half_r
        return near & (dr.abs(contribution.range_rate - middle_s) <= half_s)


class Recording:
    """Writes contributions to a list as they come, and the hits of every lane to a table.

    An accumulator and a follower of :func:`sarmitsuba.trace.kernel.trace`. Contributions without power are left out.

    Parameters
    ----------
    n_lanes : rays of the launch
    max_depth : most bounces
    n_channels : amplitudes per contribution
    capacity : contributions that there is room for; more are counted only
    gate : what is recorded; None: everything
    """

    def __init__(
        self, n_lanes: int, max_depth: int, n_channels: int, capacity: int, gate: Sieve | None = None
    ) -> None:
        self.n_lanes, self.max_depth, self.n_channels = n_lanes, max_depth, n_channels
        self.capacity, self.gate = capacity, gate
        self.hit_point = dr.zeros(mi.Float64, 3 * max_depth * n_lanes)
        self.hit_face = dr.full(mi.UInt32, NO_FACE, max_depth * n_lanes)
        self.count = dr.zeros(mi.UInt32, 1)
        self.labels = dr.zeros(mi.UInt32, 4 * capacity)  # lane, kind, order and pulse
        self.lengths = dr.zeros(mi.Float64, 5 * capacity)  # slant range, range rate and point
        self.amplitudes = dr.zeros(mi.Float, 2 * n_channels * capacity)
        dr.eval(self.memory)

    @property
    def memory(self) -> list[mi.Float]:
        """Everything that a launch writes to."""
        return [self.hit_point, self.hit_face, self.count, self.labels, self.lengths, self.amplitudes]

    def begin(self) -> LaneArrays:
        """Number of this lane."""
        return (dr.arange(mi.UInt32, self.n_lanes),)

    def visit(self, state: LaneArrays, ray: RayState, hit: Hit) -> None:
        """Store a hit; see :class:`sarmitsuba.trace.kernel.Follower`."""
        row = (hit.order - 1) * dr.opaque(mi.UInt32, self.n_lanes) + state[0]
        dr.scatter(self.hit_face, hit.face, row, hit.active)
        for i, x in enumerate((hit.p.x, hit.p.y, hit.p.z)):
            dr.scatter(self.hit_point, x, 3 * row + i, hit.active)

    def add(self, state: LaneArrays, contribution: Contribution) -> LaneArrays:
        """Append; see :class:`sarmitsuba.trace.kernel.Accumulator`."""
        if dr.flag(dr.JitFlag.SymbolicScope):
            return self._append(state, contribution)
        # a slot outside of any loop could be used once only

        def waiting(once: mi.Bool, state: LaneArrays) -> mi.Bool:
            return once

        def append(once: mi.Bool, state: LaneArrays) -> tuple[mi.Bool, LaneArrays]:
            return mi.Bool(False), self._append(state, contribution)

        _, state = dr.while_loop((mi.Bool(True), state), waiting, append, label="append", mode="symbolic")
        return state

    def _append(self, state: LaneArrays, contribution: Contribution) -> LaneArrays:
        power = sum((dr.squared_norm(a) for a in contribution.amplitudes), mi.Float(0.0))
        kept = contribution.active & ~(power <= 0.0)  # also what is not a number
        if self.gate is not None:
            kept &= self.gate.passes(contribution)
        slot = dr.scatter_inc(self.count, mi.UInt32(0), kept)
        kept &= slot < dr.opaque(mi.UInt32, self.capacity)
        for i, label in enumerate((state[0], contribution.kind, contribution.order, contribution.pulse)):
            dr.scatter(self.labels, label, 4 * slot + i, kept)
        point = contribution.point
        for i, x in enumerate((contribution.slant_range, contribution.range_rate, point.x, point.y, point.z)):
            dr.scatter(self.lengths, x, 5 * slot + i, kept)
        for i, a in enumerate(contribution.amplitudes):
            dr.scatter(self.amplitudes, a.real, 2 * (self.n_channels * slot + i), kept)
            dr.scatter(self.amplitudes, a.imag, 2 * (self.n_channels * slot + i) + 1, kept)
        return state

    def found(self) -> int:
        """Contributions of the launch, recorded or not."""
        return int(self.count[0])

    def rows(self) -> Rows:
        """What was recorded; call after the launch. Sorted: threads append in any order."""
        n = min(self.found(), self.capacity)
        labels = self.labels.numpy().reshape(-1, 4)[:n]
        lengths = self.lengths.numpy().reshape(-1, 5)[:n]
        amplitudes = self.amplitudes.numpy().view(np.complex64).reshape(-1, self.n_channels)[:n]
        order = np.lexsort([*lengths.T, *labels.T[1:], labels.T[0]])
        return Rows(
            labels=labels[order],
            lengths=lengths[order],
            amplitudes=amplitudes[order],
            hit_point=self.hit_point.numpy().reshape(self.max_depth, self.n_lanes, 3),
            hit_face=self.hit_face.numpy().reshape(self.max_depth, self.n_lanes),
        )


@dataclass(frozen=True, eq=False)
class Rows:
    """A recording on the host.

    Parameters
    ----------
    labels : (n, 4) uint32 lane, kind, order and pulse of the launch
    lengths : (n, 5) float64 slant range (m), range rate (m/s) and phase centre (m)
    amplitudes : (n, n_channels) complex64 without the phase of the slant range
    hit_point : (max_depth, n_lanes, 3) float64, m
    hit_face : (max_depth, n_lanes) uint32 rows of the scene's tables; ``NO_FACE`` where there is no such hit
    """

    labels: NDArray[np.uint32]
    lengths: F64
    amplitudes: NDArray[np.complex64]
    hit_point: F64
    hit_face: NDArray[np.uint32]


__all__ = ["NO_FACE", "Gate", "Recording", "Rows"]
