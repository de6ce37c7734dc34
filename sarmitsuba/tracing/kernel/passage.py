"""Attenuation of a wave along a straight leg: extinction in volumes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from sarmitsuba.machine.backend import mi
    from sarmitsuba.tracing.kernel.field import ComplexVector


class Passage(Protocol):
    """Object that attenuates waves that pass through it.

    The attenuation is a symmetric dyad: the same function serves the incident wave and, applied to the receiving
    vectors, the scattered wave.
    """

    def through(
        self,
        origin: mi.Vector3f,
        direction: mi.Vector3f,
        distance: mi.Float,
        active: mi.Bool,
        fields: tuple[ComplexVector, ...],
    ) -> tuple[ComplexVector, ...]:
        """Complex vectors at the end of a straight leg, from those at its start.

        Parameters
        ----------
        origin : m, scene frame; start of the leg
        direction : unit vector along it
        distance : m, its length
        active : lanes that have the leg
        fields : scene frame, across ``direction``
        """


def pass_all(
    passages: Sequence[Passage],
    origin: mi.Vector3f,
    direction: mi.Vector3f,
    distance: mi.Float,
    active: mi.Bool,
    fields: tuple[ComplexVector, ...],
) -> tuple[ComplexVector, ...]:
    """Complex vectors after all passages of a scene; see :meth:`Passage.through`."""
    for passage in passages:
        fields = passage.through(origin, direction, distance, active, fields)
    return fields
