"""Scattering of metal bodies by their surface currents, solved by the method of moments."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.arrays import C128, F64, I64
from sarmitsuba.currents.basis import CurrentBasis
from sarmitsuba.currents.matrix import MomentMatrices
from sarmitsuba.mesh.conforming import conforming
from sarmitsuba.mesh.mirrors import mirror_planes, part_of
from sarmitsuba.mesh.remesh import DEVIATION, remesh

# tolerance of corners that are one, over the wanted length of edges
JOINED = 1.0 / 200.0
# surface resistance of closed bodies over 120 pi ohm, which damps the resonances of the closed space inside
RESISTANCE = 0.003


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
            vertices, faces, *mirror_planes(vertices, faces, DEVIATION * length, 0.5 * length)
        )

    def meshed(self, length: float) -> "BodyMesh":
        """Mesh of the part that mirrors complete, in edges of a length, m."""
        vertices, faces = self.vertices, self.faces
        if self.normals.size:
            vertices, faces = part_of(vertices, faces, self.center, self.normals, JOINED * length)
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
    def closed(self) -> NDArray[np.bool_]:
        """Whether the connected surface of each triangle has no rim: edges of one triangle lie on mirror planes."""
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import connected_components

        n, m = len(self.vertices), len(self.faces)
        links = (np.ones(3 * m), (self.faces.ravel(), np.roll(self.faces, -1, axis=1).ravel()))
        _, body = connected_components(coo_matrix(links, shape=(n, n)), directed=False)
        ends = np.sort(self.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        edge, count = np.unique(ends, axis=0, return_counts=True)
        rim = edge[count == 1]
        off = np.abs(self.vertices[rim] @ self.normals.T).max(axis=1, initial=0.0) > 1e-3 * self.length
        opened = np.zeros(int(body.max(initial=0)) + 1, dtype=bool)
        opened[body[rim[off.all(axis=1), 0]]] = True
        return np.asarray(~opened[body[self.faces[:, 0]]])


def scattering_matrices(
    mesh: BodyMesh,
    wavelength: float,
    directions: F64,
    fields: F64,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> C128:
    r"""Monostatic scattering amplitudes (n, 2, 2) complex128, m, from the currents that plane waves induce.

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
    Amplitudes [direction, received, sent], phase :math:`e^{-j k L}` about the frame's origin; a plate there that is
    seen squarely has a positive one. Not numbers where the equations are singular

    Notes
    -----
    Of perfect conductors. Ignores what the edges of the mesh's triangles cannot resolve: rounding smaller than an edge,
    and currents that grow towards sharp edges, whose error falls with the length of the edges. Closed bodies have a
    surface resistance of ``RESISTANCE`` times 120 pi ohm (-0.03 dB), which damps currents of the resonances inside.

    References
    ----------
    Rao, Wilton, Glisson, IEEE Transactions on Antennas and Propagation 30(3), 1982; Harrington, Field Computation by
    Moment Methods (1968), chapter 3.
    """
    from scipy.linalg import LinAlgWarning, lu_factor, lu_solve

    k = 2.0 * np.pi / wavelength
    total = np.zeros((len(directions), 2, 2), dtype=np.complex128)
    basis = CurrentBasis.of(k * mesh.vertices, mesh.faces, mesh.normals, 1e-3 * k * mesh.length)
    matrices = MomentMatrices.of(basis, np.where(mesh.closed, RESISTANCE, 0.0))
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
            factors = lu_factor(matrices.matrix(part).T, overwrite_a=True, check_finite=False)
        right = sent.reshape(part.kept.size, -1).astype(np.complex64)
        current = lu_solve(factors, right, check_finite=False).reshape(sent.shape)
        total += len(waves) * np.einsum("ndp,ndq->dpq", sent, current)
    progress(len(parts), len(parts))
    total *= np.exp(2j * k * (directions @ mesh.center))[:, None, None]
    return np.asarray(-1j / (k * np.sqrt(4.0 * np.pi)) * total)
