"""The bounce loop: launch, intersect, close, add, reflect. One recorded kernel, one launch per batch.

Each ray stands for a tube of solid angle. At every hit the physical-optics return of the tube to the antenna and the
echoes of the persistent diffuse scatterers in its footprint are added. The length of a path behind mirrors is measured
from the virtual antenna, the image of the antenna in the chain of mirrors. It is kept in float64 and mirrored exactly
in each facet's plane, so that rounding errors of the hits do not accumulate in the length.

Not included: scatterers at known positions (wires, volumes, edges of metal, pairs of diffuse scatterers), which are
launched by :mod:`sarmitsuba.tracing.kernel.source`, and diffraction other than by edges of metal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Protocol, TypeVar, runtime_checkable

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.derivatives.hooks import derivatives_of
from sarmitsuba.tracing.kernel.closing import close_coherent, receiver, select_contribution, tube_return
from sarmitsuba.tracing.kernel.diffuse_return import DiffuseReturns, Slot, close_diffuse
from sarmitsuba.tracing.kernel.propagation import (
    arrive,
    footprint,
    launch,
    mirror,
    next_facet,
    pass_foci,
    reflect,
    through_passages,
)
from sarmitsuba.tracing.kernel.stage import apply_at_hit as by_stages
from sarmitsuba.tracing.kernel.stage import vanishing
from sarmitsuba.tracing.kernel.state import (
    NO_HIT,
    Contribution,
    Hit,
    Kernel,
    KernelSettings,
    Lane,
    RayState,
    TubeReturn,
)
from sarmitsuba.tracing.scatterers.slabs.slab_passage import Waiting, branch_ray

if TYPE_CHECKING:
    from sarmitsuba.radar.antenna import Antenna
    from sarmitsuba.tracing.kernel.propagation import Found

    LaneArrays = tuple[mi.UInt32, ...]  # state of an accumulator per lane: Dr.Jit arrays, often none


Value = TypeVar("Value")


class Accumulator(Protocol):
    """Receiver of the echoes of every hit; owns the memory in which they are summed."""

    def begin(self) -> LaneArrays:
        """Initial loop state of the accumulator (arrays of the launch's width), often none."""

    def add(self, state: LaneArrays, contribution: Contribution) -> LaneArrays:
        """Add one contribution per lane; returns the new loop state.

        Bounce orders above the accumulator's highest are added to that one.
        """


@runtime_checkable
class Follower(Protocol):
    """Accumulator that also records every ray from hit to hit."""

    def visit(self, state: LaneArrays, ray: RayState, hit: Hit) -> tuple[LaneArrays, mi.UInt32 | None]:
        """Record a hit of a ray, with its incident fields, before the hit's contributions are added.

        Returns
        -------
        state, trail : the new loop state, and the number that the ray carries on from the hit (``RayState.trail``)
        """


@dataclass(frozen=True, eq=False)
class TraceCounts:
    """Number of hits and contributions of each lane; Dr.Jit arrays of the launch's width."""

    hits: mi.UInt32
    contributions: mi.UInt32


def trace(kernel: Kernel, antenna: Antenna, accumulator: Accumulator) -> tuple[TraceCounts, LaneArrays]:
    """Trace every ray of the kernel's grid from every pulse and pass all contributions to the accumulator.

    Nothing is evaluated here: the caller's ``dr.eval`` launches the one kernel that this records.

    Returns
    -------
    counts : per-lane hits and contributions
    state : the accumulator's loop state after the last bounce
    """
    lane, ray = launch(kernel, antenna)
    if isinstance(accumulator, Follower):
        ray = replace(ray, trail=mi.UInt32(NO_HIT))

    if kernel.transmits:
        return _through_slabs(kernel, lane, ray, accumulator)

    def alive(ray: RayState, added: LaneArrays) -> mi.Bool:
        return ray.active

    def bounce(ray: RayState, added: LaneArrays) -> tuple[RayState, LaneArrays]:
        found = next_facet(kernel.scene, lane, ray)

        def hit(ray: RayState, added: LaneArrays) -> tuple[RayState, LaneArrays]:
            _, _, ray, added = _bounce(kernel, lane, ray, found, accumulator, added)
            return ray, added

        def miss(ray: RayState, added: LaneArrays) -> tuple[RayState, LaneArrays]:
            return replace(
                ray, active=found[2]
            ), added  # false here; a literal may be merged with that of a hit

        # neighbouring rays leave the scene together: whole packets of lanes skip the rest
        left: tuple[RayState, LaneArrays] = dr.if_stmt(
            (ray, added), found[2], hit, miss, rv_labels=("ray", "added"), label="hit", mode="symbolic"
        )
        return left

    ray, added = dr.while_loop(
        (ray, accumulator.begin()), alive, bounce, labels=("ray", "added"), label="bounces", mode="symbolic"
    )
    return TraceCounts(ray.hits, ray.contributions), added


def _through_slabs(
    kernel: Kernel, lane: Lane, ray: RayState, accumulator: Accumulator
) -> tuple[TraceCounts, LaneArrays]:
    """Bounce loop in scenes with slabs, where paths branch: each lane traces all its branches."""

    def alive(ray: RayState, waiting: Waiting, added: LaneArrays) -> mi.Bool:
        return ray.active

    def bounce(ray: RayState, waiting: Waiting, added: LaneArrays) -> tuple[RayState, Waiting, LaneArrays]:
        found = next_facet(kernel.scene, lane, ray)
        arrived, hit, mirrored, added = _bounce(kernel, lane, ray, found, accumulator, added)
        ray, waiting = branch_ray(kernel, arrived, hit, mirrored, waiting)
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
    kernel: Kernel, lane: Lane, ray: RayState, found: Found, accumulator: Accumulator, added: LaneArrays
) -> tuple[RayState, Hit, RayState, LaneArrays]:
    """One bounce of every ray at the facet that it hits: close, add, reflect.

    Returns the incident ray, its hit, the reflected ray, and the accumulator's state.
    """
    flags = kernel.flags
    hit = arrive(kernel, lane, ray, found)
    there = by_stages(kernel, lane, through_passages(kernel, ray, hit), hit)
    kernel, ray, hit = derivatives_of(kernel).at_hit(kernel, lane, pass_foci(there, hit), hit)
    tube_here = footprint(kernel, lane, ray, hit)
    if tube_here.lost is not None:
        hit = hit.without(tube_here.lost)
    reflection = mirror(kernel, ray, hit, hit.normal)
    receive, lane, hit = receiver(kernel, lane, ray, hit)
    trail = ray.trail
    if isinstance(accumulator, Follower):
        added, trail = accumulator.visit(added, ray, hit)

    count = mi.UInt32(0)
    if flags.coherent:
        returned = _only_where(
            hit.sees & ~vanishing(kernel, hit, tube_here),
            lambda: tube_return(kernel, lane, ray, hit, tube_here, receive),
            lambda: TubeReturn.none(derivatives_of(kernel).without_return()),
        )
    coherent = partial(close_coherent, kernel, lane, ray, hit, reflection, receive)
    if flags.diffuse:
        first = None
        if flags.coherent:
            zeros = derivatives_of(kernel).per_amplitude * tuple(mi.Complex2f(0.0) for _ in flags.channels)
            values = _only_where(returned.counts, lambda: coherent(returned).values, lambda: zeros)
            first = coherent(returned).with_values(values)
        diffuse = close_diffuse(kernel, lane, ray, hit, tube_here, receive)
        added, count = _add_all(accumulator, added, first, diffuse)
    elif flags.coherent:
        added, count = _only_where(
            returned.counts,
            lambda: (accumulator.add(added, coherent(returned)), mi.UInt32(1)),
            lambda: (added, mi.UInt32(0)),
        )
    count = ray.contributions + count
    if not flags.multi_bounce:
        last = replace(ray, active=mi.Bool(False) & hit.active, hits=hit.order, contributions=count)
        return there, hit, last, added
    mirrored = replace(
        reflect(kernel, lane, ray, hit, tube_here, reflection), contributions=count, trail=trail
    )
    return there, hit, mirrored, added


def _only_where(lanes: mi.Bool, then: Callable[[], Value], otherwise: Callable[[], Value]) -> Value:
    """Value that is computed in some lanes only.

    Neighbouring lanes are neighbouring rays: whole packets of lanes skip the computation.
    """
    value: Value = dr.if_stmt((), lanes, then, otherwise, label="some lanes", mode="symbolic")
    return value


def _add_all(
    accumulator: Accumulator, added: LaneArrays, coherent: Contribution | None, diffuse: DiffuseReturns
) -> tuple[LaneArrays, mi.UInt32]:
    """Pass all contributions of a hit to the accumulator; returns their number.

    Each lane loops over its own contributions, so that the accumulator's code, long with a gridding kernel, is in the
    kernel once, and lanes with one contribution do not wait for unused slots.
    """
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
            contribution = select_contribution(waiting, coherent, contribution)
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
