"""Gauss quadrature over triangles, and closed-form integrals of 1/R over them."""

import numpy as np

from sarmitsuba.core.arrays import F64, unit_rows


def triangle_rule(n: int) -> tuple[F64, F64]:
    r"""Product rule of Gauss and Gauss-Jacobi points on a triangle, exact for polynomials of degree 2 n - 1.

    Parameters
    ----------
    n : points in each of the two directions

    Returns
    -------
    points : (n^2, 3) float64, barycentric coordinates
    weights : (n^2,) float64, sum 1

    References
    ----------
    Stroud, Approximate Calculation of Multiple Integrals (1971), section 2.5 (conical products).
    """
    from scipy.special import roots_jacobi

    u, wu = np.polynomial.legendre.leggauss(n)
    v, wv = roots_jacobi(n, 1.0, 0.0)
    u, v = 0.5 * (u + 1.0), 0.5 * (v + 1.0)
    first, second = np.meshgrid(v, u, indexing="ij")
    a, b = first.ravel(), ((1.0 - first) * second).ravel()
    weights = np.outer(wv, wu).ravel()
    return np.stack([1.0 - a - b, a, b], axis=1), weights / weights.sum()


def inverse_distance_integrals(points: F64, corners: F64) -> tuple[F64, F64]:
    r"""Integrals of 1/R over triangles, with the weights 1 and position.

    .. math:: I = \int \frac{dS'}{R}, \quad \mathbf V = \int \frac{\mathbf r' - \mathbf r}{R}\, dS'

    Parameters
    ----------
    points : (n, m, 3) float64, observation points r of each triangle
    corners : (n, 3, 3) float64

    Returns
    -------
    scalar : (n, m) float64, I
    vector : (n, m, 3) float64, V

    References
    ----------
    Wilton et al., IEEE Transactions on Antennas and Propagation 32(3), 1984, equations 5 and 17 (uniform and linear
    sources on polygons).
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = unit_rows(normal)
    height = np.einsum("nmc,nc->nm", points - corners[:, None, 0], normal)
    above = np.abs(height)
    scalar = np.zeros(points.shape[:2])
    vector = -height[..., None] * normal[:, None]  # from r to its foot, times I at the end
    across = np.zeros(points.shape)
    for i in range(3):
        start, end = corners[:, i], corners[:, (i + 1) % 3]
        along = end - start
        length = np.linalg.norm(along, axis=1)
        along = along / length[:, None]
        outward = np.cross(along, normal)
        off = start[:, None] - points
        low = np.einsum("nmc,nc->nm", off, along)
        high = low + length[:, None]
        side = np.einsum("nmc,nc->nm", off, outward)
        near2 = side * side + height * height
        r_low, r_high = np.sqrt(low * low + near2), np.sqrt(high * high + near2)
        # of two equal forms of the logarithm the one without cancellation
        forward = low + high > 0.0
        top = np.where(forward, r_high + high, r_low - low)
        bottom = np.where(forward, r_low + low, r_high - high)
        logarithm = np.log(np.maximum(top, 1e-300) / np.maximum(bottom, 1e-300))
        turn = np.arctan2(side * high, near2 + above * r_high) - np.arctan2(side * low, near2 + above * r_low)
        scalar += side * logarithm - above * turn
        across += 0.5 * (near2 * logarithm + high * r_high - low * r_low)[..., None] * outward[:, None]
    return scalar, across + vector * scalar[..., None]
