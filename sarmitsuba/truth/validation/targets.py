"""Canonical radar targets as triangle lists, in as many triangles as asked for."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh.tessellate import cylinder as cylinder_mesh
from sarmitsuba.scene.mesh.tessellate import disk as disk_mesh
from sarmitsuba.scene.mesh.tessellate import sphere as sphere_mesh

Mesh = tuple[F64, I32]
PEC = (Material("pec", pec=True),)
# relative permittivities at X band: ITU-R P.2040-3 concrete (5.24, 0.271 S/m at 9.6 GHz), moist soil, water, a
# metal of 1e7 S/m at 10 GHz, and a lossless one that has an exact Brewster angle
PERMITTIVITY = {
    "lossless 4": 4.0 + 0.0j,
    "concrete": 5.24 - 0.507j,
    "soil": 15.0 - 3.0j,
    "water": 62.0 - 32.0j,
    "metal": 1.0 - 1.7975e7j,
}
# a black body: blocks rays and returns nothing
BLACK = Material("black", permittivity=1.0 + 0.0j)


def geometry(meshes: Sequence[Mesh], materials: Sequence[int] | None = None) -> Geometry:
    """Join meshes into one geometry; mesh i takes material ``materials[i]`` (all 0 by default) and group i."""
    offset, vertices, faces, material, group = 0, [], [], [], []
    for i, (v, f) in enumerate(meshes):
        vertices.append(v)
        faces.append(f + offset)
        offset += v.shape[0]
        material.append(np.full(f.shape[0], materials[i] if materials else 0, dtype=np.int32))
        group.append(np.full(f.shape[0], i, dtype=np.int32))
    counts = [0, *np.cumsum([f.shape[0] for f in faces])]
    return Geometry(
        np.concatenate(vertices).astype(np.float64),
        np.concatenate(faces).astype(np.int32),
        np.concatenate(material),
        np.concatenate(group),
        tuple(f"mesh_{i}" for i in range(len(meshes))),
        np.asarray(counts, dtype=np.int64),
    )


def parallelogram(corner: ArrayLike, edge_a: ArrayLike, edge_b: ArrayLike, triangles: int = 2) -> Mesh:
    """Flat face with one corner and two edges given, in about ``triangles`` triangles (at least 2).

    Interior vertices are shifted at random (fixed seed) within the plane, so that no row of edges is straight.
    """
    n = max(1, round(np.sqrt(triangles / 2.0)))
    m = max(1, round(triangles / (2.0 * n)))
    u, v = np.meshgrid(np.linspace(0.0, 1.0, n + 1), np.linspace(0.0, 1.0, m + 1), indexing="ij")
    rng = np.random.default_rng(7)
    shift = 0.25 * (rng.random((2, n + 1, m + 1)) - 0.5)
    inner = np.zeros((n + 1, m + 1), dtype=bool)
    inner[1:-1, 1:-1] = True
    u = u + np.where(inner, shift[0] / n, 0.0)
    v = v + np.where(inner, shift[1] / m, 0.0)
    c, a, b = (np.asarray(x, dtype=np.float64) for x in (corner, edge_a, edge_b))
    vertices = (c + u[..., None] * a + v[..., None] * b).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    p = (i * (m + 1) + j).ravel()
    q = p + m + 1
    faces = np.concatenate([np.column_stack([p, q, q + 1]), np.column_stack([p, q + 1, p + 1])])
    return vertices, faces.astype(np.int32)


def triangle(a: ArrayLike, b: ArrayLike, c: ArrayLike, triangles: int = 1) -> Mesh:
    """Flat triangle, divided into about ``triangles`` (n x n) similar ones."""
    n = max(1, round(np.sqrt(triangles)))
    p0, p1, p2 = (np.asarray(x, dtype=np.float64) for x in (a, b, c))
    index: dict[tuple[int, int], int] = {}
    vertices: list[F64] = []
    for i in range(n + 1):
        for j in range(n + 1 - i):
            index[i, j] = len(vertices)
            vertices.append(p0 + (p1 - p0) * (i / n) + (p2 - p0) * (j / n))
    faces = []
    for i in range(n):
        for j in range(n - i):
            faces.append([index[i, j], index[i + 1, j], index[i, j + 1]])
            if i + j < n - 1:
                faces.append([index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]])
    return np.asarray(vertices), np.asarray(faces, dtype=np.int32)


def plate(width: float, height: float, triangles: int = 2) -> Geometry:
    """Rectangle in z = 0, width along x and height along y, centred."""
    return geometry([parallelogram([-width / 2, -height / 2, 0], [width, 0, 0], [0, height, 0], triangles)])


def disc(radius: float, sagitta: float) -> Geometry:
    """Disc in z = 0, centred."""
    return geometry([disk_mesh(sagitta, radius)])


def sphere(radius: float, sagitta: float) -> Geometry:
    """Sphere about the origin."""
    return geometry([sphere_mesh(radius, sagitta)])


def cylinder(radius: float, height: float, sagitta: float) -> Geometry:
    """Barrel about the z axis (material 0), centred, its ends closed by caps of material 1."""
    low = disk_mesh(sagitta, radius)
    caps = [(low[0] + np.array([0.0, 0.0, z]), low[1]) for z in (-height / 2, height / 2)]
    return geometry([cylinder_mesh(radius, -height / 2, height / 2, sagitta), *caps], [0, 1, 1])


def dihedral(width_x: float, width_y: float, length: float, triangles: int = 2) -> Geometry:
    """Vertical corner line on the z axis; faces along +x (normal +y) and along +y (normal +x), materials 0, 1."""
    base = [0.0, 0.0, -length / 2]
    along_x = parallelogram(base, [width_x, 0, 0], [0, 0, length], triangles)
    along_y = parallelogram(base, [0, width_y, 0], [0, 0, length], triangles)
    return geometry([along_x, along_y])


def trihedral(edge: float, shape: str, triangles: int = 2) -> Geometry:
    """Corner at the origin, edges along +x, +y, +z; ``triangular`` or ``square`` faces."""
    e = np.eye(3) * edge
    if shape == "triangular":
        return geometry([triangle(np.zeros(3), e[i], e[(i + 1) % 3], triangles) for i in range(3)])
    return geometry([parallelogram(np.zeros(3), e[i], e[(i + 1) % 3], triangles) for i in range(3)])


def wall_and_ground(height: float, length: float, ground: float) -> Geometry:
    """Wall x = 0 (material 0) of the given height, ground z = 0 (material 1) from 0 to +x, both along y, centred."""
    wall = parallelogram([0, -length / 2, 0], [0, length, 0], [0, 0, height])
    floor = parallelogram([0, -length / 2, 0], [ground, 0, 0], [0, length, 0])
    return geometry([wall, floor], [0, 1])


def from_azimuth(azimuth: ArrayLike, elevation: ArrayLike = 0.0) -> F64:
    """(n, 3) unit vectors towards the radar, azimuth from +x to +y and elevation above z = 0, rad."""
    az, el = np.broadcast_arrays(
        np.asarray(azimuth, dtype=np.float64), np.asarray(elevation, dtype=np.float64)
    )
    return np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], axis=-1)
