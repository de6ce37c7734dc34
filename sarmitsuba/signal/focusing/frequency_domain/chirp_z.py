"""Fourier sums at non-FFT points: chirp-z transform, non-uniform FFT by a sparse matrix, chirp scaling."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from sarmitsuba.core.arrays import C64, F32, F64
from sarmitsuba.signal.gridding import gridding_kernel, unit_phasor

# taps of the kernel; at twofold oversampling its rms error is -103 dB (`gridding_kernel(6).error_db`)
WIDTH = 6
# bandwidth of a chirp-scaled line over that of the line before: room for the chirps' shifts in frequency
_ROOM = 1.5
# least length of the virtual chirp, in range cells
_SHORTEST = 16.0


@dataclass(frozen=True)
class ChirpZ:
    r"""Chirp-z transform: Fourier sums at uniform points of any spacing (Bluestein), by FFTs and chirps.

    .. math:: y_p = \sum_m c_m e^{j \, turn \, (first + m) \, p}, \quad p = low, low + 1, ...

    Parameters
    ----------
    n_in, n_out : number of coefficients and of points
    first, low : whole numbers of the first coefficient and of the first point
    turn : rad
    """

    n_in: int
    n_out: int
    first: int
    low: int
    turn: float

    @cached_property
    def _chirps(self) -> tuple[C64, C64, C64]:
        # p m = (p^2 + m^2 - (p - m)^2) / 2, with m counted from the band's middle to keep the chirps short
        middle = self.n_in // 2
        m = np.arange(self.n_in, dtype=np.float64) - middle
        p = np.arange(self.n_out, dtype=np.float64) + self.low
        lag = np.arange(p[0] - m[-1], p[-1] - m[0] + 1.0)
        response = unit_phasor(-0.5 * self.turn * lag**2)
        n = scipy.fft.next_fast_len(lag.size)
        return (
            unit_phasor(0.5 * self.turn * m**2),
            np.asarray(scipy.fft.fft(response, n=n)),
            unit_phasor(self.turn * p * (0.5 * p + self.first + middle)),
        )

    @property
    def n_fft(self) -> int:
        """Length of the transforms."""
        return int(self._chirps[1].size)

    @property
    def adjoint(self) -> "ChirpZ":
        """The adjoint sums, from points to coefficients: another chirp-z transform."""
        return ChirpZ(self.n_out, self.n_in, self.low, self.first, -self.turn)

    def __call__(self, lines: C64, axis: int = -1) -> C64:
        """Sums of (..., n_in, ...) complex64 along an axis: (..., n_out, ...) complex64."""
        shape = [1] * lines.ndim
        shape[axis] = -1
        before, response, after = (chirp.reshape(shape) for chirp in self._chirps)
        work = scipy.fft.fft(lines * before, n=response.size, axis=axis)
        work *= response
        work = scipy.fft.ifft(work, axis=axis, overwrite_x=True)
        pick = [slice(None)] * lines.ndim
        pick[axis] = slice(self.n_in - 1, self.n_in - 1 + self.n_out)
        return np.asarray(work[tuple(pick)] * after)


def kernel_matrix(position: F64, n: int) -> "scipy.sparse.csr_array":
    """Interpolation matrix of the gridding kernel; its transpose grids values onto the lines.

    Parameters
    ----------
    position : (rows, m) float64, cells, taken modulo ``n``
    n : cells of a line; the matrix's lines have :data:`WIDTH` more, see :func:`wrapped` and :func:`folded`

    Returns
    -------
    (rows * m, rows * (n + WIDTH)) float32
    """
    kernel = gridding_kernel(WIDTH)
    base = np.floor(position)
    taps = kernel.taps(np.asarray(position - base))
    base -= kernel.lead
    base -= n * np.floor(base * (1.0 / n))
    cell = base.astype(np.int32)
    cell += (np.arange(position.shape[0], dtype=np.int32) * (n + WIDTH))[:, None]
    index = np.empty((position.size, WIDTH), dtype=np.int32)
    weight = np.empty((position.size, WIDTH), dtype=np.float32)
    for i, tap in enumerate(taps):
        np.add(cell.reshape(-1), i, out=index[:, i])
        weight[:, i] = tap.reshape(-1)
    starts = np.arange(0, index.size + 1, WIDTH, dtype=np.int32)
    shape = (position.size, position.shape[0] * (n + WIDTH))
    return scipy.sparse.csr_array((weight.reshape(-1), index.reshape(-1), starts), shape=shape)


def apply(matrix: "scipy.sparse.sparray", values: C64) -> C64:
    """Product of a real float32 matrix with complex64 values."""
    parts = np.ascontiguousarray(values).reshape(-1).view(np.float32).reshape(-1, 2)
    return np.asarray(np.ascontiguousarray(matrix @ parts)).view(np.complex64)[:, 0]


def spread(values: C64, position: F64, n: int) -> C64:
    """Grid (rows, m) values onto lines of n cells at ``position``: (rows, n) complex64."""
    lines = apply(kernel_matrix(position, n).T, values).reshape(values.shape[0], n + WIDTH)
    lines[:, :WIDTH] += lines[:, n:]
    return lines[:, :n]


def interpolate(lines: C64, position: F64) -> C64:
    """Values of periodic lines (rows, n) at ``position`` (rows, m) cells: (rows, m) complex64.

    Exact to the kernel's error where the lines are the inverse FFT of spectra that fill at most half of the band and
    are divided by :func:`kernel_transform`.
    """
    wrapped = np.concatenate([lines, lines[:, :WIDTH]], axis=1)
    return apply(kernel_matrix(position, lines.shape[1]), wrapped).reshape(position.shape)


def kernel_transform(cycles: F64) -> F64:
    """Fourier transform of the gridding kernel at frequencies in cycles per cell."""
    return gridding_kernel(WIDTH).transform(cycles)


@dataclass(frozen=True)
class VirtualChirp:
    r"""Chirp scaling of range-compressed lines: a virtual chirp is applied and scaled.

    In four steps, q the wavenumber and u the range from the fixed point:

    .. math:: X(q) \to X e^{-j q^2 / 2 \kappa}, \quad x(u) \to x e^{j \kappa C u^2 / 2}, \quad
              X \to X e^{j q^2 / 2 \kappa (1 + C)}, \quad x(u') \to x e^{-j \kappa C (1 + C) u'^2 / 2},

    which moves an echo from u to :math:`u' = u / (1 + C)` and multiplies its amplitude by :math:`\sqrt{1 + C}`, which
    is divided out. C is the chirp scaling factor (Cumming & Wong 2005, section 7.2.2).

    Parameters
    ----------
    rate : kappa, rad/m^2
    n_fft : length of the transforms

    Notes
    -----
    The transmitted chirp is not needed: flat range compression is its exact inverse, and the virtual chirp is no longer
    and no wider than necessary.
    """

    rate: float
    n_fft: int

    @staticmethod
    def of(largest_factor: float, period: float, step: float, n_band: int) -> "VirtualChirp":
        """Chirp for factors up to ``largest_factor`` on lines of ``n_band`` wavenumbers ``step`` apart.

        The chirp is long enough to keep the scaled echoes within the transforms' band over half the ``period``, m.
        """
        n_fft = int(scipy.fft.next_fast_len(int(np.ceil(_ROOM * (1.0 + largest_factor) * n_band))))
        band = n_band * step
        return VirtualChirp(band / VirtualChirp.length(largest_factor, period, 2.0 * np.pi / band), n_fft)

    @staticmethod
    def length(largest_factor: float, period: float, cell: float) -> float:
        """Length of the chirp in range, m, for lines of ``period`` m and a range cell."""
        # scaled echoes at u have wavenumbers up to band (1 + C) / 2 + rate C |u|, and the transforms half of their band
        return max(_SHORTEST * cell, largest_factor * period / ((_ROOM - 1.0) * (1.0 + largest_factor)))

    def __call__(self, lines: C64, first: int, step: float, factor: F64, points: ChirpZ, at: F64) -> C64:
        """Scaled lines.

        Parameters
        ----------
        lines : (rows, n) complex64 spectra at the wavenumbers ``(first + i) step``
        first, step : whole number, and rad/m
        factor : (rows,) C of each line
        points : from the ``n_fft`` wavenumbers, in ascending order, to the points wanted
        at : (n_out,) m, u' of these points

        Returns
        -------
        (rows, n_out) complex64: the lines at ``at * (1 + C)``
        """
        own, phases, level = self._phases(slice(first, first + lines.shape[1]), step, factor, at)
        work = np.zeros((lines.shape[0], self.n_fft), dtype=np.complex64)
        work[:, own] = lines * unit_phasor(phases[0])
        line = np.fft.fftshift(
            scipy.fft.ifft(np.fft.ifftshift(work, axes=1), axis=1, overwrite_x=True), axes=1
        )
        line *= unit_phasor(phases[1])
        line = scipy.fft.fft(np.fft.ifftshift(line, axes=1), axis=1, overwrite_x=True)
        line = np.fft.fftshift(line, axes=1)
        line *= unit_phasor(phases[2])
        out = points(line)
        out *= unit_phasor(phases[3])
        out /= level
        return out

    def adjoint(self, lines: C64, band: slice, step: float, factor: F64, points: ChirpZ, at: F64) -> C64:
        """Adjoint: spectra (rows, n) at the whole numbers ``band`` of ``step`` from scaled lines (rows, n_out)."""
        own, phases, level = self._phases(band, step, factor, at)
        line = points.adjoint(lines / level * unit_phasor(-phases[3]))
        line *= unit_phasor(-phases[2])
        line = scipy.fft.ifft(np.fft.ifftshift(line, axes=1), axis=1, overwrite_x=True, norm="forward")
        line = np.fft.fftshift(line, axes=1)
        line *= unit_phasor(-phases[1])
        work = scipy.fft.fft(np.fft.ifftshift(line, axes=1), axis=1, overwrite_x=True, norm="forward")
        return np.asarray(np.fft.fftshift(work, axes=1)[:, own] * unit_phasor(-phases[0]))

    def _phases(
        self, band: slice, step: float, factor: F64, at: F64
    ) -> tuple[slice, tuple[F64, F64, F64, F64], F32]:
        """Place of the band in the transforms, the four steps' phases (rad), and the amplitude (rows, 1)."""
        n, rate = self.n_fft, self.rate
        m = np.arange(n, dtype=np.float64) - n // 2
        q, u = step * m, 2.0 * np.pi / (n * step) * m
        one = 1.0 + factor[:, None]
        own = slice(band.start + n // 2, band.stop + n // 2)
        phases = (
            -0.5 * q[own] ** 2 / rate,
            0.5 * rate * factor[:, None] * u**2,
            0.5 * q**2 / (rate * one),
            -0.5 * rate * factor[:, None] * one * at**2,
        )
        return own, phases, np.sqrt(one).astype(np.float32)
