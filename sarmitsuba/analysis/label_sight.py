"""Lines of sight from points of surfaces to the antenna and to the sky, and the shapes that are ground.

An echo over the ground belongs to the other shape on its path.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64, unit_rows
from sarmitsuba.machine.backend import device_array, ensure_backend, mi
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.scene import Scene
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


# semantic classes that are ground whatever the shape looks like
GROUND_CLASSES = ("ground", "terrain", "water", "road", "soil", "grass", "field", "sea")
# least share of a ground shape's area that is inclined by less than 45 degrees
LEVEL_SHARE = 0.9
# depth to another shape below, m, from which on a shape does not lie on the ground but over it
DEPTH = 0.5
# largest share of places over something else
OVER = 0.1
# places on a shape, and shapes passed below each of them
PLACES, PASSED = 64, 4


def ground_shapes(scene: Scene, classes: Mapping[str, str]) -> NDArray[np.bool_]:
    """Whether each object is ground, (n_objects,).

    A shape is ground by its class (``GROUND_CLASSES``), and where it has no class: if it goes on without end, or if
    ``LEVEL_SHARE`` of its area is inclined by less than 45 degrees and it lies over no other shape: at most ``OVER`` of
    its area has another one more than ``DEPTH`` below. A bridge's deck and a flat roof of their own shapes lie over
    others; a road on the terrain does not. Buildings and terrain in one shape are not ground.

    Parameters
    ----------
    scene : as loaded
    classes : of shapes, by name
    """
    geometry = scene.geometry
    n = len(geometry.object_names)
    out = np.zeros(n, dtype=bool)
    if not geometry.n_faces:
        return out
    corners = geometry.vertices[geometry.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    level = np.abs(normal[:, 2]) > np.sqrt(0.5) * area
    of_face = geometry.face_object
    whole = np.bincount(of_face, area, n)
    flat = np.bincount(of_face, area * level, n) >= LEVEL_SHARE * np.maximum(whole, 1e-300)
    sight = SightLines(corners)
    endless = set(geometry.mesh_object[np.flatnonzero(geometry.mesh_endless)].tolist())
    for i, name in enumerate(geometry.object_names):
        if name in classes:
            out[i] = classes[name] in GROUND_CLASSES
        elif i in endless:
            out[i] = True
        elif flat[i] and whole[i] > 0.0:
            place, face = surface_samples(geometry, i, PLACES)
            out[i] = np.mean(_lies_over_another(sight, geometry, corners, place, face, i)) <= OVER
    return out


def _lies_over_another(
    sight: SightLines, geometry: Geometry, corners: F64, place: F64, face: I64, number: int
) -> NDArray[np.bool_]:
    """Whether another object is more than ``DEPTH`` below places (n, 3), m, on faces (n,) of one."""
    height, going = place[:, 2].copy(), np.arange(len(place))
    out = np.zeros(len(place), dtype=bool)
    of_face = geometry.face_object
    for _ in range(PASSED):
        below = place[going].copy()
        below[:, 2] -= 1e5
        met = sight.hidden_by(place[going], face[going], below)
        going, met = going[met >= 0], met[met >= 0]
        if not going.size:
            break
        a, side = corners[met, 0], corners[met, 1:] - corners[met, :1]
        across = np.cross(side[:, 0], side[:, 1])
        place[going, 2] = a[:, 2] - np.einsum(
            "ni,ni->n", across[:, :2], place[going, :2] - a[:, :2]
        ) / np.where(across[:, 2] == 0.0, 1e-300, across[:, 2])
        face[going] = met
        other = of_face[met] != number
        out[going] |= other & (height[going] - place[going, 2] > DEPTH)
        going = going[~other]
    return out


def surface_samples(geometry: Geometry, number: int, n: int) -> tuple[F64, I64]:
    """Points (n, 3), m, spread evenly over the area of an object at time zero, and the faces (n,) that they lie on."""
    rows = geometry.faces_of_object(number)
    corners = geometry.vertices[geometry.faces[rows]]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    total = np.cumsum(area)
    if not total.size or total[-1] <= 0.0:
        return np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    i = np.arange(n)
    own = np.searchsorted(total, (i + 0.5) / n * total[-1])
    # points of the plastic number's lattice fill a square evenly, folded onto the triangle
    u, v = (i * 0.7548776662466927 + 0.5) % 1.0, (i * 0.5698402909980532 + 0.5) % 1.0
    u, v = np.where(u + v > 1.0, 1.0 - u, u)[:, None], np.where(u + v > 1.0, 1.0 - v, v)[:, None]
    a = corners[own]
    return a[:, 0] + u * (a[:, 1] - a[:, 0]) + v * (a[:, 2] - a[:, 0]), rows[own]
