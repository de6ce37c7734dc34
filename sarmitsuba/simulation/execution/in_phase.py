"""Energy of coherent returns that add up in phase over a resolution cell, from the returns of random patches of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import C128, F64, I64

# places of the grids of bins, in bins along range and range rate: the variance by their places is then below that by
# the patches'
_SHIFTS = ((0.0, 0.0), (0.25, 0.5), (0.5, 0.25), (0.75, 0.75))
# returns this far below the order's strongest add less than -60 dB, unless a million of them are in phase
_LEAST = 1e-6


@dataclass(frozen=True, eq=False)
class PatchReturns:
    """Coherent returns of random patches of one pulse.

    Parameters
    ----------
    field : (n_patches, n_orders, n_channels) complex128, m; sum over the patch, phase of the slant range included
    slant_range, range_rate : (n_patches, n_orders) float64, m and m/s, means weighted by amplitude
    range_bin, rate_bin : m and m/s, resolution cell
    scale : factor by which the mean product of two patches in one cell becomes the power of a patch, see
        :func:`measure_in_phase`
    """

    field: C128
    slant_range: F64
    range_rate: F64
    range_bin: float
    rate_bin: float
    scale: float


def measure_in_phase(returns: PatchReturns) -> tuple[F64, F64]:
    r"""Mean power of returns that add up over resolution cells, and the variance of that mean, (n_orders,) each.

    With the field :math:`g` per launched area, the image of a launch window of area :math:`A` has the energy
    :math:`\iint g(x) g^*(y) K(x, y)` with the ambiguity :math:`K` of the resolution cell, one for returns of equal
    range and range rate. A patch of taper :math:`w` returns :math:`f_i = \int w(x - x_i) g(x)`. So

    .. math:: A \frac{\int w^2}{(\int w)^2} \frac{1}{n (n - 1)} \sum_{i \ne j} f_i f_j^* K_{ij}

    estimates, without bias for fields smooth over a patch, the mean of :math:`|f|^2` that patches would have if no two
    of them interfered and the image had this energy. ``scale`` is its first factor. :math:`K_{ij}` is the probability
    that two returns are in one bin of a grid of random place, a triangle along either axis with the area of a cell.

    Parameters
    ----------
    returns : of one pulse

    Notes
    -----
    The variance is that of the projection of the pairs on single patches, without regard to signs where that is more:
    few pairs may cancel by chance. Ignores pulses between those traced, unlike orders in phase, and patches with
    returns of one order at two ranges.
    """
    n, n_orders = returns.field.shape[:2]
    mean, variance = np.zeros(n_orders), np.zeros(n_orders)
    if n < 2:
        return mean, variance
    power = np.square(np.abs(returns.field)).sum(axis=2)
    for order in range(n_orders):
        level = power[:, order]
        picked = np.flatnonzero(level > _LEAST * level.max(initial=0.0))
        if picked.size < 2:
            continue
        field = returns.field[picked, order]
        scale = returns.scale / (n - 1)
        bins = _bins(returns, picked, order)
        signed = scale * _partners(field, bins)
        unsigned = scale * _partners(np.abs(field).astype(np.complex128), bins)
        mean[order] = signed.sum() / n
        for partners in (signed, unsigned):
            spread = float(np.square(partners).sum()) / n - (float(partners.sum()) / n) ** 2
            variance[order] = max(variance[order], 4.0 * spread / n)
    return mean, variance


def _partners(field: C128, bins: I64) -> F64:
    """Product of each field (n, n_channels) with the sum of the others of its bin, mean over channels and grids, (n,).

    ``bins`` : (n_grids, n) of :func:`_bins`.
    """
    products = np.zeros(bins.shape)
    for column in field.T:
        many = np.broadcast_to(column, bins.shape).ravel()
        sums = np.bincount(bins.ravel(), many.real) + 1j * np.bincount(bins.ravel(), many.imag)
        products += ((sums[bins] - column) * column.conj()).real
    return np.asarray(products.mean(axis=0) / field.shape[1])


def _bins(returns: PatchReturns, picked: I64, order: int) -> I64:
    """Number of the bin of each picked return, (n_grids, n), in grids at all places; no two grids share a bin."""
    shifts = np.array(_SHIFTS)[:, :, None]
    row = np.floor(returns.slant_range[picked, order] / returns.range_bin + shifts[:, 0]).astype(np.int64)
    column = np.floor(returns.range_rate[picked, order] / returns.rate_bin + shifts[:, 1]).astype(np.int64)
    columns, rows = int(np.ptp(column)) + 1, int(np.ptp(row)) + 1
    grid = np.arange(len(shifts))[:, None]
    bins = np.unique(((grid * rows + row - row.min()) * columns + column - column.min()), return_inverse=True)
    return np.asarray(bins[1].reshape(row.shape), dtype=np.int64)


def azimuth_bin(fade: F64, spacing: float, azimuth_cell: float) -> tuple[float, float]:
    r"""Width of the bins along azimuth (m), and the factor by which they underestimate the energy of a straight corner.

    The lobe :math:`|\hat w(u)|^2` of a patch wider than the resolution cell is narrower than the aperture
    :math:`|u| < 1 / 2 \delta`, with u in cycles/m. Bins are as wide as the wider of the two, b. In the mean over the
    aperture, returns of a straight line then get

    .. math:: \int_{|u| < 1 / 2 \delta} |\hat w(u)|^2 \, b \operatorname{sinc}^2(\pi b u) \, du

    where bins of any width would get :math:`|\hat w(0)|^2`, but with the noise of all pairs of the line.

    Parameters
    ----------
    fade : (n,), taper of the patch
    spacing : m, of its samples
    azimuth_cell : m, resolution
    """
    width = max(azimuth_cell, spacing * fade.sum() ** 2 / np.square(fade).sum())
    u = (np.arange(400) + 0.5) / 400 * 0.5 / azimuth_cell
    x = spacing * (np.arange(len(fade)) - 0.5 * (len(fade) - 1))
    lobe = np.square(np.cos(2.0 * np.pi * np.outer(u, x)) @ fade / fade.sum())
    inside = 2.0 * (u[1] - u[0]) * float((lobe * width * np.square(np.sinc(width * u))).sum())
    return float(width), 1.0 / inside
