"""Matrix of the electric field integral equation in Rao-Wilton-Glisson functions."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import C64, C128, F64, I64
from sarmitsuba.machine.backend import device_array, dr, mi
from sarmitsuba.tracing.scatterers.currents.basis import CurrentBasis, Symmetry
from sarmitsuba.tracing.scatterers.currents.quadrature import inverse_distance_integrals, triangle_rule

# pairs of triangles of one launch
MAX_LANES = 8_000_000
# bytes of the matrices of all copies together that are kept
MOST_BYTES = 1_500_000_000
# pairs closer than this many of their own sizes are integrated with the pole in closed form
NEAR = 1.5
# points in each direction of these, for testing and for the smooth rest
OUTER, INNER = 3, 2
# largest element over the longest edge for which there is room
HEADROOM = 4.0
# elements that are converted at a time, and pairs at a time
_CONVERTED = 1 << 24
_BLOCK = 20_000


@dataclass(frozen=True, eq=False)
class NearPairs:
    """Elements of near pairs of triangles beyond those of three points each, by copy: rows and values (n, 3, 3)."""

    of_copy: tuple[tuple[I64, I64, C128], ...]

    @staticmethod
    def of(basis: CurrentBasis, resistance: F64) -> "NearPairs":
        """Near pairs of a basis; ``resistance``: of each triangle's surface, over 120 pi ohm."""
        found: list[tuple[I64, I64, C128]] = []
        for copy in basis.copies:
            there = basis.corners @ copy.T
            test, source = _near_pairs(basis.corners, there)
            sides = basis.corners[test], there[source]
            values = _near(*sides) - _coarse(*sides)
            own = test == source  # and its mirror image: symmetric but for the rules
            values[own] = 0.5 * (values[own] + values[own].transpose(0, 2, 1))
            if not found:  # the identity is the first
                same = basis.triangle[test] == basis.triangle[source]
                lossy = resistance[basis.triangle[test[same]], None, None]
                values[same] -= 1j * lossy * _products(basis.corners[test[same]])
            weight = basis.weight[test][:, :, None] * basis.weight[source][:, None, :]
            found.append((test, source, values * weight))
        return NearPairs(tuple(found))


@dataclass(frozen=True, eq=False)
class MomentMatrices:
    r"""Matrices of the electric field integral equation, one for the currents of each symmetry.

    .. math:: Z_{mn} = \int\!\!\int \left(\mathbf f_m \cdot \mathbf f_n - \nabla\cdot\mathbf f_m \nabla\cdot\mathbf f_n
        \right) \frac{e^{-j R}}{4 \pi R} dS\, dS'

    over the part of the surface in m, and over all copies of it in n; lengths times the wavenumber.

    Parameters
    ----------
    basis : of the mesh
    near : of the basis
    of_copy : (n, n) complex64 each, shares of the copies; empty: they take too much memory, and are made again for each
        symmetry

    Notes
    -----
    Three points on each triangle; near pairs have the integral of 1/R in closed form and a product rule for the rest.
    """

    basis: CurrentBasis
    near: NearPairs
    of_copy: tuple[C64, ...]

    @staticmethod
    def of(basis: CurrentBasis, resistance: F64) -> "MomentMatrices":
        """Matrices of a basis; ``resistance``: of each triangle's surface, over 120 pi ohm."""
        near, copies = NearPairs.of(basis, resistance), len(basis.copies)
        shares: tuple[C64, ...] = ()
        if 8 * copies * basis.n**2 < MOST_BYTES:
            shares = tuple(_matrix(basis, near, basis.function, basis.n, row) for row in np.eye(copies))
        return MomentMatrices(basis, near, shares)

    def matrix(self, symmetry: Symmetry) -> C64:
        """Symmetric matrix (n, n) complex64 of the functions that a symmetry keeps."""
        kept = symmetry.kept
        if not self.of_copy:
            return _matrix(self.basis, self.near, symmetry.function, kept.size, symmetry.signs)
        out = np.zeros((kept.size, kept.size), dtype=np.complex64)
        for sign, share in zip(symmetry.signs, self.of_copy, strict=True):
            (np.add if sign > 0.0 else np.subtract)(out, share[np.ix_(kept, kept)], out=out)
        return out


def _matrix(basis: CurrentBasis, near: NearPairs, function: I64, n: int, signs: F64) -> C64:
    """Matrix (n, n) with a sign for each copy, 0 for none; ``function`` (n_rows, 3): rows of the functions."""
    out = _far(basis, function, n, signs)
    for (test, source, values), sign in zip(near.of_copy, signs, strict=True):
        if not sign:
            continue
        rows = np.broadcast_to(function[test][:, :, None], values.shape)
        columns = np.broadcast_to(function[source][:, None, :], values.shape)
        apart = test != source
        for r, c, v in (
            (rows, columns, values),
            (columns[apart], rows[apart], values[apart]),
        ):
            used = (r >= 0) & (c >= 0)
            np.add.at(out, (r[used], c[used]), (sign * v[used]).astype(np.complex64))
    return out


def _far(basis: CurrentBasis, function: I64, n: int, signs: F64) -> C64:
    """All pairs with three points each; the same point of one triangle counts nothing.

    Threads add in any order, so that sums are of integers: the same bits each time.
    """
    rows = len(basis.corners)
    # an element is a small part of the length of the longest edge
    unit = HEADROOM * 2.0 * float(np.abs(basis.weight).max()) / 2.0**30
    number = device_array(mi.Int32, function.astype(np.int32))
    here = _table(basis.corners, basis.weight)
    out = dr.zeros(mi.Int32, 2 * n * n)
    scale = dr.opaque(mi.Float, 1.0 / unit)
    count, width = dr.opaque(mi.UInt32, rows), dr.opaque(mi.UInt32, n)
    step = max(1, MAX_LANES // rows)
    for copy, sign in zip(basis.copies, signs, strict=True):
        if not sign:
            continue
        there = _table(basis.corners @ copy.T, sign * basis.weight)
        for first in range(0, rows, step):
            lane = dr.arange(mi.UInt32, min(step, rows - first) * rows)
            test = lane // count
            source = lane - test * count
            _add_pairs(out, scale, (here, there), number, test + dr.opaque(mi.UInt32, first), source, width)
            dr.eval(out)
    dr.sync_thread()
    sums = np.asarray(out)
    values = sums.view(np.float32)
    for first in range(0, sums.size, _CONVERTED):  # in place
        some = slice(first, first + _CONVERTED)
        values[some] = sums[some] * np.float32(unit)
    return values.view(np.complex64).reshape(n, n)


def _table(corners: F64, weight: F64) -> mi.Float:
    """Middle, offsets of the corners and weights of triangles, 15 numbers each."""
    middle = corners.mean(axis=1)
    offset = (corners - middle[:, None]).reshape(len(corners), 9)
    rows = np.concatenate([middle, offset, weight], axis=1)
    return device_array(mi.Float, rows.astype(np.float32))


def _add_pairs(
    out: mi.Int32,
    scale: mi.Float,
    tables: tuple[mi.Float, mi.Float],
    number: mi.Int32,
    test: mi.UInt32,
    source: mi.UInt32,
    width: mi.UInt32,
) -> None:
    """Record one launch of the kernel: a lane is a pair of triangles."""

    def row(table: mi.Float, index: mi.UInt32) -> tuple[mi.Vector3f, list[mi.Vector3f], list[mi.Float]]:
        values = [dr.gather(mi.Float, table, 15 * index + i) for i in range(15)]
        corners = [mi.Vector3f(values[3 * i : 3 * i + 3]) for i in range(1, 4)]
        return mi.Vector3f(values[:3]), corners, values[12:]

    c, w, a = row(tables[0], test)
    d, v, b = row(tables[1], source)
    apart = c - d
    g = mi.Complex2f(0.0)
    # arrays of their own: += works in place
    gt, gs = ([mi.Complex2f(0.0) for _ in range(3)] for _ in range(2))
    gg = mi.Complex2f(0.0)
    for p in range(3):
        for q in range(3):
            x, y = 0.5 * w[p], 0.5 * v[q]
            r2 = dr.squared_norm(apart + x - y)
            inverse = dr.select(r2 > 0.0, dr.rsqrt(r2), 0.0)
            s, co = dr.sincos(r2 * inverse)
            value = mi.Complex2f(co, -s) * (inverse / (9.0 * 4.0 * dr.pi))
            g += value
            gg += value * dr.dot(x, y)
            for i in range(3):
                gt[i] += value * x[i]
                gs[i] += value * y[i]
    rows = [dr.gather(mi.Int32, number, 3 * test + i) for i in range(3)]
    columns = [dr.gather(mi.Int32, number, 3 * source + i) for i in range(3)]
    for i in range(3):
        for j in range(3):
            value = gg + g * (dr.dot(w[i], v[j]) - 4.0)
            for m in range(3):
                value -= gt[m] * v[j][m] + gs[m] * w[i][m]
            value *= a[i] * b[j]
            active = (rows[i] >= 0) & (columns[j] >= 0)
            at = 2 * (mi.UInt32(rows[i]) * width + mi.UInt32(columns[j]))
            dr.scatter_add(out, mi.Int32(dr.round(value.real * scale)), at, active)
            dr.scatter_add(out, mi.Int32(dr.round(value.imag * scale)), at + 1, active)


def _near_pairs(corners: F64, there: F64) -> tuple[I64, I64]:
    """Rows of near triangles and of triangles of a copy near to them, the smaller number first."""
    from scipy.spatial import cKDTree

    middle, other = corners.mean(axis=1), there.mean(axis=1)
    size = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    # trees of similar sizes, so that single large triangles do not make all pairs candidates
    group = np.frexp(size)[1]
    found = []
    for g in np.unique(group):
        for h in np.unique(group):
            one, two = np.flatnonzero(group == g), np.flatnonzero(group == h)
            reach = (1.0 + NEAR) * float(size[one].max() + size[two].max())
            near = cKDTree(middle[one]).sparse_distance_matrix(
                cKDTree(other[two]), reach, output_type="ndarray"
            )
            a, b = one[near["i"]], two[near["j"]]
            found.append(np.stack([a, b])[:, near["v"] < (1.0 + NEAR) * (size[a] + size[b])])
    first, second = np.concatenate(found, axis=1)
    return first[first <= second], second[first <= second]


def _moments(g: C128, x: F64, y: F64, gy: C128, w: F64, v: F64) -> C128:
    """(n, 3, 3) elements but for weights from sums over test points.

    ``g`` (n, p): weighted integrals over the source, ``gy`` (n, p, 3): of the position there, ``x`` (n, p, 3).
    """
    total = g.sum(axis=1)
    gt = np.einsum("np,npc->nc", g, x)
    gs = gy.sum(axis=1)
    gg = np.einsum("npc,npc->n", gy, x)
    inner = np.einsum("nic,njc->nij", w, v)
    return np.asarray(
        gg[:, None, None]
        + total[:, None, None] * (inner - 4.0)
        - np.einsum("nc,njc->nj", gt, v)[:, None, :]
        - np.einsum("nc,nic->ni", gs, w)[:, :, None]
    )


def _near(tested: F64, sources: F64) -> C128:
    """(n_pairs, 3, 3) elements with the pole in closed form."""
    outer, share = triangle_rule(OUTER)
    inner, inner_share = triangle_rule(INNER)
    out = np.empty((len(tested), 3, 3), dtype=np.complex128)
    for first in range(0, len(tested), _BLOCK):
        some = slice(first, first + _BLOCK)
        t, s = tested[some], sources[some]
        ct, cs = t.mean(axis=1), s.mean(axis=1)
        x = np.einsum("pk,nkc->npc", outer, t)
        y = np.einsum("qk,nkc->nqc", inner, s)
        area = 0.5 * np.linalg.norm(np.cross(s[:, 1] - s[:, 0], s[:, 2] - s[:, 0]), axis=1)
        scalar, vector = inverse_distance_integrals(x, s)
        r = np.linalg.norm(x[:, :, None] - y[:, None], axis=3)
        safe = np.maximum(r, 1e-12)
        rest = np.where(r > 1e-7, (np.exp(-1j * r) - 1.0) / safe, -1j) * inner_share
        g = scalar / area[:, None] + rest.sum(axis=2)
        gy = vector / area[:, None, None] + scalar[..., None] / area[:, None, None] * (x - cs[:, None])
        gy = gy + np.einsum("npq,nqc->npc", rest, y - cs[:, None])
        g, gy = g * share / (4.0 * np.pi), gy * share[:, None] / (4.0 * np.pi)
        out[some] = _moments(g, x - ct[:, None], y, gy, t - ct[:, None], s - cs[:, None])
    return out


def _coarse(tested: F64, sources: F64) -> C128:
    """(n_pairs, 3, 3) elements as the kernel of all pairs has them."""
    out = np.empty((len(tested), 3, 3), dtype=np.complex128)
    for first in range(0, len(tested), _BLOCK):
        some = slice(first, first + _BLOCK)
        t, s = tested[some], sources[some]
        ct, cs = t.mean(axis=1, keepdims=True), s.mean(axis=1, keepdims=True)
        x, y = 0.5 * (t - ct), 0.5 * (s - cs)
        r = np.linalg.norm((ct + x)[:, :, None] - (cs + y)[:, None], axis=3)
        r[r < 1e-12] = np.inf  # the same point
        kernel = np.exp(-1j * np.where(np.isfinite(r), r, 0.0)) / (36.0 * np.pi * r)
        gy = np.einsum("npq,nqc->npc", kernel, y)
        out[some] = _moments(kernel.sum(axis=2), x, y, gy, t - ct, s - cs)
    return out


def _products(corners: F64) -> F64:
    """(n, 3, 3) integrals of products of the functions of one triangle (n, 3, 3), but for weights."""
    w = corners - corners.mean(axis=1, keepdims=True)
    area = 0.5 * np.linalg.norm(np.cross(w[:, 1] - w[:, 0], w[:, 2] - w[:, 0]), axis=1)
    spread = np.einsum("nkc,nkc->n", w, w) / 12.0
    return np.asarray((spread[:, None, None] + np.einsum("nic,njc->nij", w, w)) / area[:, None, None])
