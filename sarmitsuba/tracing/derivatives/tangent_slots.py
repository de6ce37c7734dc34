"""Displacements of many shapes: a ray carries those of the shapes that it meets, a few slots instead of one for each.

A path of D bounces meets at most D shapes, so D slots serve any number of them. A slot is empty until the path meets a
shape that moves and has no slot yet; it then takes the number of that shape. Up to there the displacement of the shape
has changed nothing along the path, as that of an empty slot. From there on the slot's offset and gradient are those of
the shape, and everything in :mod:`sarmitsuba.tracing.derivatives.range_tangents` is as for displacements that are the
same for all rays. Each slot has as many ways as a shape has displacements: three for shifts along x, y and z.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import F64, I64, U32
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.derivatives.tangents import Carried, RayDerivative
from sarmitsuba.tracing.kernel.device_arrays import device_array

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sarmitsuba.tracing.derivatives.tangents import Displacement, StepTables

# number of a shape that does not move, and of an empty slot
NO_SHAPE = 0xFFFFFFFF
# numbers of a displacement's row: offset and a zero, then the rows of its gradient with a zero each
ROW = 16
# shapes that move an edge as the antenna sees it: of both facets that meet in it, of a mirror, and of what it shadows
EDGE_SHAPES = 4


class MovingShapes:
    """Shapes that move with their displacements, collected one displacement after the other.

    Parameters
    ----------
    n_faces : of the traced scene
    """

    def __init__(self, n_faces: int) -> None:
        self.of_face: U32 = np.full(max(n_faces, 1), NO_SHAPE, dtype=np.uint32)
        self.sizes: list[int] = []
        self.displacements: list[list[Displacement]] = []

    def add(self, displacement: Displacement) -> tuple[int, int] | None:
        """Shape and number of a displacement among those of the shape.

        None where it moves the antenna, or a part of the faces that another one moves.
        """
        if displacement.faces is None or displacement.antenna.any():
            return None
        rows = np.flatnonzero(displacement.faces)
        if not rows.size:  # no face of it is traced
            self.sizes.append(0)
            self.displacements.append([displacement])
            return len(self.sizes) - 1, 0
        shape = int(self.of_face[rows[0]])
        if (self.of_face[rows] != shape).any() or (shape != NO_SHAPE and self.sizes[shape] != rows.size):
            return None
        if shape == NO_SHAPE:
            shape = len(self.sizes)
            self.of_face[rows] = shape
            self.sizes.append(rows.size)
            self.displacements.append([])
        self.displacements[shape].append(replace(displacement, faces=None))
        return shape, len(self.displacements[shape]) - 1


@dataclass(frozen=True, eq=False)
class SlotTangents:
    """Displacements of many shapes, levels of materials and of texels, by their numbers.

    The numbers of a gradient are first those of the ways of every shape, shape by shape, then those of the materials,
    then those of the texels of level maps.

    Parameters
    ----------
    n_slots : of a ray
    translated : for each way, whether all shapes are translated by it; else they are stretched or turned too
    turn_rates : for each way, largest derivative of a unit normal of a face by it, 1 per unit; 0: no face turns
    rates : whether derivatives of range rates are needed
    n_shapes : that move
    shape : (n_faces,) uint32, number of each face's shape
    rows : (16 n_shapes ways,) float64, of every way of every shape
    n_materials : whose levels count; 0: none
    n_texels : whose levels count; 0: none
    """

    n_slots: int
    translated: tuple[bool, ...]
    turn_rates: tuple[float, ...]
    rates: bool
    n_shapes: int
    shape: mi.UInt32
    rows: mi.Float64
    n_materials: int
    n_texels: int

    @staticmethod
    def of(
        shapes: MovingShapes, most_slots: int, n_materials: int, n_texels: int, *, rates: bool = False
    ) -> tuple[SlotTangents, list[I64]]:
        """Tables on the device, and the number of each displacement of each shape in the gradient.

        Parameters
        ----------
        shapes : that move
        most_slots : bounces of a path at most
        n_materials, n_texels, rates : see the class
        """
        # ways that translate first, so that they carry no gradient for any shape
        plain = [[d.gradient is None for d in own] for own in shapes.displacements]
        n_plain = max((sum(own) for own in plain), default=0)
        ways = n_plain + max((len(own) - sum(own) for own in plain), default=0)
        rows = np.zeros((len(plain), ways, 4, 4))
        numbers, turn_rates = [], np.zeros(ways)
        for shape, (flat, own) in enumerate(zip(plain, shapes.displacements, strict=True)):
            place = np.where(flat, np.cumsum(flat) - 1, n_plain + np.cumsum(~np.array(flat)) - 1)
            numbers.append(np.asarray(shape * ways + place, dtype=np.int64))
            for way, displacement in zip(place, own, strict=True):
                rows[shape, way, 0, :3] = _fill_slots(displacement.offset, np.zeros(3))
                rows[shape, way, 1:, :3] = _fill_slots(displacement.gradient, np.zeros((3, 3)))
                turn_rates[way] = max(turn_rates[way], displacement.turn_rate)
        found = SlotTangents(
            n_slots=min(most_slots, len(plain)),
            translated=tuple(way < n_plain for way in range(ways)),
            turn_rates=tuple(turn_rates.tolist()),
            rates=rates and len(plain) > 0,
            n_shapes=len(plain),
            shape=device_array(mi.UInt32, shapes.of_face),
            rows=device_array(mi.Float64, rows if rows.size else np.zeros(ROW)),
            n_materials=n_materials,
            n_texels=n_texels,
        )
        return found, numbers

    @property
    def properties(self) -> tuple[StepTables, ...]:
        """See :class:`sarmitsuba.tracing.derivatives.tangents.TangentPlan`."""
        return ()

    @property
    def turns(self) -> tuple[tuple[int, float], ...]:
        """See :class:`sarmitsuba.tracing.derivatives.tangents.TangentPlan`."""
        every = enumerate(self.turn_rates * self.n_slots)
        return tuple((k, rate) for k, rate in every if rate > 0.0)

    def beside_edges(self) -> SlotTangents:
        """For rays beside edges: displacements alone, with slots for the shapes of the edge and of its mirror too."""
        return replace(
            self,
            n_slots=self.n_slots + EDGE_SHAPES,
            turn_rates=(0.0,) * self.ways,
            rates=False,
            n_materials=0,
            n_texels=0,
        )

    @property
    def ways(self) -> int:
        """Displacements of a shape at most."""
        return len(self.translated)

    @property
    def first_material(self) -> int:
        """Number of the first material's level in the gradient."""
        return self.n_shapes * self.ways

    @property
    def first_texel(self) -> int:
        """Number of the first texel's level in the gradient."""
        return self.first_material + self.n_materials

    @property
    def size(self) -> int:
        """Numbers of the gradient."""
        return self.first_texel + self.n_texels

    def carried(self, *, beside_edges: bool = False) -> CarriedSlots:
        """See :class:`sarmitsuba.tracing.derivatives.tangents.TangentPlan`."""
        still = mi.Vector3d(0.0)
        k = self.n_slots * self.ways
        return CarriedSlots(
            (still,) * k,
            (still,) * k,
            tuple(None if flat else (still,) * 3 for flat in self.translated) * self.n_slots,
            tuple(k for k, _ in self.turns),
            False,
            self.rates,
            self.n_texels > 0,
            beside_edges,
            self,
            (),
        )


def _fill_slots(values: F64 | None, zeros: F64) -> F64:
    return zeros if values is None else values


@dataclass(frozen=True, eq=False)
class CarriedSlots(Carried):
    """Displacements of the shapes in a ray's slots; ``numbers``: of these shapes, at a hit."""

    plan: SlotTangents
    numbers: tuple[mi.UInt32, ...]

    @property
    def slots(self) -> tuple[mi.UInt32, ...]:
        """See the base class."""
        return self.numbers

    def launched(self) -> RayDerivative:
        """See the base class."""
        return replace(super().launched(), slots=(mi.UInt32(NO_SHAPE),) * self.plan.n_slots)

    def at(self, tangents: RayDerivative | None, face: mi.UInt32, active: mi.Bool) -> CarriedSlots:
        """The same at a hit of a ray on a face, whose shape takes the first empty slot if it has none."""
        if tangents is None or not self.plan.n_slots:
            return self
        shape = dr.select(active, dr.gather(mi.UInt32, self.plan.shape, face, active), NO_SHAPE)
        waits = shape != NO_SHAPE
        for number in tangents.slots:
            waits &= number != shape
        numbers = []
        for number in tangents.slots:
            takes = waits & (number == NO_SHAPE)
            numbers.append(dr.select(takes, shape, number))
            waits &= ~takes
        offset: list[mi.Vector3d] = []
        gradient: list[tuple[mi.Vector3d, ...] | None] = []
        for number in numbers:
            there = number != NO_SHAPE
            for way, flat in enumerate(self.plan.translated):
                row = (number * self.plan.ways + way) * (ROW // 4)
                vectors = _vectors(self.plan.rows, row, range(1 if flat else 4), there)
                offset.append(vectors[0])
                gradient.append(None if flat else vectors[1:])
        return replace(self, offset=tuple(offset), gradient=tuple(gradient), numbers=tuple(numbers))

    def moves(self, k: int, face: mi.UInt32, active: mi.Bool) -> mi.Bool:
        """See the base class."""
        number = self.numbers[k // self.plan.ways]
        own = dr.gather(mi.UInt32, self.plan.shape, face, active)
        return active & (own == number) & (number != NO_SHAPE)


def _vectors(
    table: mi.Float64, row: mi.UInt32, places: Iterable[int], active: mi.Bool
) -> tuple[mi.Vector3d, ...]:
    found = [dr.gather(mi.Vector4d, table, row + i, active) for i in places]
    return tuple(mi.Vector3d(x[0], x[1], x[2]) for x in found)
