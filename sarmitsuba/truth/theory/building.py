"""A smooth wall on rough ground: Franceschetti's canonical building in its Kirchhoff limits."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import gammaln

from sarmitsuba.truth.theory.half_space import fresnel

GroundModel = Literal["geometrical_optics", "physical_optics"]


@dataclass(frozen=True)
class BuildingRcs:
    """Mean radar cross section of the contributions of wall and ground, m^2, for one polarisation.

    Parameters
    ----------
    ground : sigma0 of the open ground (dimensionless)
    double : wall-ground and ground-wall, incoherent part
    double_coherent : the same, specular (coherent) part; only for a wall parallel to the track
    triple : wall-ground-wall
    """

    ground: float
    double: float
    double_coherent: float
    triple: float


def kirchhoff_sigma0(
    incidence_angle: float,
    azimuth: float,
    wavelength: float,
    rms_height: float,
    correlation_length: float,
    reflectivity: float,
    model: GroundModel,
) -> float:
    r"""Return the bistatic sigma0 of ground with Gaussian heights for equal incidence and scattering angles.

    .. math::
        \sigma^0 = |R|^2 \frac{|q|^4}{4\pi q_z^2} \int (e^{-q_z^2 s^2 (1 - \rho)} - e^{-q_z^2 s^2})
        e^{j q_h \cdot r}\, d^2r, \quad \rho = e^{-r^2/l^2}

    ``physical_optics`` sums its series; ``geometrical_optics`` is the stationary-phase limit for large ``q_z
    s``, ``|R|^2 |q|^4 / (2 m^2 q_z^4) exp(-q_h^2 / (2 m^2 q_z^2))`` with ``m = sqrt(2) s / l``.

    Parameters
    ----------
    incidence_angle : theta of both directions, rad
    azimuth : half the turn from the specular direction, rad: 0 is specular, pi/2 backscatter;
        ``q_h = 2 k sin(theta) sin(azimuth)``
    reflectivity : |R|^2 at the local angle of the stationary point

    Notes
    -----
    Ignores polarisation mixing off the plane of incidence, shadowing and multiple scattering.

    References
    ----------
    Barrick, IEEE Trans. Antennas Propag. 16 (4) 1968 (geometrical optics); Beckmann and Spizzichino, The
    Scattering of Electromagnetic Waves from Rough Surfaces (1963) (series).
    """
    k = 2.0 * np.pi / wavelength
    q_z = 2.0 * k * np.cos(incidence_angle)
    q_h = 2.0 * k * np.sin(incidence_angle) * np.sin(azimuth)
    q_4 = (q_z * q_z + q_h * q_h) ** 2
    if model == "geometrical_optics":
        m2 = 2.0 * (rms_height / correlation_length) ** 2
        return float(reflectivity * q_4 / (2.0 * m2 * q_z**4) * np.exp(-(q_h**2) / (2.0 * m2 * q_z**2)))
    x = (q_z * rms_height) ** 2
    n = np.arange(1, int(x + 12.0 * np.sqrt(x)) + 30, dtype=np.float64)
    weight = np.exp(n * np.log(x) - gammaln(n + 1.0) - x)
    transform = np.pi * correlation_length**2 / n * np.exp(-((q_h * correlation_length) ** 2) / (4.0 * n))
    return float(reflectivity * q_4 / (4.0 * np.pi * q_z**2) * np.sum(weight * transform))


def canonical_building(
    wall_height: float,
    wall_length: float,
    incidence_angle: float,
    wavelength: float,
    rms_height: float,
    correlation_length: float,
    wall_permittivity: complex | None,
    ground_permittivity: complex | None,
    polarisation: Literal["hh", "vv"] = "hh",
    wall_azimuth: float = 0.0,
    model: GroundModel = "geometrical_optics",
) -> BuildingRcs:
    r"""Return single, double and triple contributions of a smooth wall standing on rough ground.

    The wall reflects by geometrical optics, the ground scatters by the Kirchhoff model. The wall reflects the
    illumination onto the area ``h l tan(theta) cos(phi)`` of the ground; the double bounce is the scattering of
    that area towards the antenna's mirror image, and its reversed path arrives in phase, hence the factor four in
    power; the triple bounce is backscatter of that area with two wall reflections.

    .. math::
        \sigma_2 = 4 |R_w|^2 \sigma^0(\theta, \phi)\, h\, l \tan\theta \cos\phi, \quad
        \sigma_3 = |R_w|^4 \sigma^0_{back}(\theta)\, h\, l \tan\theta \cos\phi

    Parameters
    ----------
    wall_height, wall_length : h, l, m
    incidence_angle : theta on the ground, rad
    wavelength, rms_height, correlation_length : m; Gaussian heights and correlation
    wall_permittivity, ground_permittivity : relative; None is a perfect conductor
    wall_azimuth : phi between the wall's normal and the horizontal look direction, rad
    model : ``geometrical_optics`` (very rough ground) or ``physical_optics`` (slightly rough)

    Notes
    -----
    Ignores the wall's edges, polarisation mixing for an oblique wall, shadowing by roughness, and the wall's
    own single bounce, which a smooth vertical wall sends away from the antenna.

    References
    ----------
    Franceschetti, Iodice and Riccio, A canonical problem in electromagnetic backscattering from buildings,
    IEEE TGRS 40 (8) 2002: the same set of contributions; the Kirchhoff factors here are those of
    ``kirchhoff_sigma0``.
    """
    k = 2.0 * np.pi / wavelength
    s, c = np.sin(incidence_angle), np.cos(incidence_angle)
    select = 0 if polarisation == "hh" else 1

    def power(cosine: float, permittivity: complex | None) -> float:
        if permittivity is None:
            return 1.0
        return float(np.abs(fresnel(cosine, permittivity)[select]) ** 2)

    # the stationary facet of the double bounce bisects the angle between the two rays: cos = |q| / (2 k)
    local_cosine = float(np.sqrt(c * c + (s * np.sin(wall_azimuth)) ** 2))
    wall = power(float(s * np.cos(wall_azimuth)), wall_permittivity)
    area = wall_height * wall_length * s / c * np.cos(wall_azimuth)

    def ground(azimuth: float, cosine: float) -> float:
        return kirchhoff_sigma0(
            incidence_angle,
            azimuth,
            wavelength,
            rms_height,
            correlation_length,
            power(cosine, ground_permittivity),
            model,
        )

    back = ground(np.pi / 2.0, 1.0)
    coherent = 0.0
    if wall_azimuth == 0.0:
        aperture = 2.0 * wall_length * wall_height * s
        loss = np.exp(-4.0 * (k * rms_height * c) ** 2)
        coherent = (
            4.0 * np.pi / wavelength**2 * aperture**2 * wall * power(float(c), ground_permittivity) * loss
        )
    return BuildingRcs(
        ground=back,
        double=float(4.0 * wall * ground(wall_azimuth, local_cosine) * area),
        double_coherent=float(coherent),
        triple=float(wall**2 * back * area),
    )
