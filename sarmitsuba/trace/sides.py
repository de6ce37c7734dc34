"""Where flat facets end: the sharp sides that limit a ray tube on each triangle."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.scene.meshes import weld

F64 = NDArray[np.float64]

# bend of an edge below which the surface goes on across it and tubes are not ended there
SMOOTH_BEND = np.radians(20.0)
# bend below which two triangles lie in one plane, rad
FLAT_BEND = 1e-4
N_SIDES = 4


def facet_sides(corners: F64, place: NDArray[np.int64] | None = None) -> NDArray[np.float32]:
    """Sharp sides of the flat facet that each triangle belongs to.

    A side is sharp where no neighbour continues the surface within ``SMOOTH_BEND``. A triangle alone in its plane
    has its own sharp sides; two triangles that make a convex quadrilateral share its four; triangles of a larger
    facet keep those of their own sides that are sharp.

    Parameters
    ----------
    corners : (n_faces, 3, 3) float64, m
    place : (3 n_faces,) labels of the corners' places, None to work them out

    Returns
    -------
    (n_faces, 4, 4) float32 : up to four sides ``(m_x, m_y, m_z, c)`` with ``m`` the unit vector in the plane, into
        the facet, and ``m . (p - corner 0) - c`` the distance from the side in m; unused ones are ``(0, 0, 0, -1)``

    Notes
    -----
    Ignores T-junctions (their sides count as sharp) and facets of more than two triangles beyond the triangle hit.
    """
    n = corners.shape[0]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    start, end = corners, np.roll(corners, -1, axis=1)
    along = end - start
    along /= np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-300)
    inward = np.cross(normal[:, None, :], along)

    mate, mates_inward = _neighbours(weld(corners.reshape(-1, 3)) if place is None else place, inward)
    bend = np.einsum("fki,fki->fk", inward, mates_inward)  # -1: flat
    alone = mate < 0
    smooth = ~alone & (bend < -np.cos(SMOOTH_BEND))
    # sine of a tiny bend from the normals' difference, where the cosine has no digits left
    off_plane = np.abs(np.einsum("fki,fi->fk", mates_inward, normal))
    flat = smooth & (off_plane < FLAT_BEND)

    sides = np.zeros((n, N_SIDES, 4))
    sides[:, :, 3] = -1.0
    offset = np.einsum("fki,fki->fk", inward, start - corners[:, :1])
    own = np.concatenate([inward, offset[:, :, None]], axis=2)
    sharp = ~smooth
    sides[:, :3][sharp] = own[sharp]

    first, second = _pairs(mate, flat)
    if first.size:
        shift = corners[second, 0] - corners[first, 0]
        k_first, k_second = flat[first].argmax(axis=1), flat[second].argmax(axis=1)
        others = np.array([[1, 2], [2, 0], [0, 1]])
        a, b = others[k_first], others[k_second]
        mine, theirs = own[first[:, None], a], own[second[:, None], b].copy()
        theirs[:, :, 3] += np.einsum("pki,pi->pk", theirs[:, :, :3], shift)
        quad = np.concatenate([mine, theirs], axis=1)
        keep = np.concatenate([sharp[first[:, None], a], sharp[second[:, None], b]], axis=1)
        points = np.concatenate([corners[first], corners[second]], axis=1) - corners[first, :1]
        height = np.einsum("pki,pji->pkj", quad[:, :, :3], points) - quad[:, :, 3:]
        convex = (height > -1e-6 * np.abs(points).max(axis=(1, 2))[:, None, None]).all(axis=(1, 2))
        quad[~keep] = (0.0, 0.0, 0.0, -1.0)
        sides[first[convex]] = quad[convex]
        quad = quad.copy()
        quad[:, :, 3] -= np.where(keep, np.einsum("pki,pi->pk", quad[:, :, :3], shift), 0.0)
        sides[second[convex]] = quad[convex]
    return sides.astype(np.float32)


def _neighbours(place: NDArray[np.int64], inward: F64) -> tuple[NDArray[np.int64], F64]:
    """Face across each side (-1: none, or more than one) and that face's inward vector at the common edge."""
    n = inward.shape[0]
    ids = place.reshape(n, 3)
    start, end = ids, np.roll(ids, -1, axis=1)
    key = (np.minimum(start, end) * (ids.max() + 1) + np.maximum(start, end)).ravel()
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    pair = first[np.diff(first, append=len(key)) == 2]
    a, b = order[pair], order[pair + 1]
    mate = np.full(3 * n, -1, dtype=np.int64)
    mate[a], mate[b] = b // 3, a // 3
    across = np.zeros((3 * n, 3))
    flat_inward = inward.reshape(-1, 3)
    across[a], across[b] = flat_inward[b], flat_inward[a]
    return mate.reshape(n, 3), across.reshape(n, 3, 3)


def _pairs(mate: NDArray[np.int64], flat: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Faces that are each other's only neighbour in one plane, every pair once."""
    single = flat.sum(axis=1) == 1
    other = np.where(single, mate[np.arange(mate.shape[0]), flat.argmax(axis=1)], -1)
    face = np.flatnonzero(single)
    face = face[single[other[face]] & (face < other[face])]
    return face, other[face]


__all__ = ["FLAT_BEND", "N_SIDES", "SMOOTH_BEND", "facet_sides"]
