"""Diffuse laws: every one becomes a table of sqrt(sigma0) against incidence angle.

The bistatic use of a table is ``sqrt(sigma0(theta_i, theta_s)) = sqrt(a(theta_i) a(theta_s))``, which is
reciprocal and returns the law itself in backscatter. ``h`` is the electric field perpendicular to the plane
of incidence, ``v`` the field parallel to it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import simpson

from sarmitsuba.errors import SceneError
from sarmitsuba.materials.fresnel import fresnel, refracted_cosine
from sarmitsuba.materials.laws.iem import Correlation, iem_backscatter, roughness_spectrum
from sarmitsuba.materials.material import Material
from sarmitsuba.units import power_from_db

F64 = NDArray[np.float64]

# Permittivity that stands for a perfect conductor where a formula needs a number: |R| = 1 to 1e-6
_CONDUCTOR = 1.0 - 1.0e12j
# Rms slopes between which geometrical optics is evaluated: a mirror below, nothing comes back above
_SLOPES = (1e-6, 1e6)
# Largest k s of the integral-equation series; its length grows with (k s)^2 and its meaning ends near 3
_LARGEST_IEM_ROUGHNESS = 100.0


@dataclass(frozen=True, eq=False)
class DiffuseTable:
    """Amplitude of a diffuse law at equal steps of the incidence angle.

    Parameters
    ----------
    theta : (n,) float64, rad, ``linspace(0, pi/2, n)``: uniform in the angle, not in its cosine
    amplitude_h, amplitude_v : (n,) float64, sqrt(sigma0) for hh and vv, sigma0 per unit of true surface area
    valid_from, valid_to : incidence angles between which the law is trusted, rad (equal: nowhere)
    notes : one line for each limit that the material leaves, for a warning; empty inside the domain
    """

    theta: F64
    amplitude_h: F64
    amplitude_v: F64
    valid_from: float
    valid_to: float
    notes: tuple[str, ...] = ()

    def sigma0(self, theta: ArrayLike) -> tuple[F64, F64]:
        """Sigma0 (linear) for hh and vv at any angles, rad, by linear interpolation of the amplitude."""
        at = np.asarray(theta, dtype=np.float64)
        h = np.interp(at, self.theta, self.amplitude_h)
        v = np.interp(at, self.theta, self.amplitude_v)
        return np.asarray(h * h), np.asarray(v * v)


@dataclass(frozen=True)
class _Law:
    """Sigma0 of both polarisations with the domain it is trusted in."""

    sigma_h: F64
    sigma_v: F64
    valid_from: float = 0.0
    valid_to: float = np.pi / 2
    notes: tuple[str, ...] = ()


def diffuse_tables(material: Material, wavelength: float, n_angles: int = 256) -> DiffuseTable:
    """Tabulate the diffuse law of a material at a wavelength.

    Parameters
    ----------
    material : with ``diffuse_law`` and the parameters that the law needs
    wavelength : m
    n_angles : number of nodes from 0 to pi/2

    Raises
    ------
    SceneError : a law from a height spectrum without a correlation length, or ``iem`` far outside any use

    Notes
    -----
    Ignores cross polarisation (the material's ratio is applied by the tracer), shadowing by the roughness
    itself and the bistatic shape of the physical laws: off the backscatter direction the geometric mean of
    the two angles stands in for it, so a Kirchhoff lobe points back at the radar but never forward.
    """
    if n_angles < 2:
        raise SceneError(f"diffuse table: n_angles = {n_angles} is too few; give 2 or more")
    theta = np.linspace(0.0, np.pi / 2, n_angles)
    if material.invisible or (not material.pec and material.permittivity == 1.0):
        law = none(theta)
    else:
        law = _LAWS[material.diffuse_law](material, wavelength, theta)
    label = f'material "{material.name}": diffuse_law = {material.diffuse_law}: '
    return DiffuseTable(
        theta=theta,
        amplitude_h=np.sqrt(law.sigma_h),
        amplitude_v=np.sqrt(law.sigma_v),
        valid_from=law.valid_from,
        valid_to=max(law.valid_from, law.valid_to),
        notes=tuple(label + note for note in law.notes),
    )


# ---------------------------------------------------------------- laws as functions of the angle


def none(theta: F64) -> _Law:
    """No diffuse return."""
    return _Law(np.zeros_like(theta), np.zeros_like(theta))


def constant_sigma0(theta: F64, sigma0: float) -> F64:
    """Sigma0 the same at every angle."""
    return np.full_like(theta, sigma0)


def constant_gamma_sigma0(theta: F64, gamma: float) -> F64:
    r""":math:`\sigma^0 = \gamma \cos\theta`: constant per unit of beam cross section."""
    return np.asarray(gamma * np.cos(theta))


def lambert_sigma0(theta: F64, albedo: ArrayLike) -> F64:
    r""":math:`\sigma^0 = 4 A \cos^2\theta`: a surface of brightness equal in all directions, albedo ``A``."""
    return np.asarray(4.0 * np.asarray(albedo) * np.cos(theta) ** 2)


def shared_energy_sigma0(theta: F64, reflectivity: F64, rms_phase: float) -> F64:
    r"""Sigma0 of Lambert-like scattering of exactly the power that roughness takes from the coherent wave.

    .. math::
        A(\theta) = |R(\theta)|^2 (1 - e^{-4 (k s \cos\theta)^2}), \quad
        \sigma^0(\theta_i, \theta_s) = 4 \cos\theta_i \cos\theta_s \frac{A(\theta_i) A(\theta_s)}{\bar A},
        \quad \bar A = 2 \int_0^{\pi/2} A \cos\theta \sin\theta\, d\theta

    Scattered over the hemisphere, this is the fraction ``A(theta_i)`` of the incident power for *every*
    incidence angle, and it is reciprocal; the mean albedo in the denominator is what makes both true at once.

    Parameters
    ----------
    theta : (n,) equally spaced from 0 to pi/2, rad
    reflectivity : (n,) |R|^2
    rms_phase : k s
    """
    c = np.cos(theta)
    albedo = reflectivity * -np.expm1(-4.0 * (rms_phase * c) ** 2)
    mean = float(simpson(2.0 * albedo * c * np.sin(theta), x=theta))
    return 4.0 * c**2 * albedo**2 / mean if mean > 0.0 else np.zeros_like(theta)


def geometrical_optics_sigma0(theta: F64, normal_reflectivity: float, slope: float) -> F64:
    r"""Kirchhoff model in the stationary-phase (geometrical optics) limit, the same for hh and vv.

    .. math:: \sigma^0 = \frac{|R(0)|^2 e^{-\tan^2\theta / (2 m^2)}}{2 m^2 \cos^4\theta}

    ``slope`` is m, the rms slope along one direction. Source: Ulaby, Moore and Fung, Microwave Remote
    Sensing, volume II (1982), chapter 12.
    """
    c = np.maximum(np.cos(theta), 1e-12)
    m2 = float(np.clip(slope, *_SLOPES)) ** 2
    exponent = -((np.sin(theta) / c) ** 2) / (2.0 * m2) - 4.0 * np.log(c)
    return np.asarray(normal_reflectivity * np.exp(exponent) / (2.0 * m2))


def small_perturbation_sigma0(
    theta: F64,
    permittivity: complex,
    wavenumber: float,
    rms_height: float,
    correlation_length: float,
    correlation: Correlation = "exponential",
) -> tuple[F64, F64]:
    r"""First-order small-perturbation model, hh and vv.

    .. math::
        \sigma^0_{pp} = 8 k^4 s^2 \cos^4\theta |\alpha_{pp}|^2 W(2 k \sin\theta), \quad
        \alpha_{hh} = R_{TE}, \quad
        \alpha_{vv} = (\varepsilon - 1) \frac{\sin^2\theta - \varepsilon (1 + \sin^2\theta)}
        {(\varepsilon \cos\theta + q)^2}

    Source: Ulaby, Moore and Fung, Microwave Remote Sensing, volume II (1982), chapter 12. W as in
    ``roughness_spectrum`` with n = 1.
    """
    c, sin2 = np.cos(theta), np.sin(theta) ** 2
    q = refracted_cosine(c, permittivity)
    alpha_h, _ = fresnel(c, permittivity)
    alpha_v = (permittivity - 1.0) * (sin2 - permittivity * (1.0 + sin2)) / (permittivity * c + q) ** 2
    first = np.ones(1)
    spectrum = np.array(
        [
            roughness_spectrum(first, 2.0 * wavenumber * float(np.sin(t)), correlation_length, correlation)[0]
            for t in theta
        ]
    )
    common = 8.0 * wavenumber**4 * rms_height**2 * spectrum
    return common * np.abs(c**2 * alpha_h) ** 2, common * np.abs(c**2 * alpha_v) ** 2


# ---------------------------------------------------------------- laws of a material


def _none(material: Material, wavelength: float, theta: F64) -> _Law:
    return none(theta)


def _constant(material: Material, wavelength: float, theta: F64) -> _Law:
    sigma = constant_sigma0(theta, float(power_from_db(material.diffuse_level_db)))
    return _Law(sigma, sigma)


def _constant_gamma(material: Material, wavelength: float, theta: F64) -> _Law:
    gamma = float(power_from_db(material.diffuse_level_db))
    sigma = constant_gamma_sigma0(theta, gamma)
    notes = []
    # gamma sqrt(cos_i cos_s) over the hemisphere is gamma / 3 of the power that arrives at normal incidence
    if gamma > 3.0:
        notes.append(
            f"diffuse_level_db = {material.diffuse_level_db:g} dB returns more power than arrives; "
            "give at most 4.77 dB"
        )
    return _Law(sigma, sigma, notes=tuple(notes))


def _lambert(material: Material, wavelength: float, theta: F64) -> _Law:
    albedo = float(power_from_db(material.diffuse_level_db)) / 4.0
    sigma = lambert_sigma0(theta, albedo)
    notes = []
    if albedo > 1.0 + 1e-9:
        notes.append(
            f"diffuse_level_db = {material.diffuse_level_db:g} dB is an albedo of {albedo:.3g}, above 1; "
            "give at most 6.02 dB"
        )
    return _Law(sigma, sigma, notes=tuple(notes))


def _roughness(material: Material, wavelength: float, theta: F64) -> _Law:
    rms_phase = 2.0 * np.pi / wavelength * material.rms_height
    if material.rms_height == 0.0:
        return none(theta)
    if material.pec:
        ones = np.ones_like(theta)
        sigma = shared_energy_sigma0(theta, ones, rms_phase)
        return _Law(sigma, sigma)
    te, tm = fresnel(np.cos(theta), material.permittivity)
    return _Law(
        shared_energy_sigma0(theta, np.abs(te) ** 2, rms_phase),
        shared_energy_sigma0(theta, np.abs(tm) ** 2, rms_phase),
    )


def _kirchhoff(material: Material, wavelength: float, theta: F64) -> _Law:
    length = _correlation_length(material)
    k, s = 2.0 * np.pi / wavelength, material.rms_height
    if s == 0.0:
        return none(theta)
    slope = np.sqrt(2.0) * s / length  # Gaussian correlation exp(-r^2/l^2)
    notes = []
    largest_cos = np.sqrt(10.0) / (2.0 * k * s)  # (2 k s cos)^2 > 10
    if largest_cos > 1.0:
        notes.append(
            f"(2 k s)^2 = {(2 * k * s) ** 2:.3g} is below 10, not rough enough for geometrical optics; "
            "use iem or small_perturbation"
        )
    if k * length < 6.0:
        notes.append(f"k l = {k * length:.3g} is below 6; use iem")
    if length**2 < 2.76 * s * wavelength:
        notes.append(
            f"l^2 = {length**2:.3g} m^2 is below 2.76 s lambda = {2.76 * s * wavelength:.3g} m^2, it curves "
            "too sharply for tangent planes; use iem"
        )
    if slope < 2.0 * (theta[1] - theta[0]):
        notes.append(
            f"rms slope {slope:.3g} is a lobe narrower than two steps of the table, "
            f"{2 * np.degrees(theta[1]):.2g} deg; "
            "raise rms_height, shorten correlation_length or use no diffuse law"
        )
    reflectivity = 1.0 if material.pec else float(np.abs(fresnel(1.0, material.permittivity)[0]) ** 2)
    sigma = geometrical_optics_sigma0(theta, reflectivity, slope)
    return _Law(sigma, sigma, 0.0, float(np.arccos(min(1.0, largest_cos))), tuple(notes))


def _small_perturbation(material: Material, wavelength: float, theta: F64) -> _Law:
    length = _correlation_length(material)
    k, s = 2.0 * np.pi / wavelength, material.rms_height
    if s == 0.0:
        return none(theta)
    notes = []
    if k * s > 0.3:
        notes.append(f"k s = {k * s:.3g} is above 0.3; use iem, or kirchhoff for a very rough surface")
    if np.sqrt(2.0) * s / length > 0.3:
        notes.append(f"rms slope {np.sqrt(2.0) * s / length:.3g} is above 0.3; lengthen correlation_length")
    sigma_h, sigma_v = small_perturbation_sigma0(theta, _permittivity(material), k, s, length)
    # Bragg scattering leaves out the quasi-specular lobe about the vertical
    return _Law(sigma_h, sigma_v, np.radians(15.0), np.radians(75.0), tuple(notes))


def _iem(material: Material, wavelength: float, theta: F64) -> _Law:
    length = _correlation_length(material)
    k, s = 2.0 * np.pi / wavelength, material.rms_height
    if k * s < 1e-12:  # returns less than -240 dB
        return none(theta)
    if k * s > _LARGEST_IEM_ROUGHNESS:
        raise SceneError(
            f'material "{material.name}": rms_height = {s:g} m is k s = {k * s:.3g}, above '
            f"{_LARGEST_IEM_ROUGHNESS:g}, where the integral-equation model means nothing; "
            "set diffuse_law to kirchhoff or lambert"
        )
    notes = []
    if k * s > 3.0:
        notes.append(f"k s = {k * s:.3g} is above 3; use kirchhoff or lambert")
    if s / length > 0.4:
        notes.append(
            f"s / l = {s / length:.3g} is above 0.4, multiple scattering matters; lengthen correlation_length"
        )
    grazing = theta > np.radians(89.99)  # the formula has a removable 0/0 at 90 degrees, where sigma0 is zero
    sigma_h, sigma_v = np.zeros_like(theta), np.zeros_like(theta)
    h, v = iem_backscatter(theta[~grazing], _permittivity(material), k, s, length)
    sigma_h[~grazing], sigma_v[~grazing] = h, v
    return _Law(sigma_h, sigma_v, 0.0, np.radians(70.0), tuple(notes))


def _permittivity(material: Material) -> complex:
    return _CONDUCTOR if material.pec else material.permittivity


def _correlation_length(material: Material) -> float:
    if not material.correlation_length > 0.0:
        raise SceneError(
            f'material "{material.name}": correlation_length = {material.correlation_length:g} m must be '
            f"above 0 for diffuse_law = {material.diffuse_law}; "
            "give the correlation length of the surface height"
        )
    return material.correlation_length


_LAWS: dict[str, Callable[[Material, float, F64], _Law]] = {
    "none": _none,
    "constant": _constant,
    "constant_gamma": _constant_gamma,
    "lambert": _lambert,
    "roughness": _roughness,
    "kirchhoff": _kirchhoff,
    "small_perturbation": _small_perturbation,
    "iem": _iem,
}

__all__ = [
    "DiffuseTable",
    "constant_gamma_sigma0",
    "constant_sigma0",
    "diffuse_tables",
    "geometrical_optics_sigma0",
    "lambert_sigma0",
    "shared_energy_sigma0",
    "small_perturbation_sigma0",
]
