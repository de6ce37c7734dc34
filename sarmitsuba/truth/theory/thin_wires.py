r"""Round wires, rails and posts in closed form: infinite circular cylinder, finite line, post on a half space.

Amplitudes are sqrt(sigma) in metres with the sign and phase of :mod:`sarmitsuba.truth.theory.canonical_rcs`: a plate
at normal incidence is real and positive, and a wave scattered with amplitude S is :math:`-j S e^{-j k r} / (\sqrt{4
\pi} r)` times the incoming one. Time convention exp(+j w t). Every order of the series is matched at the cylinder's
surface by a linear system, nothing is expanded: the package's coefficients are written otherwise (``materials``,
``trace``).
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_toeplitz
from scipy.special import h2vp, hankel2, jv, jvp

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.truth.theory.half_space import fresnel

EULER = 1.7810724179901979  # exp of Euler's constant


def cylinder_series(
    ka: float, tilt: float, azimuth: ArrayLike, permittivity: complex | None = None
) -> tuple[C128, C128, C128]:
    r"""Return the far-field series of an infinite circular cylinder: TM to TM, TE to TE and TE to TM.

    .. math:: T = -\sum_n a_n e^{j n \phi}, \qquad
        E_z^s = \sqrt{\frac{2 j}{\pi \kappa \rho}} e^{-j \kappa \rho} \sum_n a_n e^{j n \phi} E_z^i, \qquad
        \kappa = k \cos\psi

    with :math:`a_n` from the continuity of the fields along the surface, order by order; the conductor has
    :math:`-J_n / H_n^{(2)}` (TM: electric field in the plane of axis and ray) and the ratio of the derivatives (TE).

    Parameters
    ----------
    ka : circumference over wavelength
    tilt : psi, rad, of the ray off the plane across the axis, positive along the axis
    azimuth : phi, rad, about the axis from the ray's direction to the scattered one's, any shape
    permittivity : relative, eps' - j eps''; None is a perfect conductor

    Returns
    -------
    three arrays of the shape of ``azimuth``; TM to TE is the last with the other sign

    References
    ----------
    Wait, Can. J. Phys. 33 (1955): oblique incidence; Ruck et al., Radar Cross Section Handbook (1970), chapter 4.
    """
    phi = np.asarray(azimuth, dtype=np.float64)
    x, beta = ka * float(np.cos(tilt)), float(np.sin(tilt))
    last = int(x + 5.0 * x ** (1.0 / 3.0)) + 6
    tm, te, cross = (np.zeros(phi.shape, dtype=np.complex128) for _ in range(3))
    for n in range(-last, last + 1):
        wave = np.exp(1j * n * phi)
        if permittivity is None:
            tm += jv(n, x) / hankel2(n, x) * wave
            te += jvp(n, x) / h2vp(n, x) * wave
            continue
        matched = _match_boundary(n, ka, float(np.cos(tilt)), beta, permittivity)
        tm -= matched[0, 0] * wave
        te -= matched[1, 1] * wave
        cross -= matched[0, 1] * wave
    return tm, te, cross


def _match_boundary(n: int, ka: float, cosine: float, beta: float, permittivity: complex) -> C128:
    """Scattered E_z and eta H_z (rows) of order n for incoming ones (columns), (2, 2), in units of J_n and H_n.

    Along the surface E_z, eta H_z, E_phi and eta H_phi go on; for exp(-j beta k z) the latter two are
    ``-(j / q^2) (j n beta / a E_z - d eta H_z / d rho)`` and ``-(j / q^2) (j n beta / a eta H_z + eps d E_z / d rho)``
    with q the transverse wavenumber and all lengths in units of 1 / k.
    """
    inside = np.sqrt(complex(permittivity) - beta * beta)

    def column(q: complex, eps: complex, value: complex, slope: complex) -> C128:
        """Fields E_z, h, E_phi and h_phi (rows) of a wave of E_z and of h (columns)."""
        turn = 1j * n * beta / ka * value / q**2
        return np.array(
            [[value, 0.0], [0.0, value], [turn, -slope / q], [eps * slope / q, turn]], dtype=np.complex128
        )

    x, y = cosine * ka, inside * ka
    # the wave inside in units of its value at the surface
    within = column(inside, permittivity, 1.0, _log_derivative(n, y))
    out = column(cosine, 1.0, 1.0, h2vp(n, x) / hankel2(n, x))
    incident = column(cosine, 1.0, jv(n, x), jvp(n, x))
    solved = np.linalg.solve(np.concatenate([out, -within], axis=1), -incident)
    return np.asarray(solved[:2] / hankel2(n, x))


def _log_derivative(n: int, y: complex) -> complex:
    """J_n'(y) / J_n(y) by Lentz's continued fraction of J_{n+1} / J_n: nothing overflows in a metal."""
    m = abs(n)
    tiny = 1e-290
    fraction = c = complex(tiny)
    d = 0.0 + 0.0j
    for k in range(1, int(abs(y)) + 10_000):
        a, b = (1.0 if k == 1 else -1.0), 2.0 * (m + k) / y
        d = b + a * d
        c = b + a / c
        d = 1.0 / (d if d != 0.0 else tiny)
        fraction *= c * d
        if abs(c * d - 1.0) < 1e-15:
            break
    return complex(m / y - fraction)


def line_amplitude(
    radius: float,
    ends: ArrayLike,
    wavelength: float,
    incident: ArrayLike,
    scattered: ArrayLike,
    permittivity: complex | None = None,
) -> C128:
    r"""Return the (3, 3) scattering dyad of a straight round line in the far field, m, phase about the origin.

    .. math:: D = \frac{2}{\sqrt\pi} \int e^{-j k (\hat d - \hat s) \cdot r} dl
        \left[T_{mm} \hat t_s \hat t_i + T_{ee} \hat p_s \hat p_i
        + T_{me} (\hat t_s \hat p_i - \hat p_s \hat t_i)\right]

    with p along axis x ray and t across both. On the cone of specular directions, and for TM in backscatter at any
    tilt, the current is that of the infinite cylinder; elsewhere it is taken at the tilt whose cosine is the geometric
    mean of both, which keeps the dyad reciprocal.

    Parameters
    ----------
    radius : m
    ends : (2, 3) m
    incident, scattered : (3,) directions of the incoming and of the scattered wave
    permittivity : relative; None is a perfect conductor

    Notes
    -----
    Ignores the ends (reflected currents, resonances of lengths below some wavelengths, caps).

    References
    ----------
    Ruck et al. (1970), chapter 4; Knott, Shaeffer and Tuley, Radar Cross Section, 2nd ed. (2004), chapter 6.
    """
    start, end = np.asarray(ends, dtype=np.float64)
    d, s = (np.asarray(v, dtype=np.float64) / np.linalg.norm(v) for v in (incident, scattered))
    length = float(np.linalg.norm(end - start))
    axis = (end - start) / length
    k = 2.0 * np.pi / wavelength
    cosines = [float(np.linalg.norm(np.cross(axis, v))) for v in (d, s)]
    tilt = float(np.arccos(min(1.0, np.sqrt(cosines[0] * cosines[1]))))
    flat_d, flat_s = ((v - axis * (v @ axis)) / c for v, c in zip((d, s), cosines, strict=True))
    azimuth = float(np.arctan2(np.cross(flat_d, flat_s) @ axis, flat_d @ flat_s))
    mean = 0.5 * float((d + s) @ axis)
    mm, ee, me = cylinder_series(k * radius, tilt, azimuth, permittivity)
    if tilt > 0.0:
        me = me * (mean / np.sin(tilt))
    p_i, p_s = (np.cross(axis, v) / c for v, c in zip((d, s), cosines, strict=True))
    t_i, t_s = ((axis - v * (v @ axis)) / c for v, c in zip((d, s), cosines, strict=True))
    phase = -k * (d - s)
    pattern = length * np.sinc(float(phase @ axis) * length / (2.0 * np.pi))
    pattern = pattern * np.exp(1j * float(phase @ (0.5 * (start + end))))
    dyad = mm * np.outer(t_s, t_i) + ee * np.outer(p_s, p_i) + me * (np.outer(t_s, p_i) - np.outer(p_s, t_i))
    return np.asarray(2.0 / np.sqrt(np.pi) * pattern * dyad)


def thin_wire_rcs(
    length: float, radius: float, wavelength: float, tilt: ArrayLike = 0.0, turn: ArrayLike = 0.0
) -> F64:
    r"""Return the co-polar RCS of a thin straight wire, m^2.

    .. math:: \sigma = \frac{\pi L^2 \cos^2\psi\, \mathrm{sinc}^2(k L \sin\psi) \cos^4\tau}
        {(\pi / 2)^2 + \ln^2(\lambda / (\gamma \pi a \cos\psi))}, \quad \gamma = 1.781

    Parameters
    ----------
    length, radius, wavelength : m
    tilt : psi, rad, off broadside
    turn : tau, rad, of the electric field off the plane of wire and ray

    Notes
    -----
    For :math:`k a \ll 1` and lengths of several wavelengths. The factor :math:`\cos^2\psi` of the handbook is one over
    the main lobe; the infinite cylinder's current (``line_amplitude``) has none.

    References
    ----------
    Chu, in Ruck et al. (1970), section 4.3; Knott, Shaeffer and Tuley (2004), equation 6.30.
    """
    psi, tau = np.asarray(tilt, dtype=np.float64), np.asarray(turn, dtype=np.float64)
    c = np.cos(psi)
    sinc = np.sinc(2.0 * length / wavelength * np.sin(psi))
    log = np.log(wavelength / (EULER * np.pi * radius * c))
    return np.asarray(np.pi * (length * c * sinc * np.cos(tau) ** 2) ** 2 / ((np.pi / 2.0) ** 2 + log**2))


def thin_wire_moments(
    length: float, radius: float, wavelength: float, tilt: ArrayLike = 0.0, per_wavelength: int = 40
) -> C128:
    r"""Return sqrt(sigma) of a thin straight wire, ends and all, by the method of moments, m, phase about its middle.

    The reduced-kernel integral equation for the current with piecewise sinusoids of half width h as basis and as test,
    whose field at the wire's surface is

    .. math:: E_z = -\frac{j \eta I}{4 \pi \sin k h} \left[\frac{e^{-j k r_1}}{r_1} + \frac{e^{-j k r_2}}{r_2}
        - 2 \cos k h \frac{e^{-j k r_0}}{r_0}\right]

    Parameters
    ----------
    length, radius, wavelength : m
    tilt : psi, rad, off broadside, field in the plane of wire and ray, (n,) or one
    per_wavelength : basis functions

    Returns
    -------
    (n,) complex128

    Notes
    -----
    For radii of a hundredth of a wavelength and less, much less than h. Ignores the current around the wire.

    References
    ----------
    Richmond, Proc. IEEE 53 (1965); Balanis, Advanced Engineering Electromagnetics (2012), section 12.
    """
    k, eta = 2.0 * np.pi / wavelength, 376.730313668
    n = max(round(length / wavelength * per_wavelength), 4)
    h = length / n
    middle = np.arange(1, n) * h - 0.5 * length
    node, weight = np.polynomial.legendre.leggauss(16)
    t = 0.5 * h * np.concatenate([node - 1.0, node + 1.0])
    shape = np.sin(k * (h - np.abs(t))) / np.sin(k * h) * np.tile(0.5 * h * weight, 2)

    def wave(z: F64) -> C128:
        r = np.hypot(radius, z)
        return np.asarray(np.exp(-1j * k * r) / r)

    z = np.arange(n - 1)[:, None] * h + t
    field = wave(z - h) + wave(z + h) - 2.0 * np.cos(k * h) * wave(z)
    impedance = (1j * eta / (4.0 * np.pi * np.sin(k * h)) * field * shape).sum(axis=1)
    psi = np.atleast_1d(np.asarray(tilt, dtype=np.float64))
    sine, cosine = np.sin(psi), np.cos(psi)
    each = (shape * np.exp(1j * k * sine[:, None] * t)).sum(axis=1)
    illuminated = np.exp(1j * k * np.outer(middle, sine)) * each * cosine
    current = solve_toeplitz((impedance, impedance), illuminated)
    return np.asarray(k * eta / np.sqrt(4.0 * np.pi) * (current * illuminated).sum(axis=0))


def dielectric_needle_series(ka: float, permittivity: complex) -> tuple[complex, complex]:
    r"""Return TM and TE backscatter series of a thin dielectric cylinder at broadside.

    .. math:: T_{mm} = \frac{j \pi}{4} (k a)^2 (\varepsilon - 1), \quad
        T_{ee} = -\frac{j \pi}{2} (k a)^2 \frac{\varepsilon - 1}{\varepsilon + 1}

    References
    ----------
    Van de Hulst, Light Scattering by Small Particles (1957), section 15.4 (with exp(+j w t)).
    """
    eps = complex(permittivity)
    tm = 0.25j * np.pi * ka**2 * (eps - 1.0)
    return complex(tm), complex(-2.0 * tm / (eps + 1.0))


def post_amplitude(
    radius: float,
    height: float,
    wavelength: float,
    incidence_angle: float,
    ground_permittivity: complex | None = None,
    permittivity: complex | None = None,
) -> tuple[complex, complex]:
    r"""Return sqrt(sigma) for HH and VV of an upright post on flat ground, far field, phase about its foot, m.

    .. math:: S_{pp} = D_{pp}(d, -d) + 2 R_p D_{pp}(d', -d) + R_p^2 D_{pp}(d', -d')

    with d' the ray mirrored by the ground and its field reflected with R: straight, over the ground one way (either way
    round) and both ways. In the second the line's phases are all equal: the post's dihedral,
    :math:`\sigma \approx 4 |R|^2 \cdot 2 \pi a h^2 / (\lambda \sin\theta)` for a thick one.

    Parameters
    ----------
    radius, height, wavelength : m
    incidence_angle : theta on the ground, rad
    ground_permittivity, permittivity : relative, of ground and post; None is a perfect conductor

    Notes
    -----
    Ignores the ends and the near field of the foot, with the approximations of ``line_amplitude``.

    References
    ----------
    Image theory; Fresnel coefficients of :func:`sarmitsuba.truth.theory.half_space`.
    """
    s, c = float(np.sin(incidence_angle)), float(np.cos(incidence_angle))
    down, up = np.array([s, 0.0, -c]), np.array([s, 0.0, c])
    te, tm = (-1.0, 1.0) if ground_permittivity is None else fresnel(c, ground_permittivity)
    h = np.array([0.0, 1.0, 0.0])
    # magnetic field h of one sign before and after the mirror: E = H x d
    v_down, v_up = np.cross(h, down), np.cross(h, up)
    ends = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, height]])

    def dyad(incident: F64, scattered: F64) -> C128:
        return line_amplitude(radius, ends, wavelength, incident, scattered, permittivity)

    total = []
    for near, mirrored in ((h + 0.0j, complex(te) * h), (v_down + 0.0j, complex(tm) * v_up)):
        straight = near @ dyad(down, -down) @ near
        once = near @ dyad(up, -down) @ mirrored
        twice = mirrored @ dyad(up, -up) @ mirrored
        total.append(complex(straight + 2.0 * once + twice))
    return total[0], total[1]
