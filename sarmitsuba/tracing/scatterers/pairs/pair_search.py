r"""Random pairs of mutually visible diffuse scatterers, fixed to the scene.

A pair is a point A of a surface and the point B where a ray from A hits. The direction of the ray is a random number
hashed from A's cell: half of the rays follow the cosine law, half are uniform over the hemisphere. The density of the
unordered pair {A, B}, per m^2 of surface at either end, is the sum over both orders,

.. math::
    p = \left[ d_A f(c_A) c_B + d_B f(c_B) c_A \right] / r^2, \quad
    f(c) = \frac{1}{2} \left( \frac{c}{\pi} + \frac{1}{2 \pi} \right)

with the distance r, the cosines :math:`c` of the angles between each normal and the other end, and the densities
:math:`d` of points, 1/m^2. :attr:`SurfacePairs.weight` is :math:`1 / \sqrt{4 \pi r^2 p}`: r cancels, so that
close pairs across a corner do not dominate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, U32
from sarmitsuba.machine.backend import device_array, dr, mi
from sarmitsuba.scene.mesh.surface_samples import SurfaceSamples
from sarmitsuba.tracing.kernel.device_arrays import vector_rows
from sarmitsuba.tracing.kernel.intersector import intersector, leave_surface, query_ray
from sarmitsuba.tracing.kernel.leg import Surroundings
from sarmitsuba.tracing.kernel.propagation import hit_point
from sarmitsuba.tracing.kernel.scattering_matrix import diffuse_lookup
from sarmitsuba.tracing.kernel.scene_tables import MATERIAL_MASK
from sarmitsuba.tracing.kernel.speckle import mix
from sarmitsuba.tracing.kernel.table_rows import FaceRow, MaterialRow

# bits of a key used for a random number
BITS = 24
# cosine between normal and direction above which a surface faces it
FACING = 1e-7


@dataclass(frozen=True, eq=False)
class SurfacePairs:
    """Distinct pairs of surface points.

    Parameters
    ----------
    point : (n, 2, 3) float64, m, scene frame; of both ends
    normal : (n, 2, 3) float64, unit normals on the sides that see each other
    face : (n, 2) rows of the scene's tables
    weight : (n,) float64, m^2, factor on the product of the square roots of sigma0 of both ends
    key : (n,) uint32, hash
    clutter, cross : m^2, co-polar and cross-polar cross section of single scattering by the points, for the middle view
    """

    point: F64
    normal: F64
    face: NDArray[np.intp]
    weight: F64
    key: U32
    clutter: float
    cross: float = 0.0

    @property
    def n(self) -> int:
        """Number of pairs."""
        return int(self.weight.size)


def find_pairs(
    around: Surroundings,
    samples: SurfaceSamples,
    views: F64,
    cell: float,
    box: F64,
    *,
    seed: int = 0,
    scatters: NDArray[np.bool_] | None = None,
) -> SurfacePairs:
    """Draw one partner for each point, and keep the pairs of which each end is visible from some view.

    Parameters
    ----------
    around : geometry at rest with its occlusion and transmission
    samples : points of faces of the scene
    views : (n, 3) m, antenna positions; the middle one is that of ``SurfacePairs.clutter``
    cell, box : of the samples, m
    seed : of textures
    scatters : (n_faces,) whether a face may be an end; None: all may

    Notes
    -----
    Leaves out pairs with an end visible only from positions between the views, and pairs that see each other through a
    slab which itself scatters diffusely.
    """
    sides = _facing(samples, views)
    index = np.concatenate([np.flatnonzero(side) for side in sides])
    sign = np.repeat([1.0, -1.0], [int(side.sum()) for side in sides])
    if not index.size:
        return _none()
    normal = samples.normal[index] * sign[:, None]
    key = samples.key[index] ^ np.where(sign > 0.0, 0, 0x5BD1E995).astype(np.uint32)
    return _search(around, samples, index, normal, key.astype(np.uint32), views, cell, box, seed, scatters)


def _search(
    around: Surroundings,
    samples: SurfaceSamples,
    index: NDArray[np.intp],
    normal: F64,
    key: U32,
    views: F64,
    cell: float,
    box: F64,
    seed: int,
    scatters: NDArray[np.bool_] | None,
) -> SurfacePairs:
    scene = around.scene
    stops, rows = _stopping(around, scatters)
    if stops is None:
        return _none()
    f32, f64, u32, v32, v64 = mi.Float, mi.Float64, mi.UInt32, mi.Vector3f, mi.Vector3d
    n = index.size
    lane = dr.arange(u32, n)
    a = dr.gather(v64, vector_rows(samples.point[index]), lane)
    n_a64 = dr.gather(v64, vector_rows(normal), lane)
    keys = device_array(u32, key)
    density = device_array(f64, samples.density[index])
    face_a = device_array(u32, samples.face[index].astype(np.uint32))
    clearance = around.clearance

    n_a = v32(n_a64)
    out = mi.Frame3f(n_a).to_world(_direction(keys))
    found = stops.ray_intersect_preliminary(
        query_ray(leave_surface(v32(a), n_a, -out, clearance), out), coherent=False
    )
    there = found.is_valid()
    face_b = found.prim_index if rows is None else dr.gather(u32, rows, found.prim_index, there)
    landed, n_b64, _, _ = hit_point(scene, face_b, found.prim_uv, there)
    out64 = v64(out)
    n_b64 = dr.select(dr.dot(n_b64, out64) > 0.0, -n_b64, n_b64)
    b = a + out64 * (dr.dot(landed - a, n_b64) / dr.dot(out64, n_b64))
    b = dr.select(dr.squared_norm(b - landed) < dr.square(f64(1e3 * clearance)), b, landed)

    c_a, c_b = dr.dot(n_a64, out64), -dr.dot(n_b64, out64)
    low, high = (v64(*(dr.opaque(f64, float(x)) for x in corner)) for corner in box)
    inside = (b.x >= low.x) & (b.y >= low.y) & (b.z >= low.z)
    inside &= (b.x <= high.x) & (b.y <= high.y) & (b.z <= high.z)
    steepest = dr.maximum(dr.maximum(dr.abs(n_b64.x), dr.abs(n_b64.y)), dr.abs(n_b64.z))
    density_b = dr.select(inside, steepest * dr.opaque(f64, cell**-2), 0.0)
    both = density * _spread(c_a) * c_b + density_b * _spread(c_b) * c_a
    weight = dr.rsqrt(4.0 * dr.pi * dr.maximum(both, 1e-12))
    there &= (c_a > 0.0) & (c_b > 0.0)

    ends = ((a, n_a64), (b, n_b64))
    kept, seen = _find_seen(around, ends, views, there)
    word = FaceRow.of(scene.face_info, face_a).material_bits
    word, factor = scene.at_place(face_a, word, a, n_a64, dr.opaque(u32, seed & 0xFFFFFFFF), mi.Bool(True))
    middle = v64(*(dr.opaque(f64, float(x)) for x in views[len(views) // 2]))
    cosine = f32(dr.dot(dr.normalize(middle - a), n_a64))
    backscatter = diffuse_lookup(scene.diffuse_table, word & MATERIAL_MASK, cosine)
    clutter = dr.select(seen, 0.5 * dr.squared_norm(backscatter * factor) / f32(density), 0.0)
    cross = clutter * MaterialRow.of(scene.material_table, word & MATERIAL_MASK).cross_polar_ratio
    dr.eval(b, n_b64, weight, kept, face_b, clutter, cross)
    lanes = dr.compress(kept)
    pick = lanes.numpy()
    # component by component: a kernel on (n, 3) arrays would have n compiled in
    b, n_b64 = (np.stack([dr.gather(f64, x, lanes).numpy() for x in v], axis=1) for v in (b, n_b64))
    face_b, weight = (dr.gather(type(v), v, lanes).numpy() for v in (face_b, weight))
    return SurfacePairs(
        point=np.stack([samples.point[index[pick]], b], axis=1),
        normal=np.stack([normal[pick], n_b64], axis=1),
        face=np.stack([samples.face[index[pick]], face_b.astype(np.intp)], axis=1),
        weight=weight.astype(np.float64),
        key=key[pick],
        clutter=float(clutter.numpy().sum(dtype=np.float64)),
        cross=float(cross.numpy().sum(dtype=np.float64)),
    )


def _direction(key: mi.UInt32) -> mi.Vector3f:
    """Random unit vector about +z: half follow the cosine law, half are uniform over the hemisphere."""
    k1 = mix(key ^ 0x7F4A7C15)
    k2 = mix(k1 ^ 0x94D049BB)
    scale = 2.0**-BITS
    u = (mi.Float(k1 >> (32 - BITS)) + 0.5) * scale
    turn = mi.Float(k2 >> (32 - BITS)) * (2.0 * dr.pi * scale)
    even = (k2 & 1) == 1
    cosine = dr.select(even, u, dr.sqrt(u))
    sine = dr.sqrt(dr.maximum(1.0 - cosine * cosine, 0.0))
    s, c = dr.sincos(turn)
    return mi.Vector3f(sine * c, sine * s, cosine)


def _spread(cosine: mi.Float64) -> mi.Float64:
    """Probability density of the directions, 1/sr."""
    return (0.5 / dr.pi) * cosine + 0.25 / dr.pi


def _facing(samples: SurfaceSamples, views: F64) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Masks of the points whose front, and whose back, faces any of the views."""
    front, back = np.zeros(samples.n, dtype=bool), np.zeros(samples.n, dtype=bool)
    x, y, z = samples.normal.T
    at = np.einsum("ij,ij->i", samples.normal, samples.point)
    for view in views:
        height = x * view[0] + y * view[1] + z * view[2] - at
        front |= height > 0.0
        back |= height < 0.0
    return front, back


def _find_seen(
    around: Surroundings,
    ends: tuple[tuple[mi.Vector3d, mi.Vector3d], tuple[mi.Vector3d, mi.Vector3d]],
    views: F64,
    there: mi.Bool,
) -> tuple[mi.Bool, mi.Bool]:
    """Lanes of which both ends are visible from some view, and those whose first end the middle view sees."""
    rows = vector_rows(views)
    n_views, middle = dr.opaque(mi.UInt32, len(views)), dr.opaque(mi.UInt32, len(views) // 2)

    def one(
        number: mi.UInt32, a: mi.Bool, b: mi.Bool, now: mi.Bool
    ) -> tuple[mi.UInt32, mi.Bool, mi.Bool, mi.Bool]:
        view = dr.gather(mi.Vector3d, rows, number)
        here = number == middle
        seen_a = _sees(around, *ends[0], view, here | (there & ~a))
        seen_b = _sees(around, *ends[1], view, there & ~b)
        return number + 1, a | seen_a, b | seen_b, now | (here & seen_a)

    none = there & mi.Bool(False)
    _, a, b, now = dr.while_loop(
        (mi.UInt32(0), none, none, none),
        lambda number, a, b, now: number < n_views,
        one,
        labels=("number", "a", "b", "now"),
        label="views",
        mode="symbolic",
    )
    return there & a & b, now


def _sees(
    around: Surroundings, point: mi.Vector3d, normal: mi.Vector3d, position: mi.Vector3d, active: mi.Bool
) -> mi.Bool:
    """Lanes in which a surface point and a position see each other."""
    leg = position - point
    length = dr.norm(leg)
    to, n = mi.Vector3f(leg / length), mi.Vector3f(normal)
    seen = active & (dr.dot(to, n) > FACING)
    start = leave_surface(mi.Vector3f(point), n, -to, around.clearance)
    return seen & around.free(start, to, mi.Float(length), seen)


def _stopping(
    around: Surroundings, scatters: NDArray[np.bool_] | None
) -> tuple[mi.Scene | None, mi.UInt32 | None]:
    """Opaque facets, at which a ray between two ends stops, and their rows of the scene's tables (None: all)."""
    scene = around.scene
    if not around.transmits or scene.slabs is None:
        return scene.mi_scene, None
    stops = scene.slabs.thickness == 0.0
    stops = stops | (True if scatters is None else scatters)
    rows = np.flatnonzero(stops)
    if not rows.size:
        return None, None
    triangles = scene.triangles[rows].astype(np.float32)
    return intersector(triangles), device_array(mi.UInt32, rows.astype(np.uint32))


def _none() -> SurfacePairs:
    return SurfacePairs(
        np.zeros((0, 2, 3)),
        np.zeros((0, 2, 3)),
        np.zeros((0, 2), np.intp),
        np.zeros(0),
        np.zeros(0, np.uint32),
        0.0,
    )
