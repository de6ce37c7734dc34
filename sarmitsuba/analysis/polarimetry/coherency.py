r"""Scattering vectors and their second moments: coherency matrix T, covariance matrix C.

Reciprocity is assumed except in :func:`coherency4`: the cross-polar channel is ``X = (HV + VH) / 2``. Sources: Cloude
and Pottier, IEEE TGRS 34 (2) 1996, equations 8 to 18; Lee and Pottier, Polarimetric Radar Imaging (2009), chapter 3.
"""

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.analysis.polarimetry.multilook import averaged
from sarmitsuba.analysis.polarimetry.quad import QuadPol
from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.core.errors import DataError

_ROOT_2 = np.sqrt(2.0)
# k_pauli = U k_lexicographic
_TO_PAULI = np.array([[1.0, 0.0, 1.0], [1.0, 0.0, -1.0], [0.0, _ROOT_2, 0.0]]) / _ROOT_2


def pauli_vector(quad: QuadPol) -> C64:
    r"""Pauli vector :math:`k = (S_{HH} + S_{VV}, S_{HH} - S_{VV}, 2 X) / \sqrt 2`, (n_azimuth, n_range, 3).

    Components: odd bounces and surfaces; even bounces; even bounces rotated by 45 degrees, and volumes.
    """
    return _stacked(quad.hh + quad.vv, quad.hh - quad.vv, 2.0 * quad.cross)


def lexicographic_vector(quad: QuadPol) -> C64:
    r"""Lexicographic vector :math:`\Omega = (S_{HH}, \sqrt 2 X, S_{VV})`, (n_azimuth, n_range, 3)."""
    return np.stack([quad.hh, np.asarray(quad.cross * np.float32(_ROOT_2)), quad.vv], axis=-1)


def coherency(quad: QuadPol, looks: tuple[int, int] = (1, 1), *, sliding: bool = False) -> C128:
    r"""Coherency matrix :math:`T_3 = \langle k k^\dagger \rangle` of the Pauli vector, (rows, columns, 3, 3).

    Parameters
    ----------
    quad : scattering matrices
    looks : averaged pixels (azimuth, range)
    sliding : whether to use a window about every pixel instead of blocks

    Raises
    ------
    DataError
        ``looks`` do not fit the image.
    """
    return _moments(pauli_vector(quad), looks, sliding)


def coherency4(quad: QuadPol, looks: tuple[int, int] = (1, 1), *, sliding: bool = False) -> C128:
    r"""Coherency matrix without reciprocity, (rows, columns, 4, 4), parameters as for :func:`coherency`.

    .. math:: k_4 = (S_{HH} + S_{VV}, S_{HH} - S_{VV}, S_{HV} + S_{VH}, j (S_{HV} - S_{VH})) / \sqrt 2

    The upper 3 x 3 block is T3; the last diagonal element is the power of HV - VH: noise or a fault.
    """
    vector = _stacked(
        quad.hh + quad.vv, quad.hh - quad.vv, quad.hv + quad.vh, np.complex64(1j) * (quad.hv - quad.vh)
    )
    return _moments(vector, looks, sliding)


def covariance(quad: QuadPol, looks: tuple[int, int] = (1, 1), *, sliding: bool = False) -> C128:
    r"""Covariance matrix :math:`C_3 = \langle \Omega \Omega^\dagger \rangle` of the lexicographic vector, as T3."""
    return _moments(lexicographic_vector(quad), looks, sliding)


def covariance_of_coherency(matrices: ArrayLike) -> C128:
    """Covariance matrix C3 from T3, (..., 3, 3)."""
    return np.asarray(_TO_PAULI.T @ hermitian(matrices) @ _TO_PAULI)


def coherency_of_covariance(matrices: ArrayLike) -> C128:
    """Coherency matrix T3 from C3, (..., 3, 3)."""
    return np.asarray(_TO_PAULI @ hermitian(matrices) @ _TO_PAULI.T)


def span(matrices: ArrayLike) -> F64:
    """Total power ``|HH|^2 + 2 |X|^2 + |VV|^2``, the trace of T3 or C3 (..., n, n), in their unit."""
    return np.asarray(np.trace(np.asarray(matrices), axis1=-2, axis2=-1).real)


def hermitian(matrices: ArrayLike) -> C128:
    """Matrices (..., 3, 3) as complex128.

    Raises
    ------
    DataError
        The shape differs, or a matrix is not Hermitian.
    """
    array = np.asarray(matrices, dtype=np.complex128)
    if array.shape[-2:] != (3, 3):
        raise DataError(f"polarimetry: matrices of shape {array.shape}; (..., 3, 3) is needed")
    largest = float(np.abs(array).max(initial=0.0))
    # tol: single precision, in which most files keep them
    if not np.allclose(array, np.conj(np.swapaxes(array, -1, -2)), rtol=0.0, atol=1e-5 * largest):
        raise DataError("polarimetry: a matrix is not Hermitian; give <k k^dagger>, complex conjugate second")
    return array


def _stacked(*parts: C64) -> C64:
    return np.stack([np.asarray(part * np.float32(1.0 / _ROOT_2)) for part in parts], axis=-1)


def _moments(vector: C64, looks: tuple[int, int], sliding: bool) -> C128:
    """Averages of ``k k^dagger`` for vectors (n_azimuth, n_range, n)."""
    n = vector.shape[-1]
    wide = vector.astype(np.complex128)
    rows = [
        [averaged(wide[..., i] * np.conj(wide[..., j]), looks, sliding) for j in range(i + 1)]
        for i in range(n)
    ]
    full = [[rows[i][j] if j <= i else np.conj(rows[j][i]) for j in range(n)] for i in range(n)]
    return np.moveaxis(np.array(full), (0, 1), (-2, -1))
