"""Elevation rasters as terrain in the scene's frame.

Rasters become right-triangulated irregular networks with a measured error bound.
"""

import os
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I32, I64
from sarmitsuba.core.errors import DataError, SceneError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.loading.importing.places import (
    WGS84,
    Places,
    check_map,
    local_of_geodetic,
    project_points,
    unwrap_longitude,
)
from sarmitsuba.machine.isolated import survive
from sarmitsuba.machine.regular_files import check_regular
from sarmitsuba.radar.geodesy import Anchor

if TYPE_CHECKING:
    from rasterio.windows import Window


# number of times that the inner tolerance is lowered before every sample is used
_TRIES = 12


@dataclass(frozen=True, eq=False)
class Network:
    """Triangle network over the samples of a raster.

    Parameters
    ----------
    rows, columns : (n,) int64; samples that are corners
    faces : (m, 3) int32; counter-clockwise with columns to the right and rows downwards
    deviation : largest distance of a sample from the triangles, in the heights' unit
    """

    rows: I64
    columns: I64
    faces: I32
    deviation: float


def network(heights: F64, tolerance: float) -> Network:
    r"""Triangle network within a tolerance of every sample, without gaps.

    Right isosceles triangles are bisected at the midpoint of their hypotenuse while a sample in the subdivided triangle
    deviates by more than :math:`\tau`; every midpoint holds the greatest deviation of all its subdivisions, so that
    neighbours agree. Deviations of several bisections add up: the remaining deviation is measured, and :math:`\tau`
    lowered until it is within the tolerance.

    Parameters
    ----------
    heights : (n_rows, n_columns) float64; nan for missing samples, which leave holes
    tolerance : largest deviation, in the heights' unit

    References
    ----------
    W. Evans, D. Kirkpatrick, G. Townsend, Right-Triangulated Irregular Networks, Algorithmica 30 (2001), 264.
    """
    z = _pad_raster(heights)
    inner = tolerance
    for _ in range(_TRIES):
        active = _errors(z) > inner
        deviation = float(np.nanmax(np.abs(_interpolate_heights(z, active) - z), initial=0.0))
        if deviation <= tolerance:
            break
        inner *= 0.7
    else:
        active, deviation = np.ones_like(z, dtype=np.bool_), 0.0
    corners = _triangles(active)
    corners = corners[np.isfinite(z[corners[..., 0], corners[..., 1]]).all(axis=1)]
    flat = corners[..., 0] * z.shape[1] + corners[..., 1]
    used, faces = np.unique(flat, return_inverse=True)
    return Network(used // z.shape[1], used % z.shape[1], faces.reshape(-1, 3).astype(np.int32), deviation)


def _pad_raster(heights: F64) -> F64:
    """Raster of the next power of two and one, nan outside."""
    side = 1 << max(int(np.ceil(np.log2(max(*heights.shape, 2) - 1))), 0)
    z = np.full((side + 1, side + 1), np.nan)
    z[: heights.shape[0], : heights.shape[1]] = heights
    return z


def _sample_across(z: F64, s: int) -> tuple[tuple[slice, slice], F64]:
    """Centres of squares of side 2 s, and the means of the ends of their diagonals, which alternate."""
    here = (slice(s, None, 2 * s), slice(s, None, 2 * s))
    n = (z.shape[0] - 1) // (2 * s)
    even = np.add.outer(np.arange(n), np.arange(n)) % 2 == 0
    a, b, c, d = (
        z[i : z.shape[0] - 2 * s + i : 2 * s, j : z.shape[1] - 2 * s + j : 2 * s] for i, j in _CORNERS * 2 * s
    )
    return here, 0.5 * np.where(even, a + d, b + c)


_CORNERS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])


def _sample_along(z: F64, s: int, axis: int) -> tuple[tuple[slice, slice], F64]:
    """Midpoints of the sides of length 2 s along an axis, and the means of their ends."""
    w = z if axis == 1 else z.T
    mean = 0.5 * (w[:: 2 * s, : -2 * s : 2 * s] + w[:: 2 * s, 2 * s :: 2 * s])
    here = (slice(None, None, 2 * s), slice(s, None, 2 * s))
    return (here, mean) if axis == 1 else (here[::-1], mean.T)


def _deviation(z: F64, mean: F64) -> F64:
    """Absolute deviation; infinite where either value is missing, zero where both are."""
    off = np.abs(z - mean)
    return np.where(np.isnan(off), np.where(np.isnan(z) & np.isnan(mean), 0.0, np.inf), off)


def _errors(z: F64) -> F64:
    """Greatest deviation of every sample, as a midpoint of a hypotenuse, and of its subdivisions."""
    off = np.zeros_like(z)
    side = z.shape[0] - 1
    s = 1
    while 2 * s <= side:
        half = s // 2
        for axis in (0, 1):
            here, mean = _sample_along(z, s, axis)
            off[here] = _deviation(z[here], mean)
            if half:
                wide = np.pad(off, half)
                rows, columns = (np.arange(side + 1)[part] for part in here)
                for i in (0, 2 * half):
                    for j in (0, 2 * half):
                        off[here] = np.maximum(off[here], wide[np.ix_(rows + i, columns + j)])
        here, mean = _sample_across(z, s)
        own = _deviation(z[here], mean)
        rows, columns = (np.arange(side + 1)[part] for part in here)
        for i, j in ((-s, 0), (s, 0), (0, -s), (0, s)):
            own = np.maximum(own, off[np.ix_(rows + i, columns + j)])
        off[here] = own
        s *= 2
    return off


def _interpolate_heights(z: F64, active: NDArray[np.bool_]) -> F64:
    """Heights of the triangles at all samples."""
    made = z.copy()
    s = (z.shape[0] - 1) // 2
    while s >= 1:
        here, mean = _sample_across(made, s)
        made[here] = np.where(active[here], z[here], mean)
        for axis in (0, 1):
            here, mean = _sample_along(made, s, axis)
            made[here] = np.where(active[here], z[here], mean)
        s //= 2
    return made


def _triangles(active: NDArray[np.bool_]) -> I64:
    """Triangles (n, 3, 2) as rows and columns: ends of the hypotenuse, then the right angle."""
    side = active.shape[0] - 1
    todo = np.array([[[0, 0], [side, side], [0, side]], [[side, side], [0, 0], [side, 0]]], dtype=np.int64)
    done = []
    while len(todo):
        a, b, c = todo[:, 0], todo[:, 1], todo[:, 2]
        m = (a + b) // 2
        legs = np.abs(a - c).max(axis=1) + np.abs(b - c).max(axis=1)
        cut = active[m[:, 0], m[:, 1]] & (np.abs(a - b).max(axis=1) > 1) & (legs > 1)
        done.append(todo[~cut])
        first, second = np.stack([c, a, m], axis=1), np.stack([b, c, m], axis=1)
        todo = np.concatenate([first[cut], second[cut]])
    return np.concatenate(done)


# most samples read; triangulating more takes minutes and gigabytes
MOST_SAMPLES = 16_000_000
# most bytes of an unpacked block; a tile of 512 x 512 float64 has 2 MB
_LARGEST_BLOCK = 1 << 28
# by default GDAL reads georeferences from side files (.aux.xml, .ovr, .tfw ...), which may refer to any path
_ALONE = {
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",
    "GDAL_PAM_ENABLED": "NO",
    "GDAL_GEOREF_SOURCES": "INTERNAL",
}
# bounds of valid heights on the Earth, m
_LOWEST, _HIGHEST = -12e3, 9e3


@dataclass(frozen=True, eq=False)
class HeightRaster:
    """Elevation raster: heights on a grid.

    Parameters
    ----------
    name : of the file
    heights : (n_rows, n_columns) float64, m over the ellipsoid; nan for missing samples
    affine : (2, 3) float64, from column and row (of sample centres) to coordinates
    crs : coordinate system
    """

    name: str
    heights: F64 = field(repr=False)
    affine: F64
    crs: str

    def places(self, rows: I64, columns: I64) -> F64:
        """Longitude and latitude of samples, (n, 2), deg."""
        xy = np.column_stack([columns, rows]) @ self.affine[:, :2].T + self.affine[:, 2]
        return Places(self.crs, self.name).geodetic(xy)

    def at(self, longitude_latitude: F64) -> F64:
        """Heights interpolated bilinearly, (n,) float64, m; nan outside and next to missing samples."""
        n_rows, n_columns = self.heights.shape
        if self.crs != WGS84:
            xy = project_points(longitude_latitude, WGS84, self.crs, self.name)
        else:
            center = self.affine @ [0.5 * n_columns, 0.5 * n_rows, 1.0]
            xy = np.column_stack(
                [unwrap_longitude(longitude_latitude[:, 0], center[0]), longitude_latitude[:, 1]]
            )
        column, row = np.linalg.solve(self.affine[:, :2], (xy - self.affine[:, 2]).T)
        # positions on the last sample are inside, despite rounding
        inside = (
            (column >= -1e-6) & (row >= -1e-6) & (column <= n_columns - 1 + 1e-6) & (row <= n_rows - 1 + 1e-6)
        )
        column, row = np.clip(column, 0.0, n_columns - 1.0), np.clip(row, 0.0, n_rows - 1.0)
        j = np.minimum(column.astype(np.int64), n_columns - 2)
        i = np.minimum(row.astype(np.int64), n_rows - 2)
        u, v = column - j, row - i
        z = self.heights
        mean = (1 - v) * ((1 - u) * z[i, j] + u * z[i, j + 1]) + v * (
            (1 - u) * z[i + 1, j] + u * z[i + 1, j + 1]
        )
        return np.where(inside, mean, np.nan)


def read_raster(path: Path, geoid: float, around: F64 | None) -> HeightRaster:
    """Read the first band of a GeoTIFF, after a trial in a separate process; other formats are not read.

    Parameters
    ----------
    path : file; side files are not read
    geoid : height of the raster's zero over the ellipsoid, m
    around : (2, 2) lowest and highest longitude and latitude of the region to read, deg; None: all

    Raises
    ------
    SceneError : rasterio is missing, or the raster cannot be read, has no georeference, no heights, or too many samples
    """
    try:
        import rasterio
    except ImportError as error:
        raise SceneError(
            f"{path.name}: elevation rasters need the package rasterio ({error}); pip install 'sarmitsuba[importing]'"
        ) from error
    where = one_line(path.name)

    def read() -> HeightRaster:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            return _read(path, where, geoid, around)

    def read_and_place() -> None:
        raster = read()
        n_rows, n_columns = raster.heights.shape
        corners = np.array([[0, 0], [0, n_columns - 1], [n_rows - 1, 0], [n_rows - 1, n_columns - 1]])
        raster.at(raster.places(corners[:, 0], corners[:, 1]))

    try:
        check_regular(path)
        survive(path, read_and_place)
        return read()
    except (
        rasterio.errors.RasterioError,
        ArithmeticError,
        DataError,
        MemoryError,
        OSError,
        TypeError,
        ValueError,
    ) as error:
        raise SceneError(
            f"{where}: no readable raster: {one_line(error, 120)}; write it as GeoTIFF"
        ) from error


def _read(path: Path, where: str, geoid: float, around: F64 | None) -> HeightRaster:
    import rasterio
    from rasterio.windows import Window, from_bounds

    with rasterio.Env(**_ALONE), rasterio.open(os.path.abspath(path), driver="GTiff") as file:
        if file.crs is None:
            raise SceneError(f"{where}: has no coordinate system; write one into it with gdal_edit -a_srs")
        crs = str(file.crs)
        edges = np.array([file.transform * (x, y) for x in (0, file.width) for y in (0, file.height)])
        check_map(edges, crs, where)
        window = Window(0, 0, file.width, file.height)
        if around is not None:
            edge = _frame(around)
            if crs != WGS84:
                edge = project_points(edge, WGS84, crs, where)
            else:
                west, east = file.bounds.left, file.bounds.right
                middle = float(edge[:, 0].mean())
                edge[:, 0] += unwrap_longitude(middle, 0.5 * (west + east)) - middle
            wanted = from_bounds(*edge.min(axis=0), *edge.max(axis=0), file.transform)
            window = _whole(wanted, file.width, file.height, where)
        n = int(window.height) * int(window.width)
        if n > MOST_SAMPLES:
            raise SceneError(
                f"{where}: {n} samples are more than {MOST_SAMPLES}; crop or resample it, or give buildings "
                "or --anchor with --radius"
            )
        rows, columns = file.block_shapes[0]
        if rows * columns * file.count * np.dtype(file.dtypes[0]).itemsize > _LARGEST_BLOCK:
            raise SceneError(
                f"{where}: blocks of {rows} x {columns} samples of {file.count} bands take more than "
                f"{_LARGEST_BLOCK / 1e6:.0f} MB each; write it with -co TILED=YES"
            )
        heights = file.read(1, window=window, masked=True).astype(np.float64).filled(np.nan)
        transform = file.window_transform(window)
    if min(heights.shape) < 2:
        raise SceneError(
            f"{where}: {heights.shape[0]} x {heights.shape[1]} samples at the buildings; at least 2 x 2 are needed"
        )
    heights[~((heights > _LOWEST) & (heights < _HIGHEST))] = np.nan
    if np.isnan(heights).all():
        raise SceneError(
            f"{where}: no sample between {_LOWEST:g} m and {_HIGHEST:g} m; check the band and its unit"
        )
    matrix = np.array([[transform.a, transform.b, transform.c], [transform.d, transform.e, transform.f]])
    matrix[:, 2] += 0.5 * (matrix[:, 0] + matrix[:, 1])  # the transform refers to the corners of samples
    if abs(np.linalg.det(matrix[:, :2])) == 0.0:
        raise SceneError(f"{where}: has no georeference; write a transform into it")
    return HeightRaster(where, heights + geoid, matrix, crs)


def terrain_mesh(raster: HeightRaster, anchor: Anchor, tolerance: float) -> tuple[F64, I32, Network]:
    """Terrain in the scene's frame: vertices (n, 3) m, faces upwards, and the triangle network.

    Notes
    -----
    Heights between samples are those of triangles; objects in surface models become part of the terrain.
    """
    net = network(raster.heights, tolerance)
    z = raster.heights[net.rows, net.columns]
    vertices = local_of_geodetic(anchor, raster.places(net.rows, net.columns), z)
    a, b, c = (vertices[net.faces[:, i], :2] for i in range(3))
    down = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    faces = net.faces.copy()
    faces[down] = faces[down][:, ::-1]
    return vertices, faces, net


def _frame(around: F64) -> F64:
    """Points on the border of a rectangle, (36, 2)."""
    t = np.linspace(0.0, 1.0, 10)[:-1]
    (x0, y0), (x1, y1) = around
    turn = [(x0 + t * (x1 - x0), y0 + 0 * t), (x1 + 0 * t, y0 + t * (y1 - y0))]
    turn += [(x1 - t * (x1 - x0), y1 + 0 * t), (x0 + 0 * t, y1 - t * (y1 - y0))]
    return np.concatenate([np.column_stack(side) for side in turn])


def _whole(wanted: "Window", width: int, height: int, where: str) -> "Window":
    """Window in whole samples, one more at each side, inside the raster."""
    from rasterio.windows import Window

    left, top = max(int(wanted.col_off) - 2, 0), max(int(wanted.row_off) - 2, 0)
    right = min(int(wanted.col_off + wanted.width) + 3, width)
    bottom = min(int(wanted.row_off + wanted.height) + 3, height)
    if right - left < 2 or bottom - top < 2:
        raise SceneError(f"{where}: the raster does not cover the buildings; give one that does")
    return Window(left, top, right - left, bottom - top)
