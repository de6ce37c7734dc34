r"""Vegetation in closed form: a cloud of scatterers over ground, plant matter, simple scatterers, paths in volumes.

Extinction is of power: a wave loses :math:`1 - e^{-\kappa s}` of it on a path s. Time convention exp(+j w t).
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import hankel2, jv

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.truth.theory.half_space import fresnel


def layer_transmission(kappa: ArrayLike, depth: ArrayLike, theta: ArrayLike) -> F64:
    r"""Share of the power that crosses a layer twice, down and up, :math:`e^{-2 \kappa d / \cos\theta}`.

    Parameters
    ----------
    kappa : 1/m, extinction
    depth : m
    theta : rad, incidence angle
    """
    return np.asarray(np.exp(-2.0 * np.asarray(kappa) * np.asarray(depth) / np.cos(theta)))


def water_cloud_sigma0(
    sigma_v: ArrayLike, kappa: ArrayLike, depth: ArrayLike, theta: ArrayLike, ground: ArrayLike = 0.0
) -> F64:
    r"""Backscatter coefficient of a level layer of scatterers over ground.

    .. math::
        \sigma^0 = \frac{\sigma_v \cos\theta}{2 \kappa} \left(1 - e^{-2 \kappa d / \cos\theta}\right)
            + \sigma^0_g e^{-2 \kappa d / \cos\theta}

    Parameters
    ----------
    sigma_v : m^2/m^3, radar cross section per volume
    kappa : 1/m, extinction; 0 gives the limit ``sigma_v d``
    depth : m
    theta : rad, incidence angle
    ground : sigma0 of the bare ground

    Notes
    -----
    Ignores multiple scattering, legs over ground and scatterer, and edges of the layer.

    References
    ----------
    Attema & Ulaby 1978, Vegetation modeled as a water cloud, Radio Science 13, equation 6.
    """
    optical = 2.0 * np.asarray(kappa, dtype=np.float64) * np.asarray(depth) / np.cos(theta)
    # (1 - exp(-x)) / x without 0 / 0
    mean = np.where(optical > 1e-12, -np.expm1(-optical) / np.where(optical > 1e-12, optical, 1.0), 1.0)
    return np.asarray(np.asarray(sigma_v) * np.asarray(depth) * mean + np.asarray(ground) * np.exp(-optical))


def plant_permittivity(moisture: ArrayLike, frequency: ArrayLike) -> C128:
    r"""Relative permittivity of leaves and stalks from their water: free, with ions, and bound to sugars.

    .. math::
        \epsilon = \epsilon_r + v_f \left(4.9 + \frac{75}{1 + j f / 18} - j \frac{18 \cdot 1.27}{f}\right)
            + v_b \left(2.9 + \frac{55}{1 + \sqrt{j f / 0.18}}\right)

    with f in GHz, :math:`\epsilon_r = 1.7 - 0.74 m + 6.16 m^2`, :math:`v_f = m (0.55 m - 0.076)`,
    :math:`v_b = 4.64 m^2 / (1 + 7.36 m^2)`.

    Parameters
    ----------
    moisture : gravimetric, mass of water over all mass, 0 to 0.7
    frequency : Hz

    References
    ----------
    Ulaby & El-Rayes 1987, Microwave dielectric spectrum of vegetation, part II: dual-dispersion model, IEEE TGRS
    GE-25, equations 6, 14 to 16; 22 degrees Celsius.
    """
    m, f = np.asarray(moisture, dtype=np.float64), np.asarray(frequency, dtype=np.float64) / 1e9
    free = np.maximum(m * (0.55 * m - 0.076), 0.0)
    bound = 4.64 * m**2 / (1.0 + 7.36 * m**2)
    # real and imaginary parts written out
    debye = 75.0 / (1.0 + (f / 18.0) ** 2)
    root = np.sqrt(f / 0.36)  # of f / 0.18 times cos 45 degrees
    cole = 55.0 / ((1.0 + root) ** 2 + root**2)
    real = 1.7 - 0.74 * m + 6.16 * m**2 + free * (4.9 + debye) + bound * (2.9 + cole * (1.0 + root))
    loss = free * (debye * f / 18.0 + 22.86 / f) + bound * cole * root
    return np.asarray(real - 1j * loss)


def isotropic_orientation(across: complex, along: complex) -> tuple[float, float, complex]:
    r"""Mean polarimetric powers of small uniaxial scatterers of isotropic orientation.

    With :math:`\Delta` the difference of the amplitudes along and across the axis, the means over the sphere,
    :math:`\langle n_h^2 \rangle = 1/3, \langle n_h^4 \rangle = 1/5, \langle n_h^2 n_v^2 \rangle = 1/15`, give

    .. math::
        \langle |hh|^2 \rangle = |a|^2 + \tfrac23 \Re(a^* \Delta) + \tfrac15 |\Delta|^2, \quad
        \langle |hv|^2 \rangle = \tfrac1{15} |\Delta|^2

    Returns
    -------
    hh, hv : mean powers (vv as hh)
    hhvv : mean of hh times the conjugate of vv
    """
    delta = along - across
    common = abs(across) ** 2 + 2.0 / 3.0 * (across.conjugate() * delta).real
    return (
        common + abs(delta) ** 2 / 5.0,
        abs(delta) ** 2 / 15.0,
        complex(common + abs(delta) ** 2 / 15.0),
    )


def isotropic_between(across: complex, along: complex, cosine: float) -> float:
    r"""Mean power of small uniaxial scatterers of isotropic orientation between two polarisations.

    With :math:`\langle (\mathbf q \cdot \mathbf n)^2 (\mathbf e \cdot \mathbf n)^2 \rangle = (1 + 2 c^2) / 15`,

    .. math:: \langle |\mathbf q \cdot A \mathbf e|^2 \rangle
        = \left(|a|^2 + \tfrac23 \Re(a^* \Delta)\right) c^2 + \tfrac1{15} |\Delta|^2 (1 + 2 c^2)

    Parameters
    ----------
    across, along : amplitudes across and along the axis
    cosine : c, of the angle between sent and received polarisation
    """
    delta = along - across
    common = abs(across) ** 2 + 2.0 / 3.0 * (across.conjugate() * delta).real
    return float(common * cosine**2 + abs(delta) ** 2 * (1.0 + 2.0 * cosine**2) / 15.0)


def crown_ground_sigma0(
    sigma_v: ArrayLike, kappa: ArrayLike, depth: ArrayLike, theta: ArrayLike, reflection: complex | ArrayLike
) -> tuple[F64, F64]:
    r"""Backscatter coefficients of a layer over level smooth ground: with one ground reflection, and with two.

    Every scatterer's leg over the ground crosses the layer down and up in all, wherever it is, and both ways round add
    in phase:

    .. math::
        \sigma^0_1 = 4 \sigma_v d |\Gamma|^2 e^{-2 \kappa d / \cos\theta}, \quad
        \sigma^0_2 = \frac{\sigma_v \cos\theta}{2 \kappa} |\Gamma|^4 e^{-2 \kappa d / \cos\theta}
            \left(1 - e^{-2 \kappa d / \cos\theta}\right)

    Parameters
    ----------
    sigma_v : m^2/m^3, of the legs over the ground
    kappa, depth, theta : as for the water cloud
    reflection : Fresnel coefficient of the ground

    References
    ----------
    Ulaby, Sarabandi et al. 1990, Michigan microwave canopy scattering model, Int. J. Remote Sensing 11, its terms of
    crown-ground and ground-crown-ground.
    """
    strength = np.abs(reflection) ** 2
    once = 4.0 * np.asarray(sigma_v) * np.asarray(depth) * strength * layer_transmission(kappa, depth, theta)
    twice = (
        water_cloud_sigma0(sigma_v, kappa, depth, theta)
        * strength**2
        * layer_transmission(kappa, depth, theta)
    )
    return np.asarray(once), np.asarray(twice)


def sphere_cloud(
    radius: float, permittivity: complex, density: float, wavelength: float
) -> tuple[float, float]:
    r"""Radar cross section per volume and extinction of a cloud of small spheres.

    .. math::
        \sigma_v = 4 \pi N k^4 a^6 |K|^2, \quad
        \kappa = N \left(4 \pi k a^3 |\Im K| + \tfrac{8 \pi}3 k^4 a^6 |K|^2\right), \quad
        K = \frac{\epsilon - 1}{\epsilon + 2}

    Parameters
    ----------
    radius, wavelength : m
    density : 1/m^3

    References
    ----------
    Ulaby, Moore & Fung 1981, Microwave Remote Sensing I, equations 5.73 to 5.76.
    """
    k = 2.0 * np.pi / wavelength
    factor = (permittivity - 1.0) / (permittivity + 2.0)
    power = k**4 * radius**6 * abs(factor) ** 2
    absorbed = 4.0 * np.pi * k * radius**3 * abs(factor.imag)
    return 4.0 * np.pi * density * power, density * (absorbed + 8.0 * np.pi / 3.0 * power)


def cylinder_at_broadside(
    radius: float, permittivity: complex, wavelength: float, angle: ArrayLike
) -> tuple[C128, C128]:
    r"""Echo width amplitudes of an endless dielectric cylinder, wave across its axis.

    .. math::
        T = \sum_n c_n e^{j n \phi}, \quad
        c_n = \frac{J_n(\xi) J_n'(\eta) p - J_n'(\xi) J_n(\eta)}
            {J_n'(\eta) H_n^{(2)}(\xi) p - J_n(\eta) H_n^{(2)\prime}(\xi)}

    with :math:`\xi = k a, \eta = \xi \sqrt\epsilon`, p = :math:`\sqrt\epsilon` for E along the axis and its inverse
    for H along it; the echo width is :math:`(4 / k) |T|^2` and the extinction per length :math:`(4 / k) \Re T(0)`.

    Parameters
    ----------
    radius, wavelength : m
    angle : rad, turn of the scattered wave; 0 forward, pi back

    Returns
    -------
    along, across : T for E along and across the axis

    References
    ----------
    Balanis 1989, Advanced Engineering Electromagnetics, section 11.5.3.
    """
    xi = 2.0 * np.pi * radius / wavelength
    m = np.sqrt(complex(permittivity))
    eta = xi * m
    n = np.arange(-int(xi + 4.0 * np.cbrt(xi) + 8.0), int(xi + 4.0 * np.cbrt(xi) + 8.0) + 1)

    def slope(values: C128) -> C128:
        """Derivative from the two neighbouring orders."""
        return np.asarray(0.5 * (values[:-2] - values[2:]))

    orders = np.arange(n[0] - 1, n[-1] + 2)
    j_out, j_in, h = jv(orders, xi).astype(complex), jv(orders, eta), hankel2(orders, xi)
    turn = np.exp(1j * np.multiply.outer(np.asarray(angle, dtype=np.float64), n))
    found = []
    for p in (m, 1.0 / m):
        top = j_out[1:-1] * slope(j_in) * p - slope(j_out) * j_in[1:-1]
        bottom = slope(j_in) * h[1:-1] * p - j_in[1:-1] * slope(h)
        found.append(np.asarray(turn @ (top / bottom)))
    return found[0], found[1]


def trunk_ground_rcs(
    radius: float,
    height: float,
    wavelength: float,
    theta: ArrayLike,
    trunk: complex,
    ground: complex,
) -> tuple[F64, F64]:
    r"""Radar cross sections HH and VV of the double bounce of an upright dielectric cylinder on dielectric ground.

    A wave that comes at :math:`\theta` from the vertical meets the lit line of the cylinder at
    :math:`\pi/2 - \theta` from its normal. Physical optics gives the cone of reflection the bistatic cross section
    :math:`k a h^2 \sin\theta |\Gamma_t|^2`; ground first and trunk first add in phase, 6 dB more:

    .. math:: \sigma = 4 k a h^2 \sin\theta \, |\Gamma_t(\pi/2 - \theta) \Gamma_g(\theta)|^2

    Parameters
    ----------
    radius, height, wavelength : m
    theta : rad, from the vertical
    trunk, ground : relative permittivities

    Notes
    -----
    Ignores that for ``k a < 10`` physical optics itself is off by a decibel, that the trunk's shade on the ground hides
    what lies behind it, and spreading.

    References
    ----------
    Ruck et al. 1970, Radar Cross Section Handbook, 4.3-62 (broadside cylinder) with the image in the ground.
    """
    theta = np.asarray(theta, dtype=np.float64)
    at_trunk, at_ground = fresnel(np.sin(theta), trunk), fresnel(np.cos(theta), ground)
    size = 4.0 * (2.0 * np.pi / wavelength) * radius * height**2 * np.sin(theta)
    # H is across the plane of incidence at both, V within it
    hh, vv = (size * np.abs(t * g) ** 2 for t, g in zip(at_trunk, at_ground, strict=True))
    return np.asarray(hh), np.asarray(vv)


def path_in_ball(origin: F64, direction: F64, length: ArrayLike, center: F64, radius: float) -> F64:
    """Length of straight legs within a ball, m.

    Parameters
    ----------
    origin, direction : (..., 3) m and unit vectors
    length : (...,) m, of the ways
    center : (3,) m
    """
    to = center - origin
    along = np.sum(to * direction, axis=-1)
    root = np.sqrt(np.maximum(radius**2 - (np.sum(to * to, axis=-1) - along**2), 0.0))
    return np.asarray(np.clip(along + root, 0.0, length) - np.clip(along - root, 0.0, length))


def path_in_box(origin: F64, direction: F64, length: ArrayLike, low: F64, high: F64) -> F64:
    """Length of straight legs within a box along the axes, m; arguments as for a ball."""
    a, b = (low - origin) / direction, (high - origin) / direction
    enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
    leave = np.maximum(leave, enter)
    return np.asarray(np.clip(leave, 0.0, length) - np.clip(enter, 0.0, length))


def thin_rod(
    angle: float, radius: float, length: float, permittivity: complex, wavelength: float, segments: int = 0
) -> tuple[tuple[float, float], tuple[complex, complex]]:
    r"""Extinction cross sections (m^2) and backscatter amplitudes S (m) of a thin dielectric rod, parallel and across.

    Volume integral equation of the polarisation in equal segments of the axis, even over the cross-section, each tested
    by itself: along, and across, the axis

    .. math:: e - (\epsilon - 1) (k^2 + \partial_z^2) \bar G * e = e_{inc}, \quad
        e - \tfrac12 (\epsilon - 1) [(k^2 - \partial_z^2) \bar G * e - e] = e_{inc}

    with the Green function's mean over two discs of the cross-section, by the distribution of the distance r of two
    points of a disc, :math:`4 r / (\pi a^2) (\arccos\rho - \rho \sqrt{1 - \rho^2}), \rho = r / 2a`. What currents that
    circle in the magnetic field absorb is added: :math:`k \epsilon'' V (k a)^2` times 1/4 (parallel) and
    :math:`\sin^2\beta / 8 + \cos^2\beta / 4` (across).

    Parameters
    ----------
    angle : rad, between wave and axis
    radius, length, wavelength : m
    permittivity : relative, eps' - j eps''
    segments : 0: of a radius or a fortieth of a wavelength, 30 to 300

    Notes
    -----
    Ignores higher orders of ``k a sqrt(eps)``: to 0.1 dB up to 0.5.
    """
    k, chi, area = 2.0 * np.pi / wavelength, permittivity - 1.0, np.pi * radius**2
    n = segments or int(np.clip(np.ceil(length / min(radius, wavelength / 40.0)), 30, 300))
    step = length / n
    node, weight = np.polynomial.legendre.leggauss(60)
    rho = 0.5 * (1.0 + node)
    share = weight * rho * (np.arccos(rho) - rho * np.sqrt(1.0 - rho**2))
    share /= share.sum()

    def green(s: F64) -> C128:
        distance = np.sqrt(np.square(s)[..., None] + np.square(2.0 * radius * rho))
        return np.asarray((share * np.exp(-1j * k * distance) / (4.0 * np.pi * distance)).sum(axis=-1))

    apart: F64 = np.asarray(step * np.arange(n + 1), dtype=np.float64)
    at = green(apart)
    bend = (np.concatenate([at[1:2], at[: n - 1]]) + at[1:] - 2.0 * at[:-1]) / step
    node, weight = np.polynomial.legendre.leggauss(12)
    mean = np.zeros(n, dtype=np.complex128)
    for x, w in zip(0.5 * (node + 1.0), 0.5 * weight, strict=True):
        mean += w * (1.0 - x) * step * (green(apart[:-1] + x * step) + green(np.abs(apart[:-1] - x * step)))
    pick = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    along = area * (k * k * mean + bend)[pick]
    across = 0.5 * (area * (k * k * mean - bend)[pick] - np.eye(n))
    wave = np.exp(-1j * k * np.cos(angle) * ((np.arange(n) + 0.5) * step - 0.5 * length))
    forward, back = [], []
    for operator in (along, across):
        e = np.linalg.solve(np.eye(n) - chi * operator, wave)
        forward.append(complex((e * np.conj(wave)).mean()))
        back.append(complex((e * wave).mean()))
    s2, c2, volume = np.sin(angle) ** 2, np.cos(angle) ** 2, area * length
    circling = -k * volume * permittivity.imag * (k * radius) ** 2
    gain = k**2 / np.sqrt(4.0 * np.pi) * volume * chi
    return (
        (
            -k * volume * (chi * (s2 * forward[0] + c2 * forward[1])).imag + 0.25 * circling,
            -k * volume * (chi * forward[1]).imag + circling * (s2 / 8.0 + c2 / 4.0),
        ),
        (gain * (s2 * back[0] + c2 * back[1]), gain * back[1]),
    )
