r"""Tessellation of Mitsuba's analytic shapes, in their own coordinates, with a bounded chord error.

Curved shapes are divided until a facet with its corners on the surface lies below it by at most the ``sagitta``;
then the corners are moved outwards so that the *mean* facet lies on the surface, because a mesh inside its sphere
has too long a range and too small an area. The largest distance from the true surface, inwards or outwards, stays
below the sagitta.
"""

from functools import lru_cache

import numpy as np

from sarmitsuba.core.arrays import F64, I32, unit_rows
from sarmitsuba.core.errors import SceneError

Mesh = tuple[F64, I32]

_MAX_FACES = 8_000_000


def rectangle() -> Mesh:
    """Return the square [-1, 1]^2 at z = 0, normal +z: vertices (4, 3) float64, faces (2, 3) int32."""
    v = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
    return v, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


def cube() -> Mesh:
    """Return the cube [-1, 1]^3, normals outwards: vertices (8, 3) float64, faces (12, 3) int32."""
    v = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=np.float64)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    f = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return v, np.array(f, dtype=np.int32)


def disk(sagitta: float, radius: float = 1.0) -> Mesh:
    """Return a disk at z = 0 about the origin, normal +z, as a fan of equal triangles.

    Parameters
    ----------
    sagitta : bound of the distance from the rim, in the units of ``radius``
    radius : of the disk

    Returns
    -------
    vertices (n + 1, 3) float64, faces (n, 3) int32

    Notes
    -----
    The polygon has the area of the disk, which determines the return at normal incidence.
    """
    n = _segments(radius, sagitta)
    a = 2.0 * np.pi / n
    rim = radius * np.sqrt(a / np.sin(a)) * _circle(n)
    v = np.concatenate([np.zeros((1, 3)), np.column_stack([rim, np.zeros(n)])])
    i = np.arange(n)
    return v, np.column_stack([np.zeros(n), i + 1, (i + 1) % n + 1]).astype(np.int32)


def cylinder(radius: float, z0: float, z1: float, sagitta: float) -> Mesh:
    """Return the open lateral surface of a cylinder about the z axis, normals outwards.

    Parameters
    ----------
    radius, z0, z1 : radius and the heights of its two ends
    sagitta : bound of the distance from the true surface, same units

    Returns
    -------
    vertices (2 n, 3) float64, faces (2 n, 3) int32

    Notes
    -----
    The radius of the facets, averaged over the angle, is ``radius``.
    """
    n = _segments(radius, sagitta)
    half = np.pi / n
    # mean of cos(half) / cos(t) over |t| < half
    mean = np.cos(half) * np.arcsinh(np.tan(half)) / half
    ring = radius / mean * _circle(n)
    low, high = min(z0, z1), max(z0, z1)
    v = np.concatenate([np.column_stack([ring, np.full(n, z)]) for z in (low, high)])
    i = np.arange(n)
    j = (i + 1) % n
    f = np.concatenate([np.column_stack([i, j, j + n]), np.column_stack([i, j + n, i + n])])
    return v, f.astype(np.int32)


def sphere(radius: float, sagitta: float, edge: float = np.inf) -> Mesh:
    """Return a geodesic sphere about the origin: an icosahedron with every face divided n x n.

    Parameters
    ----------
    radius : of the sphere
    sagitta : bound of the distance from the true surface, same units
    edge : bound of the longest edge, same units. Facets repeat nearly regularly and act as a grating, whose lobes add
        to the highlight: 0.3 dB at a sagitta of lambda / 32. Up to 0.55 lambda (rows of facets closer than
        lambda / 2) there is no grating lobe.

    Returns
    -------
    vertices (10 n^2 + 2, 3) float64, faces (20 n^2, 3) int32, normals outwards

    Notes
    -----
    All vertices have one radius, chosen so that the distance of the facets from the centre, averaged over
    their area, is ``radius``: corners lie outside by 3/4 of the chord height, facet centres inside by 1/4.
    """
    found = _unit_sphere(_relative(radius, sagitta), edge / radius)
    if found is None:
        raise SceneError(
            f"sphere: radius = {radius:g} at sagitta = {sagitta:g} and edge = {edge:g} needs over "
            f"{_MAX_FACES} triangles; raise the sagitta or the edge"
        )
    v, f, distance = found
    return v * (radius / distance), f.copy()


# scenes have many spheres of one size
@lru_cache(maxsize=2)
def _unit_sphere(depth: float, edge: float) -> tuple[F64, I32, float] | None:
    """Vertices on the unit sphere and faces, both read-only, and the mean distance of the facets; None: too many."""
    # icosahedron faces have the circumradius 37.4 deg; start coarse, then refine to the bound
    n = max(1, int(0.6 / np.arccos(max(1.0 - depth, -1.0))))
    while True:
        if 20 * n * n > _MAX_FACES:
            return None
        v, f = _geodesic(n)
        chord = 1.0 - _plane_distance(v, f).min()
        longest = _longest_edge(v, f)
        if chord <= depth and longest <= edge:
            break
        n = max(n + 1, int(0.97 * n * max(np.sqrt(chord / depth), longest / edge)))
    v.flags.writeable = f.flags.writeable = False
    return v, f, _mean_distance(v, f)


def _relative(radius: float, sagitta: float) -> float:
    if not (np.isfinite(radius) and radius > 0.0 and np.isfinite(sagitta) and sagitta > 0.0):
        raise SceneError(f"shape: radius = {radius:g} and sagitta = {sagitta:g} must be positive and finite")
    return sagitta / radius


def _segments(radius: float, sagitta: float) -> int:
    """Number of chords of a circle whose height stays within the sagitta; at least 6."""
    depth = min(_relative(radius, sagitta), 0.5)
    n = max(6, int(np.ceil(np.pi / np.arccos(1.0 - depth) - 1e-9)))
    if 2 * n > _MAX_FACES:
        raise SceneError(
            f"shape: radius = {radius:g} at sagitta = {sagitta:g} needs {n} segments; raise the sagitta"
        )
    return n


def _circle(n: int) -> F64:
    a = 2.0 * np.pi * np.arange(n) / n
    return np.column_stack([np.cos(a), np.sin(a)])


def _geodesic(n: int) -> Mesh:
    """Divide the faces of an icosahedron n x n and put the vertices on the unit sphere."""
    g = (1.0 + 5.0**0.5) / 2.0
    # fmt: off
    corner = np.array([
        [-1, g, 0], [1, g, 0], [-1, -g, 0], [1, -g, 0], [0, -1, g], [0, 1, g],
        [0, -1, -g], [0, 1, -g], [g, 0, -1], [g, 0, 1], [-g, 0, -1], [-g, 0, 1],
    ])
    faces = np.array([
        [0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4], [11, 10, 2],
        [10, 7, 6], [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9], [4, 9, 5],
        [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1],
    ])
    # fmt: on
    # barycentric lattice of one face: rows i = 0..n, columns j = 0..i
    i = np.repeat(np.arange(n + 1), np.arange(1, n + 2))
    j = np.arange(i.size) - i * (i + 1) // 2
    weight = np.column_stack([n - i, i - j, j])
    up = np.flatnonzero(i < n)
    down = np.flatnonzero((i > 0) & (i < n) & (j < i))
    small = np.concatenate(
        [
            np.column_stack([up, up + i[up] + 1, up + i[up] + 2]),
            np.column_stack([down, down + i[down] + 2, down + 1]),
        ]
    )
    # great-circle spacing along the edges keeps the facets of nearly one size
    angle = np.arccos(1.0 / 5.0**0.5)
    s = np.sin(angle * weight / n)
    v = np.einsum("pk,fkc->fpc", s, corner[faces]).reshape(-1, 3)
    v = unit_rows(v)
    f = (small[None] + np.arange(20)[:, None, None] * i.size).reshape(-1, 3)
    # points on the edges of the icosahedron are shared: weld on a grid far finer than their spacing
    grid = np.rint(v * 2.0**30).astype(np.int64)
    _, first, label = np.unique(
        (grid[:, 0] * 73856093) ^ (grid[:, 1] * 19349663) ^ (grid[:, 2] * 83492791),
        return_index=True,
        return_inverse=True,
    )
    if first.size != 10 * n * n + 2:  # a hash collision or a rounding at a grid border: compare in full
        grid = np.rint(v * 1e7).astype(np.int64)
        _, first, label = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    return v[first], label.reshape(-1)[f].astype(np.int32)


def _plane_distance(v: F64, f: I32) -> F64:
    """(n_f,) distance of every facet's plane from the origin."""
    cross = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
    normal = unit_rows(cross)
    return np.asarray(np.einsum("ij,ij->i", normal, v[f[:, 0]]))


def _longest_edge(v: F64, f: I32) -> float:
    return float(np.linalg.norm(v[f] - v[np.roll(f, 1, axis=1)], axis=2).max())


def _mean_distance(v: F64, f: I32) -> float:
    """Distance of the facets from the origin, averaged over their area (7-point rule, degree 5)."""
    a, b = (6.0 - 15.0**0.5) / 21.0, (6.0 + 15.0**0.5) / 21.0
    wa, wb = (155.0 - 15.0**0.5) / 1200.0, (155.0 + 15.0**0.5) / 1200.0
    points = [(1 / 3, 1 / 3, 1 / 3, 9.0 / 40.0)]
    for s, w in ((a, wa), (b, wb)):
        points += [(s, s, 1 - 2 * s, w), (s, 1 - 2 * s, s, w), (1 - 2 * s, s, s, w)]
    p0, p1, p2 = v[f[:, 0]], v[f[:, 1]], v[f[:, 2]]
    area = np.linalg.norm(np.cross(p1 - p0, p2 - p0), axis=1)
    radial = sum(w * np.linalg.norm(x * p0 + y * p1 + z * p2, axis=1) for x, y, z, w in points)
    return float((area * radial).sum() / area.sum())
