"""Random sample points on surfaces, fixed to the scene: identical for every look, pulse and pass."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64, U32, box_of_each

# cells processed at a time; bounds the temporary arrays
CHUNK = 2_000_000
# thickness, in cells, of the height layers that distinguish surfaces above one another
LAYER_CELLS = 4.0


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Random points of triangles.

    Parameters
    ----------
    face : (n,) rows of the triangles
    point : (n, 3) float64, m
    normal : (n, 3) float64, unit normal by the triangle's winding
    density : (n,) float64, points per m^2 of surface
    key : (n,) uint32, hash of each point
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
    r"""Random points on surfaces, one in each cell of a fixed lattice, at a random position in the cell.

    The cells are squares in the two axes that span a triangle best, the normal's largest component :math:`n_c` left
    out, so that there are

    .. math:: |n_c| / \mathrm{cell}^2

    points per unit of area. The position of a point depends on its cell alone: another triangulation of the same
    surface, and another look, give the same points.

    Parameters
    ----------
    triangles : (n, 3, 3) float64, m
    cell : m, edge of the cells
    box : (2, 3) float64, m; only points within
    seed : of the positions
    """
    flat = _Flattened.of(triangles)
    low, high = flat.rectangles(box)
    first = np.floor(low / cell).astype(np.int64)
    count = np.where((high >= low) & flat.wide[:, None], np.floor(high / cell) - first + 1, 0).astype(
        np.int64
    )
    cells = count[:, 0] * count[:, 1]
    total = int(cells.sum())
    ends = [len(cells)]
    if total > CHUNK:
        ends = [*(np.searchsorted(np.cumsum(cells), np.arange(CHUNK, total, CHUNK)) + 1), len(cells)]
    parts = [
        _sample_cells(flat, start, cells[start:stop], first, count, cell, seed)
        for start, stop in zip([0, *ends[:-1]], ends, strict=True)
    ]
    face, point, key = (np.concatenate(column) for column in zip(*parts, strict=True))
    lit = ((point >= box[0]) & (point <= box[1])).all(axis=1)
    face, point, key = face[lit], point[lit], key[lit]
    normal = flat.normal[face]
    return SurfaceSamples(face, point, normal, surface_density(normal, cell), key)


def spanned_area(triangles: F64, box: F64) -> float:
    """Area of the rectangles whose cells `surface_samples` visits, m^2; same arguments."""
    flat = _Flattened.of(triangles)
    low, high = flat.rectangles(box)
    return float(np.prod(np.maximum(high - low, 0.0), axis=1) @ flat.wide)


def surface_density(normal: F64, cell: float) -> F64:
    """Points per m^2 of surfaces with unit normals (n, 3)."""
    return np.asarray(np.abs(normal).max(axis=1) / cell**2)


@dataclass(frozen=True, eq=False)
class _Flattened:
    """Triangles projected onto the coordinate plane in which each has its largest area.

    Parameters
    ----------
    axes, left_out : (n, 2) and (n,) numbers of the axes of that plane, and of the axis normal to it
    corner : (n, 3, 2) float64, m
    normal : (n, 3) float64, unit normals
    wide : (n,) whether the area is not zero
    rows : three (n, 3) float64: the barycentric coordinates of corners 1 and 2 and the coordinate along the axis left
        out (m) are these rows times the coordinates along the two axes (m) and one
    """

    axes: NDArray[np.intp]
    left_out: NDArray[np.intp]
    corner: F64
    normal: F64
    wide: NDArray[np.bool_]
    rows: tuple[F64, F64, F64]

    @staticmethod
    def of(triangles: F64) -> "_Flattened":
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        size = np.linalg.norm(normal, axis=1)
        wide = size > 0.0
        normal = normal / np.where(wide, size, 1.0)[:, None]
        left_out = np.argmax(np.abs(normal), axis=1)
        axes = np.stack([(left_out + 1) % 3, (left_out + 2) % 3], axis=1)
        corner = np.take_along_axis(triangles, np.repeat(axes[:, None], 3, axis=1), axis=2)
        origin, (a, b) = corner[:, 0], (corner[:, i] - corner[:, 0] for i in (1, 2))
        determinant = np.where(wide, a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], 1.0)
        n_a, n_b = np.take_along_axis(normal, axes, axis=1).T
        n_c = np.where(wide, np.take_along_axis(normal, left_out[:, None], axis=1)[:, 0], 1.0)
        slopes = (
            (b[:, 1] / determinant, -b[:, 0] / determinant),
            (-a[:, 1] / determinant, a[:, 0] / determinant),
            (-n_a / n_c, -n_b / n_c),
        )
        start = (0.0, 0.0, np.take_along_axis(triangles[:, 0], left_out[:, None], axis=1)[:, 0])
        first, second, height = (
            np.stack([x, y, c - x * origin[:, 0] - y * origin[:, 1]], axis=1)
            for (x, y), c in zip(slopes, start, strict=True)
        )
        return _Flattened(axes, left_out, corner, normal, wide, (first, second, height))

    def rectangles(self, box: F64) -> tuple[F64, F64]:
        """Least and greatest coordinate along the two axes, (n, 2) m, within a box (2, 3)."""
        low, high = box_of_each(self.corner)
        return np.maximum(low, np.take(box[0], self.axes)), np.minimum(high, np.take(box[1], self.axes))


def _sample_cells(
    flat: _Flattened,
    start: int,
    cells: I64,
    first: I64,
    count: I64,
    cell: float,
    seed: int,
) -> tuple[NDArray[np.intp], F64, U32]:
    """Points, in their triangle, of ``count`` cells of each face from ``start`` on: faces, points, keys."""
    stop = start + len(cells)
    within = np.arange(int(cells.sum())) - np.repeat(np.cumsum(cells) - cells, cells)
    row, column = np.divmod(within, np.repeat(count[start:stop, 1], cells))
    row += np.repeat(first[start:stop, 0], cells)
    column += np.repeat(first[start:stop, 1], cells)
    axis = np.repeat(flat.left_out[start:stop].astype(np.uint32), cells)
    key = _mix_bits(row.astype(np.uint32) * np.uint32(0x9E3779B1) + np.uint32(seed & 0xFFFFFFFF))
    key = _mix_bits(key ^ (column.astype(np.uint32) * np.uint32(0x85EBCA77) + np.uint32(0x27D4EB2F)))
    key = _mix_bits(key ^ (axis * np.uint32(0x165667B1) + np.uint32(0x3C6EF372)))
    second = _mix_bits(key ^ np.uint32(0xB5297A4D))
    x, y = ((n + (k + 0.5) * 2.0**-32) * cell for n, k in ((row, key), (column, second)))

    def value(rows: F64) -> F64:
        a, b, c = (np.repeat(part, cells) for part in rows[start:stop].T)
        return np.asarray(a * x + b * y + c)

    u, v = value(flat.rows[0]), value(flat.rows[1])
    inside = np.flatnonzero((u >= 0.0) & (v >= 0.0) & (u + v < 1.0))
    face = np.repeat(np.arange(start, stop), cells)[inside]
    key, x, y = key[inside], x[inside], y[inside]
    heights = flat.rows[2][face]
    height = heights[:, 0] * x + heights[:, 1] * y + heights[:, 2]
    point = np.empty((face.size, 3))
    for axes, values in ((flat.axes[face, 0], x), (flat.axes[face, 1], y), (flat.left_out[face], height)):
        point[np.arange(face.size), axes] = values
    # layers of a few cells distinguish surfaces above one another
    layer = np.floor(height / (LAYER_CELLS * cell) + 0.4142).astype(np.int64).astype(np.uint32)
    return face, point, _mix_bits(key ^ (layer * np.uint32(0xC2B2AE3D) + np.uint32(0x68E31DA4)))


def _mix_bits(x: U32) -> U32:
    """One round of a 32-bit hash finaliser; every input bit affects every output bit."""
    x = x ^ (x >> np.uint32(16))
    x = x * np.uint32(0x7FEB352D)
    x = x ^ (x >> np.uint32(15))
    x = x * np.uint32(0x846CA68B)
    return np.asarray(x ^ (x >> np.uint32(16)), dtype=np.uint32)
