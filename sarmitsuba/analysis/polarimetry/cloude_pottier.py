r"""Cloude-Pottier decomposition: entropy, anisotropy and alpha from the eigenvectors of the coherency matrix.

Source: Cloude and Pottier, IEEE TGRS 35 (1), 68-78, 1997.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.analysis.polarimetry.coherency import hermitian
from sarmitsuba.core.arrays import F64, U8

# zones of the entropy-alpha plane, Cloude and Pottier 1997, figure 3
ZONES: dict[int, str] = {
    1: "high entropy, multiple scattering",
    2: "high entropy, vegetation",
    3: "high entropy, surface (not feasible)",
    4: "medium entropy, multiple scattering",
    5: "medium entropy, vegetation",
    6: "medium entropy, surface",
    7: "low entropy, multiple scattering",
    8: "low entropy, dipole",
    9: "low entropy, surface",
}
ENTROPY_BOUNDS = (0.5, 0.9)
# bounds of alpha, deg, for low, medium and high entropy
ALPHA_BOUNDS_DEG = ((42.5, 47.5), (40.0, 50.0), (40.0, 55.0))


@dataclass(frozen=True, eq=False)
class CloudePottier:
    r"""Cloude-Pottier parameters of T3 on a grid; NaN where the power is zero.

    With the eigenvalues :math:`\lambda_1 \ge \lambda_2 \ge \lambda_3`, their shares :math:`p_i` of the span and
    eigenvectors :math:`e_i = (\cos\alpha_i, \sin\alpha_i \cos\beta_i e^{j\delta_i}, \sin\alpha_i \sin\beta_i
    e^{j\gamma_i})`:

    .. math::
        H = -\sum p_i \log_3 p_i, \quad A = \frac{\lambda_2 - \lambda_3}{\lambda_2 + \lambda_3}, \quad
        \bar\alpha = \sum p_i \alpha_i

    Parameters
    ----------
    eigenvalues : (..., 3) float64, descending, in the unit of T3; negative ones from rounding are 0
    entropy, anisotropy : (...) float64, 0 to 1; A is 0 where the second and third eigenvalue vanish
    alpha, beta : (...) float64, rad, 0 to pi / 2, means over the eigenvectors
    alpha_1, beta_1, delta_1, gamma_1 : (...) float64, rad, of the first eigenvector
    """

    eigenvalues: F64
    entropy: F64
    anisotropy: F64
    alpha: F64
    beta: F64
    alpha_1: F64
    beta_1: F64
    delta_1: F64
    gamma_1: F64

    @property
    def zone(self) -> U8:
        """Number of the zone in :data:`ZONES`, (...) uint8; 0 where the power is zero."""
        column = np.digitize(self.entropy, ENTROPY_BOUNDS)
        bounds = np.radians(ALPHA_BOUNDS_DEG)[np.minimum(column, 2)]
        row = (self.alpha <= bounds[..., 1]).astype(int) + (self.alpha <= bounds[..., 0])
        number = 3 * (2 - column) + row + 1
        return np.where(np.isfinite(self.entropy), number, 0).astype(np.uint8)


def cloude_pottier(coherency: ArrayLike) -> CloudePottier:
    """Decompose coherency matrices (..., 3, 3).

    Raises
    ------
    DataError
        The matrices are not (..., 3, 3) or not Hermitian.

    Notes
    -----
    Noise is not removed. With few looks H is biased low (zero for one look) and A high; with 49 looks by a few per cent
    (Lopez-Martinez et al., IEEE TGRS 43 (6) 2005). Looks are independent cells, not pixels.
    """
    t = hermitian(coherency)
    lit = np.trace(t, axis1=-2, axis2=-1).real > 0.0
    values, vectors = np.linalg.eigh(np.where(lit[..., None, None], t, np.eye(3)))
    # ascending from eigh; those below the rounding of the largest are set to 0, so that a pure target has entropy 0
    values, vectors = values[..., ::-1], vectors[..., ::-1]
    values = np.where(values < 1e-12 * values[..., :1], 0.0, values)
    share = values / values.sum(axis=-1, keepdims=True)
    size = np.abs(vectors)  # (..., component, eigenvector)
    alpha = np.arctan2(np.hypot(size[..., 1, :], size[..., 2, :]), size[..., 0, :])
    beta = np.arctan2(size[..., 2, :], size[..., 1, :])
    first = vectors[..., 0]
    rest = values[..., 1] + values[..., 2]

    def where_lit(x: F64) -> F64:
        return np.asarray(np.where(lit, x, np.nan))

    return CloudePottier(
        eigenvalues=np.where(lit[..., None], values, np.nan),
        entropy=where_lit(
            np.abs(np.sum(share * np.log(np.where(share > 0.0, share, 1.0)), axis=-1)) / np.log(3.0)
        ),
        anisotropy=where_lit((values[..., 1] - values[..., 2]) / np.where(rest > 0.0, rest, 1.0)),
        alpha=where_lit(np.sum(share * alpha, axis=-1)),
        beta=where_lit(np.sum(share * beta, axis=-1)),
        alpha_1=where_lit(alpha[..., 0]),
        beta_1=where_lit(beta[..., 0]),
        delta_1=where_lit(np.angle(first[..., 1] * np.conj(first[..., 0]))),
        gamma_1=where_lit(np.angle(first[..., 2] * np.conj(first[..., 0]))),
    )


def orientation_angle(coherency: ArrayLike) -> F64:
    r"""Orientation angle of even-bounce scatterers about the line of sight, rad, -pi/4 to pi/4.

    .. math:: \psi = \tfrac14 \arctan_2(2\,\mathrm{Re}\,T_{23}, T_{22} - T_{33})

    (Lee, Schuler, Ainsworth, IEEE TGRS 38 (5) 2000, in the sense from h towards v). The angle is ambiguous by multiples
    of 90 degrees.
    """
    t = hermitian(coherency)
    return np.asarray(0.25 * np.arctan2(2.0 * t[..., 1, 2].real, t[..., 1, 1].real - t[..., 2, 2].real))
