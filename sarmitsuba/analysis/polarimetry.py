r"""Polarimetry of an image: coherency matrices, decompositions, colours, and a report.

Scattering vectors have second moments T (coherency) and C (covariance). Reciprocity is assumed except in
:func:`coherency4`: the cross-polar channel is ``X = (HV + VH) / 2``. Entropy, anisotropy and alpha come from the
eigenvectors of T. Channels of a circular wave are decomposed by Stokes vectors (m-delta, m-chi). Averages are over
blocks of pixels or a sliding window; all pictures have one law of colours.

References
----------
Cloude and Pottier, IEEE TGRS 34 (2) 1996, equations 8 to 18, and 35 (1) 1997, 68-78; Lee and Pottier, Polarimetric
Radar Imaging (2009), chapter 3; Raney, IEEE TGRS 45 (11) 2007 (m-delta); Raney, Cahill, Patterson, Bussey, JGR 117,
E00H21, 2012 (m-chi).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.core.arrays import C64, C128, F64, U8
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.units import db_from_power
from sarmitsuba.signal.image import SarImage, block_means, sliding_means


def average_pixels(values: NDArray[np.complexfloating], looks: tuple[int, int], sliding: bool) -> C128:
    """Means of (n_azimuth, n_range) complex values over ``looks`` pixels (azimuth, range).

    Parameters
    ----------
    values : (n_azimuth, n_range) complex
    looks : pixels of a block or of the window
    sliding : whether to use a window centred on every pixel (boxcar, mirrored at the edges) instead of blocks;
        incomplete blocks at the far ends are dropped

    Raises
    ------
    DataError
        ``looks`` are below 1 or above the image's size.
    """
    check_looks(values.shape, looks)
    parts = []
    for part in (values.real, values.imag):
        wide = np.asarray(part, dtype=np.float64)
        parts.append(sliding_means(wide, looks, "reflect") if sliding else block_means(wide, looks))
    return np.asarray(parts[0] + 1j * parts[1])


def check_looks(shape: tuple[int, ...], looks: tuple[int, int]) -> None:
    """Raise a DataError where blocks of ``looks`` do not fit an image of ``shape``."""
    if not all(1 <= n <= size for n, size in zip(looks, shape, strict=True)):
        raise DataError(
            f"polarimetry: looks of {looks[0]} x {looks[1]} pixels of an image of {shape[0]} x {shape[1]}; give 1 or "
            "more, up to its size"
        )


# relative power of float32 rounding
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class QuadPol:
    """Scattering matrices on a grid, in backscatter alignment; one array per channel, transmit letter first.

    Parameters
    ----------
    hh, hv, vh, vv : (n_azimuth, n_range) complex, in one unit (the program's images have m, the square root of RCS)

    Raises
    ------
    DataError
        The arrays have not one shape of two axes.
    """

    hh: C64
    hv: C64
    vh: C64
    vv: C64

    def __post_init__(self) -> None:
        shapes = {channel.shape for channel in (self.hh, self.hv, self.vh, self.vv)}
        if len(shapes) != 1 or len(self.hh.shape) != 2:
            raise DataError(
                f"polarimetry: channels of shapes {', '.join(map(str, sorted(shapes)))}; four arrays of one shape "
                "(n_azimuth, n_range) are needed"
            )

    @property
    def cross(self) -> C64:
        """Symmetrised cross-polar channel, ``(HV + VH) / 2``; by reciprocity both are equal except for noise."""
        return np.asarray(0.5 * (self.hv + self.vh))

    @property
    def asymmetry_db(self) -> float:
        r"""Energy of ``HV - VH`` over that of both, ``sum |HV - VH|^2 / sum (|HV|^2 + |VH|^2)``, dB.

        0 dB for independent noise; -inf if both are equal; NaN if both are within the rounding of the co-polar
        channels (120 dB below them).
        """
        co_polar = np.sum(
            np.abs(self.hh.astype(np.complex128)) ** 2 + np.abs(self.vv.astype(np.complex128)) ** 2
        )
        difference = np.sum(np.abs(self.hv.astype(np.complex128) - self.vh) ** 2)
        total = np.sum(
            np.abs(self.hv.astype(np.complex128)) ** 2 + np.abs(self.vh.astype(np.complex128)) ** 2
        )
        return db_from_power(difference / total) if total > _ROUNDING * co_polar else float("nan")


def quad_pol(image: SarImage) -> QuadPol:
    """Scattering matrices of an image with HH, VV, and HV or VH; a missing cross-polar channel equals the other one.

    Raises
    ------
    DataError
        A channel is missing.
    """
    there = image.channels
    cross = [name for name in ("HV", "VH") if name in there]
    if not {"HH", "VV"} <= set(there) or not cross:
        raise DataError(
            f"polarimetry: the image has the channels {', '.join(there)}; HH, VV and HV (VH) are needed: set "
            'polarisation to "HH,HV,VH,VV"'
        )
    return QuadPol(image.total("HH"), image.total(cross[0]), image.total(cross[-1]), image.total("VV"))


_ROOT_2 = np.sqrt(2.0)
# k_pauli = U k_lexicographic
_TO_PAULI = np.array([[1.0, 0.0, 1.0], [1.0, 0.0, -1.0], [0.0, _ROOT_2, 0.0]]) / _ROOT_2


def pauli_vector(quad: QuadPol) -> C64:
    r"""Pauli vector :math:`k = (S_{HH} + S_{VV}, S_{HH} - S_{VV}, 2 X) / \sqrt 2`, (n_azimuth, n_range, 3).

    Components: odd bounces and surfaces; even bounces; even bounces rotated by 45 degrees, and volumes.
    """
    return _stack_channels(quad.hh + quad.vv, quad.hh - quad.vv, 2.0 * quad.cross)


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
    vector = _stack_channels(
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


def _stack_channels(*parts: C64) -> C64:
    return np.stack([np.asarray(part * np.float32(1.0 / _ROOT_2)) for part in parts], axis=-1)


def _moments(vector: C64, looks: tuple[int, int], sliding: bool) -> C128:
    """Averages of ``k k^dagger`` for vectors (n_azimuth, n_range, n)."""
    n = vector.shape[-1]
    wide = vector.astype(np.complex128)
    rows = [
        [average_pixels(wide[..., i] * np.conj(wide[..., j]), looks, sliding) for j in range(i + 1)]
        for i in range(n)
    ]
    full = [[rows[i][j] if j <= i else np.conj(rows[j][i]) for j in range(n)] for i in range(n)]
    return np.moveaxis(np.array(full), (0, 1), (-2, -1))


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


# range of the brightness from black to white, dB
SPAN_DB = 50.0
# percentile of the lit pixels shown as white
WHITE_PERCENTILE = 99.0


def colours(powers: ArrayLike, *, white_db: float | None = None, span_db: float = SPAN_DB) -> U8:
    r"""Red, green and blue of three powers, (rows, columns, 3) uint8.

    Brightness is the sum of the powers in dB, ``span_db`` from black to white; hue and saturation are those of the
    amplitudes:

    .. math:: c_i = 255\, b \sqrt{P_i / \max_k P_k}, \quad b = 1 + (10 \log_{10} \sum_k P_k - w) / s

    clipped to 0 ... 1. The hue is independent of the strength, and channels are not stretched separately.

    Parameters
    ----------
    powers : (rows, columns, 3), linear, not negative
    white_db : w, dB of the powers' unit; None: the 99th percentile of the sum over pixels with power
    span_db : s

    Raises
    ------
    DataError
        The shape of the powers differs, or ``span_db`` is not above 0.
    """
    p = np.asarray(powers, dtype=np.float64)
    if p.shape[-1:] != (3,):
        raise DataError(f"polarimetry: powers of shape {p.shape}; (rows, columns, 3) are needed")
    if not span_db > 0.0:
        raise DataError(f"polarimetry: span_db = {span_db:g} dB is not above 0; give for example {SPAN_DB:g}")
    total = p.sum(axis=-1)
    lit = total > 0.0
    if not lit.any():
        return np.zeros(p.shape, dtype=np.uint8)
    level = db_from_power(np.where(lit, total, 1.0))
    white = float(np.percentile(level[lit], WHITE_PERCENTILE)) if white_db is None else white_db
    brightness = np.where(lit, np.clip(1.0 + (level - white) / span_db, 0.0, 1.0), 0.0)
    hue = np.sqrt(p / np.where(lit, p.max(axis=-1), 1.0)[..., None])
    return np.asarray(np.rint(255.0 * brightness[..., None] * hue), dtype=np.uint8)


def pauli_rgb(coherency: ArrayLike, *, white_db: float | None = None) -> U8:
    """Pauli colours of T3 (rows, columns, 3, 3): red T22 (even bounces), green T33, blue T11 (odd bounces)."""
    t = hermitian(coherency)
    return colours(np.stack([t[..., i, i].real for i in (1, 2, 0)], axis=-1), white_db=white_db)


@dataclass(frozen=True, eq=False)
class Stokes:
    r"""Stokes vector of the received wave.

    .. math::
        S_1 = \langle |E_H|^2 + |E_V|^2 \rangle, \; S_2 = \langle |E_H|^2 - |E_V|^2 \rangle, \;
        S_3 = 2\,\mathrm{Re} \langle E_H E_V^* \rangle, \; S_4 = -2\,\mathrm{Im} \langle E_H E_V^* \rangle

    With exp(+j w t) and equal h and v on transmit and receive, S4 is positive for a left-handed received wave, the echo
    of a right-handed wave after one bounce.

    Parameters
    ----------
    s1, s2, s3, s4 : (rows, columns) float64, in the square of the channels' unit
    sent : ``R`` or ``L``, the transmitted sense
    """

    s1: F64
    s2: F64
    s3: F64
    s4: F64
    sent: str

    @property
    def polarised(self) -> F64:
        """Degree of polarisation m, 0 to 1; NaN where the power is zero."""
        with np.errstate(divide="ignore", invalid="ignore"):
            m = np.sqrt(self.s2**2 + self.s3**2 + self.s4**2) / self.s1
        return np.asarray(np.minimum(m, 1.0))  # 1 for one look, except for rounding

    @property
    def chi(self) -> F64:
        r"""Ellipticity angle, rad: :math:`\sin 2\chi = \mp S_4 / (m S_1)`; -pi/4 for one bounce, pi/4 for two."""
        with np.errstate(divide="ignore", invalid="ignore"):
            sine = -self._sign * self.s4 / np.sqrt(self.s2**2 + self.s3**2 + self.s4**2)
        return np.asarray(0.5 * np.arcsin(np.clip(sine, -1.0, 1.0)))

    @property
    def delta(self) -> F64:
        r"""Relative phase, rad: :math:`\arctan_2(\mp S_4, S_3)`; -pi/2 for one bounce, pi/2 for two."""
        return np.asarray(np.arctan2(-self._sign * self.s4, self.s3))

    @property
    def _sign(self) -> float:
        return 1.0 if self.sent == "R" else -1.0


def stokes(
    image: SarImage, looks: tuple[int, int] = (1, 1), *, sent: str | None = None, sliding: bool = False
) -> Stokes:
    """Stokes vector of an image's channels RH and RV, or LH and LV.

    Parameters
    ----------
    image : with both channels
    looks : averaged pixels (azimuth, range)
    sent : ``R`` or ``L``; None: the sense in the image, R before L
    sliding : whether to use a window about every pixel instead of blocks

    Raises
    ------
    DataError
        The channels are missing, or ``looks`` do not fit.
    """
    senses = (sent,) if sent else ("R", "L")
    for sense in senses:
        if sense in ("R", "L") and {sense + "H", sense + "V"} <= set(image.channels):
            return stokes_of(
                image.total(sense + "H"), image.total(sense + "V"), sense, looks, sliding=sliding
            )
    raise DataError(
        f"polarimetry: the image has the channels {', '.join(image.channels)}; RH and RV (LH and LV) are needed: set "
        'polarisation to "RH,RV"'
    )


def stokes_of(
    horizontal: C64, vertical: C64, sent: str = "R", looks: tuple[int, int] = (1, 1), *, sliding: bool = False
) -> Stokes:
    """Stokes vector of two complex channels (n_azimuth, n_range), H and V received."""
    h, v = (channel.astype(np.complex128) for channel in (horizontal, vertical))
    p_h, p_v = (average_pixels(np.abs(x) ** 2 + 0j, looks, sliding).real for x in (h, v))
    product = average_pixels(h * np.conj(v), looks, sliding)
    return Stokes(p_h + p_v, p_h - p_v, 2.0 * product.real, -2.0 * product.imag, sent)


def m_chi(vector: Stokes) -> F64:
    r"""m-chi powers of even bounces, unpolarised and odd-bounce echoes (red, green, blue), (rows, columns, 3).

    .. math:: m S_1 (1 + \sin 2\chi) / 2, \quad S_1 (1 - m), \quad m S_1 (1 - \sin 2\chi) / 2
    """
    return _split(vector, np.sin(2.0 * vector.chi))


def m_delta(vector: Stokes) -> F64:
    r"""m-delta powers: as :func:`m_chi`, with :math:`\sin\delta` instead of :math:`\sin 2\chi`.

    Equal to m-chi where S2 = 0; only m-chi distinguishes dipoles, which polarise along their axis.
    """
    return _split(vector, np.sin(vector.delta))


def _split(vector: Stokes, even: F64) -> F64:
    m, lit = vector.polarised, vector.s1 > 0.0
    polarised = np.where(lit, 0.5 * m * vector.s1, 0.0)
    even = np.where(np.isfinite(even), even, 0.0)
    return np.stack(
        [polarised * (1.0 + even), np.where(lit, vector.s1 * (1.0 - m), 0.0), polarised * (1.0 - even)], -1
    )


# resolution cells along the side of an automatic block: 25 looks give H to about 0.05
CELLS = 5.0


@dataclass(frozen=True, eq=False)
class PolarimetryReport:
    """Results of the decompositions; None for those whose channels are missing.

    Parameters
    ----------
    looks : pixels (azimuth, range) averaged into one
    cells : resolution cells in a block, the number of independent looks
    coherency : (rows, columns, 3, 3) complex128, T3, m^2
    decomposition : of the coherency matrix
    asymmetry_db : energy of HV - VH over that of both, dB; NaN without both
    stokes : of the compact channels
    """

    looks: tuple[int, int]
    cells: float
    coherency: C128 | None
    decomposition: CloudePottier | None
    asymmetry_db: float
    stokes: Stokes | None

    def as_dict(self) -> dict[str, object]:
        """Values for JSON; None for those not measured, powers as shares."""
        return {
            "looks": list(self.looks),
            "cells_per_block": self.cells,
            "quad": None if self.coherency is None else self._quad(self.coherency),
            "compact": None if self.stokes is None else self._compact(self.stokes),
        }

    def as_table(self) -> str:
        """Table of the values for a terminal."""
        lines = [
            f"blocks of {self.looks[0]} x {self.looks[1]} pixels, {self.cells:.3g} resolution cells each"
        ]
        if self.coherency is not None and self.decomposition is not None:
            odd, even, cross = pauli_shares(self.coherency)
            d = self.decomposition
            lines += [
                f"Pauli shares of power: odd bounces {odd:.1%}, even bounces {even:.1%}, cross-polar {cross:.1%}",
                f"median entropy {_median(d.entropy):.3f}, anisotropy {_median(d.anisotropy):.3f}, "
                f"alpha {np.degrees(_median(d.alpha)):.1f} deg",
                "HV - VH: none"
                if self.asymmetry_db == -math.inf
                else f"HV - VH: {self.asymmetry_db:.1f} dB of both",
                "zones of entropy and alpha, share of area and of power:",
            ]
            lines += [
                f"  {number}  {name:<42}{area:7.1%}{power:8.1%}"
                for number, (name, area, power) in zone_shares(d, span(self.coherency)).items()
            ]
        if self.stokes is not None:
            lines += [
                "m-chi shares of power: "
                + ", ".join(f"{name} {share:.1%}" for name, share in m_chi_shares(self.stokes).items()),
                f"median degree of polarisation {_median(self.stokes.polarised):.3f}",
            ]
        return "\n".join(lines)

    def _quad(self, matrices: C128) -> dict[str, object]:
        assert self.decomposition is not None
        d = self.decomposition
        shares = dict(zip(("odd_bounce", "even_bounce", "cross_polar"), pauli_shares(matrices), strict=True))
        zones = zone_shares(d, span(matrices))
        return {
            "pauli_shares": {name: _or_none(share) for name, share in shares.items()},
            "entropy": _or_none(_median(d.entropy)),
            "anisotropy": _or_none(_median(d.anisotropy)),
            "alpha_deg": _or_none(float(np.degrees(_median(d.alpha)))),
            "hv_minus_vh_db": _or_none(self.asymmetry_db),
            "zones": {
                number: {"name": name, "area": area, "power": power}
                for number, (name, area, power) in zones.items()
            },
        }

    @staticmethod
    def _compact(vector: Stokes) -> dict[str, object]:
        return {
            "m_chi_shares": {name: _or_none(share) for name, share in m_chi_shares(vector).items()},
            "degree_of_polarisation": _or_none(_median(vector.polarised)),
            "chi_deg": _or_none(float(np.degrees(_median(vector.chi)))),
        }


def polarimetry_report(image: SarImage, looks: tuple[int, int] | None = None) -> PolarimetryReport:
    """Decompose an image: T3, H, A and alpha of quad-pol channels, the Stokes vector of compact ones.

    Parameters
    ----------
    image : with HH, HV (VH), VV, or RH and RV (LH and LV), or both
    looks : pixels (azimuth, range) of a block; None takes :func:`automatic_looks`

    Raises
    ------
    DataError
        The image has neither set of channels, or ``looks`` do not fit.
    """
    there = set(image.channels)
    has_quad = {"HH", "VV"} <= there and bool(there & {"HV", "VH"})
    has_compact = {"RH", "RV"} <= there or {"LH", "LV"} <= there
    if not has_quad and not has_compact:
        raise DataError(
            f"polarimetry: the image has the channels {', '.join(image.channels)}; HH, HV, VH, VV or RH, RV are "
            'needed: set polarisation to "HH,HV,VH,VV"'
        )
    block = looks or automatic_looks(image)
    check_looks(image.grid.shape, block)
    matrices = decomposition = None
    asymmetry = float("nan")
    if has_quad:
        quad = quad_pol(image)
        matrices = coherency(quad, block)
        decomposition = cloude_pottier(matrices)
        asymmetry = quad.asymmetry_db if {"HV", "VH"} <= there else asymmetry
    pixels = np.array(cell_pixels(image))
    return PolarimetryReport(
        looks=block,
        cells=float(np.prod(np.maximum(np.array(block) / pixels, 1.0))),
        coherency=matrices,
        decomposition=decomposition,
        asymmetry_db=asymmetry,
        stokes=stokes(image, block) if has_compact else None,
    )


def cell_pixels(image: SarImage) -> tuple[float, float]:
    """Pixels (azimuth, range) of a resolution cell in the middle of the image."""
    grid = image.grid
    cell = image.range_resolution_cell
    if grid.kind == "ground":
        cell /= float(np.sin(image.incidence_angle[image.incidence_angle.size // 2]))
    return image.azimuth_resolution_cell / grid.azimuth_spacing, cell / grid.range_spacing


def automatic_looks(image: SarImage, cells: float = CELLS) -> tuple[int, int]:
    """Pixels (azimuth, range) of ``cells`` resolution cells each way, at most those of the image."""
    rows, columns = (
        min(max(1, round(cells * pixels)), size)
        for pixels, size in zip(cell_pixels(image), image.grid.shape, strict=True)
    )
    return rows, columns


def pauli_shares(matrices: C128) -> tuple[float, float, float]:
    """Pauli shares of the power: ``|HH + VV|^2 / 2``, ``|HH - VV|^2 / 2``, ``2 |X|^2``; NaN without power."""
    powers = [float(matrices[..., i, i].real.sum()) for i in range(3)]
    total = sum(powers)
    odd, even, cross = (p / total if total > 0.0 else float("nan") for p in powers)
    return odd, even, cross


def zone_shares(decomposition: CloudePottier, power: F64) -> dict[int, tuple[str, float, float]]:
    """Name, share of the area and share of the power of each zone of :data:`ZONES`."""
    number = decomposition.zone.ravel()
    counts = np.bincount(number, minlength=10)[1:].astype(np.float64)
    powers = np.bincount(number, weights=power.ravel(), minlength=10)[1:]
    area, share = (x / x.sum() if x.sum() > 0.0 else np.zeros(9) for x in (counts, powers))
    return {n: (name, float(area[n - 1]), float(share[n - 1])) for n, name in ZONES.items()}


def m_chi_shares(vector: Stokes) -> dict[str, float]:
    """Shares of the power in the three parts of :func:`sarmitsuba.analysis.polarimetry.m_chi`; NaN without power."""
    powers = m_chi(vector).sum(axis=(0, 1))
    total = float(powers.sum())
    names = ("even_bounce", "unpolarised", "odd_bounce")
    return {n: float(p) / total if total > 0.0 else float("nan") for n, p in zip(names, powers, strict=True)}


def _median(values: F64) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None
