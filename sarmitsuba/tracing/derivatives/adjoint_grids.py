"""Adjoint grids that echoes read, and the gradient that they add to.

See :mod:`sarmitsuba.tracing.derivatives.echo_derivatives`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.kernel.device_arrays import device_array

if TYPE_CHECKING:
    from collections.abc import Sequence

# bits of the smallest number of values of a gradient
SMALLEST = 10


class GradientSum:
    """Sum of the derivatives of all launches, float64; ``n``: numbers."""

    def __init__(self, n: int) -> None:
        self.n = n
        # the size is compiled in: few sizes mean few kernels
        self.memory = dr.zeros(mi.Float64, 1 << max((n - 1).bit_length(), SMALLEST))

    def add(self, number: mi.UInt32, value: mi.Float, active: mi.Bool) -> None:
        """Add one value per lane; every thread has a copy of the memory during the launch."""
        on_cpu = dr.backend_v(mi.Float) == dr.JitBackend.LLVM
        mode = dr.ReduceMode.Expand if on_cpu else dr.ReduceMode.Auto
        dr.scatter_add(self.memory, mi.Float64(value), number, active, mode=mode)

    def numbers(self) -> F64:
        """(n,) float64 after the launches."""
        return np.array(self.memory.numpy()[: self.n], dtype=np.float64)


class AdjointGrids:
    """Adjoint grids of one launch, each (n_channels, n_rows, n_columns) complex64; None: not needed.

    Parameters
    ----------
    plain : for changes of amplitudes
    farther : for changes of slant ranges, m
    turning : for changes of range rates, m/s
    total : to which echoes add
    """

    def __init__(
        self, plain: C64 | None, farther: C64 | None, turning: C64 | None, total: GradientSum
    ) -> None:
        self.total = total
        grids = [plain, farther, turning]
        self.kept = [k for k, grid in enumerate(grids) if grid is not None]
        both = np.concatenate([grid for grid in grids if grid is not None])
        self.n_channels, self.n_planes = len(both) // len(self.kept), len(both)
        self.memory = device_array(mi.Float, np.moveaxis(both, 0, -1).copy().view(np.float32))
        self.packet, self.size = (mi.Vector4f, 4) if self.n_planes % 2 == 0 else (mi.Vector2f, 2)
        self.start()

    @property
    def n_bytes(self) -> int:
        """Size of the grids."""
        return 4 * len(self.memory)

    def start(self) -> None:
        """Begin with an echo."""
        self._sums = [mi.Float(0.0)] * (2 * self.n_planes)
        self._values: Sequence[mi.Complex2f] = ()

    def read(
        self, cell: mi.UInt32, values: Sequence[mi.Complex2f], weight: mi.Float, active: mi.Bool
    ) -> None:
        """Read one cell of an echo; see :meth:`sarmitsuba.tracing.kernel.accumulators.GridAccumulator.scatter`."""
        packets = 2 * self.n_planes // self.size
        for i in range(packets):
            numbers = dr.gather(self.packet, self.memory, cell * packets + i, active)
            for j in range(self.size):
                k = self.size * i + j
                self._sums[k] = dr.fma(weight, numbers[j], self._sums[k])
        self._values = values

    def product(self, kind: int, first: int = 0) -> mi.Complex2f:
        """Derivative by a factor of values, by one of the grids: 0 plain, 1 farther, 2 turning; zero without the grid.

        The values are the echo's in all channels, from the number ``first`` on.
        """
        found = mi.Complex2f(0.0)
        if kind in self.kept:
            place = self.kept.index(kind) * self.n_channels
            for k in range(self.n_channels):
                re, im = self._sums[2 * (place + k) : 2 * (place + k) + 2]
                found += mi.Complex2f(re, -im) * self._values[first + k]
        return found
