"""State of a ray beside an edge, for the derivatives of :mod:`sarmitsuba.tracing.derivatives.edge_tangents`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.kernel.device_arrays import device_array

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sarmitsuba.tracing.kernel.launch import EdgeSamples

# leg of a path that an edge shadows from the antenna: the last one of a double bounce
SHADOWED = 3


@dataclass(frozen=True, eq=False)
class EdgeLane:
    """State of a ray beside an edge, over all bounces.

    Parameters
    ----------
    weight : length of the edge that the ray stands for over s^2, 1/m; negative on the outer side
    speeds : of the edge along its normal in the launch plane, m per unit of each displacement; of the first ones alone,
        if it stands still by the others
    distance : m, from the antenna to the launch plane
    faces : that meet in the edge; on leg ``SHADOWED`` the mirror, then the facet that the shadow of the edge is on
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
    turns : derivative of ``across`` by each displacement: that of mirrors that turn, 1 per unit
    frames : velocity along it of the lit area, as an angle about the antenna's image, rad per unit of each displacement
    outline : 1 where the edge is one of a facet that the ray hit behind it, else 0; on leg ``SHADOWED`` 1 behind the
        mirror
    """

    across: mi.Vector3d
    turns: tuple[mi.Vector3d, ...]
    frames: tuple[mi.Float64, ...]
    outline: mi.UInt32

    def mirrored(self, n: mi.Vector3d, rates: Sequence[mi.Vector3d | None]) -> EdgeState:
        """State of the reflected ray; ``rates``: derivative of the mirror's normal by each displacement; None: zero."""
        own, turns = self.across, []
        for turn, rate in zip(self.turns, rates, strict=True):
            image = turn - n * (2.0 * dr.dot(turn, n))
            if rate is not None:
                image -= 2.0 * (rate * dr.dot(own, n) + n * dr.dot(own, rate))
            turns.append(image)
        return EdgeState(own - n * (2.0 * dr.dot(own, n)), tuple(turns), self.frames, self.outline)
