"""Flat facets of triangles whose vertices are a little off their common plane, by rounding or noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.scene.mesh.topology import label_connected

# largest distance of a vertex from the plane of its facet, wavelengths: 0.025 rad of two-way phase
LARGEST_DISTANCE = 2e-3
# tolerances that are tried in turn, as shares of the largest one
SHARES = 4.0 ** -np.arange(9)
# factor on the tolerance with which a facet has the same triangles
CLEAR = 4.0
# largest bend between neighbours in one plane, rad: that of slivers, whose normals are mostly noise
LARGEST_BEND = np.pi / 3.0
# rounding of a coordinate, below which a distance from the plane is none, float64 steps
ROUNDINGS = 16.0


def flatten_facets(corners: F64, pairs: tuple[I64, I64], wavelength: float) -> F64:
    """Corners of the triangles, those of nearly flat facets moved into the facet's plane.

    Noise of the vertices tilts narrow triangles by any angle: their normals, bends and curvature then mean nothing,
    although the surface is flat to a small part of a wavelength. Neighbours join into a facet where they bend by no
    more than vertices a tolerance off the plane explain. If all of its vertices lie within the tolerance of one plane,
    the least-squares one weighted by area, they are moved there. Other facets are tried with smaller tolerances: those
    of a finely meshed curved surface fall apart into single triangles, which stay as they are.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    pairs : of :func:`sarmitsuba.scene.mesh.topology.edge_pairs`
    wavelength : m

    Returns
    -------
    (n, 3, 3) float64, m; ``corners`` itself where nothing moves. No corner moves by more than ``LARGEST_DISTANCE``
    wavelengths; those of different facets at one vertex may part by as much.

    Notes
    -----
    Ignores facets that meet at T-junctions: each is flattened alone. Triangles that noise tilts by more than 60
    degrees stay apart.
    """
    sides = _Sides.of(corners, *pairs)
    faces = np.unique(np.concatenate([sides.own, sides.other])[np.tile(sides.lifted, 2)])
    if not faces.size:
        return corners
    out = corners.copy()
    undecided = np.ones(len(corners), dtype=bool)
    for tolerance in LARGEST_DISTANCE * wavelength * SHARES:
        sides = sides.of_faces(undecided)
        joined = sides.bend <= tolerance * sides.inverse_heights
        facet = label_connected(len(corners), sides.own[joined], sides.other[joined])
        lifted = np.zeros(len(corners), dtype=bool)
        lifted[facet[sides.own[joined & sides.lifted]]] = True
        rows = np.flatnonzero(lifted[facet])
        if not rows.size:
            break
        moved, near = _onto_planes(corners[rows], facet[rows], tolerance)
        # a facet of a curved surface grows with the tolerance
        wider = sides.bend <= CLEAR * tolerance * sides.inverse_heights
        whole = label_connected(len(corners), sides.own[wider], sides.other[wider])
        near &= (np.bincount(facet)[facet] == np.bincount(whole)[whole])[rows]
        out[rows[near]] = moved[near]
        undecided[:] = False
        undecided[rows[~near]] = True
    return out


@dataclass(frozen=True, eq=False)
class _Sides:
    """Common sides of two triangles that may lie in one plane.

    Parameters
    ----------
    own, other : (n,) triangles
    bend : (n,) sine of the bend
    inverse_heights : (n,) 1/m, sum over both triangles of one over the least height
    lifted : (n,) the triangles are not in one plane to the rounding of float64
    """

    own: I64
    other: I64
    bend: F64
    inverse_heights: F64
    lifted: NDArray[np.bool_]

    @staticmethod
    def of(corners: F64, one: I64, two: I64) -> "_Sides":
        step = np.roll(corners, -1, axis=1) - corners
        normal = np.cross(step[:, 0], step[:, 1])
        twice = np.linalg.norm(normal, axis=1)
        normal /= np.maximum(twice, 1e-300)[:, None]
        length = np.maximum(np.linalg.norm(step, axis=2), 1e-300)
        inverse = length.max(axis=1) / np.maximum(twice, 1e-300)
        own, other = one // 3, two // 3
        along = step / length[:, :, None]
        inward = np.cross(normal[:, None], along).reshape(-1, 3)
        bent = np.einsum("ei,ei->e", inward[one], inward[two]) < -np.cos(LARGEST_BEND)
        one, two, own, other = one[bent], two[bent], own[bent], other[bent]
        bend = np.abs(np.einsum("ei,ei->e", inward[two], normal[own]))
        # of the flatter one: a narrow triangle has no reliable plane
        height = np.minimum(twice[own] / length.ravel()[one], twice[other] / length.ravel()[two])
        rounding = ROUNDINGS * np.finfo(np.float64).eps * np.abs(corners).reshape(-1, 9).max(axis=1)
        return _Sides(
            own,
            other,
            bend,
            inverse[own] + inverse[other],
            bend * height > np.maximum(rounding[own], rounding[other]),
        )

    def of_faces(self, chosen: NDArray[np.bool_]) -> "_Sides":
        """Sides of which both triangles are chosen."""
        kept = chosen[self.own] & chosen[self.other]
        return _Sides(
            self.own[kept], self.other[kept], self.bend[kept], self.inverse_heights[kept], self.lifted[kept]
        )


def _onto_planes(corners: F64, facet: I64, tolerance: float) -> tuple[F64, NDArray[np.bool_]]:
    """Corners moved onto the planes of their facets, and whether all of a facet's are within the tolerance."""
    first, facet = np.unique(facet, return_index=True, return_inverse=True)[1:]
    facet = facet.reshape(-1)
    points = corners - corners[first, 0][facet][:, None]
    area = 0.5 * np.linalg.norm(np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]), axis=1)
    total = np.maximum(np.bincount(facet, area), 1e-300)
    middle = points.mean(axis=1)
    centre = np.stack([np.bincount(facet, area * x) for x in middle.T], axis=1) / total[:, None]
    points, middle = points - centre[facet][:, None], middle - centre[facet]
    # second moments of a triangle: of its corners, and nine times that of its middle, over twelve
    moment = np.einsum("fki,fkj->fij", points, points) + 9.0 * middle[:, :, None] * middle[:, None]
    moment = (moment * area[:, None, None]).reshape(-1, 9)
    spread = np.stack([np.bincount(facet, x) for x in moment.T], axis=1) / total[:, None]
    normal = np.linalg.eigh(spread.reshape(-1, 3, 3))[1][:, :, 0]
    height = np.einsum("fki,fi->fk", points, normal[facet])
    largest = np.zeros(len(total))
    np.maximum.at(largest, facet, np.abs(height).max(axis=1))
    return corners - height[:, :, None] * normal[facet][:, None], (largest <= tolerance)[facet]
