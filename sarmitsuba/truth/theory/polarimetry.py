r"""Scattering and coherency matrices of canonical targets, and the entropy and angle that follow from them.

Scattering matrices are :math:`((S_{HH}, S_{HV}), (S_{VH}, S_{VV}))` in backscatter alignment. The coherency matrix is
:math:`T = \langle k k^\dagger \rangle`, :math:`k = (S_{HH} + S_{VV}, S_{HH} - S_{VV}, 2 S_{HV}) / \sqrt 2`. Sources:
Cloude and Pottier, IEEE TGRS 34 (2) 1996 and 35 (1) 1997; Freeman and Durden, IEEE TGRS 36 (3) 1998; Raney et al., JGR
117 (2012) for compact polarimetry.
"""

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import C128, F64

# a sphere, a plate or a trihedral; a dihedral whose corner line is horizontal; a dipole along h
SPHERE: C128 = np.array([[1.0, 0.0], [0.0, 1.0]], dtype=np.complex128)
DIHEDRAL: C128 = np.array([[1.0, 0.0], [0.0, -1.0]], dtype=np.complex128)
DIPOLE: C128 = np.array([[1.0, 0.0], [0.0, 0.0]], dtype=np.complex128)


def rotate_target(matrix: ArrayLike, roll: ArrayLike) -> C128:
    r"""Scattering matrix of a target rotated by ``roll`` (rad, from h towards v) about the line of sight, (..., 2, 2).

    .. math:: S' = R(\psi) S R(\psi)^T

    A turned dihedral has :math:`((\cos 2\psi, \sin 2\psi), (\sin 2\psi, -\cos 2\psi))`, a turned dipole
    :math:`((\cos^2, \sin\cos), (\sin\cos, \sin^2))`.
    """
    psi = np.asarray(roll, dtype=np.float64)
    c, s = np.cos(psi), np.sin(psi)
    rotation = np.moveaxis(np.array([[c, -s], [s, c]]), (0, 1), (-2, -1))
    return np.asarray(rotation @ np.asarray(matrix, dtype=np.complex128) @ np.swapaxes(rotation, -1, -2))


def coherency_of(matrix: ArrayLike) -> C128:
    """Coherency matrix (..., 3, 3) of one deterministic reciprocal target (..., 2, 2)."""
    s = np.asarray(matrix, dtype=np.complex128)
    hh, hv, vv = s[..., 0, 0], s[..., 0, 1], s[..., 1, 1]
    k = np.stack([hh + vv, hh - vv, 2.0 * hv], axis=-1) / np.sqrt(2.0)
    return np.asarray(k[..., :, None] * np.conj(k[..., None, :]))


def random_dipoles() -> C128:
    """Coherency matrix of a cloud of thin dipoles of unit span, evenly turned: ``diag(2, 1, 1) / 4`` of the span.

    Entropy ``-(1/2 log3 1/2 + 1/2 log3 1/4) = 0.946``, mean alpha 45 degrees.
    """
    return np.asarray(np.diag([0.5, 0.25, 0.25]).astype(np.complex128))


def rough_surface_coherency(sigma_hh: float, sigma_vv: float, cross_ratio: float) -> C128:
    r"""Coherency matrix of a rough surface without a preferred side.

    The co-polar channels of first-order theory are in phase and fully correlated (Ulaby and Elachi, Radar Polarimetry
    for Geoscience Applications, 1990); the part of multiple scattering has azimuthal symmetry,
    :math:`\langle |S_{HV}|^2 \rangle = \langle |S_{HH} - S_{VV}|^2 \rangle / 4` for that part:

    .. math::
        T = \frac{1 - r}{2} \begin{pmatrix} (h+v)^2 & (h+v)(h-v) & 0 \\ (h+v)(h-v) & (h-v)^2 & 0 \\ 0 & 0 & 0
        \end{pmatrix} + 2 r h v\, \mathrm{diag}(0, 1, 1), \quad h, v = \sqrt{\sigma_{hh}}, \sqrt{\sigma_{vv}}

    Parameters
    ----------
    sigma_hh, sigma_vv : linear
    cross_ratio : :math:`\sigma_{hv} / \sqrt{\sigma_{hh} \sigma_{vv}}`
    """
    h, v = np.sqrt(sigma_hh), np.sqrt(sigma_vv)
    k = np.array([h + v, h - v, 0.0]) * np.sqrt(0.5 * (1.0 - cross_ratio))
    return np.asarray(np.outer(k, k) + 2.0 * cross_ratio * h * v * np.diag([0.0, 1.0, 1.0])).astype(
        np.complex128
    )


def entropy_alpha(symmetric: ArrayLike) -> tuple[float, float]:
    """Entropy and mean alpha (rad) of a coherency matrix whose cross-polar part is not correlated with the rest.

    The eigenvalues are those of the upper 2 x 2 block, in closed form, and the third diagonal element; the third
    eigenvector has alpha = 90 degrees.
    """
    t = np.asarray(symmetric, dtype=np.complex128)
    a, b, c = float(t[0, 0].real), float(t[1, 1].real), complex(t[0, 1])
    middle, half = 0.5 * (a + b), float(np.sqrt(0.25 * (a - b) ** 2 + abs(c) ** 2))
    values = np.array([middle + half, max(middle - half, 0.0), float(t[2, 2].real)])
    # |first component|^2 of the eigenvectors of a 2 x 2 Hermitian matrix
    first = 0.5 * (1.0 + (0.5 * (a - b) / half if half > 0.0 else 1.0))
    alpha = np.array([np.arccos(np.sqrt(first)), np.arccos(np.sqrt(max(1.0 - first, 0.0))), 0.5 * np.pi])
    share = values / values.sum()
    lit = share > 0.0
    entropy = -np.sum(share[lit] * np.log(share[lit])) / np.log(3.0)
    return float(entropy), float(share @ alpha)


def bragg_alpha(sigma_hh: ArrayLike, sigma_vv: ArrayLike) -> F64:
    r"""Alpha (rad) of first-order rough-surface scattering, :math:`\tan\alpha = |h - v| / (h + v)`."""
    h, v = (np.sqrt(np.asarray(x, dtype=np.float64)) for x in (sigma_hh, sigma_vv))
    return np.asarray(np.arctan2(np.abs(h - v), h + v))
