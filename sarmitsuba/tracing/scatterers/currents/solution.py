"""Scattering of metal bodies by their surface currents, solved by the method of moments."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C128, F64, I64
from sarmitsuba.scene.mesh.mirrors import mirror_planes, part_of
from sarmitsuba.scene.mesh.remesh import DEVIATION, conforming, remesh
from sarmitsuba.scene.mesh.topology import edge_pairs, label_connected
from sarmitsuba.tracing.scatterers.currents.basis import CurrentBasis
from sarmitsuba.tracing.scatterers.currents.matrix import MomentMatrices

# tolerance of corners that are one, over the wanted length of edges
JOINED = 1.0 / 200.0
# distance of corners that are moved onto a mirror plane, over the wanted length of edges
MOVED = 0.1 * JOINED
# step between points that are mirrored, over the wanted length of edges
MIRROR_STEP = 0.5
# surface resistance of closed bodies over 120 pi ohm, which damps the resonances of the closed space inside, where
# volume over surface is as of the least sphere that has one, wavelengths; in proportion where it is less
RESISTANCE, DEPTH = 0.003, 2.744 / (6.0 * np.pi)
# equations of each symmetry whose residual is measured
DRAWN = 64


@dataclass(frozen=True, eq=False)
class WholeSurface:
    """Surface of a metal body before it is meshed, with its mirror planes.

    Parameters
    ----------
    vertices : (n, 3) float64, m
    faces : (m, 3) int64, that meet corner to corner; none where the surface is too narrow
    center : (3,) float64, m, on all mirror planes
    normals : (k, 3) float64, unit vectors of the mirror planes
    """

    vertices: F64
    faces: I64
    center: F64
    normals: F64

    @staticmethod
    def of(corners: F64, length: float) -> "WholeSurface":
        """Surface of triangles.

        Parameters
        ----------
        corners : (n, 3, 3) float64, m, of triangles that need not meet corner to corner
        length : m, of the longest edges with which it is to be meshed
        """
        vertices, faces = conforming(corners, JOINED * length)
        return WholeSurface(
            vertices, faces, *mirror_planes(vertices, faces, DEVIATION * length, MIRROR_STEP * length)
        )

    def make_mesh(self, length: float) -> "BodyMesh":
        """Mesh of the part that mirrors complete, in edges of a length, m."""
        vertices, faces = self.vertices, self.faces
        if self.normals.size:
            vertices, faces = part_of(vertices, faces, self.center, self.normals, MOVED * length)
        vertices, faces = remesh(vertices - self.center, faces, length)
        return BodyMesh(vertices, faces, self.center, self.normals, length)


@dataclass(frozen=True, eq=False)
class BodyMesh:
    """Mesh of a metal body for its currents: the part that mirrors complete, in edges of one length.

    Parameters
    ----------
    vertices : (n, 3) float64, m, about ``center``
    faces : (m, 3) int64
    center : (3,) float64, m, on all mirror planes
    normals : (k, 3) float64, unit vectors of the mirror planes
    length : m, wanted length of edges
    """

    vertices: F64
    faces: I64
    center: F64
    normals: F64
    length: float

    @property
    def unknowns(self) -> int:
        """Number of functions of the part, about."""
        return (3 * len(self.faces)) // 2

    @cached_property
    def rms_edge(self) -> float:
        """Root mean square of the lengths of edges, m."""
        t = self.vertices[self.faces]
        return float(np.sqrt(np.square(t - np.roll(t, 1, axis=1)).sum(axis=2).mean()))

    @cached_property
    def body(self) -> I64:
        """(m,) int64, number of the connected surface of each triangle."""
        n, corner = len(self.vertices), self.faces.ravel()
        return label_connected(n, corner, np.roll(self.faces, -1, axis=1).ravel())[self.faces[:, 0]]

    @cached_property
    def closed(self) -> NDArray[np.bool_]:
        """Whether the connected surface of each triangle has no rim: edges of one triangle lie on mirror planes."""
        ends = np.sort(self.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        _, first, count = np.unique(ends, axis=0, return_index=True, return_counts=True)
        rim = first[count == 1]
        off = np.abs(self.vertices[ends[rim]] @ self.normals.T).max(axis=1, initial=0.0) > 1e-3 * self.length
        opened = np.zeros(int(self.body.max(initial=0)) + 1, dtype=bool)
        opened[self.body[rim[off.all(axis=1)] // 3]] = True
        return np.asarray(~opened[self.body])

    @cached_property
    def depth(self) -> F64:
        """(m,) m, volume over surface of the body of closed triangles, infinite where no winding gives it; else 0."""
        t = self.vertices[self.faces]
        count = int(self.body.max(initial=0)) + 1
        turned, orientable = _wound(self.faces)
        volume = turned * np.einsum("nc,nc->n", t[:, 0], np.cross(t[:, 1], t[:, 2])) / 6.0
        area = 0.5 * np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
        whole = np.abs(np.bincount(self.body, volume, count)) / np.bincount(self.body, area, count)
        whole[np.bincount(self.body, ~orientable, count) > 0] = np.inf
        return np.where(self.closed, whole[self.body], 0.0)


def _wound(faces: I64) -> tuple[F64, NDArray[np.bool_]]:
    """Sign (m,) of each triangle that makes neighbours wound alike, and whether the neighbours of each are."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order

    m = len(faces)
    first, second = edge_pairs(faces.ravel())
    # neighbours of the same winding run along their edge in opposite directions
    same = np.where(faces.ravel()[first] == faces.ravel()[second], -1.0, 1.0)
    a, b = first // 3, second // 3
    sign = np.zeros(m)
    graph = coo_matrix((np.ones(a.size), (a, b)), shape=(m, m)).tocsr()
    flip = dict(zip(zip(a.tolist(), b.tolist(), strict=True), same.tolist(), strict=True))
    for root in range(m):
        if sign[root]:
            continue
        order, before = breadth_first_order(graph, root, directed=False)
        sign[root] = 1.0
        for i in order[1:].tolist():
            j = int(before[i])
            sign[i] = sign[j] * flip[(j, i) if (j, i) in flip else (i, j)]
    wrong = sign[a] * sign[b] != same
    good = np.ones(m, dtype=bool)
    good[a[wrong]] = good[b[wrong]] = False
    return sign, good


@dataclass(frozen=True, eq=False)
class Scattered:
    """Monostatic scattering amplitudes from currents, and the errors in them.

    Parameters
    ----------
    matrices : (n, 2, 2) complex128, m, amplitudes [direction, received, sent]
    losses : (n, 2, 2) complex128, m, contribution of the artificial losses, to first order
    residual : (n, 2, 2) float64, m, rms of the contribution of the residual of the equations
    """

    matrices: C128
    losses: C128
    residual: F64


def scattering_matrices(
    mesh: BodyMesh,
    wavelength: float,
    directions: F64,
    fields: F64,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Scattered:
    r"""Monostatic scattering amplitudes from the currents that plane waves induce.

    .. math:: S_{pq} = \frac{k}{\sqrt{4 \pi}}\, b_p^T Z^{-1} b_q

    with the electric field integral equation tested by the functions themselves; :math:`|S|^2` is the RCS. Currents of
    each symmetry of the mirrors are solved apart.

    Parameters
    ----------
    mesh : of the body
    wavelength : m
    directions : (n, 3) float64, unit vectors to the radar
    fields : (n, 2, 3) float64, polarisation vectors p and q
    progress : called with the number of solved symmetries, and of all

    Returns
    -------
    Amplitudes, phase :math:`e^{-j k L}` about the frame's origin; a plate there that is
    seen squarely has a positive one. Not numbers where the equations are singular

    Notes
    -----
    Of perfect conductors. Ignores details that the edges of the mesh's triangles cannot resolve: rounding smaller than
    an edge, and currents that grow towards sharp edges, whose error falls with the length of the edges. Closed bodies
    have a surface resistance of ``RESISTANCE`` times 120 pi ohm (-0.03 dB), and less in proportion where they are
    thinner than ``DEPTH``, which damps currents of the resonances inside at one quality. Its effect follows from the
    currents: with the matrix P of products of the functions, :math:`dS/dR = S_{pq}` with :math:`j\, b_p^T Z^{-1} P
    Z^{-1} b_q`.

    References
    ----------
    Rao, Wilton, Glisson, IEEE Transactions on Antennas and Propagation 30(3), 1982; Harrington, Field Computation by
    Moment Methods (1968), chapter 3.
    """
    from scipy.linalg import LinAlgWarning, lu_factor, lu_solve

    k = 2.0 * np.pi / wavelength
    total = np.zeros((3, len(directions), 2, 2), dtype=np.complex128)
    basis = CurrentBasis.of(k * mesh.vertices, mesh.faces, mesh.normals, 1e-3 * k * mesh.length)
    resistance = RESISTANCE * np.minimum(1.0, mesh.depth / (DEPTH * wavelength))
    matrices, products = MomentMatrices.of(basis, resistance), basis.products(resistance)
    draws = np.random.default_rng(0)
    waves = [basis.plane_waves(directions @ copy.T, fields @ copy.T) for copy in basis.copies]
    parts = basis.symmetries()
    for done, part in enumerate(parts):
        progress(done, len(parts))
        if not part.kept.size:
            continue
        sent = sum(sign * wave[part.kept] for sign, wave in zip(part.signs, waves, strict=True)) / len(waves)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LinAlgWarning)  # the amplitudes are then not numbers
            # symmetric: the transpose is in the order of columns, and is overwritten
            matrix = matrices.matrix(part).T
            rows = draws.permutation(part.kept.size)[:DRAWN]
            drawn = matrix[rows].astype(np.complex128)
            factors = lu_factor(matrix, overwrite_a=True, check_finite=False)
        right = sent.reshape(part.kept.size, -1).astype(np.complex64)
        solution = lu_solve(factors, right, check_finite=False)
        current, n = solution.reshape(sent.shape), len(waves)
        lossy = (products[part.kept][:, part.kept] @ solution).reshape(sent.shape)
        total[0] += n * np.einsum("ndp,ndq->dpq", sent, current)
        total[1] += 1j * n * np.einsum("ndp,ndq->dpq", current, lossy)
        off = (drawn @ solution - right[rows]).reshape(-1, *sent.shape[1:])
        square = np.einsum("ndp,ndq->dpq", np.square(np.abs(current[rows])), np.square(np.abs(off)))
        total[2] += n**2 * part.kept.size / rows.size * square
    progress(len(parts), len(parts))
    total[:2] *= np.exp(2j * k * (directions @ mesh.center))[:, None, None]
    scale = -1j / (k * np.sqrt(4.0 * np.pi))
    return Scattered(scale * total[0], scale * total[1], abs(scale) * np.sqrt(total[2].real))
