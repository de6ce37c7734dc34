r"""Radar cross sections of canonical PEC targets in closed form (physical and geometrical optics).

Amplitudes are sqrt(sigma) in metres with the sign and phase that the tracer uses: a plate at normal
incidence with its phase centre at the reference point is real and positive.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import j1, struve

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.truth.theory.half_space import fresnel


def _sinc(x: ArrayLike) -> F64:
    return np.asarray(np.sinc(np.asarray(x, dtype=np.float64) / np.pi))


def plate_amplitude(
    width: float, height: float, wavelength: float, sin_u: ArrayLike, sin_v: ArrayLike = 0.0
) -> F64:
    r"""Return sqrt(sigma) of a rectangular plate by physical optics, m, phase centre at its middle.

    .. math:: \sqrt\sigma = \frac{2\sqrt\pi}{\lambda} a b \cos\theta\, \mathrm{sinc}(k a u)\, \mathrm{sinc}(k
    b v)

    Parameters
    ----------
    width, height : a along u and b along v, m
    wavelength : m
    sin_u, sin_v : components of the unit look direction along the plate's edges, broadcast

    Notes
    -----
    Ignores edge diffraction, hence polarisation; good to 0.1 dB in the main lobe for sides above 5
    wavelengths.

    References
    ----------
    Ruck et al., Radar Cross Section Handbook (1970); Skolnik, Radar Handbook, 3rd ed.
    """
    u, v = np.asarray(sin_u, dtype=np.float64), np.asarray(sin_v, dtype=np.float64)
    k = 2.0 * np.pi / wavelength
    cos_theta = np.sqrt(np.maximum(0.0, 1.0 - u * u - v * v))
    area = 2.0 * np.sqrt(np.pi) / wavelength * width * height
    return np.asarray(area * cos_theta * _sinc(k * width * u) * _sinc(k * height * v))


def plate_rcs(width: float, height: float, wavelength: float, angle: ArrayLike) -> F64:
    """Return the RCS of a rectangular plate, m^2, tilted by ``angle``, rad, across its ``width``."""
    return plate_amplitude(width, height, wavelength, np.sin(np.asarray(angle, dtype=np.float64))) ** 2


def disc_rcs(radius: float, wavelength: float, angle: ArrayLike) -> F64:
    r"""Return the RCS of a circular disc by physical optics, m^2.

    .. math:: \sigma = \frac{4\pi}{\lambda^2} (\pi r^2 \cos\theta)^2 \left(\frac{2 J_1(x)}{x}\right)^2, \quad
        x = 2 k r \sin\theta

    Parameters
    ----------
    angle : off the normal, rad

    Notes
    -----
    Ignores edge diffraction.

    References
    ----------
    Ruck et al., Radar Cross Section Handbook (1970).
    """
    theta = np.asarray(angle, dtype=np.float64)
    x = 4.0 * np.pi / wavelength * radius * np.sin(theta)
    small = np.abs(x) < 1e-6
    airy = np.where(small, 1.0 - x * x / 8.0, 2.0 * j1(x) / np.where(small, 1.0, x))
    return np.asarray(4.0 * np.pi / wavelength**2 * (np.pi * radius**2 * np.cos(theta) * airy) ** 2)


def cylinder_rcs(
    radius: float, height: float, wavelength: float, angle: ArrayLike = 0.0, exact: bool = False
) -> F64:
    r"""Return the RCS of the side of a circular cylinder, m^2, ``angle`` rad off broadside.

    .. math::
        \sigma = \frac{2\pi r h^2}{\lambda} \cos\psi\, \mathrm{sinc}^2(k h \sin\psi) \quad \text{(stationary
        phase)}

    With ``exact`` the physical-optics integral around the lit half is complete, which adds the false
    return of the shadow boundary: the factor ``k r cos(psi) pi`` becomes
    ``|k r (2 - pi H_1(z) + j pi J_1(z))|^2`` with ``z = 2 k r cos(psi)`` and the Struve function ``H_1``.

    Notes
    -----
    Ignores the end caps and creeping waves.

    References
    ----------
    Skolnik, Radar Handbook, 3rd ed. (broadside); Ruck et al. (1970).
    """
    psi = np.asarray(angle, dtype=np.float64)
    k = 2.0 * np.pi / wavelength
    pattern = height * _sinc(k * height * np.sin(psi))
    if not exact:
        return np.asarray(2.0 * np.pi * radius * np.cos(psi) / wavelength * pattern**2)
    z = 2.0 * k * radius * np.cos(psi)
    around = (2.0 - np.pi * struve(1, z)) + 1j * np.pi * j1(z)
    amplitude = 2.0 * np.sqrt(np.pi) / wavelength * radius * np.cos(psi) * np.abs(around) * pattern
    return np.asarray(amplitude**2)


@dataclass(frozen=True, eq=False)
class DihedralAmplitudes:
    """Sqrt(sigma) of a 90-degree dihedral, m, phase about the corner line, one value per azimuth.

    Parameters
    ----------
    single : both faces as plates
    double : the two double bounces together, without sign
    parallel, perpendicular : total for the electric field along and across the corner line
    """

    single: C128
    double: F64
    parallel: C128
    perpendicular: C128


def dihedral(
    first_width: float, second_width: float, length: float, wavelength: float, azimuth: ArrayLike
) -> DihedralAmplitudes:
    r"""Return single and double bounces of a dihedral, added coherently, across its corner line.

    .. math::
        E_1 = \frac{2\sqrt\pi}{\lambda} b\,[a_1 \cos\phi\, \mathrm{sinc}(k a_1 \sin\phi)\, e^{j k a_1
        \sin\phi} + a_2 \sin\phi\, \mathrm{sinc}(k a_2 \cos\phi)\, e^{j k a_2 \cos\phi}], \quad
        E_2 = \frac{2\sqrt\pi}{\lambda} 2 b \min(a_1 \sin\phi', a_2 \cos\phi')

    and the total ``E_1 + E_2`` for the field across the corner line, ``E_1 - E_2`` along it.

    Parameters
    ----------
    first_width, second_width : of the faces away from the corner line, a_1 and a_2, m
    length : of the corner line, b, m
    azimuth : phi between the look direction (towards the antenna) and the normal of the first face, rad, 0
    to pi/2

    Notes
    -----
    Ignores edge diffraction, and diffraction of the first bounce (geometrical optics between the faces).

    References
    ----------
    Griesser and Balanis, IEEE Trans. Antennas Propag. 35 (10) 1987 (physical optics with geometrical optics
    first bounce); peak 8 pi a^2 b^2 / lambda^2: Skolnik, Radar Handbook.
    """
    phi = np.asarray(azimuth, dtype=np.float64)
    s, c = np.sin(phi), np.cos(phi)
    k = 2.0 * np.pi / wavelength
    scale = 2.0 * np.sqrt(np.pi) / wavelength * length
    single = scale * (
        first_width * c * _sinc(k * first_width * s) * np.exp(1j * k * first_width * s)
        + second_width * s * _sinc(k * second_width * c) * np.exp(1j * k * second_width * c)
    )
    # seen from the antenna, the first face is a_1 cos wide and the mirrored second one a_2 sin
    double = scale * 2.0 * np.minimum(first_width * c, second_width * s)
    return DihedralAmplitudes(
        np.asarray(single), np.asarray(double), np.asarray(single - double), np.asarray(single + double)
    )


def rolled_dihedral(amplitude: float, roll: ArrayLike) -> C128:
    r"""Return the (..., 2, 2) scattering matrix in (h, v) of a dihedral rolled about the line of sight.

    .. math:: S = \sqrt\sigma \begin{pmatrix} -\cos 2\tau & -\sin 2\tau \\ -\sin 2\tau & \cos 2\tau
    \end{pmatrix}

    Parameters
    ----------
    amplitude : sqrt(sigma) of the double bounce, m
    roll : tau, rad; 0 with the corner line along h

    Notes
    -----
    Ignores single bounces (on axis they vanish as sinc of many wavelengths). The sign is that of
    ``dihedral``: minus for the field along the corner line. Backscatter alignment: the same h and v for
    transmit and receive.

    References
    ----------
    Lee and Pottier, Polarimetric Radar Imaging (2009).
    """
    tau = np.asarray(roll, dtype=np.float64)
    c, s = np.cos(2.0 * tau), np.sin(2.0 * tau)
    rows = np.stack([np.stack([-c, -s], axis=-1), np.stack([-s, c], axis=-1)], axis=-2)
    return np.asarray(amplitude * rows, dtype=np.complex128)


def trihedral_rcs(
    edge: float,
    wavelength: float,
    direction: ArrayLike,
    shape: Literal["triangular", "square"] = "triangular",
) -> F64:
    r"""Return the triple-bounce RCS of a trihedral corner reflector by its effective area, m^2.

    .. math:: \sigma = \frac{4\pi}{\lambda^2} A^2

    With sorted direction cosines ``p <= q <= r`` the triangular one has ``A / a^2 = 4 p q / (p + q + r)``
    where ``p + q <= r`` and ``p + q + r - 2 / (p + q + r)`` elsewhere; the square one ``4 p q / r`` where
    ``q <= r / 2`` and ``p (4 - r / q)`` elsewhere.

    Parameters
    ----------
    edge : a, length of the three edges that meet in the corner, m
    wavelength : m
    direction : (..., 3) unit vectors towards the antenna along the edges' axes; negative components give zero

    Notes
    -----
    Ignores single and double bounces and diffraction: near the boresight these are below 1 percent of the
    field for edges above 20 wavelengths; towards the faces they dominate.

    References
    ----------
    Robertson, Bell System Technical Journal 26 (1947); Ruck et al. (1970); peaks
    4 pi a^4 / (3 lambda^2) and 12 pi a^4 / lambda^2: Skolnik, Radar Handbook.
    """
    cosines = np.sort(np.asarray(direction, dtype=np.float64), axis=-1)
    inside = cosines[..., 0] > 0.0
    p, q, r = np.moveaxis(np.where(inside[..., None], cosines, 1.0), -1, 0)
    if shape == "square":
        area = np.where(2.0 * q <= r, 4.0 * p * q / r, p * (4.0 - r / q))
    else:
        total = p + q + r
        area = np.where(p + q <= r, 4.0 * p * q / total, total - 2.0 / total)
    area = np.where(inside, area * edge**2, 0.0)
    return np.asarray(4.0 * np.pi / wavelength**2 * area**2)


def coherent_loss(rms_height: float, wavelength: float, incidence_angle: ArrayLike) -> F64:
    r"""Return the power factor of the coherent reflection of a rough surface.

    .. math:: e^{-4 (k s \cos\theta)^2}

    Notes
    -----
    Ignores slopes and shadowing: Gaussian heights, tangent planes. Ament, Proc. IRE 41 (1953).
    """
    phase = 2.0 * np.pi / wavelength * rms_height * np.cos(np.asarray(incidence_angle, dtype=np.float64))
    return np.asarray(np.exp(-4.0 * phase**2))


def wall_ground_amplitude(
    wall_height: float,
    wall_length: float,
    ground_width: float,
    wavelength: float,
    incidence_angle: ArrayLike,
    wall_permittivity: complex | None = None,
    ground_permittivity: complex | None = None,
    ground_rms_height: float = 0.0,
) -> tuple[C128, C128]:
    r"""Return sqrt(sigma) for HH and VV of the double bounce between a wall and flat ground, broadside, m.

    .. math::
        \sqrt{\sigma_{pp}} = \frac{2\sqrt\pi}{\lambda} 2 b \min(h \sin\theta, g \cos\theta)
        S_p R_w^p(\pi/2 - \theta) R_g^p(\theta)\, e^{-2 (k s \cos\theta)^2},
        \quad S_h = -1, \; S_v = 1

    with TE coefficients for HH and TM (positive for a conductor) for VV.

    Parameters
    ----------
    wall_height, wall_length, ground_width : h, b, g, m
    incidence_angle : theta on the ground, rad
    wall_permittivity, ground_permittivity : relative; None is a perfect conductor
    ground_rms_height : s, m

    Notes
    -----
    Ignores single bounces, diffraction, and the wall's roughness. For dielectrics the closing surface
    radiates as both equivalent currents of the reflected wave do towards the specular direction.

    References
    ----------
    The dihedral of ``dihedral`` with unequal faces, times the Fresnel coefficients of both bounces.
    """
    theta = np.asarray(incidence_angle, dtype=np.float64)
    s, c = np.sin(theta), np.cos(theta)
    aperture = 2.0 * wall_length * np.minimum(wall_height * s, ground_width * c)
    loss = np.sqrt(coherent_loss(ground_rms_height, wavelength, theta))
    scale = 2.0 * np.sqrt(np.pi) / wavelength * aperture * loss
    te = tm = np.ones_like(theta, dtype=np.complex128)
    for cosine, eps in ((s, wall_permittivity), (c, ground_permittivity)):
        r_te, r_tm = (-1.0, 1.0) if eps is None else fresnel(cosine, eps)
        te, tm = te * r_te, tm * r_tm
    return np.asarray(-scale * te), np.asarray(scale * tm)
