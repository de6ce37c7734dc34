"""Triangulation of height rasters: right-triangulated irregular networks with a measured error bound."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I32, I64

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
