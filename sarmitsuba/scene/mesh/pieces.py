"""Smooth pieces of surface without a crease, and their sizes."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64, box_of_each, unit_rows
from sarmitsuba.scene.mesh.topology import label_connected

# bend of an edge below which the surface continues across it, rad
SMOOTH_BEND = np.radians(20.0)


def piece_of(corners: F64, vertex: I64, pairs: tuple[I64, I64]) -> I64:
    """Smooth piece of surface to which each triangle belongs, as a number.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    vertex : (3 n,) label of each corner's vertex; equal where corners coincide
    pairs : of :func:`sarmitsuba.scene.mesh.topology.edge_pairs`

    Notes
    -----
    Triangles that touch without sharing both ends of an edge (T-junctions) belong to different pieces.
    """
    n = len(corners)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = unit_rows(normal)
    a, b = pairs
    # two neighbours of the same winding traverse their edge in opposite directions
    alike = np.where(vertex[a] == vertex[b], -1.0, 1.0)
    bend = alike * np.einsum("ei,ei->e", normal[a // 3], normal[b // 3])
    joined = bend > np.cos(SMOOTH_BEND)
    return label_connected(n, a[joined] // 3, b[joined] // 3)


def piece_sizes(corners: F64, piece: I64) -> tuple[F64, F64]:
    """Area (m^2) and width (m, the area over the greatest extent) of the piece of each triangle, both (n,) float64."""
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    count = int(piece.max(initial=-1)) + 1
    total = np.bincount(piece, area, count)
    order = np.argsort(piece, kind="stable")
    start = np.flatnonzero(np.diff(piece[order], prepend=-1))
    extent = np.zeros((count, 3))
    if len(piece):
        low, high = box_of_each(corners)
        extent = np.maximum.reduceat(high[order], start) - np.minimum.reduceat(low[order], start)
    width = total / np.maximum(np.linalg.norm(extent, axis=1), 1e-300)
    return np.asarray(total[piece]), np.asarray(width[piece])


def part_sizes(corners: F64, part: I64, area: F64, width: F64, curved: NDArray[np.bool_] | None) -> F64:
    """Width of the convex part of a flat facet at each triangle, to which ray tubes are cut, m, (n,) float64.

    The width of the whole piece where it is curved, or creased into more than ``MOST_PARTS``: rays then hit parts
    narrower than the ray spacing by chance, and represent the parts that they miss.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    part : (n,) of :func:`sarmitsuba.scene.mesh.boundary_edges.facets`
    area, width : (n,) m^2 and m, of each triangle's piece
    curved : (n,) triangles that approximate a curved surface; None: none
    """
    own_area, own_width = piece_sizes(corners, part)
    whole = own_area * MOST_PARTS < area
    if curved is not None:
        whole |= curved
    return np.asarray(np.where(whole, width, own_width))


def ray_needs(
    area: F64,
    width: F64,
    part_width: F64,
    curvature: F64 | None,
    round_need: F64 | None,
    wavelength: float,
) -> tuple[F64, F64]:
    r"""Largest ray spacing for each triangle, for coherent and for diffuse returns, m, (n,) each.

    A piece of surface needs two rays across its width and ``RAYS_ACROSS`` across its size. For coherent returns
    the sagitta within a tube must also stay small against the wavelength: with the radius of curvature :math:`\rho`

    .. math:: d = \sqrt{0.1 \lambda \rho} \geq \lambda / 4.5

    That suffices for surfaces that face the antenna. Limbs and rims of small round bodies need finer rays, see
    :func:`round_needs`.

    Parameters
    ----------
    area, width : (n,) m^2 and m, of each triangle's piece
    part_width : (n,) m, of :func:`part_sizes`
    curvature : (n, 8) of :func:`sarmitsuba.scene.mesh.smooth_surface.facet_curvature`; None: all facets are flat
    round_need : (n,) of :func:`round_needs`; None: there are no round bodies
    wavelength : m
    """
    size = np.minimum(0.5 * width, np.sqrt(area) / RAYS_ACROSS)
    finest = wavelength / 4.5
    coherent = np.maximum(np.minimum(size, 0.5 * part_width), 0.5 * finest)
    if curvature is not None:
        strongest = np.sqrt(
            np.square(curvature[:, :3]).sum(axis=1) + 2.0 * np.square(curvature[:, 3:6]).sum(axis=1)
        )
        bent = strongest > 0.0
        radius = 1.0 / np.where(bent, strongest, 1.0)
        tube = np.maximum(np.sqrt(0.1 * wavelength * radius), finest)
        coherent = np.where(bent, np.minimum(coherent, tube), coherent)
    if round_need is not None:
        coherent = np.minimum(coherent, round_need)
    return coherent, size


def slant_factor(corners: F64, antenna: F64) -> F64:
    r"""Factor on the diffuse ray spacing of each triangle for grazing incidence, (n,) float64 up to 1.

    Of the rays that a piece needs by its size, the share :math:`c`, the cosine of incidence, hits it. Below
    :math:`c_0` = ``SLANTED`` that is about one ray or none, and its return is random: there

    .. math:: d' = d \sqrt{c / c_0}

    keeps the number of rays on it as at :math:`c_0`.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    antenna : (3,) float64, m
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    leg = antenna - corners[:, 0]
    length = np.linalg.norm(normal, axis=1) * np.linalg.norm(leg, axis=1)
    cosine = np.abs(np.einsum("ti,ti->t", normal, leg)) / np.maximum(length, 1e-300)
    return np.asarray(np.sqrt(np.clip(cosine, LEAST_SLANT, SLANTED) / SLANTED))


def round_needs(
    corners: F64,
    vertex: I64,
    part: I64,
    bent: NDArray[np.bool_],
    wavelength: float,
) -> F64:
    """Largest ray spacing for small curved surfaces and for the flat facets that end at them, m, (n,) float64.

    Towards the limb of a curved surface the phase over a tube grows with one over the cube of the cosine, and a flat
    facet with a round rim (the end of a cylinder) is cut to a few straight edges only. Away from specular glints these
    strips determine the return: cylinders of 7 to 12 wavelengths were 0.3 to 2.5 dB off with 4.5 rays per wavelength.
    The error's energy falls with the cube of the spacing and is larger for smaller bodies, which have weaker glints:
    almonds, ogives and spheres of 3 to 6 wavelengths have -20 to -28 dB at a ninth of the wavelength.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    vertex : (3 n,) label of each corner's vertex
    part : (n,) flat facet of each triangle
    bent : (n,) triangles that approximate a curved surface
    wavelength : m

    Returns
    -------
    (n,) m, the finest of ``ROUND_SPACINGS`` wavelengths with which all triangles of a kind (curved, or flat ending at
    curved) need no more than ``ROUND_RAYS`` rays, and for each halving a quarter of them; infinite for others
    """
    own = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    touches = np.isin(vertex, vertex.reshape(-1, 3)[bent]).reshape(-1, 3).any(axis=1) & ~bent
    rimmed = (np.bincount(part, touches)[part] > 0.0) & ~bent
    need = np.full(len(corners), np.inf)
    for kind in (bent, rimmed):
        # the outline of a convex body is on average a quarter of its surface (Cauchy)
        outline = 0.25 * own[kind].sum()
        most = [(s, ROUND_RAYS * (s / ROUND_SPACINGS[0]) ** 2) for s in ROUND_SPACINGS]
        spacings = [s * wavelength for s, rays in most if outline <= rays * (s * wavelength) ** 2]
        need[kind] = min(spacings, default=np.inf)
    return need


# rays across a small piece of surface, each way: the number of rays of a lattice on it then varies little
RAYS_ACROSS = 5.0
# cosine of incidence below which small pieces of surface need more rays than by their size, and least cosine
SLANTED, LEAST_SLANT = 0.2, 0.01
# a quarter of the rays allowed for all finer lattices of a small scene
ROUND_RAYS = 150_000
# ray spacings of small round bodies, wavelengths: halves of 1 / 4.5, as finer lattices have. 1 / 9 for spheres of a
# radius up to 24 wavelengths, 1 / 18 up to 6, 1 / 36 up to 1.5
ROUND_SPACINGS = (1.0 / 9.0, 1.0 / 18.0, 1.0 / 36.0)
# most convex flat parts of a piece of surface for which each part gets its own rays
MOST_PARTS = 32.0
