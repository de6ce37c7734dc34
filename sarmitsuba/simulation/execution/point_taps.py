"""Echoes of ideal points on the grid of the looks."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from sarmitsuba.core.arrays import C64, C128, F64, I64
from sarmitsuba.signal.raw.look_grid import LookGrid


@dataclass(frozen=True, eq=False)
class PointTaps:
    """Echoes of ideal points, spread over cells of the looks' grid.

    Parameters
    ----------
    point : (n,) number of the point
    row, column : (n,) first cell in range and azimuth
    values : (n_channels, n, width, width) complex128, in the cells from there
    """

    point: I64
    row: I64
    column: I64
    values: C128

    @staticmethod
    def joined(parts: Sequence["PointTaps"]) -> "PointTaps":
        """Echoes of several looks."""
        axis = {"values": 1}
        return PointTaps(
            *(
                np.concatenate([getattr(p, f.name) for p in parts], axis=axis.get(f.name, 0))
                for f in fields(PointTaps)
            )
        )

    def on(self, grid: LookGrid, values: C128) -> C64:
        """Grid (n_range, n_azimuth) with the values (n, width, width) of one channel added."""
        out = np.zeros((grid.n_range, grid.n_azimuth), dtype=np.complex128)
        for p in range(values.shape[1]):
            for q in range(values.shape[2]):
                np.add.at(out, (self.row + p, self.column + q), values[:, p, q])
        return out.astype(np.complex64)


def point_taps(
    grid: LookGrid, look: int, slant_range: F64, rate: F64, amplitude: C128, wavelength: float
) -> PointTaps:
    """A few paths spread on the grid of a look: ``ImageAccumulator`` in NumPy.

    Parameters
    ----------
    look : that sees them
    slant_range, rate : (n,) m and m/s
    amplitude : (n_channels, n) at that range
    """
    kernel = grid.kernel
    place, azimuth, distance = grid.coordinates(slant_range, rate, look)
    if grid.fan is not None:  # at the time when the beam passes over them
        amplitude = amplitude * (slant_range / distance) ** 2 * grid.share(azimuth, look)
    offset, x, y = grid.cells(place, azimuth)
    inside = (x >= kernel.margin) & (x <= grid.n_range - 1 - kernel.margin)
    inside &= (y >= kernel.margin) & (y <= grid.n_azimuth - 1 - kernel.margin)
    x, y, offset, amplitude = x[inside], y[inside], offset[inside], amplitude[:, inside]
    value = amplitude * np.exp(-4j * np.pi / wavelength * offset)
    base_x, base_y = np.floor(x + kernel.shift), np.floor(y + kernel.shift)
    taps_x = np.array(kernel.taps(x + kernel.shift - base_x))
    taps_y = np.array(kernel.taps(y + kernel.shift - base_y))
    spread = np.einsum("cn,pn,qn->cnpq", value, taps_x, taps_y)
    i, j = base_x.astype(np.int64) - kernel.lead, base_y.astype(np.int64) - kernel.lead
    return PointTaps(np.flatnonzero(inside), i, j, spread)
