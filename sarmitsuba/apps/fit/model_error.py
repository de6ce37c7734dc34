r"""Standard deviations of fitted values from the residuals of parts of the image, which model errors decide.

Residuals r of echoes that the model lacks, or has too many, are alike over a building, and no noise of single samples.
With the derivatives J and the residuals focused about the scene, and the image divided into parts b, the values follow
from sums of independent parts, and (White 1980, Liang and Zeger 1986)

.. math:: C = N^{-1} \Big(\frac{B}{B - 1} \sum_b s_b s_b^T\Big) N^{-1}, \quad
          s_b = \sum_{i \in b} \Re J_i^* r_i / \sigma^2, \quad N = \Re J^H J / \sigma^2

For residuals of noise alone it is the covariance of the fit, to :math:`1 / \sqrt{2 B}` of each standard deviation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sarmitsuba.apps.fit.confirmation import focus_spectra, weakest_cells
from sarmitsuba.apps.fit.least_squares import Prior, Rows, Samples
from sarmitsuba.apps.fit.measured_looks import ROUNDING, MeasuredLook
from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.signal.raw_data import RawData

# parts along either axis of the image over which residuals are alike
PARTS = 6
# share of the energy of all derivatives that the parts hold
HELD = 0.99
# ratio to the standard deviation of noise from which that of the parts holds: three of its own standard errors
EXCESS = 1.4


def error_of_model(
    looks: Sequence[MeasuredLook],
    differences: Sequence[Samples],
    jacobians: Sequence[Rows],
    variances: F64,
    known: Mapping[int, Prior],
) -> F64:
    """(n,) standard deviations of values; 0 where a value shows itself in one part alone.

    Parameters
    ----------
    looks : of the fit
    differences, jacobians : of each look, data less model, and derivatives (n, channels, pulses, samples)
    variances, known : as for :meth:`sarmitsuba.apps.fit.least_squares.Solution.covariance`

    Notes
    -----
    Ignores errors that are alike over more than a part, such as a gain that is off, and those of values that the
    residuals are free of, as one building alone on dark ground.
    """
    n = len(jacobians[0])
    normal, meat = np.zeros((n, n)), np.zeros((n, n))
    for look, difference, rows, variance in zip(looks, differences, jacobians, variances, strict=True):
        sums, own = _sums(look, np.asarray(difference, dtype=np.complex128), rows)
        parts = len(sums)
        normal += own / variance
        meat += sums.T @ sums * (parts / max(parts - 1, 1)) / variance**2
    for k, prior in known.items():
        normal[k, k] += 0.5 / prior.sigma**2
    seen = np.diag(normal) > 0.0
    out = np.zeros(n)
    inverse = np.linalg.inv(normal[np.ix_(seen, seen)])
    out[seen] = np.sqrt(np.maximum(np.diag(inverse @ meat[np.ix_(seen, seen)] @ inverse), 0.0))
    return out


def misfit(look: MeasuredLook, difference: Samples) -> float:
    """Power of the residuals of a look over that of its noise: 1 where the model explains all but noise.

    Noise is that of the radar as stated and of the sampling that two ray sets of the data show; where there is neither,
    the weakest cells of the data bound it.
    """
    noise = look.noise.stated + sampling_noise(look.data)
    if not noise > 0.0:
        center = look.model.sampling.window.center
        noise = max(weakest_cells(look.model, center, look.measured), ROUNDING * look.noise.least)
    return float(np.mean(np.abs(difference) ** 2)) / noise


def sampling_noise(data: RawData) -> float:
    """Mean power of the error of a sample by which two ray sets of raw data differ, W; 0 without them.

    Both are stored as halves, so that the variance of their sum is the mean square of their difference.
    """
    sets = [
        sum(plane for plane, layer in zip(data.data, data.layers, strict=True) if layer.subset == k)
        for k in (1, 2)
    ]
    return float(np.mean(np.abs(sets[0] - sets[1]) ** 2))


def _sums(look: MeasuredLook, difference: Samples, rows: Rows) -> tuple[F64, F64]:
    """Products (parts, n) of residuals and derivatives over parts of a look's image, and the matrix Re J^H J."""
    center = look.model.sampling.window.center

    def image_of(data: Samples | Rows) -> C128:
        image = focus_spectra(look.model, center, np.fft.fft(np.asarray(data, dtype=np.complex128), axis=-1))
        return np.asarray(np.fft.fftshift(image, axes=(1, 2)))

    left, images = image_of(difference), [image_of(row) for row in rows]
    power = np.zeros(left.shape[1:])
    for image in images:
        own = np.sum(np.abs(image) ** 2, axis=0)
        power += own / max(float(own.sum()), np.finfo(np.float64).tiny)
    edges = [_edges(power.sum(axis=1 - axis)) for axis in (0, 1)]
    sums = np.stack(
        [_sum_parts(np.sum((image.conj() * left).real, axis=0), edges) for image in images], axis=1
    )
    flat = np.array([image.ravel() for image in images])
    return sums, np.asarray((flat.conj() @ flat.T).real)


def _edges(power: F64) -> list[int]:
    """Bounds of ``PARTS`` equal intervals of an axis that hold ``HELD`` of the power."""
    held = np.cumsum(power) / max(float(power.sum()), np.finfo(np.float64).tiny)
    first, last = np.searchsorted(held, [0.5 * (1.0 - HELD), 0.5 * (1.0 + HELD)])
    return [int(x) for x in np.unique(np.linspace(first, last + 1, PARTS + 1).round())]


def _sum_parts(products: F64, edges: Sequence[Sequence[int]]) -> F64:
    """Sums of products (rows, columns) over all parts, the remainder with the outermost ones."""
    rows, columns = ([0, *own[1:-1]] for own in edges)
    return np.asarray(np.add.reduceat(np.add.reduceat(products, rows, axis=0), columns, axis=1).ravel())
