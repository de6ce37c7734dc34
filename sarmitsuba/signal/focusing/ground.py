"""Conversion from the slant grid of a straight track to a ground grid by band-limited interpolation over range."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.linear_map import LinearMap
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.grid import natural_spacing
from sarmitsuba.signal.image.sar_image import ImageGrid

# taps of the windowed sinc, and its Kaiser parameter: errors below -90 dB at the oversampling of 2.5 of slant_below
_TAPS, _BETA = 10, 9.0


def slant_below(radar: Radar, ground: ImageGrid) -> ImageGrid:
    """Slant grid that contains a ground grid's pixels, with half the natural column spacing.

    The columns' spacing is at most 0.4 of the Nyquist spacing of the image's spectrum, see
    :func:`sarmitsuba.signal.focusing.grid.natural_spacing`; rows are those of the ground grid.
    """
    origin = radar.track.center_position
    middle = ground.positions_on_line(ground.azimuth.size // 2)[ground.range.size // 2]
    spacing = 0.5 * natural_spacing(radar, middle, "slant")[1]
    rho = slant_ranges(radar, ground)
    first = int(np.floor(rho.min() / spacing)) - _TAPS
    columns = spacing * np.arange(first, int(np.ceil(rho.max() / spacing)) + _TAPS + 1)
    return ImageGrid(
        kind="slant",
        azimuth=ground.azimuth + float((ground.origin - origin) @ ground.along),
        range=columns[columns > abs(origin[2] - ground.height)],
        origin=origin,
        along=ground.along,
        across=ground.across,
        height=ground.height,
    )


def slant_ranges(radar: Radar, ground: ImageGrid) -> F64:
    """(n_range,) float64 closest-approach range of a ground grid's columns, m; negative behind the track."""
    origin = radar.track.center_position
    across = ground.range + float((ground.origin - origin) @ ground.across)
    return np.asarray(np.copysign(np.hypot(across, origin[2] - ground.height), across))


@dataclass(frozen=True, eq=False)
class RangeInterpolation(LinearMap):
    """Interpolation of an image's rows at other ranges.

    Parameters
    ----------
    slant : oversampled at least 2.5 times
    rho : (n_range,) float64, m, where pixels are wanted
    carrier : rad/m, middle of the spectrum over range
    """

    slant: ImageGrid
    rho: F64
    carrier: float

    def forward(self, values: C64) -> C64:
        """Pixels (n_layers, n_azimuth, n_range) of those on ``slant``, (n_layers, n_azimuth, n_slant)."""
        return self._applied(self._matrix, values)

    def adjoint(self, values: C64) -> C64:
        """Pixels on ``slant`` from those at the other ranges."""
        return self._applied(self._matrix.conj().T, values)

    @staticmethod
    def _applied(matrix: "scipy.sparse.sparray", values: C64) -> C64:
        flat = values.reshape(-1, values.shape[-1])
        return np.asarray((matrix @ flat.T).T, dtype=np.complex64).reshape(*values.shape[:-1], -1)

    @cached_property
    def _matrix(self) -> "scipy.sparse.csr_array":
        slant, rho, carrier = self.slant, self.rho, self.carrier
        at = (rho - slant.range[0]) / slant.range_spacing
        base = np.floor(at).astype(np.int64)
        column = base[:, None] + np.arange(_TAPS) - (_TAPS // 2 - 1)
        offset = at[:, None] - column
        window = np.i0(_BETA * np.sqrt(np.clip(1.0 - (2.0 * offset / _TAPS) ** 2, 0.0, None))) / np.i0(_BETA)
        # interpolated in baseband; the carrier is applied again at the new ranges
        turn = np.exp(1j * carrier * slant.range_spacing * offset)
        value = (np.sinc(offset) * window * turn).astype(np.complex64)
        there = (column >= 0) & (column < slant.range.size)
        row = np.broadcast_to(np.arange(rho.size)[:, None], column.shape)
        return scipy.sparse.csr_array(
            (value[there], (row[there], column[there])), shape=(rho.size, slant.range.size)
        )
