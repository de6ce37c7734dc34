"""Shapes of the random scenes as triangles (n, 3, 3) in m, all about the origin."""

import numpy as np
import trimesh

from sarmitsuba.core.arrays import F64


def box(size: F64) -> F64:
    """Closed box of edge lengths ``size``."""
    mesh = trimesh.creation.box(size)
    return np.asarray(mesh.triangles)


def prism(outline: F64, length: float) -> F64:
    """Closed prism of a convex outline (n, 2) in x, z along y."""
    n = len(outline)
    a = np.column_stack([outline[:, 0], np.full(n, -0.5 * length), outline[:, 1]])
    b = a + np.array([0.0, length, 0.0])
    out = []
    for i in range(n):
        j = (i + 1) % n
        out += [[a[i], b[j], b[i]], [a[i], a[j], b[j]]]
    for i in range(1, n - 1):
        out += [[a[0], a[i + 1], a[i]], [b[0], b[i], b[i + 1]]]
    triangles = np.array(out)
    middle = triangles.reshape(-1, 3).mean(axis=0)
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inward = np.einsum("ti,ti->t", normal, triangles.mean(axis=1) - middle) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return triangles


def gabled(rng: np.random.Generator, size: F64) -> F64:
    """House with a gabled roof of 5 to 45 degrees."""
    w, length, h = size
    rise = 0.5 * w * np.tan(np.radians(rng.uniform(5.0, 45.0)))
    outline = np.array([[-w / 2, 0.0], [w / 2, 0.0], [w / 2, h], [0.0, h + rise], [-w / 2, h]])
    return prism(outline - [0.0, 0.5 * h], length)


def polygon(outline: F64) -> F64:
    """Flat open polygon (n, 2) in the xy plane, cut into triangles about its first corner, which sees all others."""
    flat = np.column_stack([outline, np.zeros(len(outline))])
    return np.array([flat[[0, i, i + 1]] for i in range(1, len(outline) - 1)])


def frame(outer: float, width: float) -> F64:
    """Flat square frame of four bars."""
    a, b = 0.5 * outer, 0.5 * outer - width
    bars = [(-a, a, b, a), (-a, a, -a, -b), (-a, -b, -b, b), (b, a, -b, b)]
    out = []
    for x0, x1, y0, y1 in bars:
        p = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
        out += [p[[0, 1, 2]], p[[0, 2, 3]]]
    return np.array(out)


def terrain(rng: np.random.Generator, size: float, step: float, slope: float) -> F64:
    """Open surface of smooth random slopes, cut into triangles of ``step``."""
    n = int(np.clip(round(size / step), 2, 60))
    x = np.linspace(-0.5 * size, 0.5 * size, n + 1)
    gx, gy = np.meshgrid(x, x, indexing="ij")
    z = np.zeros_like(gx)
    for _ in range(6):
        length = size * rng.uniform(0.3, 1.0)
        angle, phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        wave = 2.0 * np.pi / length
        z += slope / np.sqrt(6.0) / wave * np.sin(wave * (gx * np.cos(angle) + gy * np.sin(angle)) + phase)
    p = np.stack([gx, gy, z], axis=-1)
    a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
    return np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3, 3)


def turned(triangles: F64, rng: np.random.Generator, *, upright: bool) -> F64:
    """Rotated at random: about the vertical only, or any way."""
    matrix = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    if upright:
        a = rng.uniform(0.0, 2.0 * np.pi)
        matrix = np.array([[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
    return triangles @ matrix.T
