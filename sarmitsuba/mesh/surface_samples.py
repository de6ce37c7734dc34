"""Points spread over surfaces at random, fixed to the scene: the same ones for every look, pulse and pass."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
U32 = NDArray[np.uint32]

# cells that are worked on at a time; bounds the temporary arrays
CHUNK = 2_000_000
# cells in the thickness of a layer that tells surfaces over one another apart
LAYER_CELLS = 4.0


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Random points of triangles.

    Parameters
    ----------
    face : (n,) rows of the triangles
    point : (n, 3) float64, m
    normal : (n, 3) float64, unit normal by the triangle's winding
    density : (n,) float64, points for each m^2 of surface there
    key : (n,) uint32, a hash of each
    """

    face: NDArray[np.intp]
    point: F64
    normal: F64
    density: F64
    key: U32

    @property
    def n(self) -> int:
        """Number of points."""
        return int(self.face.size)


def surface_samples(triangles: F64, cell: float, box: F64, seed: int) -> SurfaceSamples:
    r"""One point in each cell of a lattice that a surface fills, at a random place in the cell.

    The cells are squares in the two axes that span a triangle best, the normal's largest component :math:`n_c` left
    out, so that there are

    .. math:: |n_c| / \mathrm{cell}^2

    points for each unit of area. Where a point stands depends on its cell and on nothing else: another cut of the same
    surface, or another look, has the same points.

    Parameters
    ----------
    triangles : (n, 3, 3) float64, m
    cell : m, edge of the cells
    box : (2, 3) float64, m; only points within
    seed : of the places
    """
    e1, e2 = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(e1, e2)
    size = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(size, 1e-300)[:, None]
    left_out = np.argmax(np.abs(normal), axis=1)
    axes = np.stack([(left_out + 1) % 3, (left_out + 2) % 3], axis=1)
    flat = np.take_along_axis(triangles, np.repeat(axes[:, None], 3, axis=1), axis=2)
    low = np.maximum(flat.min(axis=1), np.take(box[0], axes))
    high = np.minimum(flat.max(axis=1), np.take(box[1], axes))
    first = np.floor(low / cell).astype(np.int64)
    count = np.where((high >= low) & (size > 0.0)[:, None], np.floor(high / cell) - first + 1, 0)
    count = count.astype(np.int64)
    cells = count[:, 0] * count[:, 1]
    parts = []
    ends = np.searchsorted(np.cumsum(cells), np.arange(CHUNK, cells.sum() + CHUNK, CHUNK), side="left") + 1
    for start, stop in zip([0, *ends[:-1]], ends, strict=True):
        faces = np.repeat(np.arange(start, min(stop, len(cells))), cells[start:stop])
        if not faces.size:
            continue
        within = np.arange(faces.size) - np.repeat(
            np.cumsum(cells[start:stop]) - cells[start:stop], cells[start:stop]
        )
        row, column = np.divmod(within, count[faces, 1])
        number = first[faces] + np.stack([row, column], axis=1)
        parts.append(_in_cells(triangles, flat, normal, left_out, axes, faces, number, cell, box, seed))
    if not parts:
        none = np.zeros((0, 3))
        return SurfaceSamples(np.zeros(0, np.intp), none, none, np.zeros(0), np.zeros(0, np.uint32))
    face, point, key = (np.concatenate(column) for column in zip(*parts, strict=True))
    return SurfaceSamples(
        face=face,
        point=point,
        normal=normal[face],
        density=surface_density(normal[face], cell),
        key=key,
    )


def surface_density(normal: F64, cell: float) -> F64:
    """Points for each m^2 of surfaces (n, 3) of these unit normals."""
    return np.asarray(np.abs(normal).max(axis=1) / cell**2)


def _in_cells(
    triangles: F64,
    flat: F64,
    normal: F64,
    left_out: NDArray[np.intp],
    axes: NDArray[np.intp],
    face: NDArray[np.intp],
    number: NDArray[np.int64],
    cell: float,
    box: F64,
    seed: int,
) -> tuple[NDArray[np.intp], F64, U32]:
    """Points of some cells (n, 2) of faces that lie in their triangle: faces, points, keys."""
    key = _mixed(number[:, 0].astype(np.uint32) * np.uint32(0x9E3779B1) + np.uint32(seed & 0xFFFFFFFF))
    key = _mixed(key ^ (number[:, 1].astype(np.uint32) * np.uint32(0x85EBCA77) + np.uint32(0x27D4EB2F)))
    key = _mixed(key ^ (left_out[face].astype(np.uint32) * np.uint32(0x165667B1) + np.uint32(0x3C6EF372)))
    second = _mixed(key ^ np.uint32(0xB5297A4D))
    place = (number + (np.stack([key, second], axis=1) + 0.5) * 2.0**-32) * cell
    origin, a, b = flat[face, 0], flat[face, 1] - flat[face, 0], flat[face, 2] - flat[face, 0]
    d = place - origin
    determinant = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (d[:, 0] * b[:, 1] - d[:, 1] * b[:, 0]) / determinant
        v = (a[:, 0] * d[:, 1] - a[:, 1] * d[:, 0]) / determinant
    inside = (u >= 0.0) & (v >= 0.0) & (u + v < 1.0)
    face, key, place = face[inside], key[inside], place[inside]
    point = np.empty((face.size, 3))
    np.put_along_axis(point, axes[face], place, axis=1)
    # along the axis left out onto the triangle's plane
    height = triangles[face, 0] - np.where(np.arange(3) == left_out[face][:, None], 0.0, point)
    rest = (
        np.einsum("ij,ij->i", height, normal[face])
        / np.take_along_axis(normal[face], left_out[face][:, None], axis=1)[:, 0]
    )
    np.put_along_axis(point, left_out[face][:, None], rest[:, None], axis=1)
    layer = np.floor(rest / (LAYER_CELLS * cell) + 0.4142).astype(np.int64).astype(np.uint32)
    key = _mixed(key ^ (layer * np.uint32(0xC2B2AE3D) + np.uint32(0x68E31DA4)))
    lit = ((point >= box[0]) & (point <= box[1])).all(axis=1)
    return face[lit], point[lit], key[lit]


def _mixed(x: U32) -> U32:
    """One round of a 32-bit finaliser; every input bit reaches every output bit."""
    x = x ^ (x >> np.uint32(16))
    x = x * np.uint32(0x7FEB352D)
    x = x ^ (x >> np.uint32(15))
    x = x * np.uint32(0x846CA68B)
    return np.asarray(x ^ (x >> np.uint32(16)), dtype=np.uint32)


__all__ = ["SurfaceSamples", "surface_density", "surface_samples"]
