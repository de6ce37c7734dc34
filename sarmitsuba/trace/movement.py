"""Shapes that move: where their faces stand at a time, and how fast, for the kernel to gather."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.backend import device_array, dr, mi
from sarmitsuba.scene.motion import Motion

if TYPE_CHECKING:
    from sarmitsuba.scene.geometry import Geometry

F64 = NDArray[np.float64]
# numbers of a motion's row: displacement and a zero, velocity and a zero
ROW = 8
# cosine of incidence down to which a shadow boundary moves as fast as it does
LEAST_COSINE = 0.05


@dataclass(frozen=True, eq=False)
class Movers:
    """The motions in a scene, and the faces that have them.

    Parameters
    ----------
    motions : distinct ones; number 0 is rest
    number : (n_faces,) uint32, of each face's motion
    triangles : (n_faces, 3, 3) float64, m, at time zero
    time : s, of the state below
    face_number : ``number`` on the device
    state : (8 n_motions,) float64 on the device: displacement (m) and velocity (m/s) of each at ``time``
    """

    motions: tuple[Motion, ...]
    number: NDArray[np.uint32]
    triangles: F64
    time: float
    face_number: mi.UInt32
    state: mi.Float64

    @staticmethod
    def of(geometry: Geometry, rows: NDArray[np.intp]) -> Movers | None:
        """Movers among some faces of a geometry, at time zero; None where all of them rest."""
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

    def at(self, time: float) -> Movers:
        """The same at another time, s."""
        return replace(self, time=time, state=_state(self.motions, time))

    def corners(self) -> F64:
        """(n_faces, 3, 3) float64, m: the triangles where they stand."""
        offset = np.stack([motion.displacement(self.time) for motion in self.motions])
        return np.asarray(self.triangles + offset[self.number][:, None])

    def apart(self, vertex: NDArray[np.int64]) -> NDArray[np.int64]:
        """Labels (3 n_faces,) of corners, such that faces which move differently share none."""
        label = vertex * len(self.motions) + np.repeat(self.number, 3)
        return np.asarray(np.unique(label, return_inverse=True)[1].reshape(-1), dtype=np.int64)

    def of_face(self, face: mi.UInt32, active: mi.Bool) -> Movement:
        """What a face does, in a kernel."""
        number = dr.gather(mi.UInt32, self.face_number, face, active)
        shift, velocity = (dr.gather(mi.Vector4d, self.state, number * 2 + i, active) for i in range(2))
        return Movement(
            mi.Vector3d(shift[0], shift[1], shift[2]), mi.Vector3d(velocity[0], velocity[1], velocity[2])
        )


@dataclass(frozen=True, eq=False)
class Movement:
    """Displacement (float64, m) and velocity (float64, m/s) of a face at the time of a launch."""

    shift: mi.Vector3d
    velocity: mi.Vector3d

    def plus(self, other: Movement) -> Movement:
        """Both together: of what moves on a face that moves."""
        return Movement(self.shift + other.shift, self.velocity + other.velocity)


@dataclass  # not frozen: part of a loop's state, which Dr.Jit writes to
class ShadowBoundary:
    """What bounds the light of a chain of mirrors: the smallest piece of surface on the way.

    Parameters
    ----------
    velocity : float64, m/s, of that piece as seen through the mirrors behind it
    size : of the piece, m

    Notes
    -----
    Tubes tile the patch and their common sides must go the same way, so that all tubes of a chain follow one shadow
    boundary. Ignores that the patch may end at several pieces that move differently.
    """

    velocity: mi.Vector3d
    size: mi.Float

    @staticmethod
    def open() -> ShadowBoundary:
        """Before the first hit."""
        return ShadowBoundary(dr.zeros(mi.Vector3d), mi.Float(dr.inf))

    def at(self, movement: Movement, size: mi.Float) -> ShadowBoundary:
        """The shadow boundary on a facet that was hit."""
        own = size <= self.size
        return ShadowBoundary(dr.select(own, movement.velocity, self.velocity), dr.minimum(size, self.size))

    def on(self, movement: Movement, direction: mi.Vector3d, normal: mi.Vector3d) -> mi.Vector3d:
        r"""Velocity (m/s) of the lit patch of a facet: of the shadow boundary, cast along the ray.

        .. math:: \mathbf u = \mathbf r + \mathbf d
                  \frac{\mathbf n \cdot (\mathbf w - \mathbf r)}{\mathbf n \cdot \mathbf d}

        Parameters
        ----------
        movement : of the facet, at w
        direction, normal : of the ray, d, and of the facet, n, facing it
        """
        # along a facet that is hardly lit there is no telling
        facing = dr.minimum(dr.dot(normal, direction), -LEAST_COSINE)
        behind = dr.dot(normal, movement.velocity - self.velocity) / facing
        return self.velocity + direction * behind

    def mirrored(self, movement: Movement, normal: mi.Vector3d) -> ShadowBoundary:
        """The shadow boundary as seen through a mirror that moves."""
        velocity = self.velocity - normal * (2.0 * dr.dot(self.velocity - movement.velocity, normal))
        return ShadowBoundary(velocity, self.size)


def _state(motions: tuple[Motion, ...] | list[Motion], time: float) -> mi.Float64:
    rows = np.zeros((len(motions), ROW))
    for row, motion in zip(rows, motions, strict=True):
        row[:3], row[4:7] = motion.displacement(time), motion.velocity_at(time)
    return device_array(mi.Float64, rows)


__all__ = ["Movement", "Movers", "ShadowBoundary"]
