"""Derivatives of echoes by parameters, carried along their paths and recorded beside the echoes.

An echo of amplitude a and slant range R is :math:`a \\, e^{-j 4 \\pi f R / c}` at the frequency f. Its derivative by a
parameter needs :math:`a \\, \\partial R`, :math:`\\partial a`, or both. The kernel records each of these as further
channels of the echo's own cells, so that one traced path serves all parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.arrays import F64
from sarmitsuba.backend import dr, mi
from sarmitsuba.trace.device_arrays import device_array
from sarmitsuba.trace.movement import (
    Movement,
    ShadowBoundary,
)  # at run time: Dr.Jit reads the types of loop states

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sarmitsuba.trace.kernel import Accumulator, LaneArrays
    from sarmitsuba.trace.state import Contribution, Hit, Kernel, Lane, RayState
    from sarmitsuba.trace.variants import Property, Variants

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
    """

    antenna: F64
    faces: NDArray[np.bool_] | None = None
    offset: F64 | None = None
    gradient: F64 | None = None


@dataclass
class RayTangents:
    """Part of a ray's state: velocities of its virtual antenna and shadow boundary, for each displacement.

    Parameters
    ----------
    virtual : float64, m per unit, of the antenna mirrored through the chain so far
    boundary : of the lit area; None for displacements of the antenna alone
    """

    virtual: tuple[mi.Vector3d, ...]
    boundary: tuple[ShadowBoundary | None, ...]


@dataclass(frozen=True, eq=False)
class Tangents:
    """What the kernel records beside every echo: first displacements, then levels, then properties of materials.

    Parameters
    ----------
    displacements : each gives the channels times the derivative of the slant range
    levels : numbers of the materials whose diffuse return has a common level in dB; each gives the derivative of the
        channels
    moved : (n_faces,) bit k: the face is moved by displacement k
    levelled : (n_materials,) bit k: level k applies to the material
    properties : of materials; each gives the derivative of the channels
    """

    displacements: tuple[Displacement, ...]
    levels: tuple[frozenset[int], ...]
    moved: mi.UInt32
    levelled: mi.UInt32
    properties: tuple[Property, ...] = ()

    @staticmethod
    def of(
        displacements: Sequence[Displacement],
        levels: Sequence[frozenset[int]],
        n_faces: int,
        n_materials: int,
        properties: Sequence[Property] = (),
    ) -> Tangents:
        """Tables of these parameters on the device."""
        assert len(displacements) <= MOST and len(levels) <= MOST
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
        )

    @property
    def count(self) -> int:
        """Number of derivatives of each channel."""
        return len(self.displacements) + len(self.levels) + len(self.properties)

    def variants(self, kernel: Kernel) -> Variants | None:
        """Variants of a kernel with other materials; None without properties."""
        from sarmitsuba.trace.variants import Variants

        return Variants.of(kernel, self.properties) if self.properties else None

    def carried(self) -> Carried:
        """Numbers for one kernel, as opaque scalars: other values do not compile another kernel."""
        return Carried(
            self,
            tuple(_vector(d.antenna) for d in self.displacements),
            tuple(None if d.offset is None else _vector(d.offset) for d in self.displacements),
            tuple(
                None if d.gradient is None else tuple(_vector(row) for row in d.gradient)
                for d in self.displacements
            ),
        )


def _vector(values: F64) -> mi.Vector3d:
    return mi.Vector3d(*(dr.opaque(mi.Float64, float(x)) for x in values))


@dataclass(frozen=True, eq=False)
class Carried:
    """Tangents within a kernel.

    Parameters
    ----------
    plan : tables
    antenna, offset, gradient : of each displacement, see :class:`Displacement`; None where nothing of it moves
    """

    plan: Tangents
    antenna: tuple[mi.Vector3d, ...]
    offset: tuple[mi.Vector3d | None, ...]
    gradient: tuple[tuple[mi.Vector3d, ...] | None, ...]

    def launched(self) -> RayTangents:
        """State of a ray at launch."""
        return RayTangents(
            tuple(mi.Vector3d(a) for a in self.antenna),
            tuple(None if b is None else ShadowBoundary.open() for b in self.offset),
        )

    def movement(self, k: int, face: mi.UInt32, point: mi.Vector3d, active: mi.Bool) -> Movement | None:
        """Movement of a point of a face by displacement k, m per unit; None where no face moves."""
        offset = self.offset[k]
        if offset is None:
            return None
        velocity = offset + self._turned(k, point)
        still = mi.Vector3d(0.0)
        return Movement(still, dr.select(self._bit(k, face, active), velocity, still))

    def _bit(self, k: int, face: mi.UInt32, active: mi.Bool) -> mi.Bool:
        return ((dr.gather(mi.UInt32, self.plan.moved, face, active) >> k) & 1) == 1

    def _turned(self, k: int, vector: mi.Vector3d) -> mi.Vector3d:
        """A times a vector."""
        rows = self.gradient[k]
        if rows is None:
            return mi.Vector3d(0.0)
        return mi.Vector3d(*(dr.dot(row, vector) for row in rows))

    def _normal_rate(self, k: int, hit: Hit, n: mi.Vector3d) -> mi.Vector3d | None:
        r"""Derivative of a facet's unit normal, :math:`-A^T n + n (n \cdot A n)`; None where it is zero."""
        rows = self.gradient[k]
        if rows is None:
            return None
        pulled = rows[0] * n.x + rows[1] * n.y + rows[2] * n.z
        rate = n * dr.dot(n, pulled) - pulled
        return dr.select(self._bit(k, hit.face, hit.active), rate, mi.Vector3d(0.0))

    def mirrored(self, ray: RayState, hit: Hit, n: mi.Vector3d) -> RayTangents:
        r"""State of the ray reflected at a hit.

        The image :math:`A' = A - 2 n \, (A - p) \cdot n` of the antenna in a facet that moves and turns has the
        velocity :math:`\dot A - 2 n \, (\dot A - \dot p) \cdot n - 2 \dot n \, (A - p) \cdot n
        - 2 n \, (A - p) \cdot \dot n`.
        """
        assert ray.tangents is not None
        from_hit = ray.virtual_antenna - hit.p
        virtual, boundaries = [], []
        for k, (velocity, boundary) in enumerate(
            zip(ray.tangents.virtual, ray.tangents.boundary, strict=True)
        ):
            movement = self.movement(k, hit.face, hit.p, hit.active)
            towards = velocity if movement is None else velocity - movement.velocity
            image = velocity - n * (2.0 * dr.dot(towards, n))
            turn = self._normal_rate(k, hit, n)
            if turn is not None:
                image -= 2.0 * (turn * dr.dot(from_hit, n) + n * dr.dot(from_hit, turn))
            virtual.append(image)
            if boundary is not None and movement is not None:
                boundary = boundary.at(movement, hit.largest_cell).mirrored(movement, n)
            boundaries.append(boundary)
        return RayTangents(tuple(virtual), tuple(boundaries))

    def of_tube(self, ray: RayState, hit: Hit, rim: mi.Vector3d) -> tuple[mi.Float64, ...]:
        """Derivatives of the slant range of a tube's coherent return, m per unit.

        ``rim`` : m, phase centre of the return from the hit, in the facet's plane
        """
        assert ray.tangents is not None
        found = []
        d, s = hit.direction64, hit.to_antenna64
        across_out, across_back = rim - d * dr.dot(rim, d), rim - s * dr.dot(rim, s)
        for k, (virtual, boundary) in enumerate(
            zip(ray.tangents.virtual, ray.tangents.boundary, strict=True)
        ):
            antenna = self.antenna[k]
            movement = self.movement(k, hit.face, hit.p + rim, hit.active)
            if movement is not None and boundary is not None:
                # tubes tile the lit area: their common sides move with its boundary
                patch = boundary.at(movement, hit.largest_cell).on(movement, d, hit.normal64)
                antenna, virtual = antenna - patch, virtual - patch
            rate = dr.dot(s, antenna) - dr.dot(d, virtual)
            rate -= dr.dot(across_out, virtual) / hit.length + dr.dot(across_back, antenna) / hit.length_back
            found.append(0.5 * rate)
        return tuple(found)

    def of_scatterer(
        self, ray: RayState, hit: Hit, lane: Lane, centre: mi.Vector3d
    ) -> tuple[tuple[mi.Float64, ...], tuple[mi.Float64, ...]]:
        """Derivatives of a diffuse scatterer's slant range: straight to the antenna, and back through the mirrors."""
        assert ray.tangents is not None
        out, back = dr.normalize(centre - ray.virtual_antenna), dr.normalize(lane.antenna - centre)
        straight, reciprocal = [], []
        for k, virtual in enumerate(ray.tangents.virtual):
            antenna = self.antenna[k]
            movement = self.movement(k, hit.face, centre, hit.active)
            if movement is not None:
                antenna, virtual = antenna - movement.velocity, virtual - movement.velocity
            leg = -dr.dot(out, virtual)
            reciprocal.append(leg)
            straight.append(0.5 * (leg + dr.dot(back, antenna)))
        return tuple(straight), tuple(reciprocal)

    def recording(self, accumulator: Accumulator) -> Accumulator:
        """Accumulator that records the derivatives of every echo behind its channels."""
        return _WithTangents(self, accumulator)

    def amplitudes(self, echo: Contribution) -> tuple[mi.Complex2f, ...]:
        """Channels of an echo and their derivatives."""
        assert echo.range_tangents is not None and echo.material is not None
        out = list(echo.amplitudes)
        for rate in echo.range_tangents:
            out += [a * mi.Float(rate) for a in echo.amplitudes]
        if self.plan.levels:
            known = echo.material != NO_MATERIAL
            bits = dr.gather(mi.UInt32, self.plan.levelled, echo.material, echo.active & known)
            for k in range(len(self.plan.levels)):
                per_db = dr.select(known & (((bits >> k) & 1) == 1), mi.Float(PER_DB), 0.0)
                out += [a * per_db for a in echo.amplitudes]
        return (*out, *(echo.amplitude_tangents or ()))


class _WithTangents:
    """Accumulator with tangents; see :class:`sarmitsuba.trace.kernel.Accumulator`."""

    def __init__(self, carried: Carried, accumulator: Accumulator) -> None:
        self.carried, self.accumulator = carried, accumulator

    def begin(self) -> LaneArrays:
        return self.accumulator.begin()

    def add(self, state: LaneArrays, contribution: Contribution) -> LaneArrays:
        return self.accumulator.add(
            state, replace(contribution, amplitudes=self.carried.amplitudes(contribution))
        )
