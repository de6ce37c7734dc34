"""Expected level of the waves that physical optics and edge waves leave out, from the shape of the metal alone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.arrays import F64, I64
from sarmitsuba.mesh.connected import connected
from sarmitsuba.mesh.curvature import facet_curvature
from sarmitsuba.mesh.edge_pairs import edge_pairs
from sarmitsuba.mesh.pieces import SMOOTH_BEND, piece_of
from sarmitsuba.mesh.sharp_edges import WIDEST_GAP, SharpEdges, sharp_edges
from sarmitsuba.mesh.welding import weld

BETWEEN_EDGES, THIN, NO_EDGES, ROUNDED, CREEPING = "edges", "thin", "no edges", "rounded", "creeping"


@dataclass(frozen=True)
class WaveLaws:
    r"""Amplitudes of the waves that are left out, as fitted; :math:`k` the wavenumber.

    Parameters
    ----------
    hard, soft : amplitude of a wave that crosses a face of the width w and is diffracted again, at
        :math:`k w = 1`, over that of Keller's edge of unit coefficient; electric field across and along the edge
    hard_power, soft_power : falls with :math:`(k w)^{-p}`
    fringe : the same of an edge that is not simulated
    dark : energy of edges on the side turned away
    curved_hard, curved_soft : of curved surfaces of radius :math:`\rho`, at :math:`k \rho = 0`
    curved_power : falls with :math:`(1 + (k \rho)^2)^{-p / 2}`
    """

    hard: float = 1.0
    soft: float = 1.0
    hard_power: float = 0.5
    soft_power: float = 1.0
    most_hard: float = 1.0
    most_soft: float = 1.0
    fringe: float = 0.5
    dark: float = 0.5
    curved_hard: float = 1.0
    curved_soft: float = 1.0
    curved_power: float = 1.0


@dataclass(frozen=True, eq=False)
class MetalLines:
    """Lines from which waves go out that are not simulated: sharp edges, and curved surface as a sum of rounded edges.

    Parameters
    ----------
    along : (n, 3) float64, unit vectors
    length : (n,) float64, m, of the straight piece
    coherent : (n,) float64, m, that at most adds in phase
    normal : (n, 2, 3) float64, outward normals of both faces; zero where waves go all ways
    width : (n, 2) float64, m, of both faces across the line; infinite for curved surface
    radius : (n,) float64, m, of curvature across the line; 0 for sharp edges
    """

    along: F64
    length: F64
    coherent: F64
    normal: F64
    width: F64
    radius: F64

    @property
    def n(self) -> int:
        """Number of lines."""
        return int(self.length.size)


def metal_lines(corners: F64, wavelength: float) -> MetalLines:
    """Lines of metal triangles, see :class:`MetalLines`.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    wavelength : m
    """
    corners = np.asarray(corners, dtype=np.float64)
    vertex = weld(corners.reshape(-1, 3))
    pairs = edge_pairs(vertex)
    piece = piece_of(corners, vertex, pairs)
    edges = sharp_edges(corners, np.ones(len(corners), dtype=bool), WIDEST_GAP * wavelength)
    sharp = _of_edges(edges, corners, piece)
    curved = _of_curvature(corners, vertex, piece, wavelength)
    return MetalLines(
        *(
            np.concatenate([getattr(sharp, name), getattr(curved, name)])
            for name in ("along", "length", "coherent", "normal", "width", "radius")
        )
    )


def _of_edges(edges: SharpEdges, corners: F64, piece: I64) -> MetalLines:
    """Sharp edges, their collinear pieces joined."""
    if not edges.n:
        return _none()
    along = edges.along
    half = 0.5 * edges.length[:, None] * along
    grid = max(float(np.ptp(corners)), 1e-9) * 1e-6
    ends = np.round(np.concatenate([edges.middle - half, edges.middle + half]) / grid)
    _, node = np.unique(ends, axis=0, return_inverse=True)
    node = node.reshape(-1)
    # pieces that go on: two at an end, bent by less than a smooth surface
    order = np.argsort(node, kind="stable")
    first = np.flatnonzero(np.diff(node[order], prepend=-1))
    two = first[np.diff(first, append=node.size) == 2]
    a, b = order[two] % edges.n, order[two + 1] % edges.n
    on = np.abs(np.einsum("ei,ei->e", along[a], along[b])) > np.cos(SMOOTH_BEND)
    chain = connected(edges.n, a[on], b[on])
    straight = np.abs(np.einsum("ei,ei->e", along[a], along[b])) > 1.0 - 1e-6
    line = connected(edges.n, a[straight], b[straight])
    whole = np.bincount(line, edges.length)
    _, pick = np.unique(line, return_index=True)
    coherent = np.bincount(chain, edges.length)[chain][pick]
    normal = edges.normal[pick].copy()
    normal[edges.angle[pick] > 2.0 - 1e-9] = 0.0
    width = _widths(edges, corners, piece)
    widths = np.stack([np.bincount(line, width[:, i] * edges.length) for i in range(2)], axis=1) / whole[:, None]
    return MetalLines(along[pick], whole, coherent, normal, widths, np.zeros(pick.size))


def _widths(edges: SharpEdges, corners: F64, piece: I64) -> F64:
    """(n, 2) extent, m, of the smooth piece of surface on both sides of each edge, mean over the edge's length."""
    count = int(piece.max()) + 1
    area = np.bincount(
        piece, 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    )
    # triangle of each side of each edge: that whose middle is nearest across it
    from scipy.spatial import cKDTree

    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    sides = 0.5 * (corners + np.roll(corners, -1, axis=1)).reshape(-1, 3)
    tree = cKDTree(sides)
    _, near = tree.query(edges.middle, k=min(6, len(sides)))
    near = near.reshape(edges.n, -1)
    found = np.zeros((edges.n, 2), dtype=np.int64)
    for i in range(2):
        inside = np.einsum("eki,ei->ek", corners[near // 3].mean(axis=2) - edges.middle[:, None], edges.inward[:, i])
        level = np.abs(np.einsum("eki,ei->ek", normals[near // 3], edges.normal[:, i]))
        off = np.linalg.norm(sides[near] - edges.middle[:, None], axis=2)
        cost = off + 1e3 * ((inside <= 0.0) | (level < 0.99)) * (1.0 + np.ptp(corners))
        found[:, i] = piece[near[np.arange(edges.n), cost.argmin(axis=1)] // 3]
    # length of each piece's outline of sharp edges that run this way
    width = np.empty((edges.n, 2))
    along = edges.along
    for i in range(2):
        for p in np.unique(found[:, i]):
            rows = np.flatnonzero(found[:, i] == p)
            points = corners[piece == p].reshape(-1, 3)
            extent = ((points @ edges.inward[rows, i].T).max(axis=0)
                      - np.einsum("ei,ei->e", edges.middle[rows], edges.inward[rows, i]))
            run = np.ptp(points @ along[rows].T, axis=0)
            width[rows, i] = np.clip(area[p] / np.maximum(run, 1e-300), 1e-12, np.maximum(extent, 1e-12))
    del count
    return width


def _of_curvature(corners: F64, vertex: I64, piece: I64, wavelength: float) -> MetalLines:
    """Curved surface as rounded edges: each triangle turns by a share of half a turn over its area."""
    shape = facet_curvature(corners, piece, wavelength, vertex)
    if shape is None:
        return _none()
    rows = np.flatnonzero(np.abs(shape[:, :6]).max(axis=1) > 0.0)
    s = shape[rows]
    operator = np.stack(
        [s[:, [0, 3, 4]], s[:, [3, 1, 5]], s[:, [4, 5, 2]]], axis=1
    )
    normal = np.cross(corners[rows, 1] - corners[rows, 0], corners[rows, 2] - corners[rows, 0])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    normal /= np.maximum(2.0 * area, 1e-300)[:, None]
    value, vector = np.linalg.eigh(operator)
    order = np.argsort(-np.abs(value), axis=1)
    bend = np.abs(np.take_along_axis(value, order, axis=1))  # the least is that of the normal, 0
    strongest = np.take_along_axis(vector, order[:, None, :1], axis=2)[:, :, 0]
    along = np.cross(normal, strongest)
    radius = 1.0 / np.maximum(bend[:, 0], 1e-12)
    extent = float(np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0)))
    other = np.sqrt(wavelength / np.maximum(bend[:, 1], 1e-12))
    return MetalLines(
        along,
        area * bend[:, 0] / (2.0 * np.pi),
        np.minimum(other, extent),
        np.zeros((rows.size, 2, 3)),
        np.full((rows.size, 2), np.inf),
        radius,
    )


def _none() -> MetalLines:
    e = np.zeros(0)
    return MetalLines(np.zeros((0, 3)), e, e, np.zeros((0, 2, 3)), np.zeros((0, 2)), e)
