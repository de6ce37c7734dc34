"""Gridding kernels of the non-uniform FFT, and resampling from a fine range grid to the receiver's samples.

Why not FINUFFT here. Measured with FINUFFT 2.5.1 on two cores, CPU time, float64 sums on both sides:

- omega-K's Stolt mapping (600 rows of 430 samples onto 512 pixels): 87 to 96 ms here with 8 taps, -137 dB; 29 ms
  with FINUFFT, -123 dB. Put into omega-K it halves the call (1.04 to 0.54 s at 511 x 362 pixels, 2.23 to 1.01 s at
  1023 x 724; images equal to -136 dB).
- One look's pixels (511 x 362) from a field that is oversampled already: 20 ms here with 4 taps, -62 dB; 49 ms with
  FINUFFT at -59 dB, because it pads and transforms again.
- The block's and the window's steps are uniform FFTs and small matrix products; FINUFFT has no part in them.

The one gain is half a second of a focuser that takes seconds beside a simulation of many. It does not pay for a
compiled dependency of 10 MB, and the taps must be here anyway, because the tracing kernels spread with them. FINUFFT's
complex64 interface sums in float32 and stays above -95 dB; only its complex128 one has the dynamic range needed.

Complex exponentials of arrays of phases, reduced in float64 and evaluated in float32.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from types import ModuleType

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.core.arrays import C64, C128, F64, Samples
from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.units import db_from_power
from sarmitsuba.signal.sub_bands import RangeFilter

_STRIDE = 32  # steps of a ramp that one fine table covers


def unit_phasor(phase: F64) -> C64:
    """Phase factor ``exp(j phase)`` of any real phase (rad, float64), complex64, ten times as fast as complex128."""
    turns = phase * (0.5 / np.pi)
    turns -= np.rint(turns)
    angle = turns.astype(np.float32)
    angle *= np.float32(2.0 * np.pi)
    out = np.empty(angle.shape, dtype=np.complex64)
    np.cos(angle, out=out.real)
    np.sin(angle, out=out.imag)
    return out


def phase_ramp(step: F64, first: int, count: int) -> C64:
    """Phase factors ``exp(j step m)`` for m = first ... first + count - 1.

    Parameters
    ----------
    step : (n,) float64, rad

    Returns
    -------
    (n, count) complex64
    """
    coarse = np.exp(1j * np.multiply.outer(step, first + _STRIDE * np.arange(-(-count // _STRIDE))))
    fine = np.exp(1j * np.multiply.outer(step, np.arange(min(_STRIDE, count))))
    product = coarse.astype(np.complex64)[:, :, None] * fine.astype(np.complex64)[:, None, :]
    return product.reshape(len(step), -1)[:, :count]


# widest gridding kernel, cells
WIDEST = 8
OVERSAMPLING = 2.0
"""Grid cells per critical cell the kernels are tuned for: frequencies used stay below 1/4 cycle per cell."""

# Shape parameter beta / width of the exponential of semicircle with the least rms aliasing over
# |nu| <= 1/4, from a scan in steps of 0.02 of the exact error (error_db below).
_BETA_PER_WIDTH = {3: 2.12, 4: 2.22, 5: 2.26, 6: 2.30, 7: 2.30, 8: 2.32}
# Degree in z of each tap's polynomial: the smallest that costs less than 1.5 dB of the error.
_DEGREE = {3: 3, 4: 3, 5: 5, 6: 5, 7: 7, 8: 7}
# Degree in nu^2 of the inverse transform's polynomial
_INVERSE_DEGREE = 16


@dataclass(frozen=True)
class GriddingKernel:
    r"""Gridding kernel that spreads one contribution over ``width`` neighbouring cells of a uniform grid.

    .. math:: \phi(x) = \exp\left(\beta \left(\sqrt{1 - (2 x / w)^2} - 1\right)\right), \quad |x| \le w / 2

    for widths 3 to 8; width 1 is the nearest cell (a box) and width 2 linear interpolation (a triangle). All
    of them are divided out afterwards by :meth:`transform`: the box's ``sinc(nu)`` and the triangle's
    ``sinc(nu)^2`` too, which removes the mean droop of those two and leaves their aliasing.

    Parameters
    ----------
    width : cells touched per contribution, 1 to 8

    Notes
    -----
    Cell convention: for a position ``x`` in cells (cell i sits at x = i)::

        base  = floor(x + kernel.shift)           # shift is 0 for even widths, 0.5 for odd ones
        frac  = x + kernel.shift - base           # in [0, 1)
        first = base - kernel.lead                # first of ``width`` consecutive cells
        grid[first + k] += value * taps(frac)[k]  # k = 0 .. width - 1

    References: Barnett, Magland, af Klinteberg, SIAM J. Sci. Comput. 41 (2019), eq. (1.8) for the kernel.
    """

    width: int

    def __post_init__(self) -> None:
        if not 1 <= self.width <= WIDEST:
            raise RadarError(f"gridding_width = {self.width} is not within 1 ... {WIDEST}; take 4")

    @property
    def shift(self) -> float:
        """Added to the position before the floor: 0 for even widths, 0.5 for odd ones."""
        return 0.5 * (self.width % 2)

    @property
    def lead(self) -> int:
        """Cells between the first one touched and ``floor(x + shift)``."""
        return (self.width - 1) // 2

    @property
    def margin(self) -> int:
        """Cells a grid keeps free beyond its outermost contribution on either side."""
        return self.width // 2 + 1

    @property
    def beta(self) -> float:
        """Shape parameter of the exponential of semicircle; 0 for widths 1 and 2."""
        return _BETA_PER_WIDTH.get(self.width, 0.0) * self.width

    def evaluate(self, x: Samples, xp: ModuleType = np) -> Samples:
        """Kernel value at the distance ``x`` (cells, array of NumPy or Dr.Jit), 0 outside the support."""
        if self.width == 1:
            return _where(xp, abs(x) <= 0.5, 1.0 + 0.0 * x, 0.0 * x)
        if self.width == 2:
            y = 1.0 - abs(x)
            return _where(xp, y > 0.0, y, 0.0 * x)
        y = 1.0 - (x * (2.0 / self.width)) ** 2
        inside = y >= 0.0
        root = xp.sqrt(_where(xp, inside, y, 0.0 * x))
        value: Samples = xp.exp(self.beta * (root - 1.0))
        return _where(xp, inside, value, 0.0 * x)

    def taps(self, frac: Samples, xp: ModuleType = np) -> list[Samples]:
        """Weights of the ``width`` cells, first to last, for ``frac`` in [0, 1) (see the class notes).

        Piecewise polynomials, branch free: multiplications and additions only, so that arrays of NumPy
        and of Dr.Jit work alike and in their own precision (``xp`` is not needed and accepted for symmetry).
        """
        del xp
        if self.width == 1:
            return [0.0 * frac + 1.0]
        if self.width == 2:
            return [1.0 - frac, frac]
        z = frac - 0.5
        z2 = z * z
        left: list[Samples] = []  # taps up to the middle one
        right: list[Samples] = []  # their mirror images, from the last tap inwards
        for k, (even, odd) in enumerate(self._subsets):
            e = _horner(even, z2)
            if 2 * k == self.width - 1:
                left.append(e)
                continue
            o = _horner(odd, z2) * z
            left.append(e + o)
            right.append(e - o)
        return left + right[::-1]

    @cached_property
    def _subsets(self) -> list[tuple[list[float], list[float]]]:
        """Even and odd polynomial coefficients in z^2 of the first half of the taps (the rest mirror)."""
        w, degree = self.width, _DEGREE[self.width]
        z = 0.5 * np.cos(np.pi * (np.arange(400) + 0.5) / 400)  # Chebyshev points in (-1/2, 1/2)
        subsets = []
        for k in range((w + 1) // 2):
            c = np.polynomial.chebyshev.Chebyshev.fit(
                z, self.evaluate(k - 0.5 * (w - 1) - z), degree, [-0.5, 0.5]
            )
            p = c.convert(kind=np.polynomial.Polynomial, domain=[-1, 1]).coef
            subsets.append(([float(v) for v in p[0::2]], [float(v) for v in p[1::2]]))
        return subsets

    def transform(self, nu: ArrayLike) -> F64:
        """Fourier transform of the kernel of :meth:`taps`, at ``nu`` cycles per cell, float64.

        Gauss-Legendre quadrature of the piecewise polynomial, exact to rounding for ``|nu| <= 1``.
        """
        nu = np.asarray(nu, dtype=np.float64)
        if self.width <= 2:
            return np.asarray(np.sinc(nu) ** self.width)
        z, weight = _quadrature()
        taps = self.taps(z + 0.5)
        out = np.zeros(nu.shape)
        for k in range(self.width):
            distance = k - 0.5 * (self.width - 1) - z
            out += np.cos(2.0 * np.pi * nu[..., None] * distance) @ (taps[k] * weight)
        return out

    def inverse_transform(self, nu: ArrayLike) -> F64:
        """Reciprocal of :meth:`transform`: for ``|nu| <= 1/2`` a polynomial in ``nu^2``, exact to 1e-9."""
        nu = np.asarray(nu, dtype=np.float64)
        if self.width <= 2 or np.abs(nu).max(initial=0.0) > 0.5:
            return np.asarray(1.0 / self.transform(nu))
        return np.asarray(_horner(self._inverse, 8.0 * nu * nu - 1.0))

    @cached_property
    def _inverse(self) -> list[float]:
        """Coefficients of the inverse transform in ``8 nu^2 - 1``, between -1 and 1 for ``|nu| <= 1/2``."""
        z = np.cos(np.pi * (np.arange(200) + 0.5) / 200)  # Chebyshev points
        value = 1.0 / self.transform(np.sqrt(np.maximum(z + 1.0, 0.0) / 8.0))
        c = np.polynomial.chebyshev.Chebyshev.fit(z, value, _INVERSE_DEGREE, [-1.0, 1.0])
        p = c.convert(kind=np.polynomial.Polynomial, domain=[-1, 1]).coef
        return [float(v) for v in p]

    def aliasing(self, nu: ArrayLike) -> F64:
        r"""Relative rms error of one spread tone over random positions, at ``nu`` cycles per cell.

        .. math:: \epsilon(\nu)^2 = \sum_{m \ne 0} \hat\phi(\nu + m)^2 / \hat\phi(\nu)^2
        """
        nu = np.asarray(nu, dtype=np.float64)
        node, weight = np.polynomial.legendre.leggauss(24)
        # Parseval over the position: mean_z |sum_k tap_k(z) exp(-j 2 pi nu x_k)|^2 is the sum over all m
        z, weight = 0.5 * node, 0.5 * weight
        k = np.arange(self.width)[:, None]
        spread = np.array(self.taps(z + 0.5)) * np.ones_like(z)
        error = np.empty(nu.shape)
        for i in np.ndindex(nu.shape):
            distance = k - 0.5 * (self.width - 1) - z
            tone = (spread * np.exp(-2j * np.pi * nu[i] * distance)).sum(axis=0)
            main = self.transform(nu[i])
            error[i] = np.sqrt(np.sum(weight * np.abs(tone / main - 1.0) ** 2))
        return error

    @cached_property
    def error_db(self) -> float:
        """Relative rms error of one dimension over the used band ``|nu| <= 1/4``, dB."""
        z, weight = _quadrature()
        return db_from_power(np.sum(weight * self.aliasing(0.25 * (z + 0.5)) ** 2))


@lru_cache(maxsize=16)
def gridding_kernel(width: int) -> GriddingKernel:
    """Gridding kernel of a given width; its coefficients are fitted once."""
    return GriddingKernel(width)


@dataclass(frozen=True)
class FineGrid:
    """Lengths of the FFTs between a fine range grid and the window's samples, and the common cell.

    Parameters
    ----------
    range_step : cell of the fine grid, m; at most ``range_cell / OVERSAMPLING``
    n_fine, n_out : ``n_fine * range_step = n_out * sample_spacing`` is the period, m
    low, high : least and greatest distance from a contribution to a sample, m; within them the response is a
        sinc without wrap-around
    """

    range_step: float
    n_fine: int
    n_out: int
    low: float
    high: float


def fine_grid(
    range_cell: float, sample_spacing: float, low: float, high: float, n_least: int = 0
) -> FineGrid:
    """Fine grid for distances ``low`` ... ``high`` (m) between contributions and samples.

    ``n_least`` is the least number of cells the period must have.
    """
    step = range_cell / OVERSAMPLING
    period = max(1.1 * (high - low) + 32.0 * range_cell, (n_least + 2) * step)
    n_out = scipy.fft.next_fast_len(int(np.ceil(period / sample_spacing)))
    n_fine = scipy.fft.next_fast_len(int(np.ceil(n_out * sample_spacing / step - 1e-9)))
    return FineGrid(n_out * sample_spacing / n_fine, n_fine, n_out, low, high)


def to_window(
    fine: NDArray[np.complexfloating],
    offset: F64,
    grid: FineGrid,
    range_cell: float,
    n_samples: int,
    kernel: GriddingKernel | None = None,
    share: RangeFilter | None = None,
) -> C64:
    r"""Range-compressed samples of exactly the radar's band, from contributions on a fine range grid.

    Every contribution at x becomes ``sinc((r - x) / range_cell)`` (np.sinc) at the samples r.

    Parameters
    ----------
    fine : (n_layers, n_pulses, n) complex, n <= ``grid.n_fine``
    offset : (n_pulses,) float64, m, range of the first sample less that of cell 0
    grid : see :func:`fine_grid`; contributions outside its ``low`` ... ``high`` may wrap
    range_cell : c / (2 B), m
    n_samples : samples to return
    kernel : divided out when the contributions were spread with one
    share : factor on the spectrum; None: one

    Returns
    -------
    (n_layers, n_pulses, n_samples) complex64

    Notes
    -----
    The periodic point response is ``sinc`` times a taper that is 1 on ``low`` ... ``high`` and 0 half a period
    away: the tails of the sinc decay so slowly that their aliases in a plain DFT would be a -45 dB error.
    """
    n_layers, n_pulses, _ = fine.shape
    ramp, count = _ramp(offset, grid, range_cell, kernel, share)
    out = np.empty((n_layers, n_pulses, n_samples), dtype=np.complex64)
    batch = max(1, 2**22 // grid.n_fine)  # bounds memory: 32 MB a buffer
    for layer in range(n_layers):
        for k0 in range(0, n_pulses, batch):
            k = slice(k0, min(k0 + batch, n_pulses))
            full = scipy.fft.fft(fine[layer, k], n=grid.n_fine, axis=-1, workers=-1)
            band = np.zeros((full.shape[0], grid.n_out), dtype=full.dtype)
            band[:, : count + 1] += full[:, : count + 1] * ramp[k, count:]
            band[:, grid.n_out - count :] += full[:, grid.n_fine - count :] * ramp[k, :count]
            out[layer, k] = scipy.fft.ifft(band, axis=-1, workers=-1, overwrite_x=True)[:, :n_samples]
    return out


def to_window_adjoint(
    samples: C64,
    offset: F64,
    grid: FineGrid,
    range_cell: float,
    n: int,
    kernel: GriddingKernel | None = None,
    share: RangeFilter | None = None,
) -> C64:
    """Adjoint of :func:`to_window`: fine range grids (n_layers, n_pulses, n) from samples.

    Parameters
    ----------
    samples : (n_layers, n_pulses, n_samples) complex64
    n : cells to return, at most ``grid.n_fine``
    offset, grid, range_cell, kernel, share : as there
    """
    n_layers, n_pulses, _ = samples.shape
    ramp, count = _ramp(offset, grid, range_cell, kernel, share)
    ramp = ramp.conj()
    out = np.empty((n_layers, n_pulses, n), dtype=np.complex64)
    batch = max(1, 2**22 // grid.n_fine)  # as above
    for layer in range(n_layers):
        for k0 in range(0, n_pulses, batch):
            k = slice(k0, min(k0 + batch, n_pulses))
            band = scipy.fft.fft(samples[layer, k], n=grid.n_out, axis=-1, norm="forward", workers=-1)
            full = np.zeros((band.shape[0], grid.n_fine), dtype=band.dtype)
            full[:, : count + 1] = band[:, : count + 1] * ramp[k, count:]
            full[:, grid.n_fine - count :] = band[:, grid.n_out - count :] * ramp[k, :count]
            out[layer, k] = scipy.fft.ifft(full, axis=-1, norm="forward", workers=-1, overwrite_x=True)[:, :n]
    return out


def _ramp(
    offset: F64, grid: FineGrid, range_cell: float, kernel: GriddingKernel | None, share: RangeFilter | None
) -> tuple[C64, int]:
    """Factor on the spectra of fine range grids, (n_pulses, 2 count + 1) at -count ... count, and the count."""
    weight, count = _band_weight(grid, range_cell, kernel)
    if share is not None:
        weight = weight * share(np.arange(-count, count + 1) / (grid.n_fine * grid.range_step))
    ramp = phase_ramp(2.0 * np.pi / (grid.n_fine * grid.range_step) * offset, -count, 2 * count + 1)
    ramp *= (weight * (grid.n_out / grid.n_fine)).astype(np.complex64)
    return ramp, count


def _band_weight(grid: FineGrid, range_cell: float, kernel: GriddingKernel | None) -> tuple[C128, int]:
    """Spectrum of the tapered sinc at -count ... count, with the kernel divided out, and the count."""
    n, step = grid.n_fine, grid.range_step
    gap = 0.5 * (n * step - (grid.high - grid.low))
    first = round((grid.low - gap) / step)
    index = first + np.arange(n)
    x = index * step
    beyond = np.clip(np.maximum(x - grid.high, grid.low - x) / gap, 0.0, 1.0)
    response = np.zeros(n)
    response[index % n] = np.sinc(x / range_cell) * np.cos(0.5 * np.pi * beyond) ** 2
    spectrum = scipy.fft.fft(response)
    # the band ends at step / (2 range_cell) <= 1/4 cycle per cell; past 0.32 the taper's skirt is below 1e-7
    count = min(int(0.32 * n), grid.n_out - 1)
    m = np.arange(-count, count + 1)
    weight = spectrum[m % n]
    if kernel is not None:
        weight = weight / kernel.transform(m / n)
    return weight, count


@lru_cache(maxsize=1)
def _quadrature() -> tuple[F64, F64]:
    """Gauss-Legendre nodes and weights on (-1/2, 1/2)."""
    node, weight = np.polynomial.legendre.leggauss(24)
    return 0.5 * node, 0.5 * weight


def _where(xp: ModuleType, mask: object, a: Samples, b: Samples) -> Samples:
    picked: Samples = xp.where(mask, a, b) if xp is np else xp.select(mask, a, b)
    return picked


def _horner(coefficients: list[float], x: Samples) -> Samples:
    value = coefficients[-1] + 0.0 * x if len(coefficients) == 1 else coefficients[-1] * x + coefficients[-2]
    for c in coefficients[-3::-1]:
        value = value * x + c
    return value
