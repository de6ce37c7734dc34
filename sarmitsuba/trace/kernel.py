"""The bounce loop: launch, intersect, close, add, reflect. One recorded kernel, one launch per batch.

Each ray stands for a tube of solid angle. At every hit the tube closes to the antenna by physical optics, and the
persistent diffuse scatterers it falls on close as well. A path behind mirrors is measured from the virtual antenna,
mirrored through its chain ("unfolded"), which is carried in float64 and mirrored exactly in each facet's plane:
lengths depend on where a ray hits, never on the rounding of how it got there.

What this does not do: what no ray of a lattice finds (wires, volumes, edges of metal, pairs of diffuse scatterers),
which :mod:`sarmitsuba.trace.source` launches by itself, and diffraction beyond the edges of metal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from sarmitsuba.backend import dr, mi
from sarmitsuba.trace.closing import close_coherent, receiver, selected
from sarmitsuba.trace.diffuse_return import DiffuseReturns, Slot, close_diffuse
from sarmitsuba.trace.propagation import (
    footprint,
    intersect,
    launch,
    mirror,
    past_foci,
    reflect,
    through_passages,
)
from sarmitsuba.trace.slab_passage import Waiting, branched
from sarmitsuba.trace.stage import arrived as by_stages
from sarmitsuba.trace.stage import launched
from sarmitsuba.trace.state import (
    NO_HIT,
    Contribution,
    Hit,
    Kernel,
    KernelSettings,
    Lane,
    RayState,
)

if TYPE_CHECKING:
    from sarmitsuba.radar.antenna import Antenna

    LaneArrays = tuple[mi.UInt32, ...]  # what an accumulator keeps per lane: Dr.Jit arrays, often none


class Accumulator(Protocol):
    """Takes the contributions of one hit; owns the memory they go to."""

    def begin(self) -> LaneArrays:
        """Loop state that the accumulator needs (arrays of the launch's width), often none."""

    def add(self, state: LaneArrays, contribution: Contribution) -> LaneArrays:
        """Add one contribution per lane; returns the new loop state.

        The accumulator puts orders above its highest into that one.
        """


@runtime_checkable
class Follower(Protocol):
    """An accumulator that also follows every ray from hit to hit."""

    def visit(self, state: LaneArrays, ray: RayState, hit: Hit) -> tuple[LaneArrays, mi.UInt32 | None]:
        """Take note of a hit of a ray, with its fields as they arrive, before the hit's contributions are added.

        Returns
        -------
        state, trail : the new loop state, and the number that the ray carries on from the hit (``RayState.trail``)
        """


@dataclass(frozen=True, eq=False)
class TraceCounts:
    """Dr.Jit arrays of the launch's width, to be reduced by the caller: hits and contributions of each lane."""

    hits: mi.UInt32
    contributions: mi.UInt32


def trace(kernel: Kernel, antenna: Antenna, accumulator: Accumulator) -> tuple[TraceCounts, LaneArrays]:
    """Trace every ray of the kernel's grid from every pulse and hand all contributions to the accumulator.

    Nothing is evaluated here: the caller's ``dr.eval`` launches the one kernel that this records.

    Returns
    -------
    counts : per-lane hits and contributions
    state : the accumulator's loop state after the last bounce
    """
    lane, ray = launch(kernel, antenna)
    ray = launched(kernel, lane, ray)
    if isinstance(accumulator, Follower):
        ray = replace(ray, trail=mi.UInt32(NO_HIT))

    if kernel.transmits:
        return _through_slabs(kernel, lane, ray, accumulator)

    def alive(ray: RayState, added: LaneArrays) -> mi.Bool:
        return ray.active

    def bounce(ray: RayState, added: LaneArrays) -> tuple[RayState, LaneArrays]:
        _, _, ray, added = _bounce(kernel, lane, ray, accumulator, added)
        return ray, added

    ray, added = dr.while_loop(
        (ray, accumulator.begin()), alive, bounce, labels=("ray", "added"), label="bounces", mode="symbolic"
    )
    return TraceCounts(ray.hits, ray.contributions), added


def _through_slabs(
    kernel: Kernel, lane: Lane, ray: RayState, accumulator: Accumulator
) -> tuple[TraceCounts, LaneArrays]:
    """The loop where paths branch at slabs: lanes go on until none of their paths waits."""

    def alive(ray: RayState, waiting: Waiting, added: LaneArrays) -> mi.Bool:
        return ray.active

    def bounce(ray: RayState, waiting: Waiting, added: LaneArrays) -> tuple[RayState, Waiting, LaneArrays]:
        arrived, hit, mirrored, added = _bounce(kernel, lane, ray, accumulator, added)
        ray, waiting = branched(kernel, arrived, hit, mirrored, waiting)
        return ray, waiting, added

    ray, waiting, added = dr.while_loop(
        (ray, Waiting.none(ray), accumulator.begin()),
        alive,
        bounce,
        labels=("ray", "waiting", "added"),
        label="bounces",
        mode="symbolic",
    )
    return TraceCounts(waiting.hits, ray.contributions), added


def _bounce(
    kernel: Kernel, lane: Lane, ray: RayState, accumulator: Accumulator, added: LaneArrays
) -> tuple[RayState, Hit, RayState, LaneArrays]:
    """One bounce of every ray: intersect, close, add, reflect.

    The ray as it arrives, its hit, the ray behind the mirror, and the accumulator's state.
    """
    flags = kernel.flags
    hit = intersect(kernel, lane, ray)
    there = by_stages(kernel, lane, through_passages(kernel, ray, hit), hit)
    ray = past_foci(there, hit)
    tube_here = footprint(kernel, lane, ray, hit)
    if tube_here.lost is not None:
        hit = hit.without(tube_here.lost)
    reflection = mirror(kernel, ray, hit, hit.normal)
    receive, lane, hit = receiver(kernel, lane, ray, hit)
    coherent = diffuse = None
    if flags.coherent:
        coherent = close_coherent(kernel, lane, ray, hit, tube_here, reflection, receive)
    if flags.diffuse:
        diffuse = close_diffuse(kernel, lane, ray, hit, tube_here, receive)
    trail = ray.trail
    if isinstance(accumulator, Follower):
        added, trail = accumulator.visit(added, ray, hit)
    added, count = _add(accumulator, added, coherent, diffuse)
    count = ray.contributions + count
    if not flags.multi_bounce:
        last = replace(ray, active=mi.Bool(False) & hit.active, hits=hit.order, contributions=count)
        return there, hit, last, added
    mirrored = replace(reflect(kernel, ray, hit, tube_here, reflection), contributions=count, trail=trail)
    return there, hit, mirrored, added


def _add(
    accumulator: Accumulator,
    added: LaneArrays,
    coherent: Contribution | None,
    diffuse: DiffuseReturns | None,
) -> tuple[LaneArrays, mi.UInt32]:
    """Hand the contributions of a hit to the accumulator; returns how many there are.

    Each lane goes through its own in a loop, so that the accumulator's code, long for gridding kernels, is in the
    kernel once, and lanes with one contribution do not wait for the slots of nine.
    """
    if diffuse is None:
        if coherent is None:
            return added, mi.UInt32(0)
        return accumulator.add(added, coherent), dr.select(coherent.active, mi.UInt32(1), 0)
    # the coherent return comes before all others
    waiting = mi.Bool(False) if coherent is None else coherent.active

    def some_left(slot: Slot, waiting: mi.Bool, count: mi.UInt32, added: LaneArrays) -> mi.Bool:
        return waiting | slot.there

    def add_next(
        slot: Slot, waiting: mi.Bool, count: mi.UInt32, added: LaneArrays
    ) -> tuple[Slot, mi.Bool, mi.UInt32, LaneArrays]:
        active = waiting | slot.there
        contribution = diffuse.contribution(slot, active)
        if coherent is not None:
            contribution = selected(waiting, coherent, contribution)
        return diffuse.after(slot, waiting), mi.Bool(False), count + 1, accumulator.add(added, contribution)

    _, _, count, added = dr.while_loop(
        (diffuse.first(), waiting, mi.UInt32(0), added),
        some_left,
        add_next,
        labels=("slot", "waiting", "count", "added"),
        label="contributions",
        mode="symbolic",
    )
    return added, count


__all__ = ["Accumulator", "Follower", "KernelSettings", "TraceCounts", "trace"]
