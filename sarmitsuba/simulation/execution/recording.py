"""Recording of the trace kernel's individual contributions, each with its chain of hits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F64, I64, U32
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.kernel.device_arrays import device_array
from sarmitsuba.tracing.kernel.state import NO_HIT

if TYPE_CHECKING:
    from sarmitsuba.tracing.kernel.kernel import LaneArrays
    from sarmitsuba.tracing.kernel.state import Contribution, Hit, RayState


class Sieve(Protocol):
    """Condition for contributions to be recorded."""

    def passes(self, contribution: Contribution) -> mi.Bool:
        """Lanes whose contribution is recorded."""


@dataclass(frozen=True, eq=False)
class Gate:
    """Interval of slant range and range rate, for each pulse, in which contributions are recorded.

    Parameters
    ----------
    slant_range, range_rate : (n_pulses,) float64, m and m/s
    half_range, half_rate : (n_pulses,) float64, half widths of the interval, m and m/s
    """

    slant_range: F64
    range_rate: F64
    half_range: F64
    half_rate: F64

    def passes(self, contribution: Contribution) -> mi.Bool:
        """Lanes whose contribution lies within the gate."""
        pulse, active = contribution.pulse, contribution.active
        middle_r, half_r, middle_s, half_s = (
            dr.gather(mi.Float64, device_array(mi.Float64, x), pulse, active)
            for x in (self.slant_range, self.half_range, self.range_rate, self.half_rate)
        )
        near = dr.abs(contribution.slant_range - middle_r) <= half_r
        return near & (dr.abs(contribution.range_rate - middle_s) <= half_s)


class Recording:
    """Lists of contributions and hits of a launch; each hit refers to the previous one of its path.

    An accumulator and a follower of :func:`sarmitsuba.tracing.kernel.kernel.trace`. Contributions without power are
    left out.

    Parameters
    ----------
    n_lanes : rays of the launch
    n_channels : amplitudes per contribution
    room : capacity for contributions and hits; further ones are only counted
    gate : condition for contributions; None: all
    """

    def __init__(
        self, n_lanes: int, n_channels: int, room: tuple[int, int], gate: Sieve | None = None
    ) -> None:
        self.n_lanes, self.n_channels = n_lanes, n_channels
        self.room, self.gate = room, gate
        capacity, hits = room
        self.hit_point = dr.zeros(mi.Float64, max(3 * hits, 1))
        self.hit_labels = dr.zeros(mi.UInt32, max(2 * hits, 1))  # hit before, and face
        self.hit_count, self.count = dr.zeros(mi.UInt32, 1), dr.zeros(mi.UInt32, 1)
        self.labels = dr.zeros(mi.UInt32, 5 * capacity)  # lane, kind, order, pulse and last hit
        self.lengths = dr.zeros(mi.Float64, 5 * capacity)  # slant range, range rate and point
        self.amplitudes = dr.zeros(mi.Float, 2 * n_channels * capacity)
        dr.eval(self.memory)

    @property
    def memory(self) -> list[mi.Float]:
        """Arrays to which a launch writes."""
        hits = [self.hit_point, self.hit_labels, self.hit_count]
        return [*hits, self.count, self.labels, self.lengths, self.amplitudes]

    def begin(self) -> LaneArrays:
        """Number of the lane and of its current hit."""
        return (dr.arange(mi.UInt32, self.n_lanes), mi.UInt32(NO_HIT))

    def visit(self, state: LaneArrays, ray: RayState, hit: Hit) -> tuple[LaneArrays, mi.UInt32 | None]:
        """Append a hit, with a reference to the previous one.

        See :class:`sarmitsuba.tracing.kernel.kernel.Follower`.
        """
        assert ray.trail is not None
        slot = dr.scatter_inc(self.hit_count, mi.UInt32(0), hit.active)
        kept = hit.active & (slot < dr.opaque(mi.UInt32, self.room[1]))
        for i, label in enumerate((ray.trail, hit.face)):
            dr.scatter(self.hit_labels, label, 2 * slot + i, kept)
        for i, x in enumerate((hit.p.x, hit.p.y, hit.p.z)):
            dr.scatter(self.hit_point, x, 3 * slot + i, kept)
        trail = dr.select(kept, slot, NO_HIT)
        return (state[0], trail), trail

    def add(self, state: LaneArrays, contribution: Contribution) -> LaneArrays:
        """Append a contribution; see :class:`sarmitsuba.tracing.kernel.kernel.Accumulator`."""
        if dr.flag(dr.JitFlag.SymbolicScope):
            return self._append(state, contribution)
        # a slot outside of any loop could be used only once

        def waiting(once: mi.Bool, state: LaneArrays) -> mi.Bool:
            return once

        def append(once: mi.Bool, state: LaneArrays) -> tuple[mi.Bool, LaneArrays]:
            return mi.Bool(False), self._append(state, contribution)

        _, state = dr.while_loop((mi.Bool(True), state), waiting, append, label="append", mode="symbolic")
        return state

    def _append(self, state: LaneArrays, contribution: Contribution) -> LaneArrays:
        # a sum, as squares of amplitudes below 1e-19 are zero in float32
        size = sum((dr.abs(a.real) + dr.abs(a.imag) for a in contribution.amplitudes), mi.Float(0.0))
        kept = contribution.active & ~(size <= 0.0)  # also NaN
        if self.gate is not None:
            kept &= self.gate.passes(contribution)
        slot = dr.scatter_inc(self.count, mi.UInt32(0), kept)
        kept &= slot < dr.opaque(mi.UInt32, self.room[0])
        labels = (state[0], contribution.kind, contribution.order, contribution.pulse, state[1])
        for i, label in enumerate(labels):
            dr.scatter(self.labels, label, 5 * slot + i, kept)
        point = contribution.point
        for i, x in enumerate((contribution.slant_range, contribution.range_rate, point.x, point.y, point.z)):
            dr.scatter(self.lengths, x, 5 * slot + i, kept)
        for i, a in enumerate(contribution.amplitudes):
            dr.scatter(self.amplitudes, a.real, 2 * (self.n_channels * slot + i), kept)
            dr.scatter(self.amplitudes, a.imag, 2 * (self.n_channels * slot + i) + 1, kept)
        return state

    def found(self) -> tuple[int, int]:
        """Number of contributions and hits of the launch, recorded or not."""
        return int(self.count[0]), int(self.hit_count[0])

    @property
    def whole(self) -> bool:
        """Whether the capacity was sufficient; call after the launch."""
        return all(found <= room for found, room in zip(self.found(), self.room, strict=True))

    def rows(self) -> Rows:
        """Recorded rows, sorted (threads append in any order); call after the launch."""
        n, hits = (min(found, room) for found, room in zip(self.found(), self.room, strict=True))
        labels = self.labels.numpy().reshape(-1, 5)[:n]
        lengths = self.lengths.numpy().reshape(-1, 5)[:n]
        amplitudes = self.amplitudes.numpy().view(np.complex64).reshape(-1, self.n_channels)[:n]
        order = np.lexsort([*lengths.T, *labels.T[1:4], labels.T[0]])
        return Rows(
            labels=labels[order],
            lengths=lengths[order],
            amplitudes=amplitudes[order],
            hit_point=self.hit_point.numpy()[: 3 * hits].reshape(-1, 3),
            hit_labels=self.hit_labels.numpy()[: 2 * hits].reshape(-1, 2),
        )


@dataclass(frozen=True, eq=False)
class Rows:
    """Recording as NumPy arrays.

    Parameters
    ----------
    labels : (n, 5) uint32 lane, kind, order and pulse of the launch, and the row of its last hit, or ``NO_HIT``
    lengths : (n, 5) float64 slant range (m), range rate (m/s) and phase centre (m)
    amplitudes : (n, n_channels) complex64 without the phase of the slant range
    hit_point : (n_hits, 3) float64, m
    hit_labels : (n_hits, 2) uint32 row of the path's previous hit, or ``NO_HIT``, and row of the scene's tables
    """

    labels: U32
    lengths: F64
    amplitudes: C64
    hit_point: F64
    hit_labels: U32

    def chains(self, hits: NDArray[np.intp]) -> tuple[F64, I64]:
        """Hits of every path, first to last: points (n, most, 3) in m, and rows (n, most) of the scene's tables.

        NaN and -1 beyond the last hit of a path.

        Parameters
        ----------
        hits : (n,) number of hits of each path
        """
        n, most = len(self.labels), int(hits.max(initial=1))
        points, faces = np.full((n, most, 3), np.nan), np.full((n, most), -1, dtype=np.int64)
        last = self.labels[:, 4].astype(np.int64)
        for bounce in range(most - 1, -1, -1):
            there = np.flatnonzero((hits > bounce) & (last != NO_HIT))
            at = last[there]
            points[there, bounce], faces[there, bounce] = self.hit_point[at], self.hit_labels[at, 1]
            last[there] = self.hit_labels[at, 0]
        return points, faces
