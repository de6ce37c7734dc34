"""Accumulators that pass every echo through the stages of the active effects before it is summed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sarmitsuba.tracing.kernel.kernel import Accumulator, Follower
from sarmitsuba.tracing.kernel.stage import apply_at_echo, changes_echoes, own_stages

if TYPE_CHECKING:
    from sarmitsuba.machine.backend import mi
    from sarmitsuba.tracing.kernel.kernel import LaneArrays
    from sarmitsuba.tracing.kernel.state import Contribution, Hit, Kernel, RayState


def through_stages(kernel: Kernel, accumulator: Accumulator) -> Accumulator:
    """Accumulator that applies the stages to echoes, and checks those of extensions; itself where none does."""
    if not (changes_echoes(kernel.flags) or own_stages(kernel.flags)):
        return accumulator
    if isinstance(accumulator, Follower):
        return _StagedFollower(kernel, accumulator, accumulator)
    return _Staged(kernel, accumulator)


class _Staged:
    """Accumulator with the stages applied first; see :class:`sarmitsuba.tracing.kernel.kernel.Accumulator`."""

    def __init__(self, kernel: Kernel, accumulator: Accumulator) -> None:
        self.kernel, self.accumulator = kernel, accumulator

    def begin(self) -> LaneArrays:
        return self.accumulator.begin()

    def add(self, state: LaneArrays, contribution: Contribution) -> LaneArrays:
        flags, wavenumber = self.kernel.flags, self.kernel.constants.wavenumber
        return self.accumulator.add(state, apply_at_echo(flags, wavenumber, contribution))


class _StagedFollower(_Staged):
    """The same for an accumulator that also records every ray.

    See :class:`sarmitsuba.tracing.kernel.kernel.Follower`.
    """

    def __init__(self, kernel: Kernel, accumulator: Accumulator, follower: Follower) -> None:
        super().__init__(kernel, accumulator)
        self.follower = follower

    def visit(self, state: LaneArrays, ray: RayState, hit: Hit) -> tuple[LaneArrays, mi.UInt32 | None]:
        return self.follower.visit(state, ray, hit)
