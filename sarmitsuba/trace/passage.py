"""What a straight leg between two surfaces does to a wave: extinction in a volume, transmission through a slab."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from sarmitsuba.backend import mi
    from sarmitsuba.trace.field import ComplexVector


class Passage(Protocol):
    """Something that stands in the way and lets a part of the wave through.

    What it does is a symmetric dyad, so that the same function serves the incident wave and, in its receiving
    vectors, the scattered one.
    """

    def through(
        self,
        origin: mi.Vector3f,
        direction: mi.Vector3f,
        distance: mi.Float,
        active: mi.Bool,
        fields: tuple[ComplexVector, ...],
    ) -> tuple[ComplexVector, ...]:
        """Complex vectors at the end of a straight leg, from those at its beginning.

        Parameters
        ----------
        origin : m, scene frame; start of the leg
        direction : unit vector along it
        distance : m, its length
        active : lanes that have it
        fields : scene frame, across ``direction``
        """


def passed(
    passages: Sequence[Passage],
    origin: mi.Vector3f,
    direction: mi.Vector3f,
    distance: mi.Float,
    active: mi.Bool,
    fields: tuple[ComplexVector, ...],
) -> tuple[ComplexVector, ...]:
    """Through all that a scene has; see :meth:`Passage.through`."""
    for passage in passages:
        fields = passage.through(origin, direction, distance, active, fields)
    return fields


__all__ = ["Passage", "passed"]
