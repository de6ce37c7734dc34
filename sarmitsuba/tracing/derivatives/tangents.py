r"""Derivatives of echoes by parameters, carried along their paths and recorded beside the echoes.

An echo of amplitude a and slant range R is :math:`a \, e^{-j 4 \pi f R / c}` at the frequency f. Its derivative by a
parameter needs :math:`a \, \partial R`, :math:`\partial a`, or both. The kernel records each of these as further
channels of the echo's cells, so that one traced path serves all parameters. Where a block of pulses shares one
tracing, :math:`a \, \partial \dot R` is recorded too: the slant range at the time :math:`\tau` from the key pulse
changes by :math:`\partial R + \partial \dot R \, \tau`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.derivatives.edge_state import EdgeState  # at run time, like the next
from sarmitsuba.tracing.kernel.device_arrays import device_array
from sarmitsuba.tracing.kernel.field import ComplexVector  # as the next
from sarmitsuba.tracing.kernel.movement import (
    Movement,
    ShadowBoundary,
)  # at run time: Dr.Jit reads the types of loop states

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sarmitsuba.tracing.derivatives.edge_state import EdgeLane
    from sarmitsuba.tracing.kernel.scene_tables import TraceScene

Number = TypeVar("Number")
# per channel, values of the fixed tensors of a diffuse scatterer
Terms: TypeAlias = "list[list[mi.Complex2f]]"

# parameters of one kind that one launch carries at most: bits of a table entry
MOST = 32
# amplitude per decibel of power
PER_DB = float(np.log(10.0) / 20.0)
# material number of returns without a diffuse level
NO_MATERIAL = 0xFFFFFFFF


@dataclass(frozen=True, eq=False)
class Displacement:
    r"""Velocity, per unit of a parameter, of the antenna and of the points :math:`\mathbf p` of some faces.

    .. math:: \dot{\mathbf p} = \mathbf b + A \mathbf p

    Parameters
    ----------
    antenna : (3,) float64, m per unit
    faces : (n_faces,) bool, faces of the traced scene that move; None: none
    offset : (3,) float64, b, m per unit
    gradient : (3, 3) float64, A, 1 per unit; None: the faces are translated
    turn_rate : 1 per unit, largest derivative of the unit normal of a face; 0: no face turns
    """

    antenna: F64
    faces: NDArray[np.bool_] | None = None
    offset: F64 | None = None
    gradient: F64 | None = None
    turn_rate: float = 0.0


@dataclass(frozen=True, eq=False)
class StepTables:
    """Property of a material: the scene's geometry with the tables of its materials at both ends of a step.

    Parameters
    ----------
    below, above : scenes that share everything but these tables
    per_unit : one over the difference of the property between them
    """

    below: TraceScene
    above: TraceScene
    per_unit: float


class KernelDerivatives:
    """Derivatives that a kernel carries: its hooks are in :mod:`sarmitsuba.tracing.derivatives.hooks`."""


@dataclass(frozen=True, eq=False)
class LaneDerivative:
    """Values of a ray that stay the same over all its bounces.

    Parameters
    ----------
    edge : of a ray beside an edge; None for rays of a lattice
    beam_rates : 1/rad, slopes of the launch's gain by the two angles of the beam; None: not recorded
    """

    edge: EdgeLane | None
    beam_rates: tuple[mi.Float, mi.Float] | None


@dataclass
class RayDerivative:
    """Part of a ray's state: velocities of its virtual antenna and of the lit area, for each displacement.

    Parameters
    ----------
    virtual : float64, m per unit, of the antenna mirrored through the chain so far
    boundary : of the lit area; None for displacements of the antenna alone
    stretch : m per unit, change of the tube's two edges with the lit area, of the last facet; None for translations
    velocity : float64, m/s per unit, change of the virtual antenna's velocity; None where no mirror turns, or without
        derivatives of range rates
    slots : numbers of the shapes met so far that move, see :mod:`sarmitsuba.tracing.derivatives.tangent_slots`; empty
        for displacements that are the same for all rays
    edge : of a ray beside an edge; None for rays of a lattice
    fields : with other materials or turned facets, for each variant; empty without any
    """

    virtual: tuple[mi.Vector3d, ...]
    boundary: tuple[ShadowBoundary | None, ...]
    stretch: tuple[tuple[mi.Vector3f, mi.Vector3f] | None, ...]
    velocity: tuple[mi.Vector3d | None, ...]
    slots: tuple[mi.UInt32, ...] = ()
    edge: EdgeState | None = None
    fields: tuple[tuple[ComplexVector, ...], ...] = ()


@dataclass(frozen=True, eq=False)
class PatchDerivative:
    """Derivatives of the diffuse returns of one hit.

    Parameters
    ----------
    terms : of the straight and the reciprocal path, for each variant; empty without any
    texels : see :class:`EchoDerivative`
    """

    terms: tuple[tuple[Terms, Terms | None], ...] = ()
    texels: tuple[tuple[mi.UInt32, mi.Float], ...] = ()


@dataclass
class EchoDerivative:
    """Derivatives of one echo.

    Parameters
    ----------
    ranges : of the slant range by displacements, m per unit, see :mod:`.range_tangents`
    rates : of the range rate by displacements, m/s per unit; None where none is recorded
    amplitudes : of the channels by properties of materials, property by property, then by the displacements that turn
        facets, as amplitude times slant range; None without any
    gains : relative, of the channels by the two angles of the beam, 1/rad; None: not recorded
    material : number of the material of a diffuse scatterer, ``NO_MATERIAL`` for other returns; None before the echo
        is formed
    partner : the same of the other one of a pair; None for all other returns
    slots, texels : numbers of the shapes of ``ranges``, numbers and shares of a level's texels; empty: none
    """

    ranges: tuple[mi.Float64 | mi.Complex2f, ...]
    rates: tuple[mi.Float, ...] | None = None
    amplitudes: tuple[mi.Complex2f, ...] | None = None
    gains: tuple[mi.Float, ...] | None = None
    material: mi.UInt32 | None = None
    partner: mi.UInt32 | None = None
    slots: tuple[mi.UInt32, ...] = ()
    texels: tuple[tuple[mi.UInt32, mi.Float], ...] = ()

    @staticmethod
    def selected(
        condition: mi.Bool, a: EchoDerivative | None, b: EchoDerivative | None
    ) -> EchoDerivative | None:
        """Derivatives ``a`` where the condition holds, else ``b``; partner, slots and texels of ``b``."""
        if a is None or b is None:
            return None
        return replace(
            b,
            ranges=tuple(dr.select(condition, x, y) for x, y in zip(a.ranges, b.ranges, strict=True)),
            rates=_select(condition, a.rates, b.rates),
            amplitudes=_select(condition, a.amplitudes, b.amplitudes),
            gains=_select(condition, a.gains, b.gains),
            material=dr.select(condition, a.material, b.material),
        )


def _select(
    condition: mi.Bool, a: tuple[Number, ...] | None, b: tuple[Number, ...] | None
) -> tuple[Number, ...] | None:
    """Numbers ``a`` where the condition holds, else ``b``; None where either is."""
    if a is None or b is None:
        return None
    return tuple(dr.select(condition, x, y) for x, y in zip(a, b, strict=True))


class TangentPlan(Protocol):
    """Derivatives that a kernel carries: those of :class:`Tangents`, or of many parameters by their numbers."""

    @property
    def properties(self) -> tuple[StepTables, ...]:
        """Properties of materials, each a difference of amplitudes along the path."""

    @property
    def turns(self) -> tuple[tuple[int, float], ...]:
        """Numbers of the displacements that turn faces, and the largest derivative of a unit normal of each."""

    def carried(self, *, beside_edges: bool = False) -> Carried:
        """Numbers for one kernel, as opaque scalars: other values do not compile another kernel."""


@dataclass(frozen=True, eq=False)
class Tangents:
    """Derivatives recorded beside every echo: displacements, levels, properties of materials, range rates.

    Parameters
    ----------
    displacements : each gives the channels times the derivative of the slant range
    levels : numbers of the materials whose diffuse return has a common level in dB; each gives the derivative of the
        channels
    moved : (n_faces,) bit k: the face is moved by displacement k
    levelled : (n_materials,) bit k: level k applies to the material
    properties : of materials; each gives the derivative of the channels
    texels : numbers of texels of level maps, as in :meth:`BitmapLayer.shares`; each gives the derivative of the
        channels by its level in dB
    pointing : whether the two angles of the beam give the derivative of the channels, after the properties
    rates : whether each displacement gives the channels times the derivative of the range rate too, after all others
    """

    displacements: tuple[Displacement, ...]
    levels: tuple[frozenset[int], ...]
    moved: mi.UInt32
    levelled: mi.UInt32
    properties: tuple[StepTables, ...] = ()
    texels: tuple[int, ...] = ()
    pointing: bool = False
    rates: bool = False

    @staticmethod
    def of(
        displacements: Sequence[Displacement],
        levels: Sequence[frozenset[int]],
        n_faces: int,
        n_materials: int,
        properties: Sequence[StepTables] = (),
        texels: Sequence[int] = (),
        *,
        pointing: bool = False,
        rates: bool = False,
    ) -> Tangents:
        """Tables of these parameters on the device."""
        assert max(len(displacements), len(levels), len(texels)) <= MOST
        moved = np.zeros(max(n_faces, 1), dtype=np.uint32)
        for k, displacement in enumerate(displacements):
            if displacement.faces is not None:
                moved[displacement.faces] |= np.uint32(1 << k)
        levelled = np.zeros(max(n_materials, 1), dtype=np.uint32)
        for k, numbers in enumerate(levels):
            levelled[sorted(numbers)] |= np.uint32(1 << k)
        return Tangents(
            tuple(displacements),
            tuple(levels),
            device_array(mi.UInt32, moved),
            device_array(mi.UInt32, levelled),
            tuple(properties),
            tuple(texels),
            pointing,
            rates,
        )

    @property
    def turns(self) -> tuple[tuple[int, float], ...]:
        """See :class:`TangentPlan`."""
        return tuple((k, d.turn_rate) for k, d in enumerate(self.displacements) if d.turn_rate > 0.0)

    @property
    def count(self) -> int:
        """Number of derivatives of each channel, without those of range rates."""
        own = (self.displacements, self.levels, self.properties, self.texels)
        return sum(len(sort) for sort in own) + 2 * self.pointing

    @property
    def recorded(self) -> int:
        """Numbers recorded for each channel: itself, its derivatives, and those with range rates."""
        return 1 + self.count + (len(self.displacements) if self.rates else 0)

    def carried(self, *, beside_edges: bool = False) -> CarriedDisplacements:
        """See :class:`TangentPlan`."""
        return CarriedDisplacements(
            tuple(_vector(d.antenna) for d in self.displacements),
            tuple(None if d.offset is None else _vector(d.offset) for d in self.displacements),
            tuple(
                None if d.gradient is None else tuple(_vector(row) for row in d.gradient)
                for d in self.displacements
            ),
            tuple(k for k, _ in self.turns),
            self.pointing,
            self.rates,
            bool(self.texels),
            beside_edges,
            self,
            tuple(dr.opaque(mi.UInt32, texel) for texel in self.texels),
        )


def _vector(values: F64) -> mi.Vector3d:
    return mi.Vector3d(*(dr.opaque(mi.Float64, float(x)) for x in values))


@dataclass(frozen=True, eq=False)
class Carried(ABC):
    """Tangents within a kernel.

    Parameters
    ----------
    antenna, offset, gradient : of each displacement, see :class:`Displacement`; None where nothing of it moves
    turning : numbers of those that turn faces
    pointing : whether echoes carry derivatives by the angles of the beam
    rates : whether echoes carry derivatives of their range rates
    mapped : whether echoes carry the shares of texels in their level
    beside_edges : whether rays are those beside edges, see :mod:`sarmitsuba.tracing.derivatives.edge_tangents`
    """

    antenna: tuple[mi.Vector3d, ...]
    offset: tuple[mi.Vector3d | None, ...]
    gradient: tuple[tuple[mi.Vector3d, ...] | None, ...]
    turning: tuple[int, ...]
    pointing: bool
    rates: bool
    mapped: bool
    beside_edges: bool

    @property
    def slots(self) -> tuple[mi.UInt32, ...]:
        """Numbers of the shapes to which the displacements belong; empty where they are the same for all rays."""
        return ()

    def at(self, tangents: RayDerivative | None, face: mi.UInt32, active: mi.Bool) -> Carried:
        """The same at a hit of a ray on a face."""
        return self

    def launched(self) -> RayDerivative:
        """State of a ray at launch."""
        turning = self.turning if self.rates else ()
        return RayDerivative(
            tuple(mi.Vector3d(a) for a in self.antenna),
            tuple(None if b is None else ShadowBoundary.open() for b in self.offset),
            tuple(
                None if g is None else (dr.zeros(mi.Vector3f), dr.zeros(mi.Vector3f)) for g in self.gradient
            ),
            tuple(mi.Vector3d(0.0) if k in turning else None for k in range(len(self.antenna))),
        )

    def movement(self, k: int, face: mi.UInt32, point: mi.Vector3d, active: mi.Bool) -> Movement | None:
        """Movement of a point of a face by displacement k, m per unit; None where no face moves."""
        offset = self.offset[k]
        if offset is None:
            return None
        velocity = offset + self.turned(k, point)
        still = mi.Vector3d(0.0)
        return Movement(still, dr.select(self.moves(k, face, active), velocity, still))

    def without_return(self) -> EchoDerivative:
        """Derivatives of a slant range and of a range rate that nothing changes."""
        real = self.beside_edges
        return EchoDerivative(
            tuple(mi.Float64(0.0) if g is None or real else mi.Complex2f(0.0) for g in self.gradient),
            tuple(mi.Float(0.0) for _ in self.antenna) if self.rates else None,
        )

    @abstractmethod
    def moves(self, k: int, face: mi.UInt32, active: mi.Bool) -> mi.Bool:
        """Whether displacement k moves a face."""

    def turned(self, k: int, vector: mi.Vector3d) -> mi.Vector3d:
        """A times a vector."""
        rows = self.gradient[k]
        if rows is None:
            return mi.Vector3d(0.0)
        return mi.Vector3d(*(dr.dot(row, vector) for row in rows))


@dataclass(frozen=True, eq=False)
class CarriedDisplacements(Carried):
    """Displacements that are the same for all rays; ``plan``: tables, ``texels``: numbers as there."""

    plan: Tangents
    texels: tuple[mi.UInt32, ...]

    def moves(self, k: int, face: mi.UInt32, active: mi.Bool) -> mi.Bool:
        """See the base class."""
        return ((dr.gather(mi.UInt32, self.plan.moved, face, active) >> k) & 1) == 1
