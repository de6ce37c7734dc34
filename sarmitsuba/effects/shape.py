"""Analysis of the geometry: proofs of a single bounce and of visibility, and small features that rays may miss."""

from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I32, I64
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.mesh.convexity import SLACK, face_edges, is_convex_body, merge_vertices, one_sided
from sarmitsuba.scene.mesh.facet_edges import enclosed_volume, is_closed
from sarmitsuba.scene.mesh.topology import label_connected

# products of planes and vertices that a proof may cost; 5e7 take about 0.2 s
_MAX_PRODUCTS = 50_000_000
# antenna positions at which the angles of all faces are examined; in between, they have a margin
_POSITIONS = 17
# faces up to which all pairs are examined
_MAX_FACING = 1500
# number of bounces possible only between faces opposite each other
DEEP = 8
# faces up to which edges are searched for
_MAX_FACES = 200_000


class ShapeAnalysis:
    """Properties of the visible geometry, each computed on first use.

    Parameters
    ----------
    geometry : of the scene
    visible : (n_materials,) bool, visible materials
    antenna : (n, 3) float64, m, positions along the aperture
    thorough : whether to attempt proofs; otherwise only properties stored in the geometry are used

    Notes
    -----
    A face counts with both sides: the kernel orients normals towards the ray.
    """

    def __init__(
        self, geometry: Geometry, visible: NDArray[np.bool_], antenna: F64, *, thorough: bool = True
    ) -> None:
        self.thorough = thorough
        keep = visible[geometry.face_material] if geometry.n_faces else np.zeros(0, dtype=bool)
        self.faces = geometry.faces[keep]
        self.material = geometry.face_material[keep] if geometry.n_faces else np.zeros(0, dtype=np.int32)
        self.mesh = np.repeat(np.arange(len(geometry.mesh_names)), np.diff(geometry.mesh_face_offset))[keep]
        self.vertices = geometry.vertices
        self.antenna = antenna
        self.stated_convex = _one_convex_mesh(geometry, keep)
        self.lone_mesh = len(geometry.mesh_convex) == 1  # loading has tried the proof

    @cached_property
    def points(self) -> F64:
        """Vertices of visible faces, (n, 3), m."""
        used = np.zeros(len(self.vertices), dtype=bool)
        used[self.faces] = True
        return np.asarray(self.vertices[used])

    @cached_property
    def size(self) -> float:
        """Longest edge of the bounds, m."""
        return float(np.ptp(self.points, axis=0).max()) if len(self.points) else 0.0

    @property
    def slack(self) -> float:
        """Tolerance of coplanarity, m: float64 rounding of a transformed mesh, float32 of a file."""
        return SLACK * self.size

    @property
    def n_faces(self) -> int:
        """Number of visible faces."""
        return int(self.faces.shape[0])

    @cached_property
    def normals(self) -> F64:
        """Unit normals (n_faces, 3); zero for degenerate faces."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        n = np.cross(b - a, c - a)
        length = np.linalg.norm(n, axis=1, keepdims=True)
        return np.asarray(n / np.where(length > 0, length, 1.0))

    @cached_property
    def areas(self) -> F64:
        """Areas (n_faces,), m^2."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))

    @cached_property
    def perimeters(self) -> F64:
        """Perimeters (n_faces,), m."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return np.asarray(sum(np.linalg.norm(side, axis=1) for side in (b - a, c - b, a - c)))

    @cached_property
    def planes(self) -> tuple[F64, F64]:
        """Distinct planes of the faces (of few, all): normals (n, 3) and offsets (n,), ``normal . x = offset``."""
        offset = np.einsum("ij,ij->i", self.normals, self.vertices[self.faces[:, 0]])
        if self.n_faces <= 64:
            return self.normals, offset
        sign = np.where(_first_nonzero(self.normals) < 0, -1.0, 1.0)
        rows = np.column_stack([self.normals * sign[:, None], offset * sign])
        step = np.array([1e-7, 1e-7, 1e-7, max(self.slack, 1e-9)])
        _, pick = np.unique(np.round(rows / step), axis=0, return_index=True)
        return rows[pick, :3], rows[pick, 3]

    @cached_property
    def _hull(self) -> F64:
        """Vertices of the convex hull (all vertices where there are few, or they are coplanar)."""
        if len(self.points) > 500:
            try:
                return np.asarray(self.points[scipy.spatial.ConvexHull(self.points).vertices])
            except scipy.spatial.QhullError:
                pass
        return self.points

    @cached_property
    def _one_sided(self) -> bool:
        """Whether the scene lies on one side of the planes of a few test faces.

        Every proof below needs this for all faces, and nearly every scene fails for the first few.
        """
        if self.n_faces == 0 or not self.thorough:
            return False
        return one_sided(self.normals, self.vertices[self.faces[:, 0]], self.points, self.slack)

    @cached_property
    def _plane_heights(self) -> tuple[F64, F64, F64, F64] | None:
        """Least and largest height of vertices and antenna over every plane; None where useless or too expensive."""
        if not self._one_sided:
            return None
        points = self._hull
        normal, offset = self.planes
        if len(offset) * len(points) > _MAX_PRODUCTS:
            return None
        low, high = np.empty(len(offset)), np.empty(len(offset))
        step = max(1, 4_000_000 // len(points))
        for i in range(0, len(offset), step):
            height = normal[i : i + step] @ points.T - offset[i : i + step, None]
            low[i : i + step], high[i : i + step] = height.min(axis=1), height.max(axis=1)
        antenna = normal @ self.antenna.T - offset[:, None]
        return low, high, antenna.min(axis=1), antenna.max(axis=1)

    @cached_property
    def flat(self) -> bool:
        """Whether the geometry lies in one plane."""
        heights = self._plane_heights
        return heights is not None and bool(
            (heights[0] >= -self.slack).all() and (heights[1] <= self.slack).all()
        )

    @cached_property
    def single_bounce(self) -> str:
        """Proof that no ray from the antenna can hit twice, as one phrase; empty when there is none.

        A reflected ray stays in the half space it came from. If nothing lies in that half space, for any face that can
        be hit, no ray hits again.
        """
        if self.n_faces == 0:
            return "no mesh to reflect rays"
        if self.convex_body:
            return "one closed convex body"
        heights = self._plane_heights
        if heights is None:
            return ""
        if self.flat:
            return "one flat surface cannot reflect onto itself"
        low, high, a_low, a_high = heights
        empty_above, empty_below = high <= self.slack, low >= -self.slack
        if not (empty_above | empty_below).all():
            return ""
        # hit from the empty side only: the antenna stays there, or the body is closed and the antenna outside
        outside = np.where(empty_above, a_low > -self.slack, True) & np.where(
            empty_below, a_high < self.slack, True
        )
        return "every face is convex towards the antenna" if outside.all() else ""

    def facing(self, *, both_sides: bool = False) -> bool:
        """Whether nearly parallel faces may be opposite each other, as those of a duct, a street or a slab and a wall.

        Between two planes at an angle a there are at most pi / a reflections: more than ``DEEP`` of them need faces
        that are opposite within ``pi / DEEP``. True where there are too many faces to examine.

        Parameters
        ----------
        both_sides : whether waves enter closed meshes

        Notes
        -----
        Ignores occlusion between the faces, and waves that creep along concave surfaces.
        """
        if self.n_faces > _MAX_FACING:
            return True
        corner = self.vertices[self.faces]
        middle = corner.mean(axis=1)
        reach = np.linalg.norm(corner - middle[:, None], axis=2).max(axis=1)
        outer = np.zeros(self.n_faces, dtype=bool) if both_sides else self._of_closed_meshes
        close, away = np.cos(np.pi / DEEP), middle[None] - middle[:, None]
        turned = self.normals @ self.normals.T
        height = np.einsum("ij,ikj->ik", self.normals, away)  # height of the second face over the first
        aside = np.sqrt(np.maximum(np.square(away).sum(axis=2) - np.square(height), 0.0))
        near = (np.abs(turned) > close) & (np.abs(height) > self.slack) & (aside < reach + reach[:, None])
        # the first face's side that the second is on, and the second's that the first is on, must be open
        near &= (~outer[:, None] | (height > 0.0)) & (~outer[None] | (height * turned < 0.0))
        return bool(near.any())

    @cached_property
    def _of_closed_meshes(self) -> NDArray[np.bool_]:
        """Mask (n_faces,) of faces of closed meshes with outward normals."""
        found = np.zeros(self.n_faces, dtype=bool)
        for number in np.unique(self.mesh):
            faces = self.faces[self.mesh == number]
            if is_closed(self.vertices, faces) and enclosed_volume(self.vertices, faces) > 0.0:
                found[self.mesh == number] = True
        return found

    @cached_property
    def convex_body(self) -> bool:
        """Whether the geometry is one closed convex body with the antenna outside, from loading or proven here."""
        if not self.stated_convex and (
            self.lone_mesh
            or not self._one_sided
            or self.n_faces > _MAX_FACES
            or not is_convex_body(self.vertices, self.faces)
        ):
            return False
        beyond = (self.antenna < self.points.min(axis=0)) | (self.antenna > self.points.max(axis=0))
        if beyond.any(axis=1).all():
            return True
        corner = self.vertices[self.faces[:, 0]]
        outward = np.sign(np.einsum("ij,ij->i", self.normals, corner - self.points.mean(axis=0)))
        normals = self.normals * outward[:, None]
        return all(
            bool((np.einsum("ij,ij->i", normals, p - corner) > self.slack).any()) for p in self.antenna
        )

    @cached_property
    def open_sight(self) -> bool:
        """Proof that no face can come between any point of the scene and the antenna.

        For every face, scene and antenna lie on the same side of its plane, so no straight line between the two crosses
        it.
        """
        heights = self._plane_heights
        if heights is None:
            return self.n_faces == 0
        low, high, a_low, a_high = heights
        above = (low >= -self.slack) & (a_low >= 0.0)
        below = (high <= self.slack) & (a_high <= 0.0)
        return bool((above | below).all())

    @cached_property
    def cosines(self) -> tuple[float, float]:
        """Least and largest cosine of the incidence angle on any face, mid-aperture and both ends."""
        if self.n_faces == 0 or not self.thorough:
            return 0.0, 1.0
        ends = self.antenna[[0, len(self.antenna) // 2, -1]]
        middle = self.vertices[self.faces].mean(axis=1)
        values = []
        for a in ends:
            ray = a - middle
            values.append(np.abs(np.einsum("ij,ij->i", ray, self.normals)) / np.linalg.norm(ray, axis=1))
        return float(np.min(values)), float(np.max(values))

    @cached_property
    def incidence_bounds(self) -> tuple[F64, F64, F64]:
        """Least sine, greatest and least cosine of the incidence angle over each face and the aperture, (n_faces,)."""
        pick = np.unique(
            np.linspace(0, len(self.antenna) - 1, min(len(self.antenna), _POSITIONS)).round().astype(int)
        )
        corners = self.vertices[self.faces]
        middle = corners.mean(axis=1)
        radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
        least, greatest = np.full(self.n_faces, 0.5 * np.pi), np.zeros(self.n_faces)
        previous = None
        for position in self.antenna[pick]:
            ray = position - middle
            distance = np.linalg.norm(ray, axis=1)
            unit = ray / distance[:, None]
            angle = np.arccos(np.clip(np.abs(np.einsum("ij,ij->i", unit, self.normals)), 0.0, 1.0))
            margin = np.arcsin(np.minimum(radius / distance, 1.0))
            if previous is not None:  # back to the line of sight from the position before
                margin = margin + 2.0 * np.arcsin(
                    np.minimum(0.5 * np.linalg.norm(unit - previous, axis=1), 1.0)
                )
            previous = unit
            least = np.minimum(least, np.maximum(angle - margin, 0.0))
            greatest = np.maximum(greatest, np.minimum(angle + margin, 0.5 * np.pi))
        return np.sin(least), np.cos(least), np.cos(greatest)

    # ---- connectivity

    @cached_property
    def _welded(self) -> I64:
        """Vertex numbers (n_faces, 3) after merging coincident vertices."""
        return merge_vertices(self.vertices, self.faces, self.slack)

    @cached_property
    def _edges(self) -> tuple[I64, F64]:
        """Pairs of faces that share an edge (n, 2), those edges' middles (n, 3)."""
        f = self._welded
        ends = np.sort(face_edges(f), axis=1)
        face = np.tile(np.arange(len(f)), 3)
        key = ends[:, 0] * (int(f.max()) + 1 if f.size else 1) + ends[:, 1]
        order = np.argsort(key, kind="stable")
        key, face = key[order], face[order]
        same = key[1:] == key[:-1]
        own = face_edges(self.faces)
        middle = self.vertices[own[order[:-1][same]]].mean(axis=1)
        return np.stack([face[:-1][same], face[1:][same]], axis=1), middle

    @cached_property
    def component(self) -> I32:
        """Number (n_faces,) of the connected piece of each face (faces that share a vertex are connected)."""
        if self.n_faces == 0 or self.n_faces > _MAX_FACES:
            return np.zeros(self.n_faces, dtype=np.int32)
        f = self._welded
        n = int(f.max()) + 1
        rows = np.concatenate([f[:, 0], f[:, 1]])
        columns = np.concatenate([f[:, 1], f[:, 2]])
        _, number = np.unique(label_connected(n, rows, columns)[f[:, 0]], return_inverse=True)
        return np.asarray(number.reshape(-1), dtype=np.int32)

    @property
    def n_components(self) -> int:
        """Number of connected pieces."""
        return int(self.component.max()) + 1 if self.n_faces else 0

    @cached_property
    def features(self) -> tuple[F64, F64]:
        """Small features that may return more than one bounce: points (n, 3) and sizes (n,), m.

        The size bounds the return: the flat-plate RCS is 4 pi size^4 / lambda^2. Every connected piece, and every
        concave edge (with the smaller of its two faces' heights over the edge), largest first.
        """
        if self.n_faces < 2 or self.n_faces > _MAX_FACES:
            return np.zeros((0, 3)), np.zeros(0)
        middle = self.vertices[self.faces].mean(axis=1)
        points, sizes = [], []
        if self.n_components > 1:
            total = np.bincount(self.component, self.areas)
            centre = np.stack(
                [np.bincount(self.component, self.areas * middle[:, i]) for i in range(3)], axis=1
            )
            with np.errstate(invalid="ignore", divide="ignore"):
                centre = np.where(total[:, None] > 0, centre / total[:, None], 0.0)
            points.append(centre)
            sizes.append(np.sqrt(0.5 * total))  # about half of a closed body is visible
        first, second = self._edges[0].T
        if len(first):
            n1, n2 = self.normals[first], self.normals[second]
            # faces whose planes intersect at less than 20 degrees have no significant double bounce
            bend = np.linalg.norm(np.cross(n1, n2), axis=1) > 0.34
            across = middle[second] - middle[first]
            towards = self.antenna[len(self.antenna) // 2] - middle[first]
            facing = np.sign(np.einsum("ij,ij->i", n1, towards))
            concave = bend & (np.einsum("ij,ij->i", n1, across) * facing > self.slack)
            i, j = first[concave], second[concave]
            height = np.minimum(np.sqrt(self.areas[i]), np.sqrt(self.areas[j]))
            points.append(self._edges[1][concave])
            sizes.append(height)
        if not points:
            return np.zeros((0, 3)), np.zeros(0)
        p, s = np.concatenate(points), np.concatenate(sizes)
        order = np.argsort(-s, kind="stable")
        return np.asarray(p[order]), np.asarray(s[order])


def _one_convex_mesh(geometry: Geometry, visible: NDArray[np.bool_]) -> bool:
    """Whether the visible geometry is one whole mesh found convex during loading."""
    if not any(geometry.mesh_convex):
        return False
    seen = [
        (convex, visible[start:stop])
        for convex, start, stop in zip(
            geometry.mesh_convex, geometry.mesh_face_offset[:-1], geometry.mesh_face_offset[1:], strict=True
        )
        if visible[start:stop].any()
    ]
    return len(seen) == 1 and seen[0][0] and bool(seen[0][1].all())


def _first_nonzero(rows: F64) -> F64:
    """First component of each row that is not nearly zero."""
    big = np.abs(rows) > 1e-6
    return np.asarray(rows[np.arange(len(rows)), np.argmax(big, axis=1)])
