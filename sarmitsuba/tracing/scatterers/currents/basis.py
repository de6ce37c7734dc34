"""Rao-Wilton-Glisson functions: currents that flow across the edges of a triangle mesh."""

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C128, F64, I64
from sarmitsuba.tracing.scatterers.currents.quadrature import triangle_rule

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

# directions at a time for the integrals of plane waves
_BLOCK = 2_000_000


@dataclass(frozen=True, eq=False)
class CurrentBasis:
    r"""Functions of a mesh, one for every edge that two triangles share, k - 1 for an edge of k triangles.

    .. math:: \mathbf f = \pm\frac{l}{2 A} (\mathbf r - \mathbf v)

    on both triangles, with the edge's length l and the opposite corner v; on one for an edge on a mirror plane.

    Parameters
    ----------
    corners : (n_rows, 3, 3) float64, triangles times the wavenumber. Triangles at an edge of more than two stand in
        several rows
    function : (n_rows, 3) int64, number of the function of the edge opposite to each corner, -1 for none
    weight : (n_rows, 3) float64, signed :math:`l / 2`
    triangle : (n_rows,) int64, number of the row's triangle
    crosses : (n, n_planes) bool, mirror planes that a function crosses
    copies : (n_copies, 3, 3) float64, mirrors that complete the surface, the identity first

    References
    ----------
    Rao, Wilton, Glisson, IEEE Transactions on Antennas and Propagation 30(3), 1982.
    """

    corners: F64
    function: I64
    weight: F64
    triangle: I64
    crosses: NDArray[np.bool_]
    copies: F64

    @staticmethod
    def of(vertices: F64, faces: I64, normals: F64, tolerance: float) -> "CurrentBasis":
        """Functions of a mesh whose triangles meet corner to corner.

        Parameters
        ----------
        vertices : (n, 3) float64, times the wavenumber, about a point on all mirror planes
        faces : (m, 3) int64
        normals : (k, 3) float64, unit vectors of mirror planes that complete the surface
        tolerance : distance within which an edge lies on a plane
        """
        m = len(faces)
        copies = [np.eye(3)]
        for normal in normals:
            mirror = np.eye(3) - 2.0 * np.outer(normal, normal)
            copies += [mirror @ c for c in copies]
        # edge i of a triangle is opposite to its corner i
        start, end = np.roll(faces, -1, axis=1).ravel(), np.roll(faces, -2, axis=1).ravel()
        key = np.minimum(start, end) * (int(faces.max(initial=0)) + 1) + np.maximum(start, end)
        sides = np.argsort(key, kind="stable")
        first = np.flatnonzero(np.diff(key[sides], prepend=-1))
        count = np.diff(first, append=sides.size)
        rim = sides[first[count == 1]]
        off = np.maximum(np.abs(vertices[start[rim]] @ normals.T), np.abs(vertices[end[rim]] @ normals.T))
        on = off < tolerance
        half, on = rim[on.any(axis=1)], on[on.any(axis=1)]
        plus, minus = [half], []
        for extra in range(1, int(count.max(initial=1))):
            some = first[count > extra]
            plus.append(sides[some + extra - 1])
            minus.append(sides[some + extra])
        slot = np.concatenate([*plus, *minus])
        n = sum(p.size for p in plus)
        number = np.concatenate([np.arange(n), np.arange(half.size, n)])
        length = np.linalg.norm(vertices[start[slot]] - vertices[end[slot]], axis=1)
        signed = 0.5 * length * np.where(np.arange(slot.size) < n, 1.0, -1.0)
        # the second function of a side stands in a row of its own
        order = np.argsort(slot, kind="stable")
        new = np.diff(slot[order], prepend=-1) != 0
        place = np.arange(slot.size)
        rank = np.zeros(slot.size, dtype=np.int64)
        rank[order] = place - np.maximum.accumulate(np.where(new, place, 0))
        rows, row_of = np.unique(rank * m + slot // 3, return_inverse=True)
        table, weights = np.full((rows.size, 3), -1), np.zeros((rows.size, 3))
        table[row_of, slot % 3], weights[row_of, slot % 3] = number, signed
        crosses = np.zeros((n, len(normals)), dtype=bool)
        crosses[: half.size] = on
        triangle = rows % m
        return CurrentBasis(
            np.asarray(vertices[faces[triangle]], dtype=np.float64),
            table,
            weights,
            triangle,
            crosses,
            np.array(copies),
        )

    @property
    def n(self) -> int:
        """Number of functions."""
        return len(self.crosses)

    def symmetries(self) -> list["Symmetry"]:
        """Independent kinds of currents: even or odd about each mirror plane."""
        return [
            Symmetry.of(self, np.array(odd, dtype=bool))
            for odd in itertools.product((False, True), repeat=self.crosses.shape[1])
        ]

    def products(self, weight: F64) -> "csr_matrix":
        """Sparse matrix (n, n) of integrals of products of two functions; ``weight``: (m,) of each triangle."""
        from scipy.sparse import csr_matrix, diags

        points, share = triangle_rule(2)
        place = np.einsum("pk,nkc->npc", points, self.corners)
        t = self.corners
        area = 0.5 * np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
        row, edge = np.nonzero(self.function >= 0)
        flow = (self.weight[row, edge] / area[row])[:, None, None] * (place[row] - t[row, edge][:, None])
        # rows of one triangle add up
        m, q = len(weight), len(share)
        where = (self.triangle[row][:, None] * q + np.arange(q)).ravel()
        of_triangle = np.zeros(m)
        of_triangle[self.triangle] = area
        power = diags((weight[:, None] * of_triangle[:, None] * share).ravel())
        columns = np.repeat(self.function[row, edge], q)
        parts = [
            csr_matrix((flow[..., c].ravel(), (where, columns)), shape=(m * q, self.n)) for c in range(3)
        ]
        return sum(part.T @ power @ part for part in parts).tocsr()

    def plane_waves(self, directions: F64, fields: F64) -> C128:
        r"""Integrals (n, n_directions, n_fields) complex128 of functions times plane waves from the directions.

        .. math:: \int \mathbf f \cdot \mathbf q \, e^{j \hat{\mathbf s} \cdot \mathbf r} dS

        Parameters
        ----------
        directions : (n_directions, 3) float64, unit vectors s
        fields : (n_directions, n_fields, 3) float64, q
        """
        from scipy.sparse import csr_matrix

        points, share = triangle_rule(2)
        place = np.einsum("pk,nkc->npc", points, self.corners)
        row, edge = np.nonzero(self.function >= 0)
        out = np.zeros((self.n, len(directions), fields.shape[1]), dtype=np.complex128)
        where = (self.function[row, edge], row)
        shape = (self.n, len(self.corners))
        weight = self.weight[row, edge]
        constant = csr_matrix((weight, where), shape=shape)
        corner = [csr_matrix((weight * self.corners[row, edge, c], where), shape=shape) for c in range(3)]
        step = max(1, _BLOCK // max(place.shape[0] * place.shape[1], 1))
        for first in range(0, len(directions), step):
            some = slice(first, first + step)
            wave = np.exp(1j * (place @ directions[some].T)) * share[:, None]  # (rows, points, directions)
            whole = wave.sum(axis=1)
            moment = [np.einsum("npd,np->nd", wave, place[..., c]) for c in range(3)]
            parts = [constant @ moment[c] - corner[c] @ whole for c in range(3)]
            out[:, some] = np.einsum("cnd,dqc->ndq", np.array(parts), fields[some])
        return out


@dataclass(frozen=True, eq=False)
class Symmetry:
    """Currents that are even or odd about each mirror plane.

    Parameters
    ----------
    kept : (n,) int64, functions of the basis that do not vanish
    function : (n_rows, 3) int64, their numbers among these, -1 for none
    signs : (n_copies,) float64, of the currents on each copy relative to the mirrored ones
    """

    kept: I64
    function: I64
    signs: F64

    @staticmethod
    def of(basis: CurrentBasis, odd: NDArray[np.bool_]) -> "Symmetry":
        """Currents that change their sign about the planes ``odd`` when mirrored; only these cross the plane."""
        signs = [1.0]
        for other in odd:
            signs += [-s if other else s for s in signs]
        kept = ~(basis.crosses & ~odd).any(axis=1)
        number = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)
        return Symmetry(np.flatnonzero(kept), number[basis.function], np.array(signs))
