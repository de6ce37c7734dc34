"""Moving shapes: positions and velocities of their faces at a time, as tables for the kernel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64, U32
from sarmitsuba.machine.backend import device_array, dr, mi
from sarmitsuba.scene.motion import Motion

if TYPE_CHECKING:
    from sarmitsuba.scene.geometry import Geometry

# numbers of a motion's row: displacement and a zero, velocity and a zero
ROW = 8
# cosine of incidence below which the velocity of a shadow boundary is held
LEAST_COSINE = 0.05


@dataclass(frozen=True, eq=False)
class Movers:
    """Motions in a scene and the faces to which they apply.

    Parameters
    ----------
    motions : distinct motions; number 0 is rest
    number : (n_faces,) uint32, of each face's motion
    triangles : (n_faces, 3, 3) float64, m, at time zero
    time : s, of the state below
    face_number : ``number`` on the device
    state : (8 n_motions,) float64 on the device: displacement (m) and velocity (m/s) of each at ``time``
    deformations : of shapes that were displaced once and are at rest, the same at all times; ``motions`` is then empty:
        (24 n,) float64 on the device, rows of each matrix and of its inverse, with a zero each; None: of moving shapes
    """

    motions: tuple[Motion, ...]
    number: U32
    triangles: F64
    time: float
    face_number: mi.UInt32
    state: mi.Float64
    deformations: mi.Float64 | None = None

    @staticmethod
    def of(geometry: Geometry, rows: NDArray[np.intp]) -> Movers | None:
        """Motions of some faces of a geometry, at time zero; None where all of them are at rest."""
        motions, number = [Motion()], np.zeros(geometry.n_faces, dtype=np.uint32)
        for motion, faces in geometry.moving_meshes():
            if motion not in motions:
                motions.append(motion)
            number[faces] = motions.index(motion)
        number = number[rows]
        if not number.any():
            return None
        triangles = geometry.vertices[geometry.faces[rows]]
        return Movers(
            tuple(motions), number, triangles, 0.0, device_array(mi.UInt32, number), _state(motions, 0.0)
        )

    @staticmethod
    def displaced(triangles: F64, number: U32, matrices: F64, offsets: F64) -> Movers:
        """Faces at rest that were displaced, stretched or turned with their diffuse scatterers.

        Parameters
        ----------
        triangles : (n_faces, 3, 3) float64, m, displaced
        number : (n_faces,) uint32, of each face's row of the others
        matrices, offsets : (n, 3, 3) and (n, 3) float64, 1 and m: a point p came to ``matrix p + offset``
        """
        state = np.zeros((len(offsets), ROW))
        state[:, :3] = offsets
        rows = np.zeros((len(offsets), 6, 4))
        rows[:, :3, :3], rows[:, 3:, :3] = matrices, np.linalg.inv(matrices)
        tables = device_array(mi.UInt32, number), device_array(mi.Float64, state)
        return Movers((), number, triangles, 0.0, *tables, device_array(mi.Float64, rows))

    def at(self, time: float) -> Movers:
        """The same at another time, s."""
        return replace(self, time=time, state=_state(self.motions, time))

    def corners(self) -> F64:
        """Corners (n_faces, 3, 3) of the triangles at ``time``, float64, m."""
        offset = np.stack([motion.displacement(self.time) for motion in self.motions])
        return np.asarray(self.triangles + offset[self.number][:, None])

    def apart(self, vertex: I64) -> I64:
        """Labels (3 n_faces,) of corners; faces with different motions share none."""
        label = vertex * len(self.motions) + np.repeat(self.number, 3)
        return np.asarray(np.unique(label, return_inverse=True)[1].reshape(-1), dtype=np.int64)

    def of_face(self, face: mi.UInt32, active: mi.Bool) -> Movement:
        """Movement of a face, in a kernel."""
        number = dr.gather(mi.UInt32, self.face_number, face, active)
        shift, velocity = (dr.gather(mi.Vector4d, self.state, number * 2 + i, active) for i in range(2))
        deformation = None
        if self.deformations is not None:
            found = (dr.gather(mi.Vector4d, self.deformations, number * 6 + i, active) for i in range(6))
            deformation = tuple(mi.Vector3d(row[0], row[1], row[2]) for row in found)
        return Movement(
            mi.Vector3d(shift[0], shift[1], shift[2]),
            mi.Vector3d(velocity[0], velocity[1], velocity[2]),
            deformation,
        )


@dataclass(frozen=True, eq=False)
class Movement:
    """Displacement (float64, m) and velocity (float64, m/s) of a face at the time of a launch.

    ``deformation`` : rows of the matrix by which the face was stretched or turned, then of its inverse; None: neither
    """

    shift: mi.Vector3d
    velocity: mi.Vector3d
    deformation: tuple[mi.Vector3d, ...] | None = None

    def plus(self, other: Movement) -> Movement:
        """Sum of two movements: of an object that moves on a moving face."""
        return Movement(self.shift + other.shift, self.velocity + other.velocity, self.deformation)

    def at_rest(self, point: mi.Vector3d) -> mi.Vector3d:
        """Place of a point of the face before it was displaced."""
        point = point - self.shift
        return point if self.deformation is None else _times(self.deformation[3:], point)

    def displaced(self, point: mi.Vector3d) -> mi.Vector3d:
        """Place of a point of the face that it had before it was displaced."""
        return (point if self.deformation is None else _times(self.deformation[:3], point)) + self.shift

    def direction_at_rest(self, vector: mi.Vector3d) -> mi.Vector3d:
        """Vector in the face, as it was before the face was stretched or turned."""
        return vector if self.deformation is None else _times(self.deformation[3:], vector)

    def normal_at_rest(self, normal: mi.Vector3d) -> mi.Vector3d:
        """Unit normal of the face, as it was before the face was stretched or turned."""
        if self.deformation is None:
            return normal
        rows = self.deformation[:3]
        return dr.normalize(rows[0] * normal.x + rows[1] * normal.y + rows[2] * normal.z)


@dataclass  # not frozen: part of a loop's state, which Dr.Jit writes to
class ShadowBoundary:
    """Shadow boundary of the area lit by a chain of mirrors: the outline of the smallest piece of surface on the path.

    Parameters
    ----------
    velocity : float64, m/s, of that piece, mirrored in the facets hit after it
    size : of the piece, m

    Notes
    -----
    Tubes tile the lit patch and their common sides must move together, so all tubes of a chain use one boundary.
    Ignores that the patch may be bounded by several pieces that move differently.
    """

    velocity: mi.Vector3d
    size: mi.Float

    @staticmethod
    def open() -> ShadowBoundary:
        """Shadow boundary before the first hit."""
        return ShadowBoundary(dr.zeros(mi.Vector3d), mi.Float(dr.inf))

    def at(self, movement: Movement, size: mi.Float) -> ShadowBoundary:
        """Shadow boundary after a hit: the outline of the facet's piece of surface if that is smaller."""
        own = size <= self.size
        return ShadowBoundary(dr.select(own, movement.velocity, self.velocity), dr.minimum(size, self.size))

    def on(self, movement: Movement, direction: mi.Vector3d, normal: mi.Vector3d) -> mi.Vector3d:
        r"""Velocity (m/s) of the lit patch of a facet: of the shadow boundary, projected along the ray.

        .. math:: \mathbf u = \mathbf r + \mathbf d
                  \frac{\mathbf n \cdot (\mathbf w - \mathbf r)}{\mathbf n \cdot \mathbf d}

        Parameters
        ----------
        movement : of the facet, at w
        direction, normal : of the ray, d, and of the facet, n, facing it
        """
        # undefined at grazing incidence
        facing = dr.minimum(dr.dot(normal, direction), -LEAST_COSINE)
        behind = dr.dot(normal, movement.velocity - self.velocity) / facing
        return self.velocity + direction * behind

    def mirrored(self, movement: Movement, normal: mi.Vector3d) -> ShadowBoundary:
        """Shadow boundary mirrored in a moving facet."""
        velocity = self.velocity - normal * (2.0 * dr.dot(self.velocity - movement.velocity, normal))
        return ShadowBoundary(velocity, self.size)


def _times(rows: tuple[mi.Vector3d, ...], vector: mi.Vector3d) -> mi.Vector3d:
    """Matrix of three rows times a vector."""
    return mi.Vector3d(*(dr.dot(row, vector) for row in rows))


def _state(motions: tuple[Motion, ...] | list[Motion], time: float) -> mi.Float64:
    rows = np.zeros((len(motions), ROW))
    for row, motion in zip(rows, motions, strict=True):
        row[:3], row[4:7] = motion.displacement(time), motion.velocity_at(time)
    return device_array(mi.Float64, rows)
