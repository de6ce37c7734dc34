"""Diffuse double bounce between Lambertian surfaces: a bowl in closed form, facets by a double sum."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64


@dataclass(frozen=True, eq=False)
class PairReturn:
    """Mean radar cross section of all pairs of scatterers, m^2: HH, VV and the cross-polar one (HV = VH)."""

    co_h: F64
    co_v: F64
    cross: F64


def lambertian_bowl(radius: float, albedo: float, tilt: ArrayLike, turn: ArrayLike = 0.0) -> PairReturn:
    r"""Diffuse double bounce of a hemispherical bowl, seen through its opening.

    For two points of a sphere of radius a the cosines at both ends are :math:`r / 2a`, so that Lambert's law on the
    path between them,

    .. math:: \frac{4 A c_i c \cdot 4 A c\, c_s}{4 \pi r^2} = \frac{A^2}{\pi a^2} c_i c_s,

    is independent of their positions (the constant form factor of a sphere), and the integral over both ends is that of
    the projected opening, squared: :math:`\pi A^2 a^2 \cos^2\tau` at a tilt :math:`\tau` of the line of sight from the
    bowl's axis. Fields keep their parts perpendicular and parallel to each plane of incidence; from A to B of a sphere
    these planes are one, and

    .. math:: S_{AB} \propto \begin{pmatrix} \cos\Sigma & \sin\Sigma \\ \sin\Sigma & -\cos\Sigma \end{pmatrix},
        \quad \Sigma = \varphi_A + \varphi_B

    with the azimuths about the line of sight. Both orders of a pair add in phase (twice the power), and

    .. math:: \sigma_{co, cross} = \pi A^2 a^2 \cos^2\tau \, (1 \pm m^2 \cos 4 \chi), \quad
        m = \frac{1 - \cos\tau}{1 + \cos\tau}

    with :math:`m e^{2 j \chi}` the mean of :math:`e^{2 j \varphi}` over the opening, an ellipse as it is seen.

    Parameters
    ----------
    radius : m; albedo : A, sigma0 at normal incidence is 4 A
    tilt : rad, below pi / 2
    turn : rad, of the opening's longer axis from the direction of H

    Notes
    -----
    Ignores third and higher orders: each has A / 2 of the power of the previous one, since half of the directions
    within the bowl end on the bowl.

    References
    ----------
    Form factor of a sphere: Modest, Radiative Heat Transfer (2013), section 5.2. Enhancement: Ishimaru, Backscattering
    enhancement, IEEE AP Magazine 33 (5) 1991.
    """
    tau, chi = np.asarray(tilt, dtype=np.float64), np.asarray(turn, dtype=np.float64)
    mean = (1.0 - np.cos(tau)) / (1.0 + np.cos(tau))
    level = np.pi * albedo**2 * radius**2 * np.cos(tau) ** 2
    part = mean**2 * np.cos(4.0 * chi)
    co = np.asarray(level * (1.0 + part))
    return PairReturn(co, co, np.asarray(level * (1.0 - part)))


def pair_sum(
    point: F64, normal: F64, area: F64, albedo: F64, to_radar: F64, horizontal: F64, visible: F64
) -> PairReturn:
    r"""Second-order return of Lambertian facets by a sum over all pairs, as seen from far away.

    .. math:: \sigma_{qe} = \tfrac12 \sum_{A, B} |s_{AB}^{qe} + s_{BA}^{qe}|^2, \quad
        |s_{AB}|^2 \propto \frac{16 A_A A_B c_{iA} c_{AB} c_{BA} c_{sB}}{4 \pi r^2} a_A a_B

    with polarisations kept in the four planes of incidence; needs facets small against their distances.

    Parameters
    ----------
    point, normal : (n, 3) m, middles of the facets and unit normals
    area, albedo : (n,) m^2, and sigma0 at normal incidence over 4
    to_radar, horizontal : (3,) unit vectors: to the radar, and of H across it
    visible : (n, n) 1 where two facets see each other, else 0; all are seen by the radar
    """
    across = point[None] - point[:, None]
    r2 = np.square(across).sum(axis=2) + np.eye(len(point))
    s = across / np.sqrt(r2)[..., None]
    leaves = np.einsum("abi,ai->ab", s, normal)  # at A, towards B
    lands = -np.einsum("abi,bi->ab", s, normal)  # at B
    seen = normal @ to_radar
    open_ = (leaves > 0.0) & (lands > 0.0) & (visible > 0.0)
    both = albedo[:, None] * albedo[None] * seen[:, None] * seen[None] * leaves * lands
    power = np.where(open_, 16.0 * both * area[:, None] * area[None] / (4.0 * np.pi * r2), 0.0)
    vertical = np.cross(horizontal, -to_radar)
    s_matrix = np.empty((2, 2, len(point), len(point)))
    for i, e in enumerate((horizontal, vertical)):
        field = _diffuse_field(np.broadcast_to(e, s.shape), -to_radar, normal[:, None], s)
        field = _diffuse_field(field, s, normal[None], to_radar)
        for j, q in enumerate((horizontal, vertical)):
            s_matrix[i, j] = field @ q
    total = s_matrix + s_matrix.swapaxes(2, 3)
    sigma = 0.5 * np.einsum("ijab,ab->ij", np.square(total), power)
    return PairReturn(*(np.array(x) for x in (sigma[0, 0], sigma[1, 1], 0.5 * (sigma[0, 1] + sigma[1, 0]))))


def _diffuse_field(field: F64, d: F64, normal: F64, s: F64) -> F64:
    """Field incident along d and scattered along s, with its components kept in both planes of incidence."""
    h_i, h_s = _unit(np.cross(d, normal)), _unit(np.cross(normal, s))
    v_i, v_s = np.cross(h_i, d), np.cross(h_s, -s)
    along_h = np.einsum("...i,...i->...", field, h_i)[..., None]
    along_v = np.einsum("...i,...i->...", field, v_i)[..., None]
    return np.asarray(along_h * h_s + along_v * v_s)


def _unit(v: F64) -> F64:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12))
