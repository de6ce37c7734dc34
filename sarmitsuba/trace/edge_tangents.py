r"""Moving boundaries of what the antenna sees: rays on both sides of the edges of shapes, weighted by their motion.

The sum over the tubes of a lattice of spacing s is, in the mean over the lattice's place, an integral over the launch
plane of the return F of the tube at x. Derivatives of the returns of single tubes are taken with the tubes moving along
with what they light (:mod:`sarmitsuba.trace.range_tangents`). Where F jumps at the projection of an edge, that leaves

.. math:: \frac{1}{s^2} \oint \left( (v - u_i) F_i - (v - u_o) F_o \right) dl

with the velocity v of the edge along its normal in the launch plane, and those u of the tubes on the inner and the outer
side. An edge hidden behind others has the same returns on both sides, and adds nothing.

References
----------
Reynolds' transport theorem; Li et al., "Differentiable Monte Carlo ray tracing through edge sampling", ACM TOG 37 (2018),
for the sampling of edges.

Notes
-----
Edges are those on the first leg of a path, and on the second behind a flat mirror. The others count as those of the
reversed path, so that all of one, two and three bounces are there. Ignores edges on the middle legs of four bounces or
more, and what hides a diffuse scatterer that is lit over a mirror from the antenna.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sarmitsuba.backend import dr, mi
from sarmitsuba.trace.device_arrays import device_array

if TYPE_CHECKING:
    from sarmitsuba.trace.launch import EdgeSamples
    from sarmitsuba.trace.state import Hit, Lane, RayState
    from sarmitsuba.trace.tangents import Carried, RayTangents


@dataclass(frozen=True, eq=False)
class EdgeLane:
    """What a ray beside an edge keeps over all bounces.

    Parameters
    ----------
    weight : length of the edge that the ray stands for over s^2, 1/m; negative on the outer side
    speeds : of the edge along its normal in the launch plane, m per unit of each displacement; of the first ones alone,
        if it stands still by the others
    distance : m, from the antenna to the launch plane
    faces : that meet in the edge
    leg : of the path, from 1, on which the ray passes the edge
    """

    weight: mi.Float
    speeds: tuple[mi.Float, ...]
    distance: mi.Float
    faces: tuple[mi.UInt32, mi.UInt32]
    leg: mi.UInt32

    @staticmethod
    def of(samples: EdgeSamples, row: mi.UInt32, distance: mi.Float64) -> EdgeLane:
        """From the samples of a launch; ``row``: of each lane."""
        weight, *speeds = (
            dr.gather(mi.Float, device_array(mi.Float, x), row) for x in (samples.weight, *samples.speeds)
        )
        first, second, leg = (
            dr.gather(mi.UInt32, device_array(mi.UInt32, x), row) for x in (*samples.faces.T, samples.leg)
        )
        return EdgeLane(weight, tuple(speeds), mi.Float(distance), (first, second), leg)

    def relative(self, weight: mi.Float64, k: int, frame: mi.Float64) -> mi.Float64:
        """Weight times the velocity of the edge relative to the lit area, which moves by an angle ``frame``, rad."""
        lit = mi.Float64(self.distance) * frame
        return weight * (mi.Float64(self.speeds[k]) - lit) if k < len(self.speeds) else -weight * lit


@dataclass
class EdgeState:
    """Part of the state of a ray beside an edge.

    Parameters
    ----------
    across : normal of the edge, made perpendicular to the ray along that of the launch plane, and mirrored with the ray
    frames : velocity along it of the lit area, as an angle about the antenna's image, rad per unit of each displacement
    outline : 1 where the edge is one of a facet that the ray hit behind it, else 0
    """

    across: mi.Vector3d
    frames: tuple[mi.Float64, ...]
    outline: mi.UInt32

    @staticmethod
    def begun(
        tangents: RayTangents,
        samples: EdgeSamples,
        row: mi.UInt32,
        d: mi.Vector3d,
        axes: tuple[mi.Vector3d, mi.Vector3d],
    ) -> RayTangents:
        """State of a ray launched along ``d``; ``row``: of each lane in the samples; ``axes``: of the launch plane."""
        x, y = (dr.gather(mi.Float64, device_array(mi.Float64, n), row) for n in samples.normal.T)
        normal = axes[0] * x + axes[1] * y
        plane = dr.cross(*axes)
        across = normal - plane * (dr.dot(normal, d) / dr.dot(plane, d))
        state = EdgeState(across, tuple(mi.Float64(0.0) for _ in tangents.virtual), mi.UInt32(0))
        slots = tangents.slots
        if samples.shapes is not None:
            own = (dr.gather(mi.UInt32, device_array(mi.UInt32, n), row) for n in samples.shapes.T)
            slots = (*own, *slots[samples.shapes.shape[1] :])
        return replace(tangents, slots=slots, edge=state)

    def at(self, carried: Carried, lane: Lane, ray: RayState, hit: Hit) -> EdgeState:
        """State at a hit: the lit area moves with the smallest piece of surface on the path."""
        assert ray.tangents is not None
        frames = []
        for k, (boundary, before) in enumerate(zip(ray.tangents.boundary, self.frames, strict=True)):
            if boundary is None:
                frames.append(before)
                continue
            own = hit.largest_cell <= boundary.size
            frames.append(dr.select(own, self.frame(carried, k, ray, hit, hit.p), before))
        edge = lane.edge
        assert edge is not None
        own = (hit.face == edge.faces[0]) | (hit.face == edge.faces[1])
        outline = dr.select(hit.order == edge.leg, dr.select(own, mi.UInt32(1), 0), self.outline)
        return EdgeState(self.across, tuple(frames), outline)

    def frame(self, carried: Carried, k: int, ray: RayState, hit: Hit, point: mi.Vector3d) -> mi.Float64:
        """Velocity of a point of the facet that was hit, as an angle about the antenna's image."""
        assert ray.tangents is not None
        movement = carried.movement(k, hit.face, point, hit.active)
        towards = (
            -ray.tangents.virtual[k] if movement is None else movement.velocity - ray.tangents.virtual[k]
        )
        return dr.dot(self.across, towards) / hit.length

    def mirrored(self, n: mi.Vector3d) -> EdgeState:
        """State of the reflected ray."""
        return EdgeState(self.across - n * (2.0 * dr.dot(self.across, n)), self.frames, self.outline)


def of_tube(carried: Carried, lane: Lane, ray: RayState, hit: Hit) -> tuple[mi.Float64, ...]:
    """Weights of a coherent return by every displacement, 1 per unit.

    A path and the reversed one have the same return, and each is traced. They count twice for what happens on legs of
    the reversed path that no ray is sampled for: a facet hidden from the antenna on the way back, and outlines beyond the
    second.
    """
    edge, before = lane.edge, None if ray.tangents is None else ray.tangents.edge
    assert edge is not None and before is not None
    state = before.at(carried, lane, ray, hit)
    legs = edge.leg + dr.select(state.outline == 1, mi.UInt32(1), 0)
    weight = mi.Float64(edge.weight * dr.select(hit.order > legs, 2.0, 1.0))
    return tuple(edge.relative(weight, k, frame) for k, frame in enumerate(state.frames))


def of_scatterer(
    carried: Carried, lane: Lane, ray: RayState, hit: Hit, centre: mi.Vector3d
) -> tuple[mi.Float64, ...]:
    """Weights of the return of a diffuse scatterer by every displacement, 1 per unit."""
    edge, state = lane.edge, None if ray.tangents is None else ray.tangents.edge
    assert edge is not None and state is not None
    frames = (state.frame(carried, k, ray, hit, centre) for k in range(len(state.frames)))
    return tuple(edge.relative(mi.Float64(edge.weight), k, frame) for k, frame in enumerate(frames))
