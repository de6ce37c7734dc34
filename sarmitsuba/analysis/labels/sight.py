"""Lines of sight from points of surfaces: to the antenna, and to the sky."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64, unit_rows
from sarmitsuba.machine.backend import device_array, ensure_backend, mi
from sarmitsuba.tracing.kernel.intersector import clearance_of, intersector, query_ray

# rays traced at once
_RAYS = 2_000_000


class SightLines:
    """Triangles that may hide points.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    """

    def __init__(self, corners: F64) -> None:
        ensure_backend()
        # about their middle, where float32 is finest
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        self._middle = 0.5 * (low + high)
        self._scene = intersector((corners - self._middle).astype(np.float32))
        sides = corners[:, 1:] - corners[:, :1]
        normal = np.cross(sides[:, 0], sides[:, 1])
        self.normal = unit_rows(normal)
        self._clearance = clearance_of(float(np.abs(high - self._middle).max()))

    def hidden_by(self, point: F64, face: I64, antenna: F64) -> I64:
        """Row of the triangle that hides points (n, 3), m, of triangles (n,) from antennas (n, 3), m; -1 for none.

        A surface is seen from both sides.
        """
        line = antenna - point
        line = unit_rows(line)
        return self._meets_shape(point, self._side(face, line), line)

    def open_to_the_sky(self, point: F64, face: I64) -> NDArray[np.bool_]:
        """Whether nothing is above points (n, 3), m, of triangles (n,), on one side of the triangle or the other."""
        up = np.broadcast_to([0.0, 0.0, 1.0], point.shape)
        side = self._side(face, up)
        return np.asarray(
            (self._meets_shape(point, side, up) < 0) | (self._meets_shape(point, -side, up) < 0)
        )

    def _side(self, face: I64, direction: F64) -> F64:
        """Normals (n, 3) of triangles on the side that a direction (n, 3) points to."""
        normal = self.normal[face]
        away = np.einsum("ij,ij->i", normal, direction) < 0.0
        return np.asarray(np.where(away[:, None], -normal, normal))

    def _meets_shape(self, point: F64, side: F64, direction: F64) -> I64:
        start = (point + self._clearance * side - self._middle).astype(np.float32)
        to = direction.astype(np.float32)
        found = [np.zeros(0, dtype=np.int64)]
        for k in range(0, len(start), _RAYS):
            rays = query_ray(*(_vector(rows[k : k + _RAYS]) for rows in (start, to)))
            hit = self._scene.ray_intersect_preliminary(rays, coherent=True)
            row = np.asarray(hit.prim_index, dtype=np.int64)
            found.append(np.where(np.asarray(hit.is_valid(), dtype=bool), row, -1))
        return np.concatenate(found)


def _vector(rows: NDArray[np.float32]) -> "mi.Vector3f":
    """Rows (n, 3) as a Dr.Jit vector."""
    return mi.Vector3f(*(device_array(mi.Float, np.ascontiguousarray(column)) for column in rows.T))
