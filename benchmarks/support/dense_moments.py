"""Monostatic scattering of small metal bodies by moments: Rao-Wilton-Glisson currents, dense matrix, NumPy alone.

An exact reference for bodies of a few wavelengths that needs no further package and imports nothing of the simulator;
``full_wave_solver`` takes larger ones with symmetries and package bempp-cl. Lengths are in wavelengths.

``python -m benchmarks.support.dense_moments`` checks it: spheres against the Mie series, and a plate on a finer mesh.
"""

import sys
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lu_factor, lu_solve
from scipy.spatial import cKDTree

K = 2.0 * np.pi  # wavenumber, rad per wavelength
F64, I64, C128 = NDArray[np.float64], NDArray[np.int64], NDArray[np.complex128]
# three Gauss points of a triangle, and seven for pairs whose kernel's pole is integrated in closed form
_THREE = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6.0
_A, _B, _P, _Q = 0.059715871789770, 0.470142064105115, 0.797426985353087, 0.101286507323456
_SEVEN = np.array(
    [
        [1 / 3, 1 / 3, 1 / 3],
        [_A, _B, _B],
        [_B, _A, _B],
        [_B, _B, _A],
        [_P, _Q, _Q],
        [_Q, _P, _Q],
        [_Q, _Q, _P],
    ]
)
_WEIGHTS = np.array([0.225] + [0.132394152788506] * 3 + [0.125939180544827] * 3)
# pairs nearer than so many sizes of the source triangle
NEAR = 3.0
_BLOCK = 1_500_000

Mesh = tuple[F64, I64]


def welded(patches: list[Mesh]) -> Mesh:
    """One mesh of patches whose rims have the same points."""
    points = np.concatenate([p for p, _ in patches])
    offset = np.cumsum([0] + [len(p) for p, _ in patches])
    faces = np.concatenate([f + o for (_, f), o in zip(patches, offset[:-1], strict=True)])
    _, first, number = np.unique(
        np.round(points * 1e7).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    faces = number.reshape(-1)[faces]
    keep = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return points[first], faces[keep]


def rectangle(corner: ArrayLike, a: ArrayLike, b: ArrayLike, step: float) -> Mesh:
    """Flat rectangle with the edges a and b in triangles of about ``step``."""
    corner, a, b = (np.asarray(x, dtype=np.float64) for x in (corner, a, b))
    n, m = (max(1, int(np.ceil(np.linalg.norm(e) / step - 1e-9))) for e in (a, b))
    u, v = np.meshgrid(np.arange(n + 1) / n, np.arange(m + 1) / m, indexing="ij")
    i, j = (x.ravel() for x in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    p = i * (m + 1) + j
    q = p + m + 1
    faces = np.concatenate([np.column_stack([p, q, q + 1]), np.column_stack([p, q + 1, p + 1])])
    return (corner + u[..., None] * a + v[..., None] * b).reshape(-1, 3), faces


def _strip(first: I64, second: I64) -> list[tuple[int, int, int]]:
    """Triangles between two rows of points of the same extent."""
    i = j = 0
    out = []
    n, m = len(first) - 1, len(second) - 1
    while i < n or j < m:
        if j == m or (i < n and i * m < j * n):
            out.append((int(first[i]), int(second[j]), int(first[i + 1])))
            i += 1
        else:
            out.append((int(first[i]), int(second[j]), int(second[j + 1])))
            j += 1
    return out


def polygon(outline: ArrayLike, step: float) -> Mesh:
    """Flat convex polygon (n, 3) in rings about its middle; its sides have the points of ``rectangle``."""
    corners = np.asarray(outline, dtype=np.float64)
    middle = corners.mean(axis=0)
    rings = max(1, int(np.ceil(np.linalg.norm(corners - middle, axis=1).max() / step)))
    points, faces = [middle], []
    for a, b in pairwise([*corners, corners[0]]):
        sides = max(1, int(np.ceil(np.linalg.norm(b - a) / step - 1e-9)))
        before = np.array([0])
        for ring in range(1, rings + 1):
            n = sides if ring == rings else max(1, round(sides * ring / rings))
            row = middle + ring / rings * (a + np.linspace(0.0, 1.0, n + 1)[:, None] * (b - a) - middle)
            here = len(points) + np.arange(n + 1)
            points.extend(row)
            faces += _strip(before, here)
            before = here
    return np.array(points), np.array(faces)


def prism(outline: ArrayLike, height: float, step: float) -> Mesh:
    """Convex polygon (n, 2) extruded along z about 0."""
    flat = np.asarray(outline, dtype=np.float64)
    low, high = (np.column_stack([flat, np.full(len(flat), z)]) for z in (-0.5 * height, 0.5 * height))
    up = np.array([0.0, 0.0, height])
    sides = [rectangle(a, b - a, up, step) for a, b in pairwise([*low, low[0]])]
    return welded([*sides, polygon(low, step), polygon(high, step)])


def revolved(profile: ArrayLike, step: float) -> Mesh:
    """Body of revolution about z of a polyline (n, 2) of radius and height; its ends may be off the axis (open)."""
    line = np.asarray(profile, dtype=np.float64)
    rows = [line[0]]
    for a, b in pairwise(line):
        n = max(1, round(float(np.linalg.norm(b - a)) / step))
        rows += [a + (b - a) * (i + 1) / n for i in range(n)]
    points, faces, before = [], [], None
    for radius, z in rows:
        n = max(6, int(np.ceil(2.0 * np.pi * radius / step))) if radius > 1e-9 else 1
        arc = 2.0 * np.pi * np.arange(n) / n
        here = len(points) + np.append(np.arange(n), 0)
        points.extend(np.column_stack([radius * np.cos(arc), radius * np.sin(arc), np.full(n, z)]))
        if before is not None:
            faces += _strip(before, here)
        before = here
    return welded([(np.array(points), np.array(faces))])


def _rwg(faces: I64) -> tuple[I64, F64, int]:
    """Number of the function of each side of each triangle (-1 at rims), its sign, and their count.

    Side i lacks corner i.
    """
    ends = np.sort(np.stack([faces[:, [1, 2]], faces[:, [2, 0]], faces[:, [0, 1]]], axis=1), axis=2).reshape(
        -1, 2
    )
    _, number, count = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    number = number.reshape(-1)
    if (count > 2).any():
        raise ValueError("three triangles meet at a side")
    inner = count == 2
    label = np.where(inner, np.cumsum(inner) - 1, -1)[number]
    sign = np.ones(label.size)
    order = np.argsort(number, kind="stable")
    again = order[1:][number[order[1:]] == number[order[:-1]]]
    sign[again] = -1.0
    return label.reshape(-1, 3), sign.reshape(-1, 3), int(inner.sum())


def _pole(points: F64, corners: F64) -> tuple[F64, F64]:
    """Integrals of 1/R and r'/R over triangles (n, 3, 3) seen from points (n, q, 3) (Wilton et al. 1984)."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    height = np.einsum("nqi,ni->nq", points - corners[:, None, 0], normal)
    foot = points - height[..., None] * normal[:, None]
    d = np.abs(height)
    whole, vector = np.zeros_like(d), np.zeros_like(points)
    for i in range(3):
        a, b = corners[:, i], corners[:, (i + 1) % 3]
        along = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
        out = np.cross(along, normal)
        low = np.einsum("nqi,ni->nq", a[:, None] - points, along)
        high = np.einsum("nqi,ni->nq", b[:, None] - points, along)
        t = np.einsum("nqi,ni->nq", a[:, None] - points, out)
        r0 = np.maximum(t * t + d * d, 1e-24)
        r_low, r_high = np.sqrt(r0 + low * low), np.sqrt(r0 + high * high)
        # the larger of two equal forms
        up = low + high > 0.0
        log = np.log(
            np.where(
                up,
                (r_high + high) / np.maximum(r_low + low, 1e-30),
                (r_low - low) / np.maximum(r_high - high, 1e-30),
            )
        )
        turn = np.arctan2(t * high, r0 + d * r_high) - np.arctan2(t * low, r0 + d * r_low)
        whole += t * log - d * turn
        vector += 0.5 * out[:, None] * (r0 * log + high * r_high - low * r_low)[..., None]
    return whole, foot * whole[..., None] + vector


def _moments(corners: F64) -> tuple[C128, C128, C128, C128]:
    """Integrals of G, r G, r' G and r.r' G over all pairs of triangles: (n, n), (n, n, 3), (n, n, 3), (n, n)."""
    n = len(corners)
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    x = np.einsum("qc,nci->nqi", _THREE, corners)
    one, dot = np.zeros((n, n), np.complex64), np.zeros((n, n), np.complex64)
    test, source = np.zeros((3, n, n), np.complex64), np.zeros((3, n, n), np.complex64)
    for p in range(3):
        for q in range(3):
            a, b = x[:, p], x[:, q]
            square = np.square(a).sum(1)[:, None] + np.square(b).sum(1)[None] - 2.0 * a @ b.T
            r = np.sqrt(np.maximum(square, 1e-8)).astype(np.float32)
            green = np.exp(np.complex64(-1j * K) * r) / r
            green *= (area[:, None] * area[None] / (36.0 * np.pi)).astype(np.float32)
            one += green
            for i in range(3):
                test[i] += green * a[:, None, i].astype(np.float32)
                source[i] += green * b[None, :, i].astype(np.float32)
            dot += green * (a @ b.T).astype(np.float32)
    # near pairs: pole over the source in closed form
    middle, size = corners.mean(axis=1), np.sqrt(2.0 * area)
    reach = NEAR * float(np.max(size))
    pairs = cKDTree(middle).query_pairs(reach, output_type="ndarray")
    pairs = np.concatenate([pairs, pairs[:, ::-1], np.tile(np.arange(n)[:, None], (1, 2))])
    y = np.einsum("qc,nci->nqi", _SEVEN, corners)
    for k in range(0, len(pairs), 20000):
        i, j = pairs[k : k + 20000].T
        at, weight = y[i], _WEIGHTS[None] * area[i, None]
        pole, vector = _pole(at, corners[j])
        r = np.linalg.norm(at[:, :, None] - y[j][:, None], axis=3)
        smooth = np.where(r > 1e-6, (np.exp(-1j * K * r) - 1.0) / np.maximum(r, 1e-6), -1j * K)
        w = _WEIGHTS[None] * area[j, None]
        whole = pole + np.einsum("npq,nq->np", smooth, w)
        moved = vector + np.einsum("npq,nq,nqi->npi", smooth, w, y[j])
        four = 1.0 / (4.0 * np.pi)
        one[i, j] = four * np.einsum("np,np->n", weight, whole)
        dot[i, j] = four * np.einsum("np,npi,npi->n", weight, at, moved)
        for c in range(3):
            test[c][i, j] = four * np.einsum("np,np,np->n", weight, at[..., c], whole)
            source[c][i, j] = four * np.einsum("np,np->n", weight, moved[..., c])
    return one, test, source, dot


def amplitudes(mesh: Mesh, looks: ArrayLike) -> C128:
    r"""Return the backscatter amplitudes (n, 2) in HH and VV, \|S\|^2 the radar cross section in square wavelengths.

    .. math:: S_p = \frac{k}{\sqrt{4\pi}}\, b_p^T Z^{-1} b_p, \quad
        Z_{mn} = j k \int\!\!\int \left(\mathbf f_m \cdot \mathbf f_n
        - \tfrac1{k^2} \nabla \cdot \mathbf f_m \nabla' \cdot \mathbf f_n\right) G

    Parameters
    ----------
    mesh : vertices (n, 3) in wavelengths, and faces that share them; open sheets are allowed
    looks : (n, 3) unit vectors towards the radar

    Notes
    -----
    Rao, Wilton and Glisson, IEEE Trans. Antennas Propag. 30 (1982). Closed bodies have cavity resonances, whose
    currents do not radiate but spoil the matrix's condition.
    """
    vertices, faces = mesh
    looks = np.asarray(looks, dtype=np.float64)
    corners = vertices[faces]
    label, sign, n = _rwg(faces)
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    length = np.linalg.norm(corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]], axis=2)
    scale = sign * length / (2.0 * area[:, None])  # of r minus the corner
    one, test, source, dot = _moments(corners)
    matrix = np.zeros((n, n), np.complex64)
    for i in range(3):
        rows = np.flatnonzero(label[:, i] >= 0)
        vi, si = corners[rows, i], scale[rows, i].astype(np.float32)
        for j in range(3):
            columns = np.flatnonzero(label[:, j] >= 0)
            vj, sj = corners[columns, j], scale[columns, j].astype(np.float32)
            at = np.ix_(rows, columns)
            value = dot[at] + ((vi @ vj.T) - 4.0 / K**2).astype(np.float32) * one[at]
            for c in range(3):
                value -= vi[:, None, c].astype(np.float32) * source[c][at]
                value -= vj[None, :, c].astype(np.float32) * test[c][at]
            value *= si[:, None] * sj[None]
            half = np.zeros((n, len(columns)), np.complex64)
            np.add.at(half, label[rows, i], value)
            np.add.at(matrix.T, label[columns, j], half.T)
    matrix *= np.complex64(1j * K)
    azimuth = np.arctan2(looks[:, 1], looks[:, 0])
    h = np.stack([-np.sin(azimuth), np.cos(azimuth), 0.0 * azimuth], axis=1)
    x = np.einsum("qc,nci->nqi", _SEVEN, corners)
    phase = np.exp(1j * K * np.einsum("nqi,di->nqd", x, looks))
    flat = np.einsum("q,nqd->nd", _WEIGHTS, phase) * area[:, None]
    first = np.einsum("q,nqd,nqi->ndi", _WEIGHTS, phase, x) * area[:, None, None]
    factors = lu_factor(matrix, overwrite_a=True, check_finite=False)
    out = np.empty((len(looks), 2), dtype=np.complex128)
    for p, vector in enumerate((h, np.cross(looks, h))):
        b = np.zeros((n, len(looks)), np.complex128)
        for i in range(3):
            rows = np.flatnonzero(label[:, i] >= 0)
            value = np.einsum("ndi,di->nd", first[rows], vector) - flat[rows] * (corners[rows, i] @ vector.T)
            np.add.at(b, label[rows, i], scale[rows, i, None] * value)
        solved = lu_solve(factors, b.astype(np.complex64), check_finite=False)
        out[:, p] = np.einsum("nd,nd->d", b, solved) * K / np.sqrt(4.0 * np.pi)
    return out


def sphere(radius: float, step: float) -> Mesh:
    """Sphere as a body of revolution."""
    n = max(8, round(np.pi * radius / step))
    arc = np.linspace(0.0, np.pi, n + 1)
    return revolved(np.column_stack([radius * np.sin(arc), -radius * np.cos(arc)]), step)


def main() -> int:
    import time

    from sarmitsuba.truth import theory

    for radius in (0.2, 0.53, 0.9):
        start = time.process_time()
        mesh = sphere(radius, 0.11)
        found = amplitudes(mesh, [[1.0, 0.0, 0.0], [0.6, 0.0, 0.8], [0.0, 0.8, 0.6]])
        exact = np.pi * radius**2 * theory.sphere_mie(K * radius)
        off = 20.0 * np.log10(np.abs(found)) - 10.0 * np.log10(exact)
        print(
            f"sphere of radius {radius}: {np.abs(off).max():.2f} dB off the series; {len(mesh[1])} triangles, "
            f"{time.process_time() - start:.1f} CPU s"
        )
    cut = np.radians(np.arange(0.0, 91.0, 15.0))
    looks = np.stack([np.sin(cut), 0.0 * cut, np.cos(cut)], axis=1)
    for step in (0.1, 0.06):
        start = time.process_time()
        mesh = rectangle([-1.15, -0.65, 0.0], [2.3, 0.0, 0.0], [0.0, 1.3, 0.0], step)
        found = amplitudes(welded([mesh]), looks)
        with np.errstate(divide="ignore"):
            print(
                step,
                np.round(20.0 * np.log10(np.abs(found.T)), 2),
                f"{time.process_time() - start:.1f} CPU s",
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
